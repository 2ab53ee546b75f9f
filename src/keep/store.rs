//! The calibration store: a log of calibrations in non-volatile memory. The newest accepted calibration is safe
//! whatever happens while the next calibration is written.
//!
//! ```text
//! EEPROM      | slot | slot | slot | ...                       a slot is overwritten when its turn has come
//! NOR flash   | slot slot slot ... | slot slot slot ... | ...  sectors; a sector is erased when the log enters it
//! ```
//! Records follow each other through all slots and then start again at the first slot. A save takes the slot after the
//! newest record, writes the record and reads it back. If this fails, it takes the next slot. Records of another version
//! of the format count here too: they are overwritten in their turn and not before. The newest accepted
//! record is never overwritten or erased. Once [`HISTORY`] records have been written, at least as many are kept as long
//! as the memory works. Memory that was never written has all bits set; it is empty, not damaged.
//!
//! An erase takes effect at once: a tombstone is written into a block without the newest accepted record, and only then
//! the other blocks are erased, and at last the block of the tombstone. If the power is cut before the tombstone is
//! whole, the newest accepted record is still found. If it is cut later, no record is found, and [`prepare`] completes
//! the erase at the next power-up. No cut brings an older record back.
//!
//! [`prepare`]: CalibrationStore::prepare
//!
//! The crate `sequential-storage` is not used, because one layout must serve EEPROM and NOR flash, and because every
//! record is read back.

use super::medium::{MAX_SLOTS, Medium};
use super::record::{Damage, FORMAT_VERSION, SLOT_BYTES};
use crate::run::result::StoredCalibration;
use heapless::Vec;

/// Smallest number of records that are kept.
pub const HISTORY: usize = 8;
/// Largest number of rejected calibrations in a row that are kept: the first ones after the newest accepted calibration,
/// or the first ones of all if there is no accepted calibration. More records would at some time need the place of the
/// accepted one, and a unit that is never accepted would wear out its memory.
pub const REJECTED_IN_A_ROW: usize = 4;

/// The memory is read in pieces of this length, bytes.
const PIECE_BYTES: usize = 32;

/// The content of the store.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box the record on")]
pub enum Loaded {
    /// There is no accepted calibration and no damage.
    Empty,
    /// The newest accepted calibration. A damaged slot, if there is one, may have held a newer calibration.
    Found {
        /// The record.
        record: StoredCalibration,
        /// The first damage. A record of newer software comes before it, an intact record of older software after it.
        damage: Option<Damage>,
    },
    /// No accepted calibration can be read, and a slot is damaged or holds a record of another version of the format.
    Corrupt {
        /// The first damage. A record of newer software comes before it, an intact record of older software after it.
        damage: Damage,
    },
}

/// Why the store could not be read or written. The newest accepted record is intact in every case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError<E> {
    /// The memory reports a fault.
    Memory(E),
    /// The memory is too small. It has this number of bytes.
    Capacity(usize),
    /// The record does not fit in a slot.
    Size,
    /// No slot reads back as it was written or erased.
    Worn,
    /// The store has records of newer software, in this version of the format. Nothing is written until they are
    /// erased.
    Newer(u8),
    /// The record is of a rejected run, and the store already keeps [`REJECTED_IN_A_ROW`] rejected runs since the newest
    /// accepted calibration. This is no fault.
    Rejected,
}

/// The state of one slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    Empty,
    /// An intact frame.
    Frame {
        sequence: u32,
        holds: Holds,
    },
    Damaged(Damage),
}

/// What an intact frame holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holds {
    Accepted,
    Rejected,
    /// Nothing: all records before it were erased.
    Tombstone,
    /// A record that cannot be read.
    Unread(Damage),
}

impl Holds {
    fn of(record: &StoredCalibration) -> Self {
        if record.verdict.accepted() { Self::Accepted } else { Self::Rejected }
    }
}

/// An intact frame: its place and its sequence number.
#[derive(Clone, Copy, Debug)]
struct Framed {
    place: usize,
    sequence: u32,
    holds: Holds,
}

