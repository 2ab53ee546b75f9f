//! The calibration store: two slots of non-volatile memory, written in turn.
//!
//! ```text
//! slot, little-endian   0-3          magic "RSC2"; its last character is the version of the format
//!                       4-7          sequence number, wraps; the newer record is the one ahead
//!                       8-11         length n of the payload, bytes
//!                       12..12+n     payload: postcard of StoredCalibration
//!                       12+n..16+n   CRC-32/ISO-HDLC of all before
//! ```
//! A save writes the slot that does not hold the newest good record, and reads it back. Whatever interrupts it, the record
//! before stays. Memory never written, all ones, is empty, not damaged.

use crate::error_model::{InstrumentErrors, PARAMETERS};
use crate::estimator::Estimate;
use crate::method::Method;
use crate::policy::Moment;
use crate::site::Site;
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use embedded_storage::Storage;
use heapless::String;
use serde::{Deserialize, Serialize};

/// Memory of one slot, bytes: a multiple of every EEPROM's page.
pub const SLOT_BYTES: usize = 1024;
/// Number of slots.
pub const SLOTS: usize = 2;

const MAGIC: [u8; 3] = *b"RSC";
const FORMAT_VERSION: u8 = b'2';
const HEADER_BYTES: usize = 12;
const CRC_BYTES: usize = 4;
const PAYLOAD_BYTES: usize = SLOT_BYTES - HEADER_BYTES - CRC_BYTES;
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A calibration and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredCalibration {
    /// The errors found, SI.
    pub errors: InstrumentErrors<f64>,
    /// Their standard deviations in the order of the parameter vector, SI.
    pub sigmas: [f64; PARAMETERS],
    /// How they were estimated.
    pub method: Method,
    /// Name of the rotation scheme.
    pub scheme: String<32>,
    /// Where it was done.
    pub site: Site,
    /// Time of the power-up at which it was done, seconds since 1970-01-01 UTC; `None` where there is no clock.
    pub utc_s: Option<u64>,
    /// Mean IMU temperature, deg C; not a number where there is no sensor.
    pub temperature_c: f32,
    /// Chi-square of the residuals.
    pub chi_square: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: u32,
    /// Version of the software that did it.
    pub software_version: String<16>,
}

/// What is wrong with a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// The slot does not begin as one.
    Magic,
    /// A record of another version of the format, this character.
    Version(u8),
    /// The length cannot be, bytes.
    Length(u32),
    /// The CRC is wrong.
    Crc,
    /// The CRC is right and the payload is no calibration.
    Payload,
}

/// What is in the store.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box the record on")]
pub enum Loaded {
    /// Nothing was ever saved.
    Empty,
    /// The newest good record, and what is wrong with the other slot, if something is: perhaps it held a newer one.
    Found {
        /// The record.
        record: StoredCalibration,
        /// Damage of the other slot.
        damage: Option<Damage>,
    },
    /// There is no good record, and at least one slot is damaged.
    Corrupt {
        /// Damage of each slot; `None` for an empty one.
        damage: [Option<Damage>; SLOTS],
    },
}

/// Why the store could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError<E> {
    /// The memory reports a fault.
    Memory(E),
    /// The memory is smaller than the slots, bytes.
    Capacity(usize),
    /// The record does not fit in a slot.
    Size,
    /// The slot does not read back as written. The record before is intact.
    Verify,
}

/// One slot as read.
enum Slot {
    Empty,
    Good { sequence: u32 },
    Damaged(Damage),
}

/// The store on the memory `S`, from its address 0 on.
#[derive(Debug)]
pub struct CalibrationStore<S> {
    memory: S,
}

impl StoredCalibration {
    /// Parameters with their uncertainty.
    pub fn estimate(&self) -> Estimate {
        Estimate { errors: self.errors, sigmas: self.sigmas }
    }

    /// When it was done and how warm.
    pub fn moment(&self) -> Moment {
        Moment { utc_s: self.utc_s, temperature_c: self.temperature_c }
    }
}

impl<S: Storage> CalibrationStore<S> {
    /// The store on `memory`.
    pub fn new(memory: S) -> Self {
        Self { memory }
    }

    /// Gives the memory back.
    pub fn release(self) -> S {
        self.memory
    }

    /// Reads the newest good record.
    ///
    /// # Errors
    /// The memory does not work or is too small; damage of its content is not an error but an answer.
    pub fn load(&mut self) -> Result<Loaded, StoreError<S::Error>> {
        let mut buffer = [0; SLOT_BYTES];
        let slots = self.inspect(&mut buffer)?;
        let damage = slots.each_ref().map(Slot::damage);
        let Some(newest) = newest(&slots) else {
            let empty = damage == [None; SLOTS];
            return Ok(if empty { Loaded::Empty } else { Loaded::Corrupt { damage } });
        };
        if newest != SLOTS - 1 {
            // The buffer still holds the last slot.
            self.read_slot(newest, &mut buffer)?;
        }
        match parse(&buffer) {
            Some(record) => Ok(Loaded::Found { record, damage: damage.into_iter().flatten().next() }),
            // It was good a moment ago.
            None => Err(StoreError::Verify),
        }
    }

