//! The calibration store on virtual memories: power cuts at every byte, word and erasure, stuck cells, bit rot, old and
//! new versions. Each exhaustive test prints its number of cases.

use crc::{CRC_32_ISO_HDLC, Crc};
use host_tests::bench::memory::{MemoryFault, Power, Stuck, Torn, VirtualEeprom, VirtualFlash};
use rayon::prelude::*;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::site::Site;
use rins_selfcal::instrument::{Archive, FoundRecord};
use rins_selfcal::keep::frame::Damage;
use rins_selfcal::keep::medium::{Eeprom, Flash, Medium};
use rins_selfcal::keep::record::{FORMAT_VERSION, HISTORY, SLOT_BYTES, encode};
use rins_selfcal::keep::slots::StoreError;
use rins_selfcal::keep::store::{CalibrationStore, Loaded, Piece, REJECTED_IN_A_ROW, Wanted};
use rins_selfcal::model::error_model::InstrumentErrors;
use rins_selfcal::run::result::{StoredCalibration, StoredVerdict};
use rins_selfcal::verdict::{Reason, Verdict};
use std::ops::Range;

#[path = "storage/journals.rs"]
mod journals;

/// A virtual memory under a store.
trait Virtual: Medium<Error = MemoryFault> + Clone + Send + Sync {
    fn blank() -> Self;
    fn power(&mut self) -> &mut Power;
    fn bytes(&mut self) -> &mut Vec<u8>;
    fn stick(&mut self, stuck: Stuck);
}

impl Virtual for Eeprom<VirtualEeprom> {
    fn blank() -> Self {
        Self(VirtualEeprom::blank(8192))
    }
    fn power(&mut self) -> &mut Power {
        &mut self.0.power
    }
    fn bytes(&mut self) -> &mut Vec<u8> {
        &mut self.0.bytes
    }
    fn stick(&mut self, stuck: Stuck) {
        self.0.stuck = stuck;
    }
}

/// A flash with two or three sectors for the store. The sector before them belongs to another part of the program.
impl<const WORD: usize, const SECTOR: usize> Virtual for Flash<VirtualFlash<WORD, SECTOR>> {
    fn blank() -> Self {
        let sectors = if SECTOR > 4096 { 2 } else { 3 };
        let mut flash = VirtualFlash::blank(1 + sectors);
        flash.bytes[..SECTOR].fill(0x5a);
        Self::new(flash, SECTOR as u32..(SECTOR * (1 + sectors)) as u32)
    }
    fn power(&mut self) -> &mut Power {
        &mut self.flash().power
    }
    fn bytes(&mut self) -> &mut Vec<u8> {
        &mut self.flash().bytes
    }
    fn stick(&mut self, stuck: Stuck) {
        self.flash().stuck = stuck;
    }
}

/// An EEPROM of 8 KiB, such as a 24x64.
type Pages = Eeprom<VirtualEeprom>;
/// The flash of an STM32H743: words of 32 bytes, sectors of 128 KiB; two of them.
type Internal = Flash<VirtualFlash<32, 131_072>>;
/// A serial flash: words of 4 bytes, sectors of 4 KiB; three of them.
type Serial = Flash<VirtualFlash<4, 4096>>;

fn record(number: u32) -> StoredCalibration {
    let value = |index: usize| f64::from(number) + 1e-3 * index as f64;
    StoredCalibration {
        errors: InstrumentErrors { heading: f64::from(number), mounting: [1e-3; 3], ..InstrumentErrors::default() },
        sigmas: std::array::from_fn(value),
        method: Method::Bai,
        scheme: "bai".parse().unwrap(),
        site: Site::default(),
        utc_s: Some(1_790_000_000 + u64::from(number)),
        temperature_c: 35.5,
        chi_square: 81.2,
        degrees_of_freedom: number,
        software_version: env!("CARGO_PKG_VERSION").parse().unwrap(),
        verdict: StoredVerdict::default(),
        imu: Some(ImuIdentity { product: 16_495, serial: 100 + number }),
    }
}

fn rejected(number: u32) -> StoredCalibration {
    let reasons = [Reason::Refused(number), Reason::TooFewSegments(2)].into_iter().collect();
    let verdict = StoredVerdict::new(&Verdict { reasons, more: 1, ..Verdict::default() });
    StoredCalibration { verdict, ..record(number) }
}

fn saved<M: Virtual>(count: u32) -> CalibrationStore<M> {
    let mut store = CalibrationStore::new(M::blank());
    (0..count).for_each(|number| assert_eq!(store.save(&record(number)), Ok(0)));
    store
}

/// The same memory after power-up.
fn rebooted<M: Virtual>(store: CalibrationStore<M>) -> CalibrationStore<M> {
    let mut memory = store.release();
    memory.power().on();
    CalibrationStore::new(memory)
}

fn number(record: &StoredCalibration) -> u32 {
    record.degrees_of_freedom
}

/// Number of the newest record after power-up. Checks that this record and those before it are intact.
fn newest<M: Virtual>(store: &mut CalibrationStore<M>) -> Option<u32> {
    let newest = match store.load().expect("a memory that works") {
        Loaded::Found { record: found, .. } => {
            assert_eq!(found, record(number(&found)));
            number(&found)
        }
        Loaded::Empty | Loaded::Corrupt { .. } => return None,
    };
    for back in 0..HISTORY.min(1 + newest as usize) {
        let (_, entry) = store.entry(back).expect("a memory that works").expect("an entry");
        assert_eq!(entry, record(newest - back as u32), "{back} before {newest}");
    }
    Some(newest)
}

