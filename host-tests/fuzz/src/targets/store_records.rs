//! A slot of the store.

use super::samples::record;
use super::stable_bytes;
use crate::reference::crc_32;
use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use rins_selfcal::keep::frame::Damage;
use rins_selfcal::keep::record::{SLOT_BYTES, decode, encode};

const HEADER_BYTES: usize = 12;
const CRC_BYTES: usize = 4;

/// Contents of a slot. Missing bytes are blank.
pub struct Records(Vec<Vec<u8>>);

impl Records {
    /// The good records to damage.
    pub fn new() -> Self {
        let slot = |number| {
            let mut slot = [0; SLOT_BYTES];
            let used = encode(&mut slot, 0xffff_fff0 + number, &record(number)).expect("it fits");
            slot[..used].to_vec()
        };
        Self((0..4).map(slot).collect())
    }
}

impl Target for Records {
    fn name(&self) -> &'static str {
        "store-records"
    }

    fn moment(&self) -> u64 {
        4_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        input.extend(source.pick(&self.0));
        match source.below(4) {
            0 => {
                let (sequence, record) = decode(&slot(input)).expect("a good record");
                Claim::Value(digest((sequence, stable_bytes(&record))))
            }
            1 => {
                // A CRC-32 detects any three wrong bits in 91 607 bits or fewer.
                let count = 1 + source.below(3);
                source.flip(input, count);
                Claim::Refused
            }
            2 => {
                source.damage(input);
                Claim::Nothing
            }
            _ => {
                // A record from an attacker: length and CRC are right.
                let mut payload = input[HEADER_BYTES..input.len() - CRC_BYTES].to_vec();
                source.damage(&mut payload);
                payload.truncate(SLOT_BYTES - HEADER_BYTES - CRC_BYTES);
                input.truncate(HEADER_BYTES - 4);
                input[3] = *source.pick(b"124556");
                input.extend((payload.len() as u32).to_le_bytes());
                input.extend(payload);
                input.extend(crc_32(input).to_le_bytes());
                Claim::Nothing
            }
        }
    }

    /// A slot with a wrong frame is refused. A decoded record encodes to the same bytes, and its reasons can be
    /// printed.
    fn judge(&self, input: &[u8]) -> Outcome {
        let slot = slot(input);
        let decoded = decode(&slot);
        let length = u32::from_le_bytes([slot[8], slot[9], slot[10], slot[11]]) as usize;
        let framed = slot.get(..HEADER_BYTES.saturating_add(length));
        let crc = framed.and_then(|framed| slot[framed.len()..].first_chunk());
        let is_whole = framed.zip(crc).is_some_and(|(framed, crc)| crc_32(framed).to_le_bytes() == *crc);
        let sound = slot.starts_with(b"RSC") && is_whole;
        assert_eq!(sound, matches!(decoded, Ok(_) | Err(Damage::Version(_) | Damage::Payload)), "{decoded:?}");
        match decoded {
            Ok((sequence, record)) => {
                assert!(record.reasons().all(|reason| !reason.to_string().contains('\n')));
                let mut again = [0; SLOT_BYTES];
                if encode(&mut again, sequence, &record).is_some() {
                    let (number, same) = decode(&again).expect("what was encoded");
                    assert_eq!((number, stable_bytes(&same)), (sequence, stable_bytes(&record)));
                }

                Outcome::accepted("record", (sequence, stable_bytes(&record)))
            }
            Err(Damage::Magic) => Outcome::refused("magic"),
            Err(Damage::Version(_)) => Outcome::refused("version"),
            Err(Damage::Length(_)) => Outcome::refused("length"),
            Err(Damage::Crc) => Outcome::refused("crc"),
            Err(Damage::Payload) => Outcome::refused("payload"),
            Err(damage) => panic!("{damage:?}"),
        }
    }
}

fn slot(bytes: &[u8]) -> [u8; SLOT_BYTES] {
    std::array::from_fn(|index| bytes.get(index).copied().unwrap_or(0xff))
}