/// The store in a memory.
///
/// ```
/// use embedded_storage::{ReadStorage, Storage};
/// use rins_selfcal::keep::medium::Eeprom;
/// use rins_selfcal::keep::store::{CalibrationStore, Loaded};
/// use rins_selfcal::run::result::StoredCalibration;
///
/// /// An EEPROM of 16 KiB. On a board this is the type of a driver.
/// struct Memory(Vec<u8>);
///
/// impl ReadStorage for Memory {
///     type Error = std::convert::Infallible;
///     fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
///         bytes.copy_from_slice(&self.0[at as usize..][..bytes.len()]);
///         Ok(())
///     }
///     fn capacity(&self) -> usize {
///         self.0.len()
///     }
/// }
/// impl Storage for Memory {
///     fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Self::Error> {
///         self.0[at as usize..][..bytes.len()].copy_from_slice(bytes);
///         Ok(())
///     }
/// }
///
/// # use rins_selfcal::model::error_model::InstrumentErrors;
/// # use rins_selfcal::base::method::Method;
/// # use rins_selfcal::base::site::Site;
/// # let record = StoredCalibration {
/// #     errors: InstrumentErrors::default(), sigmas: [1e-6; 28], method: Method::Joint, scheme: "fast-180".try_into().unwrap(),
/// #     site: Site::default(), utc_s: None, temperature_c: 25.0, chi_square: 80.0, degrees_of_freedom: 84,
/// #     software_version: "0.1.0".try_into().unwrap(), verdict: Default::default(),
/// # };
/// let mut store = CalibrationStore::new(Eeprom(Memory(vec![0xff; 16 * 1024])));
/// assert_eq!(store.load(), Ok(Loaded::Empty));
/// // `record` comes from `SelfCalibration::record`, when a step reports that it shall be saved.
/// store.save(&record).expect("the memory works");
/// assert_eq!(store.load(), Ok(Loaded::Found { record, damage: None }));
/// ```
#[derive(Debug)]
pub struct CalibrationStore<M> {
    memory: M,
    /// State of every slot, as found at the first access and as written since then.
    slots: Vec<Slot, MAX_SLOTS>,
}

impl<M: Medium> CalibrationStore<M> {
    /// The store in `memory`. The memory is not accessed yet.
    pub fn new(memory: M) -> Self {
        Self { memory, slots: Vec::new() }
    }

    /// The memory. The store sees bytes that were written directly only after the next [`Self::load`].
    pub fn memory(&mut self) -> &mut M {
        &mut self.memory
    }

    /// Returns the memory.
    pub fn release(self) -> M {
        self.memory
    }

    /// Reads the newest accepted calibration.
    ///
    /// # Errors
    /// The memory does not work or is too small. Damaged content is not an error; it is part of the result.
    #[inline(never)]
    pub fn load(&mut self) -> Result<Loaded, StoreError<M::Error>> {
        self.scan()?;
        let damage = self.damage();
        let Some(newest) = self.newest_accepted() else {
            return Ok(damage.map_or(Loaded::Empty, |damage| Loaded::Corrupt { damage }));
        };
        // The record was intact when the slots were inspected.
        let (_, record) = self.read(newest.place)?.good().ok_or(StoreError::Worn)?;
        Ok(Loaded::Found { record, damage })
    }

    /// The newest accepted calibration, by the last inspection of the slots. Only the slot of this calibration is read.
    ///
    /// # Errors
    /// The memory does not work or is too small.
    #[inline(never)]
    pub fn newest_record(&mut self) -> Result<Option<StoredCalibration>, StoreError<M::Error>> {
        self.scan_once()?;
        match self.newest_accepted() {
            Some(newest) => Ok(self.read(newest.place)?.good().map(|(_, record)| record)),
            None => Ok(None),
        }
    }

    /// Sequence number and record of an entry of the history, 0 for the newest; `None` beyond the last entry, or if the
    /// entry has been damaged since the last inspection.
    ///
    /// # Errors
    /// The memory does not work or is too small.
    #[inline(never)]
    pub fn entry(&mut self, back: usize) -> Result<Option<(u32, StoredCalibration)>, StoreError<M::Error>> {
        self.scan_once()?;
        match self.place(back) {
            Some(place) => Ok(self.read(place)?.good()),
            None => Ok(None),
        }
    }