#[test]
fn blank_memory_is_empty_and_the_newest_record_is_found() {
    fn check<M: Virtual>() {
        assert_eq!(saved::<M>(0).load(), Ok(Loaded::Empty));
        for count in 1..140 {
            let mut store = rebooted(saved::<M>(count));
            assert_eq!(newest(&mut store), Some(count - 1));
            assert_eq!(store.damaged(), 0);
            let entries = store.entries().unwrap();
            assert!(entries >= HISTORY.min(count as usize));
            assert_eq!(store.entry(entries), Ok(None));
            assert!((0..entries).all(|back| matches!(store.entry(back), Ok(Some(_)))));
        }
    }
    check::<Pages>();
    check::<Internal>();
    check::<Serial>();
}

/// An EEPROM that counts the bytes that are read.
struct Counted {
    eeprom: Pages,
    read: usize,
}

impl Medium for Counted {
    type Error = <Pages as Medium>::Error;
    const ERASE_BYTES: Option<usize> = Pages::ERASE_BYTES;
    const READ_FAULT_IS_DAMAGE: bool = Pages::READ_FAULT_IS_DAMAGE;

    fn capacity(&self) -> usize {
        self.eeprom.capacity()
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.read += bytes.len();
        self.eeprom.read(address, bytes)
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.eeprom.write(address, bytes)
    }

    fn erase(&mut self, address: u32, length: usize) -> Result<(), Self::Error> {
        self.eeprom.erase(address, length)
    }
}

/// Reads a record piece by piece. Returns the number of pieces and the number of the record.
fn in_pieces(store: &mut CalibrationStore<Counted>, wanted: Wanted) -> (usize, Option<u32>) {
    for pieces in 1..=SLOT_BYTES / 32 {
        store.memory().read = 0;
        let piece = store.read_piece(wanted).expect("a memory that works");
        assert!(store.memory().read <= 32, "{} bytes at once", store.memory().read);
        match piece {
            Piece::More => {}
            Piece::Whole(found) => return (pieces, Some(number(&found))),
            Piece::Nothing => return (pieces, None),
        }
    }
    panic!("the read does not end");
}

#[test]
fn a_record_is_read_in_pieces_and_a_write_in_between_begins_the_read_anew() {
    let mut store = CalibrationStore::new(Counted { eeprom: Pages::blank(), read: 0 });
    (0..3).for_each(|number| assert_eq!(store.save(&record(number)), Ok(0)));
    let (pieces, newest) = in_pieces(&mut store, Wanted::Newest);
    assert!(pieces > 5 && newest == Some(2), "{pieces} pieces, {newest:?}");
    for (back, found) in [(0, Some(2)), (1, Some(1)), (2, Some(0)), (3, None), (u16::MAX, None)] {
        assert_eq!(in_pieces(&mut store, Wanted::Entry { back }).1, found);
    }
    let begin = |store: &mut CalibrationStore<Counted>| assert_eq!(store.read_piece(Wanted::Newest), Ok(Piece::More));
    begin(&mut store);
    assert_eq!(store.save(&record(3)), Ok(0));
    assert_eq!(in_pieces(&mut store, Wanted::Newest), (pieces, Some(3)));
    begin(&mut store);
    assert_eq!(in_pieces(&mut store, Wanted::Entry { back: 2 }).1, Some(1));
    assert_eq!(in_pieces(&mut store, Wanted::Newest), (pieces, Some(3)));
    begin(&mut store);
    store.erase().expect("a memory that works");
    assert_eq!(in_pieces(&mut store, Wanted::Newest).1, None);
}

// ------------------------------------------------------------------------------------------------------- power is cut

/// Everything that is written or erased between one save and the next.
#[derive(Clone, Copy, Debug)]
enum Act {
    Save,
    /// Getting the next place ready at power-up.
    Prepare,
}

fn act<M: Virtual>(store: &mut CalibrationStore<M>, act: Act, number: u32) {
    // The result does not count: power is cut during the act or just after it.
    match act {
        Act::Save => drop(store.save(&record(number))),
        Act::Prepare => drop(store.prepare()),
    }
}

fn steps<M: Virtual>(before: &M, what: Act, number: u32) -> usize {
    let mut store = CalibrationStore::new(before.clone());
    store.memory().power().on();
    act(&mut store, what, number);
    store.memory().power().steps()
}

/// Cuts the power in a step, and checks what the next boot finds and does. Returns the memory at that boot.
fn cut<M: Virtual>(before: &M, what: Act, number: u32, step: usize, torn: Torn) -> M {
    let mut store = CalibrationStore::new(before.clone());
    store.memory().power().cut_after(step, torn);
    act(&mut store, what, number);
    let mut store = rebooted(store);
    let found = newest(&mut store);
    let (old, new) = (number.checked_sub(1), Some(number));
    assert!(
        found == old || found == new && matches!(what, Act::Save),
        "{found:?} for {number}: {what:?} {step} {torn:?}"
    );
    let next = found.map_or(0, |found| found + 1);
    let at_boot = store.memory().clone();
    store.prepare().expect("a place");
    assert_eq!(store.save(&record(next)), Ok(0), "{number}: {what:?} {step} {torn:?}");
    assert_eq!(newest(&mut rebooted(store)), Some(next), "{number}: {what:?} {step} {torn:?}");
    at_boot
}