    /// Writes a record beside the newest good one.
    ///
    /// # Errors
    /// The memory does not work or is too small, the record does not fit, or it does not read back. The newest good
    /// record is intact in every case.
    pub fn save(&mut self, record: &StoredCalibration) -> Result<(), StoreError<S::Error>> {
        let mut buffer = [0; SLOT_BYTES];
        let slots = self.inspect(&mut buffer)?;
        let (target, sequence) = match newest(&slots) {
            Some(newest) => (1 - newest, slots.get(newest).map_or(0, Slot::sequence).wrapping_add(1)),
            None => (0, 0),
        };
        let length = write_slot(&mut buffer, sequence, record).ok_or(StoreError::Size)?;
        let image = buffer.get(..length).ok_or(StoreError::Size)?;
        self.memory.write(address(target), image).map_err(StoreError::Memory)?;
        self.verify(target, image)
    }

    /// Compares a slot with what was written, piece by piece.
    fn verify(&mut self, slot: usize, image: &[u8]) -> Result<(), StoreError<S::Error>> {
        let mut offset = address(slot);
        let mut read = [0; 64];
        for written in image.chunks(read.len()) {
            let read = read.get_mut(..written.len()).ok_or(StoreError::Verify)?;
            self.memory.read(offset, read).map_err(StoreError::Memory)?;
            if read != written {
                return Err(StoreError::Verify);
            }
            offset += 64;
        }
        Ok(())
    }

    fn inspect(&mut self, buffer: &mut [u8; SLOT_BYTES]) -> Result<[Slot; SLOTS], StoreError<S::Error>> {
        let capacity = self.memory.capacity();
        if capacity < SLOTS * SLOT_BYTES {
            return Err(StoreError::Capacity(capacity));
        }
        self.read_slot(0, buffer)?;
        let first = inspect(buffer);
        self.read_slot(1, buffer)?;
        Ok([first, inspect(buffer)])
    }

    /// Reads a slot as far as it is used, by its own account.
    fn read_slot(&mut self, slot: usize, buffer: &mut [u8; SLOT_BYTES]) -> Result<(), StoreError<S::Error>> {
        let (header, rest) = buffer.split_at_mut(HEADER_BYTES);
        self.memory.read(address(slot), header).map_err(StoreError::Memory)?;
        let length = header.last_chunk().map_or(0, |length| u32::from_le_bytes(*length) as usize);
        // A length that cannot be reads nothing; `check` says so.
        let used = rest.get_mut(..length.saturating_add(CRC_BYTES)).unwrap_or_default();
        self.memory.read(address(slot) + HEADER_BYTES as u32, used).map_err(StoreError::Memory)
    }
}

impl Slot {
    fn damage(&self) -> Option<Damage> {
        match self {
            Self::Damaged(damage) => Some(*damage),
            Self::Empty | Self::Good { .. } => None,
        }
    }

    fn sequence(&self) -> u32 {
        match self {
            Self::Good { sequence } => *sequence,
            Self::Empty | Self::Damaged(_) => 0,
        }
    }
}

fn address(slot: usize) -> u32 {
    (slot * SLOT_BYTES) as u32
}

/// The slot that holds the newest good record.
fn newest(slots: &[Slot; SLOTS]) -> Option<usize> {
    match slots {
        [Slot::Good { sequence: first }, Slot::Good { sequence: second }] => {
            Some(usize::from(second.wrapping_sub(*first).cast_signed() > 0))
        }
        [Slot::Good { .. }, _] => Some(0),
        [_, Slot::Good { .. }] => Some(1),
        _ => None,
    }
}

fn inspect(slot: &[u8; SLOT_BYTES]) -> Slot {
    if slot.iter().take(HEADER_BYTES).all(|&byte| byte == 0xff) {
        return Slot::Empty;
    }
    match check(slot) {
        Err(damage) => Slot::Damaged(damage),
        Ok((_, payload)) if postcard::from_bytes::<StoredCalibration>(payload).is_err() => {
            Slot::Damaged(Damage::Payload)
        }
        Ok((sequence, _)) => Slot::Good { sequence },
    }
}

fn parse(slot: &[u8; SLOT_BYTES]) -> Option<StoredCalibration> {
    let (_, payload) = check(slot).ok()?;
    postcard::from_bytes(payload).ok()
}

