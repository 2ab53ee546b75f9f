//! The encoder driver on captures of its line.

use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use host_tests::bench::chips::biss::BissChip;
use host_tests::bench::chips::exchange;
use rins_selfcal::base::angle::Angle;
use rins_selfcal::drivers::biss::{BissEncoder, BissFault, CAPTURE_BYTES, Mounting, Resolution};
use std::convert::Infallible;
use std::f64::consts::TAU;

const CAPTURE_BITS: usize = 8 * CAPTURE_BYTES;

/// The number of position bits, then the captures of consecutive reads.
pub struct Biss;

impl Target for Biss {
    fn name(&self) -> &'static str {
        "biss"
    }

    fn moment(&self) -> u64 {
        60_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        let (bits, resolution) = *source.pick(&[(26, 0), (32, 1)]);
        let chip = BissChip {
            acknowledge: 1 + source.below(if bits == 26 { 58 } else { 52 }) as u32,
            timeout: source.below(40) as u32,
            error: source.one_in(16),
            warning: source.one_in(8),
            ..BissChip::new(bits)
        };
        let position = (source.bits() >> (64 - bits)) as u32;
        let mut capture = [0; CAPTURE_BYTES];
        chip.clock(f64::from(position) / 2_f64.powi(bits as i32) * TAU, &mut capture);
        let value = digest(position << (32 - bits));
        input.push(resolution);
        // The previous read shows where the frame begins.
        if source.one_in(2) {
            input.extend(capture);
        }
        let content = 2 + chip.acknowledge as usize + 2;
        match source.below(4) {
            0 => {
                input.extend(capture);
                if chip.error { Claim::Refused } else { Claim::Value(value) }
            }
            1 => {
                let count = 1 + source.below(2);
                flip_within(source, &mut capture, content..content + bits as usize + 8, count);
                input.extend(capture);
                Claim::Refused
            }
            2 => {
                source.flip(&mut capture, 1);
                input.extend(capture);
                // Without the previous read a displaced frame may be accepted.
                if input.len() > 1 + CAPTURE_BYTES { Claim::NotOther(value) } else { Claim::Nothing }
            }
            _ => {
                let mut damaged = capture.to_vec();
                source.damage(&mut damaged);
                damaged.resize(CAPTURE_BYTES, 0xff);
                input.extend(damaged);
                Claim::Nothing
            }
        }
    }

    fn judge(&self, input: &[u8]) -> Outcome {
        let (resolution, captures) = input.split_first().unwrap_or((&0, &[]));
        let (bits, resolution) = if resolution % 2 == 0 { (26, Resolution::Bits26) } else { (32, Resolution::Bits32) };
        let captures = captures.as_chunks::<CAPTURE_BYTES>().0;
        let mut encoder = BissEncoder::new(Line(captures.iter()), resolution, Mounting::STRAIGHT);
        let (mut start, mut outcome) = (None, Outcome::refused("nothing"));
        for capture in captures {
            let read = encoder.read();
            assert_eq!(read, expected(capture, bits, &mut start));
            outcome = match read {
                Ok(angle) => Outcome::accepted("angle", angle.ticks()),
                Err(BissFault::NoAnswer) => Outcome::refused("no-answer"),
                Err(BissFault::NotReady) => Outcome::refused("not-ready"),
                Err(BissFault::Framing) => Outcome::refused("framing"),
                Err(BissFault::Crc) => Outcome::refused("crc"),
                Err(BissFault::Error) => Outcome::refused("error"),
                Err(BissFault::Bus(never)) => match never {},
            };
        }
        outcome
    }
}

/// Inverts `count` different bits of a range.
fn flip_within(source: &mut Source, bytes: &mut [u8], range: std::ops::Range<usize>, count: usize) {
    let first = source.below(range.len());
    // Another one, wherever the first is.
    let second = (first + 1 + source.below(range.len() - 1)) % range.len();
    for bit in [first, second].into_iter().take(count).map(|bit| range.start + bit) {
        bytes[bit / 8] ^= 0x80 >> (bit % 8);
    }
}

/// The expected result of a read, decoded bit by bit as the protocol says.
fn expected(
    capture: &[u8; CAPTURE_BYTES],
    bits: usize,
    before: &mut Option<usize>,
) -> Result<Angle, BissFault<Infallible>> {
    let line: Vec<bool> = (0..CAPTURE_BITS).map(|bit| capture[bit / 8] & 0x80 >> (bit % 8) != 0).collect();
    let low = line.iter().position(|high| !high).ok_or(BissFault::NoAnswer)?;
    let start = (low..CAPTURE_BITS).find(|bit| line[*bit]).filter(|_| low > 0).ok_or(BissFault::NotReady)?;
    let content = start + 2;
    let (crc, end) = (content + bits + 2, content + bits + 8);
    if end > CAPTURE_BITS || line[start + 1] || !line[end..].is_sorted() {
        return Err(BissFault::Framing);
    }
    let number = |range: std::ops::Range<usize>| line[range].iter().fold(0_u64, |sum, bit| sum << 1 | u64::from(*bit));
    let remainder = line[content..crc].iter().fold(0_u64, |rest, bit| {
        let shifted = rest << 1 ^ if (rest >> 5 & 1 == 1) == *bit { 0 } else { 0x43 };
        shifted & 0x3f
    });
    if number(crc..end) != !remainder & 0x3f {
        return Err(BissFault::Crc);
    }
    let jump = before.replace(start).unwrap_or(start).abs_diff(start);
    match (jump, line[crc - 2]) {
        (2.., _) => Err(BissFault::Framing),
        (_, false) => Err(BissFault::Error),
        _ => Ok(Angle::from_ticks((number(content..crc - 2) << (32 - bits)) as u32)),
    }
}

/// A bus that delivers captures.
struct Line<'c>(std::slice::Iter<'c, [u8; CAPTURE_BYTES]>);

impl ErrorType for Line<'_> {
    type Error = Infallible;
}

impl SpiDevice for Line<'_> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let capture = self.0.next().expect("a capture for each read");
        exchange(operations, |bytes| bytes.copy_from_slice(capture));
        Ok(())
    }
}