/// Every step of every act in these saves, left in every way. Returns the number of cases.
fn cut_everywhere<M: Virtual>(saves: Range<u32>) -> usize {
    let each = |number: u32| {
        let before = saved::<M>(number).release();
        let acts = [Act::Prepare, Act::Save].map(|what| (what, steps(&before, what, number)));
        let cases = acts.into_iter().flat_map(|(what, steps)| (0..steps).map(move |step| (what, step)));
        let each = |(what, step): (Act, usize)| Torn::ALL.map(|torn| cut(&before, what, number, step, torn)).len();
        cases.map(each).sum::<usize>()
    };
    saves.into_par_iter().map(each).sum()
}

#[test]
fn power_cut_at_every_byte_word_and_erase_leaves_the_old_or_the_new_record() {
    // The store wraps more than twice.
    let eeprom = cut_everywhere::<Pages>(0..22);
    let internal = cut_everywhere::<Internal>(0..132);
    let serial = cut_everywhere::<Serial>(0..33);
    println!("power cuts: {eeprom} in EEPROM, {internal} in internal flash, {serial} in serial flash");
    assert!(eeprom > 50_000 && internal > 10_000 && serial > 20_000);
}

/// Power is cut again, in the save after the first cut.
#[test]
fn power_cut_twice_leaves_the_old_or_the_new_record() {
    // Saves in the middle of a sector, and saves that begin the next sector.
    let each = |number: u32| {
        let before = saved::<Serial>(number).release();
        let mut cases = 0;
        for step in 0..steps(&before, Act::Save, number) {
            for torn in Torn::ALL {
                let between = cut(&before, Act::Save, number, step, torn);
                let next = newest(&mut CalibrationStore::new(between.clone())).expect("a record") + 1;
                // Some steps and two ways: the product is large.
                for again in (0..steps(&between, Act::Save, next)).step_by(13) {
                    for torn in [Torn::Half, Torn::Lost] {
                        cut(&between, Act::Save, next, again, torn);
                        cases += 1;
                    }
                }
            }
        }
        cases
    };
    let cases: usize = [13, 15].into_par_iter().map(each).sum();
    println!("two power cuts: {cases}");
    assert!(cases > 20_000);
}

// ------------------------------------------------------------------------------------------------- cells, bits, faults

/// Stores in which every slot is in use, one for every slot that can be the next to be written.
fn full<M: Virtual>() -> Vec<(M, u32)> {
    let slots = slots::<M>();
    let saved = (0..slots).map(|slot| (2 * slots + slot) as u32).map(|count| (saved::<M>(count).release(), count));
    saved.collect()
}

/// Number of calibrations in a block.
fn per_block<M: Medium>() -> usize {
    M::ERASE_BYTES.map_or(1, |bytes| (bytes / SLOT_BYTES).min(32))
}

fn block_bytes<M: Medium>() -> usize {
    M::ERASE_BYTES.unwrap_or(SLOT_BYTES)
}

fn slots<M: Virtual>() -> usize {
    M::blank().capacity() / block_bytes::<M>() * per_block::<M>()
}

/// Every byte of the next two slots is stuck, at 0 and at 1. Every save succeeds, and its record is found.
fn every_stuck_byte<M: Virtual>(saves: u32) -> usize {
    let each = |(memory, count): &(M, u32)| {
        let mut store = CalibrationStore::new(memory.clone());
        let image = changed::<M>(&mut store, *count);
        let stick = |(address, value): (usize, u8)| {
            let mut memory = memory.clone();
            memory.stick(vec![(address, value)]);
            let mut store = CalibrationStore::new(memory);
            for number in *count..count + saves {
                let failed = store.save(&record(number)).expect("another slot");
                assert!(failed <= 1, "{failed} slots for one stuck byte at {address:#x}");
                assert!(matches!(store.load(), Ok(Loaded::Found { record: found, .. }) if found == record(number)));
            }
        };
        let cases = image.flat_map(|address| [(address, 0), (address, 0xff)]);
        cases.map(stick).count()
    };
    full::<M>().par_iter().map(each).sum()
}

/// Addresses of the slot that the next save writes.
fn changed<M: Virtual>(store: &mut CalibrationStore<M>, number: u32) -> Range<usize> {
    store.prepare().unwrap();
    let before = store.memory().bytes().clone();
    store.save(&record(number)).unwrap();
    let after = store.memory().bytes();
    let first = before.iter().zip(after.iter()).position(|(before, after)| before != after).unwrap();
    let slot = first / 32 * 32;
    slot..slot + SLOT_BYTES
}

#[test]
fn a_stuck_byte_costs_no_record() {
    let (eeprom, serial) = (every_stuck_byte::<Pages>(2), every_stuck_byte::<Serial>(2));
    println!("stuck bytes: {eeprom} in EEPROM, {serial} in flash");
    assert_eq!((eeprom, serial), (2 * 10 * SLOT_BYTES, 2 * 15 * SLOT_BYTES));
}

#[test]
fn memory_that_keeps_nothing_is_told_and_what_it_holds_stays() {
    #[derive(Clone)]
    struct Protected(Pages);
    impl Medium for Protected {
        type Error = MemoryFault;
        const ERASE_BYTES: Option<usize> = Pages::ERASE_BYTES;
        const READ_FAULT_IS_DAMAGE: bool = Pages::READ_FAULT_IS_DAMAGE;
        fn capacity(&self) -> usize {
            self.0.capacity()
        }
        fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), MemoryFault> {
            self.0.read(address, bytes)
        }
        fn write(&mut self, _: u32, _: &[u8]) -> Result<(), MemoryFault> {
            Ok(())
        }
        fn erase(&mut self, _: u32, _: usize) -> Result<(), MemoryFault> {
            Ok(())
        }
    }
    let mut store = CalibrationStore::new(Protected(saved::<Pages>(12).release()));
    assert_eq!(store.save(&record(12)), Err(StoreError::Worn));
    assert_eq!(store.erase(), Err(StoreError::Worn));
    assert!(matches!(store.load(), Ok(Loaded::Found { record: found, damage: None }) if found == record(11)));
}