    /// Number of entries of the history.
    ///
    /// # Errors
    /// The memory does not work or is too small.
    pub fn entries(&mut self) -> Result<usize, StoreError<M::Error>> {
        self.scan_once()?;
        Ok(self.good().count())
    }

    /// Number of damaged slots at the last inspection. Intact records of another version of the format are not counted.
    pub fn damaged(&self) -> usize {
        self.damages().filter(|damage| !damage.is_other_version()).count()
    }

    /// Number of intact records of another version of the format at the last inspection. This software cannot read
    /// them. It overwrites records of an older version when the log reaches them.
    pub fn other_versions(&self) -> usize {
        self.damages().filter(|damage| damage.is_other_version()).count()
    }

    /// The highest version of the format, a character, among the intact records of other versions at the last
    /// inspection.
    pub fn other_version(&self) -> Option<u8> {
        let version = |damage| if let Damage::Version(version) = damage { Some(version) } else { None };
        self.damages().filter_map(version).max()
    }

    /// Appends a record. Returns the number of slots that failed before a slot took the record.
    ///
    /// # Errors
    /// The memory does not work or is too small, the record does not fit, no slot takes it, or it must not be written.
    #[inline(never)]
    pub fn save(&mut self, record: &StoredCalibration) -> Result<usize, StoreError<M::Error>> {
        self.scan_once()?;
        self.refuse_newer()?;
        let holds = Holds::of(record);
        if holds == Holds::Rejected && self.rejected_in_a_row() >= REJECTED_IN_A_ROW {
            return Err(StoreError::Rejected);
        }
        let (first, sequence) = self.next();
        let mut buffer = [0; SLOT_BYTES];
        let length = super::record::encode(&mut buffer, sequence, record).ok_or(StoreError::Size)?;
        let image = buffer.get(..length.div_ceil(PIECE_BYTES) * PIECE_BYTES).ok_or(StoreError::Size)?;
        let (mut failed, mut error) = (0, StoreError::Worn);
        for ahead in 0..self.slots.len() {
            let place = self.ahead(first, ahead);
            match self.write(place, image) {
                Ok(true) => {
                    self.note(place, Slot::Frame { sequence, holds });
                    return Ok(failed);
                }
                Ok(false) => {}
                Err(fault) => {
                    self.note(place, Slot::Damaged(Damage::Worn));
                    (failed, error) = (failed + 1, fault);
                }
            }
        }
        Err(error)
    }

    /// Completes an erase that was cut by a loss of power, and prepares the place of the next record. In flash this may
    /// need an erase, so call it at power-up, when no sample waits.
    ///
    /// # Errors
    /// The memory does not work or is too small, or no place can be prepared.
    #[inline(never)]
    pub fn prepare(&mut self) -> Result<(), StoreError<M::Error>> {
        self.scan_once()?;
        if self.tombstone().is_some() {
            // If a part of the memory cannot be erased, the rest of it may still take a record.
            let _ = self.erase();
            self.scan_once()?;
        }
        self.refuse_newer()?;
        let (first, _) = self.next();
        for ahead in 0..self.slots.len() {
            if self.is_ready(self.ahead(first, ahead))? {
                return Ok(());
            }
        }
        Err(StoreError::Worn)
    }

    /// Erases everything, including records of newer software.
    ///
    /// # Errors
    /// The memory does not work, is too small, or is not blank after the erase.
    #[inline(never)]
    pub fn erase(&mut self) -> Result<(), StoreError<M::Error>> {
        let count = self.slot_count()?;
        // A memory that cannot be inspected is erased too.
        let _ = self.scan();
        // If no slot takes a tombstone, the newest accepted record goes last.
        let last = self.tombstone().or_else(|| self.bury()).or_else(|| Some(self.newest_accepted()?.place));
        let last = last.map(|place| place - place % M::SLOTS_PER_BLOCK);
        self.slots.clear();
        let others = (0..count).step_by(M::SLOTS_PER_BLOCK).filter(|place| Some(*place) != last);
        for place in others.chain(last) {
            self.blank(place)?;
        }
        if (0..count).all(|place| self.is_blank(place)) { Ok(()) } else { Err(StoreError::Worn) }
    }

