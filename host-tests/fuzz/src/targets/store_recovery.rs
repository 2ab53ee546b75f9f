//! A complete store in a damaged EEPROM. The newest undamaged record of an accepted calibration must be found, and a
//! new record can be saved.

use super::samples::record;
use super::{bytes_of, stable_bytes};
use crate::source::Source;
use crate::target::{Claim, Outcome, Target};
use host_tests::bench::memory::VirtualEeprom;
use rins_selfcal::keep::medium::Eeprom;
use rins_selfcal::keep::record::{SLOT_BYTES, decode};
use rins_selfcal::keep::slots::StoreError;
use rins_selfcal::keep::store::{CalibrationStore, Loaded};
use rins_selfcal::run::result::{StoredCalibration, StoredVerdict};
use rins_selfcal::verdict::{Reason, Verdict};

const EEPROM_BYTES: usize = 8192;
const STEP_BYTES: usize = 4;

/// Steps of damage to a store with a history. Each step has four bytes: the kind of damage, and its place or value.
pub struct Recovery(Vec<u8>);

impl Recovery {
    /// A store whose ring of slots has wrapped around.
    pub fn new() -> Self {
        let mut store = CalibrationStore::new(Eeprom(VirtualEeprom::blank(EEPROM_BYTES)));
        for number in 0..14 {
            let record = if number % 4 == 3 { rejected(number) } else { record(number) };
            store.save(&record).expect("a good memory");
        }
        Self(store.release().0.bytes)
    }

    fn damaged(&self, steps: &[u8]) -> Vec<u8> {
        let mut bytes = self.0.clone();
        let slots = EEPROM_BYTES / SLOT_BYTES;
        for [what, high, low, value] in steps.as_chunks::<STEP_BYTES>().0 {
            let address = usize::from(u16::from_be_bytes([*high, *low])) % EEPROM_BYTES;
            let from = usize::from(*high) % slots * SLOT_BYTES;
            match what % 4 {
                0 => bytes[address] = *value,
                1 => bytes[from..from + SLOT_BYTES].fill(*value),
                2 => bytes.copy_within(from..from + SLOT_BYTES, usize::from(*low) % slots * SLOT_BYTES),
                _ => bytes[address..].iter_mut().take(usize::from(*value)).for_each(|byte| *byte ^= value | 1),
            }
        }
        bytes
    }
}

impl Target for Recovery {
    fn name(&self) -> &'static str {
        "store-recovery"
    }

    fn moment(&self) -> u64 {
        400
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        for _ in 0..source.below(16) {
            input.extend([source.bits() as u8, source.bits() as u8, source.bits() as u8, source.byte()]);
        }
        Claim::Nothing
    }

    fn judge(&self, input: &[u8]) -> Outcome {
        let bytes = self.damaged(input);
        let newest = newest(&bytes);
        let mut store = CalibrationStore::new(Eeprom(VirtualEeprom::new(bytes)));
        let loaded = store.load().expect("the memory answers");
        let outcome = match loaded {
            Loaded::Found { record, damage } => {
                assert_eq!(Some(bytes_of(&record)), newest.as_ref().map(bytes_of));
                Outcome::accepted(if damage.is_none() { "found" } else { "found-beside-damage" }, stable_bytes(&record))
            }
            Loaded::Empty | Loaded::Corrupt { .. } => {
                assert!(newest.is_none());
                Outcome::refused(if loaded == Loaded::Empty { "empty" } else { "corrupt" })
            }
        };
        save_on(store, newest.as_ref());
        outcome
    }
}

/// A saved record is found after a reboot. If the store refuses it because a record of newer software exists, the old
/// record is still found.
fn save_on(mut store: CalibrationStore<Eeprom<VirtualEeprom>>, newest: Option<&StoredCalibration>) {
    let new = record(99);
    let expected = match store.save(&new) {
        Ok(_) => Some(&new),
        Err(StoreError::Newer(_)) => newest,
        Err(error) => panic!("{error:?}"),
    };
    let found = match CalibrationStore::new(store.release()).load().expect("the memory answers") {
        Loaded::Found { record, .. } => Some(record),
        Loaded::Empty | Loaded::Corrupt { .. } => None,
    };
    assert_eq!(found.as_ref().map(bytes_of), expected.map(bytes_of), "after a save");
}

/// The newest record of all undamaged slots with an accepted record.
fn newest(bytes: &[u8]) -> Option<StoredCalibration> {
    let slots = bytes.as_chunks::<SLOT_BYTES>().0;
    let good = slots.iter().filter_map(|slot| decode(slot).ok()).filter(|(_, record)| record.verdict.accepted());
    good.max_by_key(|(sequence, _)| *sequence).map(|(_, record)| record)
}

fn rejected(number: u32) -> StoredCalibration {
    let verdict = Verdict { reasons: [Reason::TooFewSegments(2)].into_iter().collect(), ..Verdict::default() };
    StoredCalibration { verdict: StoredVerdict::new(&verdict), ..record(number) }
}
