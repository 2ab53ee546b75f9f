//! Records of one kind in the slots of a memory. The calibration store and the journals share this file.
//!
//! ```text
//! EEPROM      | slot | slot | slot | ...                       a block is one slot; it is overwritten in its turn
//! NOR flash   | slot slot slot ... | slot slot slot ... | ...  a block is a sector; it is erased when the log enters it
//! ```
//! Records follow each other through all slots and then start again at the first slot. A new record takes the slot after
//! the newest intact frame, whatever the version of its format, is written there and read back. If this fails, it takes
//! the next slot. One record is kept whatever happens: its slot is never overwritten, and its block is never erased.
//! Memory that was never written has all bits set; it is empty, not damaged. Damage that may be a lost newer record stays
//! in the memory until a newer record is written.
//!
//! An erase takes effect at once: a tombstone is written into a block without the kept record, and only then the other
//! blocks are erased, and at last the block of the tombstone. If the power is cut before the tombstone is whole, the kept
//! record is still found. If it is cut later, no record is found. No cut brings an older record back.

use super::frame::{self, Damage, Frame, PIECE_BYTES};
use super::medium::Medium;
use core::marker::PhantomData;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A kind of record.
pub trait Kind {
    /// The first bytes of every record.
    const MAGIC: [u8; 3];
    /// Version of the format that is written, a character.
    const VERSION: u8;
    /// Number of records that are kept, once they have been written, while the next block is blank.
    const HISTORY: usize = 1;
    /// Largest number of slots. Only a part of a larger memory is used.
    const MAX_SLOTS: usize = usize::MAX;
    /// The bytes of a slot: whole pieces of 32 bytes, and whole pages of an EEPROM.
    type Slot: AsRef<[u8]> + AsMut<[u8]>;
    /// A blank slot.
    const BLANK: Self::Slot;
    /// The record.
    type Record: Serialize + DeserializeOwned;

    /// The record of a payload in this version of the format.
    ///
    /// # Errors
    /// [`Damage::Version`]: this software does not read the version. [`Damage::Payload`]: the payload is no record.
    fn decode(version: u8, payload: &[u8]) -> Result<Self::Record, Damage> {
        if version != Self::VERSION {
            return Err(Damage::Version(version));
        }
        postcard::from_bytes(payload).map_err(|_| Damage::Payload)
    }
}

/// Why records could not be read or written. The newest record, or in the calibration store the newest accepted record,
/// is intact in every case.
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
    /// The calibration store has records of newer software, in this version of the format. Nothing is written until they
    /// are erased.
    Newer(u8),
    /// The record is of a rejected run, and the calibration store already keeps as many rejected runs in a row as it may.
    /// This is no fault.
    Rejected,
}

/// Largest number of slots that may fail before a write gives up.
const MAX_FAILED: usize = 64;
/// Largest number of damaged slots at the beginning of a block that can be those of writes that were cut or failed.
const MAX_TORN: usize = 8;

/// Place and sequence number of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Position {
    pub place: usize,
    pub sequence: u32,
}

impl Position {
    /// Whether this frame was written after the other one. The sequence number wraps.
    pub fn is_after(self, other: Self) -> bool {
        self.sequence.wrapping_sub(other.sequence).cast_signed() > 0
    }
}

/// The end of a log.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tail {
    /// The newest intact frame, also if its record cannot be read.
    pub newest: Option<Position>,
    /// Whether that frame is a tombstone.
    pub is_tombstone: bool,
    /// The frame that is neither overwritten nor erased.
    pub kept: Option<Position>,
    /// Number of slots that cannot be read at present.
    pub unreadable: u32,
}

impl Tail {
    /// Takes a frame for the newest, and for the one that is kept, if it is newer.
    pub fn add(&mut self, at: Position, is_tombstone: bool) {
        if self.newest.is_none_or(|newest| at.is_after(newest)) {
            (self.newest, self.kept, self.is_tombstone) = (Some(at), Some(at), is_tombstone);
        }
    }

    /// The slot after the newest frame, and the next sequence number. No slot that is unreadable at present has this
    /// number. The place may be one beyond the last.
    pub fn next(&self) -> Position {
        self.newest.map_or(Position { place: 0, sequence: 0 }, |newest| Position {
            place: newest.place + 1,
            sequence: newest.sequence.wrapping_add(self.unreadable).wrapping_add(1),
        })
    }
}