    // --------------------------------------------------------------------------------------------------- what there is

    /// Number of slots that fit into the memory.
    fn slot_count(&self) -> Result<usize, StoreError<M::Error>> {
        let capacity = self.memory.capacity();
        let blocks = (capacity / M::BLOCK_BYTES).min(MAX_SLOTS / M::SLOTS_PER_BLOCK);
        let slots = blocks * M::SLOTS_PER_BLOCK;
        // The history must fit while one block is empty.
        if slots < HISTORY + M::SLOTS_PER_BLOCK { Err(StoreError::Capacity(capacity)) } else { Ok(slots) }
    }

    fn scan_once(&mut self) -> Result<(), StoreError<M::Error>> {
        if self.slots.is_empty() { self.scan() } else { Ok(()) }
    }

    fn scan(&mut self) -> Result<(), StoreError<M::Error>> {
        let count = self.slot_count()?;
        self.slots.clear();
        let (mut slots, mut readable, mut fault) = (Vec::new(), false, None);
        for place in 0..count {
            let slot = match self.inspect(place) {
                Ok(slot) => slot,
                Err(error) if M::READ_FAULT_IS_DAMAGE => {
                    fault = Some(error);
                    Slot::Damaged(Damage::Unreadable)
                }
                Err(error) => return Err(error),
            };
            readable |= slot != Slot::Damaged(Damage::Unreadable);
            // `slots` has room for every slot, so the push cannot fail.
            let _ = slots.push(slot);
        }
        if let Some(fault) = fault
            && !readable
        {
            return Err(fault);
        }
        self.slots = slots;
        Ok(())
    }

    fn note(&mut self, place: usize, slot: Slot) {
        if let Some(noted) = self.slots.get_mut(place) {
            *noted = slot;
        }
    }