/// Only the slot of the newest record still works. A save fails and leaves that record.
#[test]
fn the_newest_record_outlives_all_other_slots() {
    fn check<M: Virtual>(count: u32, begin: usize, place: impl Fn(usize) -> usize, newest: Range<usize>) {
        let mut memory = saved::<M>(count).release();
        let others = (0..slots::<M>()).filter(|slot| !newest.contains(slot));
        memory.stick(others.map(|slot| (begin + place(slot), 0)).collect());
        let mut store = CalibrationStore::new(memory);
        for _ in 0..3 {
            assert_eq!(store.save(&record(count)), Err(StoreError::Worn));
            let Ok(Loaded::Found { record: found, .. }) = store.load() else { panic!("nothing found") };
            assert_eq!(found, record(count - 1));
        }
    }
    // Record 12 is in slot 2.
    check::<Pages>(13, 0, |slot| slot * SLOT_BYTES, 2..3);
    // Record 19 is in slot 4, the last of the first sector, all of which works.
    check::<Serial>(20, 4096, |slot| slot / 5 * 4096 + slot % 5 * SLOT_BYTES, 0..5);
}

/// An interrupted erase has left a remainder in the last part of a sector.
#[test]
fn a_sector_is_entered_only_if_all_of_it_is_blank() {
    let mut store = saved::<Internal>(32);
    let rest = 131_072 * 2 + 3 * SLOT_BYTES;
    store.memory().bytes()[rest..131_072 * 3].fill(0);
    for number in 32..40 {
        assert_eq!(store.save(&record(number)), Ok(0));
        assert_eq!(newest(&mut store), Some(number));
    }
}

/// The first record of a sector is damaged. Every power-up reports the damage until a newer record is written.
#[test]
fn damage_that_may_be_the_newest_record_stays_told() {
    // Record 5 is the first in the second of three sectors.
    let mut store = saved::<Serial>(6);
    store.memory().flash().set_readable(2 * 4096, false);
    for _ in 0..3 {
        store = rebooted(store);
        let found = Loaded::Found { record: record(4), damage: Some(Damage::Unreadable) };
        assert_eq!(store.load(), Ok(found));
        store.prepare().expect("a place");
    }
    assert_eq!(store.save(&record(5)), Ok(0));
    assert_eq!(newest(&mut rebooted(store)), Some(5));
}

/// A record cannot be read for a while. When it can be read again, it does not replace the records written meanwhile.
#[test]
fn a_record_that_can_be_read_again_is_not_the_newest() {
    let mut store = saved::<Serial>(3);
    let third = 4096 + 2 * SLOT_BYTES;
    store.memory().flash().set_readable(third, false);
    let Ok(Loaded::Found { record: found, damage: Some(Damage::Unreadable) }) = store.load() else { panic!("damage") };
    assert_eq!((found, store.save(&record(3))), (record(1), Ok(0)));
    store.memory().flash().set_readable(third, true);
    assert_eq!(newest(&mut rebooted(store)), Some(3));
}

/// Every bit of a full EEPROM is flipped once. The damaged slot is reported, and all other slots are read.
#[test]
fn every_flipped_bit_is_found() {
    let memory = saved::<Pages>(23).release();
    let each = |bit: usize| {
        let mut memory = memory.clone();
        memory.bytes()[bit / 8] ^= 1 << (bit % 8);
        let mut store = CalibrationStore::new(memory);
        let Ok(Loaded::Found { record: found, damage }) = store.load() else { panic!("nothing found") };
        let slot = bit / 8 / SLOT_BYTES;
        // Record 22 is in slot 2.
        let used = damage.is_some();
        let expected = if used && slot == 2 { 21 } else { 22 };
        assert_eq!(found, record(expected), "bit {bit}");
        assert_eq!((store.damaged(), store.entries()), (usize::from(used), Ok(10 - usize::from(used))));
        usize::from(used)
    };
    let told: usize = (0..10 * SLOT_BYTES * 8).into_par_iter().map(each).sum();
    let image = encode(&mut [0; SLOT_BYTES], 22, &record(22)).unwrap();
    println!("flipped bits: {} of which {told} in use", 10 * SLOT_BYTES * 8);
    // The lengths of the records differ by one byte at most, because the lengths of their numbers in postcard differ.
    assert!(told.abs_diff(10 * image * 8) <= 10 * 8, "{told}");
}

/// An EEPROM that does not answer from an address on.
#[derive(Clone)]
struct Silent(Pages, u32);

impl Medium for Silent {
    type Error = &'static str;
    const ERASE_BYTES: Option<usize> = Pages::ERASE_BYTES;
    const READ_FAULT_IS_DAMAGE: bool = Pages::READ_FAULT_IS_DAMAGE;
    fn capacity(&self) -> usize {
        self.0.capacity()
    }
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), &'static str> {
        let end = address + bytes.len() as u32;
        if end > self.1 { Err("no answer") } else { self.0.read(address, bytes).map_err(|_| "fault") }
    }
    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), &'static str> {
        panic!("written without having been read")
    }
    fn erase(&mut self, _: u32, _: usize) -> Result<(), &'static str> {
        panic!("erased without having been read")
    }
}