/// How far a slot has been read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor {
    place: usize,
    /// The next byte.
    next: usize,
    /// Whether the slot is read for the second time.
    is_second: bool,
}

impl Cursor {
    /// At the beginning of the slot at this place.
    pub const fn at(place: usize) -> Self {
        Self { place, next: 0, is_second: false }
    }
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Content {
    Blank,
    Frame(Frame),
    Damaged(Damage),
}

/// What has become of a slot while a record was written.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    Blanked,
    Failed,
}

/// The slots of a memory.
#[derive(Debug)]
pub(super) struct Slots<M, K> {
    pub memory: M,
    kind: PhantomData<K>,
}

impl<M: Medium, K: Kind> Slots<M, K> {
    const BYTES: usize = {
        assert!(size_of::<K::Slot>().is_multiple_of(PIECE_BYTES) && size_of::<K::Slot>() > 0, "a slot is whole pieces");
        size_of::<K::Slot>()
    };
    /// At least two blocks: the kept record is in one block while the other is erased.
    const PER_BLOCK: usize = match M::ERASE_BYTES {
        None => 1,
        Some(bytes) => {
            let (slots, most) = (bytes / Self::BYTES, K::MAX_SLOTS / 2);
            assert!(slots > 0 && most > 0, "a sector holds a slot");
            if slots > most { most } else { slots }
        }
    };
    const BLOCK_BYTES: usize = match M::ERASE_BYTES {
        None => Self::BYTES,
        Some(bytes) => bytes,
    };

    pub fn new(memory: M) -> Self {
        Self { memory, kind: PhantomData }
    }

    /// Number of slots that fit into the memory.
    pub fn count(&self) -> Result<usize, StoreError<M::Error>> {
        let capacity = self.memory.capacity();
        let slots = (capacity / Self::BLOCK_BYTES).min(K::MAX_SLOTS / Self::PER_BLOCK) * Self::PER_BLOCK;
        // The history must fit while one block is blank.
        if slots < K::HISTORY + Self::PER_BLOCK { Err(StoreError::Capacity(capacity)) } else { Ok(slots) }
    }

    // --------------------------------------------------------------------------------------------------------- reading

    /// Passes the place, the content and the bytes of every slot to `see`.
    pub fn scan(&mut self, mut see: impl FnMut(usize, Content, &[u8])) -> Result<(), StoreError<M::Error>> {
        let (count, mut slot, mut is_readable) = (self.count()?, K::BLANK, false);
        for place in 0..count {
            let content = self.inspect(place, &mut slot)?;
            is_readable |= content != Content::Damaged(Damage::Unreadable);
            see(place, content, slot.as_ref());
        }
        // A memory of which nothing can be read does not work.
        if is_readable { Ok(()) } else { self.fetch(&mut Cursor::at(0), &mut slot) }
    }

    /// The content of a slot, which is read into `slot`.
    pub fn inspect(&mut self, place: usize, slot: &mut K::Slot) -> Result<Content, StoreError<M::Error>> {
        let mut cursor = Cursor::at(place);
        loop {
            if let Some(content) = self.read_piece(&mut cursor, slot)? {
                return Ok(content);
            }
        }
    }

    /// Reads the next 32 bytes of a slot into `slot`. Returns the content of the slot once as much is read as its header
    /// claims; the rest of `slot` is then blank. A slot that seems damaged is read again, because the transfer may have
    /// been disturbed.
    pub fn read_piece(
        &mut self,
        cursor: &mut Cursor,
        slot: &mut K::Slot,
    ) -> Result<Option<Content>, StoreError<M::Error>> {
        if cursor.next == 0 {
            slot.as_mut().fill(0xff);
        }
        let content = match self.fetch(cursor, slot) {
            Ok(()) if cursor.next < Self::claimed_bytes(slot.as_ref()) => return Ok(None),
            Ok(()) if slot.as_ref().first_chunk() == Some(&BLANK_PIECE) => Content::Blank,
            Ok(()) => frame::check(slot.as_ref(), K::MAGIC).map_or_else(Content::Damaged, Content::Frame),
            Err(_) if M::READ_FAULT_IS_DAMAGE => Content::Damaged(Damage::Unreadable),
            Err(error) => return Err(error),
        };
        if matches!(content, Content::Damaged(_)) && !cursor.is_second {
            *cursor = Cursor { is_second: true, ..Cursor::at(cursor.place) };
            return Ok(None);
        }
        Ok(Some(content))
    }