    fn damages(&self) -> impl Iterator<Item = Damage> + '_ {
        self.slots
            .iter()
            .filter_map(|slot| match slot {
                Slot::Damaged(damage) => Some(*damage),
                Slot::Empty | Slot::Frame { .. } => None,
            })
            .chain(self.frames().filter_map(|frame| match frame.holds {
                Holds::Unread(damage) => Some(damage),
                Holds::Accepted | Holds::Rejected | Holds::Tombstone => None,
            }))
    }

    fn damage(&self) -> Option<Damage> {
        let first = |wanted: fn(Damage) -> bool| self.damages().find(|damage| wanted(*damage));
        first(Damage::is_newer).or_else(|| first(|damage| !damage.is_other_version())).or_else(|| first(|_| true))
    }

    fn refuse_newer(&self) -> Result<(), StoreError<M::Error>> {
        match self.damage() {
            Some(Damage::Version(version)) if version > FORMAT_VERSION => Err(StoreError::Newer(version)),
            _ => Ok(()),
        }
    }

    /// The intact frames that were not erased, also those whose records cannot be read.
    fn frames(&self) -> impl Iterator<Item = Framed> + '_ {
        let tombstone = newest(self.all_frames().filter(|frame| frame.holds == Holds::Tombstone));
        let is_erased = move |frame: &Framed| tombstone.is_some_and(|stone| is_newer(stone.sequence, frame.sequence));
        self.all_frames().filter(move |frame| !is_erased(frame))
    }

    fn all_frames(&self) -> impl Iterator<Item = Framed> + '_ {
        (0..).zip(&self.slots).filter_map(|(place, slot)| match *slot {
            Slot::Frame { sequence, holds } => Some(Framed { place, sequence, holds }),
            Slot::Empty | Slot::Damaged(_) => None,
        })
    }

    /// Place of the tombstone of an erase that was not completed.
    fn tombstone(&self) -> Option<usize> {
        newest(self.frames()).filter(|frame| frame.holds == Holds::Tombstone).map(|frame| frame.place)
    }

    /// The records that can be read.
    fn good(&self) -> impl Iterator<Item = Framed> + '_ {
        self.frames().filter(|frame| matches!(frame.holds, Holds::Accepted | Holds::Rejected))
    }

    fn newest_accepted(&self) -> Option<Framed> {
        newest(self.frames().filter(|frame| frame.holds == Holds::Accepted))
    }

    /// Place of an entry of the history, 0 for the newest.
    fn place(&self, back: usize) -> Option<usize> {
        let mut entry = newest(self.good())?;
        let newest = entry.sequence;
        let age = |good: &Framed| newest.wrapping_sub(good.sequence);
        for _ in 0..back {
            entry = self.good().filter(|good| age(good) > age(&entry)).min_by_key(age)?;
        }
        Some(entry.place)
    }

    fn rejected_in_a_row(&self) -> usize {
        let accepted = self.newest_accepted();
        self.good().filter(|good| accepted.is_none_or(|accepted| is_newer(good.sequence, accepted.sequence))).count()
    }

    // -------------------------------------------------------------------------------------------------- where to write

    /// The slot after the newest record of any version, and the next sequence number. No slot that is unreadable at
    /// present has this number.
    fn next(&self) -> (usize, u32) {
        let Some(newest) = newest(self.frames()) else { return (0, 0) };
        let unreadable = self.slots.iter().filter(|slot| **slot == Slot::Damaged(Damage::Unreadable)).count();
        (newest.place + 1, newest.sequence.wrapping_add(1 + unreadable as u32))
    }

    fn ahead(&self, first: usize, ahead: usize) -> usize {
        let (place, count) = (first + ahead, self.slots.len());
        if place < count { place } else { place - count }
    }

    /// Whether a write or an erase here would damage the newest accepted record.
    fn is_protected(&self, place: usize, erasing: bool) -> bool {
        let block = |place: usize| place / M::SLOTS_PER_BLOCK;
        self.newest_accepted()
            .is_some_and(|newest| if erasing { block(newest.place) == block(place) } else { newest.place == place })
    }

    /// Whether a slot may be written now. Erases a whole sector if the log enters it.
    fn is_ready(&mut self, place: usize) -> Result<bool, StoreError<M::Error>> {
        if self.is_protected(place, false) {
            return Ok(false);
        }
        if !M::ERASES {
            return Ok(true);
        }
        if place.is_multiple_of(M::SLOTS_PER_BLOCK) && !self.is_protected(place, true) {
            self.blank(place)?;
        }
        Ok(self.is_blank(place))
    }

    /// Erases the block that begins at this place, unless it is blank.
    fn blank(&mut self, place: usize) -> Result<(), StoreError<M::Error>> {
        let block = place..place + M::SLOTS_PER_BLOCK;
        if !block.clone().all(|place| self.is_blank(place)) {
            self.memory.erase(address::<M>(place)).map_err(StoreError::Memory)?;
            block.for_each(|place| self.note(place, Slot::Empty));
        }
        Ok(())
    }

    /// Writes a tombstone after the newest record, into a block without the newest accepted record. Returns its place;
    /// `None` if there is no record, or if no block takes a tombstone.
    fn bury(&mut self) -> Option<usize> {
        newest(self.frames())?;
        let (_, sequence) = self.next();
        let mut buffer = [0; SLOT_BYTES];
        super::record::encode_tombstone(&mut buffer, sequence)?;
        let image = buffer.get(..PIECE_BYTES)?;
        let mut blocks = (0..self.slots.len()).step_by(M::SLOTS_PER_BLOCK);
        blocks.find(|place| !self.is_protected(*place, true) && matches!(self.write(*place, image), Ok(true)))
    }

    // ---------------------------------------------------------------------------------------------------------- access

    /// Writes a slot and reads it back. Returns `false`, without a write, if the slot is not ready.
    fn write(&mut self, place: usize, image: &[u8]) -> Result<bool, StoreError<M::Error>> {
        if !self.is_ready(place)? {
            return Ok(false);
        }
        let mut address = address::<M>(place);
        self.memory.write(address, image).map_err(StoreError::Memory)?;
        for written in image.as_chunks::<PIECE_BYTES>().0 {
            let mut read = [0; PIECE_BYTES];
            self.memory.read(address, &mut read).map_err(StoreError::Memory)?;
            if read != *written {
                return Err(StoreError::Worn);
            }
            address += PIECE_BYTES as u32;
        }
        Ok(true)
    }

    fn is_blank(&mut self, place: usize) -> bool {
        let address = address::<M>(place);
        (0..SLOT_BYTES as u32).step_by(PIECE_BYTES).all(|offset| {
            let mut piece = [0; PIECE_BYTES];
            self.memory.read(address + offset, &mut piece).is_ok() && piece == [0xff; PIECE_BYTES]
        })
    }

    /// The state of a slot. A slot that seems damaged is read again, because the transfer may have been disturbed.
    fn inspect(&mut self, place: usize) -> Result<Slot, StoreError<M::Error>> {
        match self.read(place)?.slot() {
            Slot::Damaged(_) => Ok(self.read(place)?.slot()),
            found => Ok(found),
        }
    }

    /// Reads as much of a slot as its header claims.
    fn read(&mut self, place: usize) -> Result<Content, StoreError<M::Error>> {
        let address = address::<M>(place);
        let mut buffer = [0xff; SLOT_BYTES];
        let Some((head, rest)) = buffer.split_first_chunk_mut::<PIECE_BYTES>() else { return Ok(Content::Blank) };
        self.memory.read(address, head).map_err(StoreError::Memory)?;
        if *head == [0xff; PIECE_BYTES] {
            return Ok(Content::Blank);
        }
        // If the length is not possible, nothing more is read, and decoding reports the length.
        let more =
            super::record::used_bytes(head).map_or(0, |used| used.div_ceil(PIECE_BYTES) * PIECE_BYTES - PIECE_BYTES);
        let rest = rest.get_mut(..more).unwrap_or_default();
        self.memory.read(address + PIECE_BYTES as u32, rest).map_err(StoreError::Memory)?;
        Ok(Content::of(&buffer))
    }
}