#[test]
fn an_eeprom_that_does_not_answer_is_a_fault_and_is_not_written() {
    for readable in [0, 100, 768, 900, 7000] {
        let mut store = CalibrationStore::new(Silent(saved::<Pages>(10).release(), readable));
        assert_eq!(store.load(), Err(StoreError::Memory("no answer")));
        assert_eq!(store.save(&record(2)), Err(StoreError::Memory("no answer")));
        assert_eq!(store.entries(), Err(StoreError::Memory("no answer")));
    }
}

#[test]
fn a_small_memory_is_refused() {
    let store = |length| CalibrationStore::new(Eeprom(VirtualEeprom::blank(length)));
    assert_eq!(store(9 * SLOT_BYTES).load(), Ok(Loaded::Empty));
    let capacity = 9 * SLOT_BYTES - 1;
    assert_eq!(store(capacity).load(), Err(StoreError::Capacity(capacity)));
    assert_eq!(store(capacity).save(&record(0)), Err(StoreError::Capacity(capacity)));
    assert_eq!(store(capacity).erase(), Err(StoreError::Capacity(capacity)));
}

// ----------------------------------------------------------------------------------------------- versions and verdicts

/// A slot of a calibration with this version and payload.
fn framed(version: u8, sequence: u32, payload: &[u8]) -> Vec<u8> {
    framed_as(*b"RSC", version, sequence, payload)
}

/// A slot of this kind of record.
fn framed_as(magic: [u8; 3], version: u8, sequence: u32, payload: &[u8]) -> Vec<u8> {
    let mut slot = [magic.as_slice(), &[version], &sequence.to_le_bytes()].concat();
    slot.extend((payload.len() as u32).to_le_bytes());
    slot.extend(payload);
    let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&slot);
    slot.extend(crc.to_le_bytes());
    slot
}

/// An instrument finds the records of the version before after an update of its software.
#[test]
fn records_of_an_older_version_are_told_and_overwritten_in_their_turn() {
    for version in [b'2', b'3'] {
        let mut eeprom = VirtualEeprom::blank(12 * SLOT_BYTES);
        for (place, sequence) in [(0, 5), (1, 6)] {
            let slot = framed(version, sequence, &[7; 500]);
            eeprom.bytes[place * SLOT_BYTES..][..slot.len()].copy_from_slice(&slot);
        }
        let mut store = CalibrationStore::new(Eeprom(eeprom));
        let damage = Damage::Version(version);
        assert_eq!(damage.other_version(), Some(version));
        assert_eq!(store.load(), Ok(Loaded::Corrupt { damage }));
        assert_eq!((store.entries(), store.damaged(), store.other_versions()), (Ok(0), 0, 2));
        assert_eq!(store.other_version(), Some(version));
        // Ten slots are free, so ten saves leave both records. The next two saves take one each.
        for number in 1..=12 {
            assert_eq!(store.prepare(), Ok(()));
            assert_eq!(store.save(&record(number)), Ok(0));
            store = rebooted(store);
            let left = (12 - number).min(2) as usize;
            let expected = Loaded::Found { record: record(number), damage: (left > 0).then_some(damage) };
            assert_eq!(store.load(), Ok(expected));
            assert_eq!((store.entries(), store.damaged(), store.other_versions()), (Ok(number as usize), 0, left));
        }
    }
}

/// A log of this many records of an older version, as the software of that version has written it.
fn older<M: Virtual>(version: u8, count: usize) -> (M, Vec<usize>) {
    let (mut memory, slots) = (M::blank(), slots::<M>());
    let address =
        |place: usize| (place / per_block::<M>() * block_bytes::<M>() + place % per_block::<M>() * SLOT_BYTES) as u32;
    let mut held = vec![None; slots];
    for number in 0..count {
        let place = number % slots;
        if M::ERASE_BYTES.is_some() && place.is_multiple_of(per_block::<M>()) {
            memory.erase(address(place), block_bytes::<M>()).unwrap();
            held[place..place + per_block::<M>()].fill(None);
        }
        let mut slot = framed(version, number as u32, &[7; 500]);
        slot.resize(slot.len().next_multiple_of(32), 0xff);
        memory.write(address(place), &slot).unwrap();
        held[place] = Some(number);
    }
    (memory, held.into_iter().flatten().collect())
}

/// The first start of new software takes no more of the older records than a save by the older software would have.
#[test]
fn the_first_start_keeps_the_records_of_an_older_version_but_those_whose_turn_has_come() {
    fn check<M: Virtual>() {
        let slots = slots::<M>();
        for count in 1..=2 * slots {
            let (memory, held) = older::<M>(b'3', count);
            let entered = count % slots;
            let is_entered = M::ERASE_BYTES.is_some() && entered.is_multiple_of(per_block::<M>());
            let in_turn = if is_entered { entered..entered + per_block::<M>() } else { 0..0 };
            let kept = held.iter().filter(|number| !in_turn.contains(&(*number % slots))).count();
            let mut store = CalibrationStore::new(memory);
            assert_eq!(store.load(), Ok(Loaded::Corrupt { damage: Damage::Version(b'3') }));
            assert_eq!((store.damaged(), store.other_versions()), (0, held.len()));
            store.prepare().unwrap();
            let mut store = rebooted(store);
            store.load().unwrap();
            assert_eq!((store.damaged(), store.other_versions()), (0, kept), "{count} records");
            assert_eq!(store.save(&record(1)), Ok(0));
            assert_eq!(store.entry(0), Ok(Some((count as u32, record(1)))));
            let mut store = rebooted(store);
            let kept = if M::ERASE_BYTES.is_some() { kept } else { kept.min(slots - 1) };
            let damage = (kept > 0).then_some(Damage::Version(b'3'));
            assert_eq!(store.load(), Ok(Loaded::Found { record: record(1), damage }));
            assert_eq!((store.damaged(), store.other_versions()), (0, kept), "{count} records");
        }
    }
    check::<Pages>();
    check::<Internal>();
    check::<Serial>();
}