    /// Reads the piece at the cursor.
    fn fetch(&mut self, cursor: &mut Cursor, slot: &mut K::Slot) -> Result<(), StoreError<M::Error>> {
        let piece = slot.as_mut().get_mut(cursor.next..cursor.next + PIECE_BYTES).ok_or(StoreError::Size)?;
        let address = Self::address(cursor.place) + cursor.next as u32;
        self.memory.read(address, piece).map_err(StoreError::Memory)?;
        cursor.next += PIECE_BYTES;
        Ok(())
    }

    /// Number of bytes of whole pieces that the header of a slot claims. If the length is not possible, this is the first
    /// piece, and the check of the frame reports the length.
    fn claimed_bytes(slot: &[u8]) -> usize {
        let head = slot.first_chunk().filter(|head| **head != BLANK_PIECE);
        head.and_then(|head| frame::used_bytes(head, Self::BYTES)).unwrap_or(0).next_multiple_of(PIECE_BYTES)
    }

    fn is_blank(&mut self, place: usize) -> bool {
        let address = Self::address(place);
        (0..Self::BYTES as u32).step_by(PIECE_BYTES).all(|offset| {
            let mut piece = [0; PIECE_BYTES];
            self.memory.read(address + offset, &mut piece).is_ok() && piece == BLANK_PIECE
        })
    }

    // --------------------------------------------------------------------------------------------------------- writing

    /// Writes a record into the first slot after the tail that takes it. Returns its position and the number of slots
    /// that failed before.
    pub fn append(
        &mut self,
        tail: &Tail,
        record: &K::Record,
        note: &mut impl FnMut(usize, Change),
    ) -> Result<(Position, usize), StoreError<M::Error>> {
        let (count, next) = (self.count()?, tail.next());
        let mut slot = K::BLANK;
        let image = Self::image(slot.as_mut(), next.sequence, record).ok_or(StoreError::Size)?;
        let (mut failed, mut error) = (0, StoreError::Worn);
        for place in (next.place..count).chain(0..next.place.min(count)) {
            match self.write(place, image, tail, note) {
                Ok(true) => return Ok((Position { place, ..next }, failed)),
                Ok(false) => {}
                Err(fault) => {
                    note(place, Change::Failed);
                    (failed, error) = (failed + 1, fault);
                }
            }
            if failed == MAX_FAILED {
                break;
            }
        }
        Err(error)
    }

    /// Blanks what must be erased before `records` more records can be written. At least one slot is then ready.
    pub fn prepare(
        &mut self,
        tail: &Tail,
        records: usize,
        note: &mut impl FnMut(usize, Change),
    ) -> Result<(), StoreError<M::Error>> {
        let (count, next) = (self.count()?, tail.next());
        let (mut ready, mut error) = (0, StoreError::Worn);
        for place in (next.place..count).chain(0..next.place.min(count)) {
            match self.is_ready(place, tail, note) {
                Ok(is_ready) => ready += usize::from(is_ready),
                Err(fault) => error = fault,
            }
            if ready >= records {
                break;
            }
        }
        if ready > 0 { Ok(()) } else { Err(error) }
    }

    /// Erases everything.
    pub fn erase(&mut self, tail: &Tail) -> Result<(), StoreError<M::Error>> {
        let count = self.count()?;
        let newest = tail.newest.map(|newest| newest.place);
        let tombstone = if tail.is_tombstone { newest } else { self.bury(tail) };
        // If no block takes a tombstone, the kept record goes last.
        let last = tombstone.or(tail.kept.map(|kept| kept.place)).map(|place| place - place % Self::PER_BLOCK);
        let others = (0..count).step_by(Self::PER_BLOCK).filter(|place| Some(*place) != last);
        for place in others.chain(last) {
            self.blank(place, &mut |_, _| ())?;
        }
        if (0..count).all(|place| self.is_blank(place)) { Ok(()) } else { Err(StoreError::Worn) }
    }

