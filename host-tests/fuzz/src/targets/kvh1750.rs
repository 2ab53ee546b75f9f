//! The byte stream of a KVH 1750.

use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use crc::{CRC_32_MPEG_2, Crc, Table};
use host_tests::bench::chips::kvh1750::Kvh1750Chip;
use rins_selfcal::drivers::kvh1750::{ALL_VALID, HEADER, Kvh1750, Kvh1750Settings, MESSAGE_BYTES};
use rins_selfcal::drivers::{ImuFault, ImuReading};

static CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_MPEG_2);

/// A stream of bytes.
pub struct Stream;

/// Content of a message: the bits of its numbers and its status, or nothing if its CRC is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
enum Found {
    Reading([u32; 6]),
    Status(u8),
    Crc,
}

impl Target for Stream {
    fn name(&self) -> &'static str {
        "kvh1750"
    }

    fn moment(&self) -> u64 {
        40_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        match source.below(4) {
            0 => {
                input.extend(message(source));
                let (found, _) = scanned(input);
                let is_reading = matches!(found[..], [Found::Reading(_)]);
                if is_reading { Claim::Value(digest(found)) } else { Claim::Refused }
            }
            1 => {
                input.extend(message(source));
                // A CRC-32 detects any five wrong bits in 268 bits or fewer, not counting the 32 bits of the CRC.
                let count = 1 + source.below(5);
                source.flip(input, count);
                Claim::Refused
            }
            _ => {
                for _ in 0..=source.below(3) {
                    let mut piece = message(source);
                    match source.below(4) {
                        0 => piece = source.noise(50),
                        1 => piece.truncate(source.below(MESSAGE_BYTES)),
                        2 => source.damage(&mut piece),
                        _ => {}
                    }
                    input.extend(piece);
                }
                Claim::Nothing
            }
        }
    }

    /// The driver finds the same messages as a search through the whole stream. Every byte belongs to a message or is
    /// counted. Two messages follow the stream, and the second of them is always read.
    fn judge(&self, input: &[u8]) -> Outcome {
        let mut unit = Kvh1750::new(&Kvh1750Settings::default());
        let found = pushed(&mut unit, input);
        let (expected, dropped) = scanned(input);
        assert_eq!(found, expected);
        assert_eq!(unit.discarded().bytes as usize, dropped);
        let next = Kvh1750Chip::default().message([0.25; 3], [9.806_65; 3], 20.0);
        let next = [&next[..], &next].concat();
        assert_eq!(pushed(&mut unit, &next).last(), scanned(&next).0.last(), "out of step");
        let accepted = found.iter().any(|found| matches!(found, Found::Reading(_)));
        let name = match found.last() {
            None => "nothing",
            Some(Found::Reading(_)) => "reading",
            Some(Found::Status(ALL_VALID)) => "not-finite",
            Some(Found::Status(_)) => "status",
            Some(Found::Crc) => "crc",
        };
        if accepted { Outcome::accepted(name, &found) } else { Outcome::refused(name) }
    }
}

fn message(source: &mut Source) -> Vec<u8> {
    let mut chip = Kvh1750Chip::default();
    chip.invalid = if source.one_in(8) { source.byte() } else { 0 };
    let mut number = || if source.one_in(64) { f64::INFINITY } else { source.bits() as f64 / 1e18 - 9.0 };
    let [omega, force] = [(); 2].map(|()| [number(), number(), number()]);
    (0..source.below(3)).for_each(|_| drop(chip.message(omega, force, 20.0)));
    chip.message(omega, force, 20.0)
}

fn pushed(unit: &mut Kvh1750, bytes: &[u8]) -> Vec<Found> {
    let found = |byte: &u8| {
        Some(match unit.push::<f64>(*byte, 1_000_000)? {
            Ok(ImuReading { omega_g, force_a, .. }) => {
                let omega = [omega_g.x, omega_g.y, omega_g.z].map(|x| (x as f32).to_bits());
                let force = [force_a.x, force_a.y, force_a.z].map(|x| ((x / 9.806_65) as f32).to_bits());
                Found::Reading([omega[0], omega[1], omega[2], force[0], force[1], force[2]])
            }
            Err(ImuFault::Status(status)) => Found::Status(status as u8),
            Err(ImuFault::Crc) => Found::Crc,
            Err(fault) => panic!("{fault:?}"),
        })
    };
    bytes.iter().filter_map(found).collect()
}

/// The messages in the bytes, searched from the first byte on, and the number of bytes that belong to no message.
fn scanned(bytes: &[u8]) -> (Vec<Found>, usize) {
    let (mut found, mut at, mut dropped) = (Vec::new(), 0, 0);
    while at < bytes.len() {
        let rest = &bytes[at..];
        let head = &rest[..rest.len().min(HEADER.len())];
        if HEADER.starts_with(head) {
            let Some(message) = rest.first_chunk::<MESSAGE_BYTES>() else { break };
            if CRC.checksum(&message[..32]).to_be_bytes() == message[32..] {
                found.push(content(message));
                at += MESSAGE_BYTES;
                continue;
            }
            found.push(Found::Crc);
        }
        (at, dropped) = (at + 1, dropped + 1);
    }
    (found, dropped)
}

fn content(message: &[u8; MESSAGE_BYTES]) -> Found {
    let numbers: [f32; 6] =
        std::array::from_fn(|index| f32::from_be_bytes(std::array::from_fn(|byte| message[4 + 4 * index + byte])));
    let status = message[28];
    if status != ALL_VALID || numbers.iter().any(|number| !number.is_finite()) {
        return Found::Status(status);
    }
    Found::Reading(numbers.map(f32::to_bits))
}