/// What is reported at power-up keeps damage and other versions apart.
#[test]
fn records_of_another_version_are_not_reported_as_damage() {
    let mut store = CalibrationStore::new(older::<Pages>(b'3', 4).0);
    let found = FoundRecord { other_version: Some(b'3'), writable: true, ..FoundRecord::default() };
    assert_eq!(store.power_up(), found);
    store.memory().bytes()[5] ^= 1;
    assert_eq!(store.power_up(), FoundRecord { damaged: true, ..found });
    assert_eq!(store.load(), Ok(Loaded::Corrupt { damage: Damage::Crc }));
}

#[test]
fn a_newer_version_is_refused_and_stays_until_it_is_erased() {
    let mut memory = saved::<Pages>(3).release();
    let newer = framed(FORMAT_VERSION + 1, 3, &[7; 300]);
    memory.bytes()[3 * SLOT_BYTES..][..newer.len()].copy_from_slice(&newer);
    // Damage of another record does not hide the newer version.
    memory.bytes()[5] ^= 1;
    let before = memory.bytes().clone();
    let mut store = CalibrationStore::new(memory);
    let damage = Damage::Version(FORMAT_VERSION + 1);
    assert_eq!(store.load(), Ok(Loaded::Found { record: record(2), damage: Some(damage) }));
    assert_eq!(store.save(&record(3)), Err(StoreError::Newer(FORMAT_VERSION + 1)));
    assert_eq!(store.prepare(), Err(StoreError::Newer(FORMAT_VERSION + 1)));
    assert_eq!(*store.memory().bytes(), before);
    store.erase().unwrap();
    assert_eq!(store.load(), Ok(Loaded::Empty));
    assert_eq!(store.save(&record(3)), Ok(0));
    // A record whose byte of the version has a flipped bit is damaged. It does not prevent a save.
    store.memory().bytes()[3] ^= 4;
    assert_eq!(store.load(), Ok(Loaded::Corrupt { damage: Damage::Crc }));
    assert_eq!(store.save(&record(4)), Ok(0));
}

#[test]
fn everything_is_erased() {
    fn check<M: Virtual>() {
        let mut store = saved::<M>(40);
        store.erase().unwrap();
        assert_eq!((store.load(), store.entries()), (Ok(Loaded::Empty), Ok(0)));
        let memory = store.memory();
        let span = block_bytes::<M>() * (slots::<M>() / per_block::<M>());
        let blank = memory.bytes().iter().filter(|byte| **byte == 0xff).count();
        assert!(blank >= span);
        assert_eq!(store.save(&record(0)), Ok(0));
    }
    check::<Pages>();
    check::<Internal>();
    check::<Serial>();
}

/// What an erase that is cut leaves: the newest accepted record, or no record. Never an older one. The next power-up
/// completes an erase that has taken effect. Returns whether the record was found.
fn cut_erase<M: Virtual>(before: &M, newest: &StoredCalibration, step: usize, torn: Torn, seed: u64) -> bool {
    let mut store = CalibrationStore::new(before.clone());
    store.memory().power().cut_at_random(step, torn, seed);
    assert!(store.erase().is_err(), "the power is cut");
    let mut store = rebooted(store);
    let context = format!("{step} {torn:?} {seed}");
    let is_found = match store.load().expect("a memory that works") {
        Loaded::Found { record: found, .. } => {
            assert_eq!(found, *newest, "{context}");
            true
        }
        Loaded::Empty | Loaded::Corrupt { .. } => false,
    };
    store.prepare().expect("a place");
    let mut store = rebooted(store);
    if !is_found {
        // If the cut was in the erase of the tombstone itself, its block may be damaged. This is reported.
        assert!(matches!(store.load(), Ok(Loaded::Empty | Loaded::Corrupt { .. })), "{context}");
        assert_eq!(store.entries(), Ok(0), "{context}");
    }
    assert_eq!(store.save(&record(999)), Ok(0), "{context}");
    assert!(matches!(store.load(), Ok(Loaded::Found { record: found, .. }) if found == record(999)), "{context}");
    is_found
}

/// Every step of an erase, left in every way, after these numbers of saves and then some rejected runs. Returns in how
/// many cases the record was found, and in how many there was none.
fn cut_erase_everywhere<M: Virtual>(saves: Range<u32>, seeds: u64) -> [usize; 2] {
    let each = |number: u32| {
        let mut store = saved::<M>(number);
        (0..number % (1 + REJECTED_IN_A_ROW as u32))
            .for_each(|number| assert_eq!(store.save(&rejected(number)), Ok(0)));
        let (before, newest) = (store.release(), record(number - 1));
        let mut store = CalibrationStore::new(before.clone());
        store.memory().power().on();
        store.erase().expect("a memory that works");
        let mut counts = [0, 0];
        for step in 0..store.memory().power().steps() {
            for torn in Torn::ALL {
                let seeds = if matches!(torn, Torn::Random | Torn::Patchy) { seeds } else { 1 };
                for seed in 0..seeds {
                    counts[usize::from(!cut_erase(&before, &newest, step, torn, seed))] += 1;
                }
            }
        }
        counts
    };
    let add = |sum: [usize; 2], counts: [usize; 2]| [sum[0] + counts[0], sum[1] + counts[1]];
    saves.into_par_iter().map(each).reduce(|| [0, 0], add)
}