    /// Writes a tombstone after the newest frame, into a block without the kept record. Returns its place; `None` if
    /// there is nothing to erase, or if no block takes a tombstone.
    fn bury(&mut self, tail: &Tail) -> Option<usize> {
        tail.newest?;
        let (count, mut slot) = (self.count().ok()?, K::BLANK);
        // The unit type is the record without bytes.
        let image = Self::image(slot.as_mut(), tail.next().sequence, &())?;
        let mut blocks = (0..count).step_by(Self::PER_BLOCK);
        blocks.find(|place| {
            !Self::is_block_kept(*place, tail) && matches!(self.write(*place, image, tail, &mut |_, _| ()), Ok(true))
        })
    }

    /// The bytes to write for a record: its frame, rounded up to whole pieces.
    fn image<'s>(slot: &'s mut [u8], sequence: u32, record: &impl Serialize) -> Option<&'s [u8]> {
        let used = frame::encode(slot, (K::MAGIC, K::VERSION), sequence, record)?;
        slot.get(..used.next_multiple_of(PIECE_BYTES))
    }

    /// Writes a slot and reads it back. Returns `false`, without a write, if the slot is not ready.
    fn write(
        &mut self,
        place: usize,
        image: &[u8],
        tail: &Tail,
        note: &mut impl FnMut(usize, Change),
    ) -> Result<bool, StoreError<M::Error>> {
        if !self.is_ready(place, tail, note)? {
            return Ok(false);
        }
        let mut address = Self::address(place);
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

    /// Whether a slot may be written now. Erases a whole sector if the log enters it.
    fn is_ready(
        &mut self,
        place: usize,
        tail: &Tail,
        note: &mut impl FnMut(usize, Change),
    ) -> Result<bool, StoreError<M::Error>> {
        if tail.kept.is_some_and(|kept| kept.place == place) {
            return Ok(false);
        }
        if M::ERASE_BYTES.is_none() {
            return Ok(true);
        }
        if place.is_multiple_of(Self::PER_BLOCK) && !Self::is_block_kept(place, tail) && !self.is_entered(place) {
            self.blank(place, note)?;
        }
        Ok(self.is_blank(place))
    }

    /// Whether the log has already entered the block that begins at this place, although no frame in it is intact: its
    /// first slots are damaged, and all others are blank. Such a block is not erased, because the damage tells that a
    /// newer record may be lost.
    fn is_entered(&mut self, first: usize) -> bool {
        let mut slot = K::BLANK;
        let mut is_damaged = |place: &usize| matches!(self.inspect(*place, &mut slot), Ok(Content::Damaged(_)));
        let damaged = (first..first + Self::PER_BLOCK).take(MAX_TORN + 1).take_while(&mut is_damaged).count();
        let mut others = first + damaged..first + Self::PER_BLOCK;
        (1..=MAX_TORN).contains(&damaged) && !others.is_empty() && others.all(|place| self.is_blank(place))
    }

    /// Erases the block that begins at this place, unless it is blank.
    fn blank(&mut self, place: usize, note: &mut impl FnMut(usize, Change)) -> Result<(), StoreError<M::Error>> {
        let block = place..place + Self::PER_BLOCK;
        if !block.clone().all(|place| self.is_blank(place)) {
            self.memory.erase(Self::address(place), Self::BLOCK_BYTES).map_err(StoreError::Memory)?;
            block.for_each(|place| note(place, Change::Blanked));
        }
        Ok(())
    }

    /// Whether the kept record is in the block of this place.
    fn is_block_kept(place: usize, tail: &Tail) -> bool {
        tail.kept.is_some_and(|kept| kept.place / Self::PER_BLOCK == place / Self::PER_BLOCK)
    }

    fn address(place: usize) -> u32 {
        let (block, slot) = (place / Self::PER_BLOCK, place % Self::PER_BLOCK);
        (block * Self::BLOCK_BYTES + slot * Self::BYTES) as u32
    }
}

const BLANK_PIECE: [u8; PIECE_BYTES] = [0xff; PIECE_BYTES];