/// The content of a slot.
#[expect(clippy::large_enum_variant, reason = "there is no heap to box the record on")]
enum Content {
    Blank,
    Damaged(Damage),
    Tombstone(u32),
    Unread(u32, Damage),
    Good(u32, StoredCalibration),
}

impl Content {
    fn of(slot: &[u8; SLOT_BYTES]) -> Self {
        let frame = match super::record::check(slot) {
            Ok(frame) => frame,
            Err(damage) => return Self::Damaged(damage),
        };
        if frame.is_tombstone() {
            return Self::Tombstone(frame.sequence);
        }
        match frame.record() {
            Ok(record) => Self::Good(frame.sequence, record),
            Err(damage) => Self::Unread(frame.sequence, damage),
        }
    }

    fn slot(&self) -> Slot {
        match self {
            Self::Blank => Slot::Empty,
            Self::Damaged(damage) => Slot::Damaged(*damage),
            Self::Tombstone(sequence) => Slot::Frame { sequence: *sequence, holds: Holds::Tombstone },
            Self::Unread(sequence, damage) => Slot::Frame { sequence: *sequence, holds: Holds::Unread(*damage) },
            Self::Good(sequence, record) => Slot::Frame { sequence: *sequence, holds: Holds::of(record) },
        }
    }

    fn good(self) -> Option<(u32, StoredCalibration)> {
        if let Self::Good(sequence, record) = self { Some((sequence, record)) } else { None }
    }
}

fn newest(frames: impl Iterator<Item = Framed>) -> Option<Framed> {
    frames.reduce(|first, second| if is_newer(second.sequence, first.sequence) { second } else { first })
}

/// Whether this sequence number is ahead of the other one. The number wraps.
fn is_newer(sequence: u32, than: u32) -> bool {
    sequence.wrapping_sub(than).cast_signed() > 0
}

fn address<M: Medium>(place: usize) -> u32 {
    let (block, slot) = (place / M::SLOTS_PER_BLOCK, place % M::SLOTS_PER_BLOCK);
    (block * M::BLOCK_BYTES + slot * SLOT_BYTES) as u32
}