#[test]
fn an_erase_that_is_cut_leaves_the_newest_calibration_or_none_and_never_an_older_one() {
    for (name, [found, none]) in [
        ("EEPROM", cut_erase_everywhere::<Pages>(11..13, 1)),
        ("internal flash", cut_erase_everywhere::<Internal>(30..67, 40)),
        ("serial flash", cut_erase_everywhere::<Serial>(1..33, 100)),
    ] {
        println!("erases cut in {name}: the newest calibration was found in {found} cases, none in {none}");
        assert!(found > 100 && none > 100);
    }
}

/// The tombstone of an erase that is not completed also erases what the memory still holds.
#[test]
fn records_before_a_tombstone_are_erased_and_those_after_it_are_not() {
    let mut memory = saved::<Pages>(4).release();
    let tombstone = framed(FORMAT_VERSION, 4, &[]);
    memory.bytes()[4 * SLOT_BYTES..][..tombstone.len()].copy_from_slice(&tombstone);
    let mut store = CalibrationStore::new(memory.clone());
    assert_eq!((store.load(), store.entries(), store.other_version()), (Ok(Loaded::Empty), Ok(0), None));
    // Without a preparation the log goes on after the tombstone.
    assert_eq!(store.save(&record(7)), Ok(0));
    let mut store = rebooted(store);
    assert_eq!((store.entries(), store.entry(0)), (Ok(1), Ok(Some((5, record(7))))));
    store.prepare().unwrap();
    assert_eq!(store.load(), Ok(Loaded::Found { record: record(7), damage: None }));
    // A tombstone of newer software counts too, and records of newer software before it do not prevent a save.
    for (place, version, payload) in [(4, FORMAT_VERSION + 1, &[7][..]), (5, FORMAT_VERSION + 1, &[])] {
        let slot = framed(version, place as u32, payload);
        memory.bytes()[place * SLOT_BYTES..][..slot.len()].copy_from_slice(&slot);
    }
    let mut store = CalibrationStore::new(memory);
    assert_eq!(store.load(), Ok(Loaded::Empty));
    assert_eq!(store.prepare(), Ok(()));
    assert!(store.memory().bytes()[..10 * SLOT_BYTES].iter().all(|byte| *byte == 0xff));
}

/// The flash before the store belongs to another part of the program.
#[test]
fn nothing_outside_its_sectors_is_touched() {
    let mut store = saved::<Serial>(40);
    store.erase().unwrap();
    assert!(store.memory().bytes()[..4096].iter().all(|byte| *byte == 0x5a));
}

#[test]
fn rejected_calibrations_are_history_and_never_in_the_way_of_an_accepted_one() {
    fn check<M: Virtual>() {
        for accepted in 1..70 {
            let mut store = saved::<M>(accepted);
            for number in 0..REJECTED_IN_A_ROW as u32 {
                assert_eq!(store.save(&rejected(number)), Ok(0));
                let Ok(Loaded::Found { record: found, damage: None }) = store.load() else { panic!("nothing found") };
                assert_eq!(found, record(accepted - 1));
            }
            assert_eq!(store.save(&rejected(9)), Err(StoreError::Rejected));
            let (_, last) = store.entry(0).unwrap().unwrap();
            assert_eq!(last, rejected(REJECTED_IN_A_ROW as u32 - 1));
            assert_eq!(store.save(&record(accepted)), Ok(0));
            let mut store = rebooted(store);
            assert!(matches!(store.load(), Ok(Loaded::Found { record: found, .. }) if found == record(accepted)));
        }
    }
    check::<Pages>();
    check::<Internal>();
    check::<Serial>();
}

/// A unit that is never accepted does not wear out its memory.
#[test]
fn only_the_first_rejected_calibrations_in_a_row_are_kept_also_if_none_was_accepted() {
    fn check<M: Virtual>() {
        let mut store = saved::<M>(0);
        for number in 0..300 {
            let is_kept = number < REJECTED_IN_A_ROW as u32;
            assert_eq!(store.save(&rejected(number)), if is_kept { Ok(0) } else { Err(StoreError::Rejected) });
            store = rebooted(store);
        }
        assert_eq!((store.load(), store.entries()), (Ok(Loaded::Empty), Ok(REJECTED_IN_A_ROW)));
        assert_eq!(store.save(&record(7)), Ok(0));
        assert_eq!(store.load(), Ok(Loaded::Found { record: record(7), damage: None }));
        assert_eq!(store.save(&rejected(8)), Ok(0));
    }
    check::<Pages>();
    check::<Internal>();
    check::<Serial>();
}

#[test]
fn a_verdict_is_kept_with_its_first_reasons() {
    let record = rejected(3);
    assert_eq!(record.verdict.doubts, 3);
    assert!(!record.verdict.accepted());
    let reasons: Vec<_> = record.reasons().collect();
    assert_eq!(reasons, [Reason::Refused(3), Reason::TooFewSegments(2)]);
    // Whatever version of the software wrote them: their encoding has a version of its own.
    let other = StoredCalibration { software_version: "0.0.9".parse().unwrap(), ..record };
    assert_eq!(other.reasons().collect::<Vec<_>>(), reasons);
    // As many as fit; the others count.
    let long = Reason::ChiSquare { chi_square: 1.0, degrees_of_freedom: u32::MAX, low: 2.0, high: 3.0 };
    let verdict = Verdict { reasons: std::iter::repeat_n(long, 12).collect(), more: 5, ..Verdict::default() };
    let kept = StoredCalibration { verdict: StoredVerdict::new(&verdict), ..other };
    assert_eq!((kept.verdict.doubts, kept.reasons().count()), (17, 4));
    assert!(kept.reasons().all(|reason| reason == long));
}