/// Sequence number and payload of a slot whose frame is right.
fn check(slot: &[u8; SLOT_BYTES]) -> Result<(u32, &[u8]), Damage> {
    let [m0, m1, m2, version, s0, s1, s2, s3, l0, l1, l2, l3, rest @ ..] = slot;
    if [*m0, *m1, *m2] != MAGIC {
        return Err(Damage::Magic);
    }
    if *version != FORMAT_VERSION {
        return Err(Damage::Version(*version));
    }
    let length = u32::from_le_bytes([*l0, *l1, *l2, *l3]);
    let (payload, crc) = rest.split_at_checked(length as usize).ok_or(Damage::Length(length))?;
    let stored = crc.first_chunk().ok_or(Damage::Length(length))?;
    let (framed, _) = slot.split_at_checked(HEADER_BYTES + payload.len()).ok_or(Damage::Length(length))?;
    if CRC.checksum(framed) != u32::from_le_bytes(*stored) {
        return Err(Damage::Crc);
    }
    Ok((u32::from_le_bytes([*s0, *s1, *s2, *s3]), payload))
}

/// Fills the slot and returns the number of bytes to write; `None` if the record does not fit.
fn write_slot(slot: &mut [u8; SLOT_BYTES], sequence: u32, record: &StoredCalibration) -> Option<usize> {
    let (header, rest) = slot.split_first_chunk_mut::<HEADER_BYTES>()?;
    let payload = postcard::to_slice(record, rest.get_mut(..PAYLOAD_BYTES)?).ok()?.len();
    let ([m0, m1, m2], [s0, s1, s2, s3]) = (MAGIC, sequence.to_le_bytes());
    let [l0, l1, l2, l3] = u32::try_from(payload).ok()?.to_le_bytes();
    *header = [m0, m1, m2, FORMAT_VERSION, s0, s1, s2, s3, l0, l1, l2, l3];
    let (framed, rest) = slot.split_at_mut_checked(HEADER_BYTES + payload)?;
    *rest.first_chunk_mut()? = CRC.checksum(framed).to_le_bytes();
    Some(HEADER_BYTES + payload + CRC_BYTES)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_storage::ReadStorage;

    /// Memory that loses power after a number of written bytes, and cannot be read from an address on.
    #[derive(Clone)]
    struct Memory {
        bytes: Vec<u8>,
        writable: usize,
        readable: usize,
    }

    impl Memory {
        fn blank() -> Self {
            Self { bytes: vec![0xff; SLOTS * SLOT_BYTES], writable: usize::MAX, readable: usize::MAX }
        }
    }

    impl ReadStorage for Memory {
        type Error = &'static str;
        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
            if offset as usize + bytes.len() > self.readable {
                return Err("no answer");
            }
            bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
            Ok(())
        }
        fn capacity(&self) -> usize {
            self.bytes.len()
        }
    }

    impl Storage for Memory {
        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
            let count = bytes.len().min(self.writable);
            self.writable -= count;
            self.bytes[offset as usize..][..count].copy_from_slice(&bytes[..count]);
            if count < bytes.len() { Err("power lost") } else { Ok(()) }
        }
    }

    fn record(number: u32) -> StoredCalibration {
        StoredCalibration {
            errors: InstrumentErrors { heading: f64::from(number), ..InstrumentErrors::default() },
            sigmas: core::array::from_fn(|index| 1e-6 * index as f64),
            method: Method::TwoStage,
            scheme: String::try_from("bai").unwrap(),
            site: Site::default(),
            utc_s: Some(1_790_000_000),
            temperature_c: 35.5,
            chi_square: 81.2,
            degrees_of_freedom: number,
            software_version: String::try_from("0.1.0").unwrap(),
        }
    }

    fn found(number: u32) -> Loaded {
        Loaded::Found { record: record(number), damage: None }
    }

    fn saved(numbers: core::ops::Range<u32>) -> CalibrationStore<Memory> {
        let mut store = CalibrationStore::new(Memory::blank());
        for number in numbers {
            store.save(&record(number)).unwrap();
        }
        store
    }

    #[test]
    fn blank_memory_is_empty_and_the_newest_record_is_found() {
        assert_eq!(saved(0..0).load(), Ok(Loaded::Empty));
        for count in 1..6 {
            assert_eq!(saved(0..count).load(), Ok(found(count - 1)));
        }
    }

    #[test]
    fn the_longest_record_fits() {
        let mut longest = record(u32::MAX);
        longest.scheme = String::try_from("s".repeat(32).as_str()).unwrap();
        longest.software_version = String::try_from("v".repeat(16).as_str()).unwrap();
        longest.site.measured_gravity_m_s2 = Some(9.8);
        let mut store = saved(0..1);
        store.save(&longest).unwrap();
        assert_eq!(store.load(), Ok(Loaded::Found { record: longest, damage: None }));
    }

    /// Bytes a record of these tests takes.
    fn used() -> usize {
        saved(0..1).release().bytes.iter().rposition(|&byte| byte != 0xff).unwrap() + 1
    }

    #[test]
    fn every_flipped_byte_is_found() {
        let memory = saved(0..2).release();
        for slot in 0..SLOTS {
            for offset in 0..used() {
                for flip in [0x01, 0x80, 0xff] {
                    let mut memory = memory.clone();
                    memory.bytes[slot * SLOT_BYTES + offset] ^= flip;
                    // Slot 1 holds record 1, the newest; the other record is good in either case.
                    let other = 1 - slot as u32;
                    match CalibrationStore::new(memory).load() {
                        Ok(Loaded::Found { record: kept, damage: Some(_) }) => assert_eq!(kept, record(other)),
                        other => panic!("slot {slot}, byte {offset}, {flip:#x}: {other:?}"),
                    }
                }
            }
        }
    }

    #[test]
    fn without_a_good_record_the_damage_is_reported() {
        let mut memory = saved(0..1).release();
        memory.bytes[40] ^= 1;
        let corrupt = Loaded::Corrupt { damage: [Some(Damage::Crc), None] };
        assert_eq!(CalibrationStore::new(memory.clone()).load(), Ok(corrupt));
        memory.bytes[3] = b'1';
        let other_version = Loaded::Corrupt { damage: [Some(Damage::Version(b'1')), None] };
        assert_eq!(CalibrationStore::new(memory).load(), Ok(other_version));
    }

    #[test]
    fn a_save_cut_at_any_byte_keeps_the_record_before() {
        for before in 1..4 {
            let memory = saved(0..before).release();
            for cut in 0..used() {
                let mut store = CalibrationStore::new(Memory { writable: cut, ..memory.clone() });
                assert_eq!(store.save(&record(before)), Err(StoreError::Memory("power lost")));
                match store.load() {
                    Ok(Loaded::Found { record: kept, .. }) => assert_eq!(kept, record(before - 1), "cut {cut}"),
                    other => panic!("cut {cut}: {other:?}"),
                }
                let mut store = CalibrationStore::new(Memory { writable: usize::MAX, ..store.release() });
                store.save(&record(before)).unwrap();
                assert_eq!(store.load(), Ok(found(before)), "cut {cut}");
            }
        }
    }

    /// A cut in the middle of programming leaves a page that is neither old nor new.
    #[test]
    fn a_page_left_half_programmed_keeps_the_record_before() {
        const PAGE_BYTES: usize = 32;
        for page in 0..used() / PAGE_BYTES {
            let cut = page * PAGE_BYTES;
            let mut store = CalibrationStore::new(Memory { writable: cut, ..saved(0..2).release() });
            assert!(store.save(&record(2)).is_err());
            let mut memory = Memory { writable: usize::MAX, ..store.release() };
            let torn = (0..PAGE_BYTES).map(|byte| 0x5a ^ (byte as u8).wrapping_mul(37));
            memory.bytes[cut..][..PAGE_BYTES].iter_mut().zip(torn).for_each(|(byte, torn)| *byte = torn);
            let mut store = CalibrationStore::new(memory);
            assert!(matches!(store.load(), Ok(Loaded::Found { record: kept, .. }) if kept == record(1)), "page {page}");
            store.save(&record(2)).unwrap();
            assert_eq!(store.load(), Ok(found(2)));
        }
    }

    #[test]
    fn memory_that_does_not_answer_is_a_fault_and_is_not_written() {
        for readable in [0, 100, SLOT_BYTES, SLOT_BYTES + 100] {
            let memory = Memory { readable, ..saved(0..2).release() };
            let before = memory.bytes.clone();
            let mut store = CalibrationStore::new(memory);
            assert_eq!(store.load(), Err(StoreError::Memory("no answer")));
            assert_eq!(store.save(&record(2)), Err(StoreError::Memory("no answer")));
            assert_eq!(store.release().bytes, before);
        }
    }

    #[test]
    fn the_sequence_number_wraps() {
        let mut memory = Memory::blank();
        let mut slot = [0xff; SLOT_BYTES];
        write_slot(&mut slot, u32::MAX, &record(1)).unwrap();
        memory.bytes[..SLOT_BYTES].copy_from_slice(&slot);
        let mut store = CalibrationStore::new(memory);
        store.save(&record(2)).unwrap();
        assert_eq!(store.load(), Ok(found(2)));
    }

    #[test]
    fn a_small_memory_is_refused() {
        let mut store = CalibrationStore::new(Memory { bytes: vec![0xff; 512], ..Memory::blank() });
        assert_eq!(store.load(), Err(StoreError::Capacity(512)));
        assert_eq!(store.save(&record(0)), Err(StoreError::Capacity(512)));
    }
}