#[test]
fn the_longest_record_fits() {
    let long = Reason::ChiSquare { chi_square: 1.0, degrees_of_freedom: u32::MAX, low: 2.0, high: 3.0 };
    let verdict = Verdict { reasons: std::iter::repeat_n(long, 12).collect(), more: u16::MAX, ..Verdict::default() };
    let longest = StoredCalibration {
        scheme: "s".repeat(32).parse().unwrap(),
        site: Site { measured_gravity_m_s2: Some(9.8), ..Site::default() },
        utc_s: Some(u64::MAX),
        degrees_of_freedom: u32::MAX,
        software_version: "v".repeat(16).parse().unwrap(),
        verdict: StoredVerdict::new(&verdict),
        imu: Some(ImuIdentity { product: u16::MAX, serial: u32::MAX }),
        ..record(1)
    };
    let mut store = saved::<Pages>(1);
    assert_eq!(store.save(&StoredCalibration { verdict: StoredVerdict::default(), ..longest.clone() }), Ok(0));
    assert_eq!(store.save(&longest), Ok(0));
    assert_eq!(store.entry(0).unwrap().unwrap().1, longest);
}

#[test]
fn the_sequence_number_wraps() {
    let mut memory = Pages::blank();
    let mut slot = [0; SLOT_BYTES];
    encode(&mut slot, u32::MAX - 3, &record(0)).unwrap();
    memory.bytes()[..SLOT_BYTES].copy_from_slice(&slot);
    let mut store = CalibrationStore::new(memory);
    (1..12).for_each(|number| assert_eq!(store.save(&record(number)), Ok(0)));
    assert_eq!(newest(&mut rebooted(store)), Some(11));
}

/// What is stored must stay readable: whoever changes these bytes counts up `FORMAT_VERSION`.
#[test]
fn the_bytes_of_a_record_are_these() {
    let mut slot = [0; SLOT_BYTES];
    let fixed = StoredCalibration { software_version: "0.2.0".parse().unwrap(), ..record(5) };
    let length = encode(&mut slot, 7, &fixed).unwrap();
    // The CRC of all before it.
    let crc = |frame: &[u8]| u32::from_le_bytes(*frame.last_chunk().unwrap());
    assert_eq!((&slot[..12], length), (b"RSC5\x07\0\0\0\xf8\x01\0\0".as_slice(), 520));
    assert_eq!(crc(&slot[..length]), 2_347_485_529);
    // The identity of the IMU comes last.
    assert_eq!(slot[length - 4 - 5..length - 4], [1, 0xef, 0x80, 1, 105]);
    // With reasons: two doubts, of schema 1.
    let length = encode(&mut slot, 7, &StoredCalibration { imu: None, ..rejected(3) }).unwrap();
    let verdict = &slot[length - 4 - 9..length - 4];
    assert_eq!(verdict, [3, 0, 1, 4, 7, 3, 4, 2, 0]);
}

/// A record that software 0.2.0 has written. The file must never change.
const FORMAT_4: &[u8] = include_bytes!("../data/calibration-format-4.bin");

#[test]
fn a_record_of_format_4_is_read_without_the_identity_of_its_imu() {
    let written = StoredCalibration { software_version: "0.2.0".parse().unwrap(), imu: None, ..record(5) };
    let mut memory = Pages::blank();
    memory.bytes()[..FORMAT_4.len()].copy_from_slice(FORMAT_4);
    let mut store = CalibrationStore::new(memory);
    assert_eq!(store.load(), Ok(Loaded::Found { record: written.clone(), damage: None }));
    assert_eq!((store.damaged(), store.other_versions()), (0, 0));
    // It is the newest record until the next one is stored, and an entry of the history then.
    assert_eq!(store.save(&record(6)), Ok(0));
    let mut store = rebooted(store);
    assert_eq!(store.load(), Ok(Loaded::Found { record: record(6), damage: None }));
    assert_eq!((store.entry(0), store.entry(1)), (Ok(Some((8, record(6)))), Ok(Some((7, written)))));
}

/// The newest accepted record of the format before is kept as one of the present format is.
#[test]
fn a_record_of_format_4_outlives_rejected_runs_and_cuts() {
    let mut memory = Serial::blank();
    let slot: Vec<u8> = FORMAT_4.iter().copied().chain([0xff; 29]).collect();
    memory.write(4 * SLOT_BYTES as u32, &slot).unwrap();
    let mut store = CalibrationStore::new(memory);
    (0..REJECTED_IN_A_ROW as u32).for_each(|number| assert_eq!(store.save(&rejected(number)), Ok(0)));
    assert_eq!(store.save(&rejected(9)), Err(StoreError::Rejected));
    for torn in Torn::ALL {
        let mut cut = CalibrationStore::new(store.memory().clone());
        cut.memory().power().cut_after(3, torn);
        assert!(cut.save(&record(6)).is_err());
        let Ok(Loaded::Found { record: found, .. }) = rebooted(cut).load() else { panic!("nothing found") };
        assert_eq!((found.degrees_of_freedom, found.imu), (5, None));
    }
}
