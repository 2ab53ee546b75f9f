//! The calibration store: a log of calibrations in non-volatile memory. The newest accepted calibration is safe
//! whatever happens while the next calibration is written. [`slots`](super::slots) describes the log.
//!
//! Records of another version of the format count as records of the log: they are overwritten in their turn and not
//! before. The newest accepted record is never overwritten or erased. Once [`HISTORY`] records have been written, at
//! least as many are kept as long as the memory works. An [`erase`](CalibrationStore::erase) that was cut by a loss of
//! power is completed by [`prepare`](CalibrationStore::prepare) at the next power-up.
//!
//! [`HISTORY`]: super::record::HISTORY
//!
//! The crate `sequential-storage` is not used, because one layout must serve EEPROM and NOR flash, and because every
//! record is read back.

use super::frame::{Damage, Frame};
use super::medium::Medium;
use super::record::{Calibrations, FORMAT_VERSION, MAX_SLOTS, SLOT_BYTES};
use super::slots::{Change, Content, Cursor, Kind, Position, Slots, StoreError, Tail};
use crate::run::result::StoredCalibration;
use heapless::Vec;

/// Largest number of rejected calibrations in a row that are kept: the first ones after the newest accepted calibration,
/// or the first ones of all if there is no accepted calibration. More records would at some time need the place of the
/// accepted one, and a unit that is never accepted would wear out its memory.
pub const REJECTED_IN_A_ROW: usize = 4;

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

/// A record that can be read in pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Wanted {
    /// The calibration that the next power-up would use.
    Newest,
    /// An entry of the history of calibrations, rejected ones included.
    Entry {
        /// Number of newer entries.
        back: u16,
    },
}

/// What a piece of a read has given.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box the record on")]
pub enum Piece {
    /// The record is not whole yet.
    More,
    /// The whole record.
    Whole(StoredCalibration),
    /// There is no such record, or it has been damaged since the last inspection.
    Nothing,
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

    fn in_frame(frame: Frame, slot: &[u8]) -> Self {
        if frame.is_tombstone() {
            return Self::Tombstone;
        }
        record(frame, slot).map_or_else(Self::Unread, |record| Self::of(&record))
    }
}

/// An intact frame.
#[derive(Clone, Copy, Debug)]
struct Framed {
    at: Position,
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
/// #     software_version: "0.1.0".try_into().unwrap(), verdict: Default::default(), imu: None,
/// # };
/// let mut store = CalibrationStore::new(Eeprom(Memory(vec![0xff; 16 * 1024])));
/// assert_eq!(store.load(), Ok(Loaded::Empty));
/// // `record` comes from `SelfCalibration::record`, when a step reports that it shall be saved.
/// store.save(&record).expect("the memory works");
/// assert_eq!(store.load(), Ok(Loaded::Found { record, damage: None }));
/// ```
#[derive(Debug)]
pub struct CalibrationStore<M> {
    slots: Slots<M, Calibrations>,
    /// State of every slot, as found at the first access and as written since then.
    states: Vec<Slot, MAX_SLOTS>,
    /// The read under way, and its slot.
    reading: Option<(Wanted, Cursor)>,
    slot: [u8; SLOT_BYTES],
}

impl<M: Medium> CalibrationStore<M> {
    /// The store in `memory`. The memory is not accessed yet.
    pub fn new(memory: M) -> Self {
        Self { slots: Slots::new(memory), states: Vec::new(), reading: None, slot: Calibrations::BLANK }
    }

    /// The memory. The store sees bytes that were written directly only after the next [`Self::load`].
    pub fn memory(&mut self) -> &mut M {
        &mut self.slots.memory
    }

    /// Returns the memory.
    pub fn release(self) -> M {
        self.slots.memory
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
        let (_, record) = self.read(newest.at.place)?.ok_or(StoreError::Worn)?;
        Ok(Loaded::Found { record, damage })
    }

    /// Reads the next 32 bytes of a record, so that no caller has to wait for a whole record: call it again while it
    /// returns [`Piece::More`]. A read of another record, and a write or an erase, begin the read anew.
    ///
    /// # Errors
    /// The memory does not work or is too small.
    #[inline(never)]
    pub fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, StoreError<M::Error>> {
        self.scan_once()?;
        let started = self.reading.take().filter(|(started, _)| *started == wanted).map(|(_, cursor)| cursor);
        let first = || match wanted {
            Wanted::Newest => self.newest_accepted().map(|newest| newest.at.place),
            Wanted::Entry { back } => self.place(back.into()),
        };
        let Some(mut cursor) = started.or_else(|| first().map(Cursor::at)) else { return Ok(Piece::Nothing) };
        match self.slots.read_piece(&mut cursor, &mut self.slot)? {
            None => {
                self.reading = Some((wanted, cursor));
                Ok(Piece::More)
            }
            Some(Content::Frame(frame)) => Ok(record(frame, &self.slot).map_or(Piece::Nothing, Piece::Whole)),
            Some(Content::Blank | Content::Damaged(_)) => Ok(Piece::Nothing),
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
            Some(place) => self.read(place),
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
        self.damages().filter(|damage| damage.other_version().is_none()).count()
    }

    /// Number of intact records of another version of the format at the last inspection. This software cannot read
    /// them. It overwrites records of an older version when the log reaches them.
    pub fn other_versions(&self) -> usize {
        self.damages().filter_map(Damage::other_version).count()
    }

    /// The highest version of the format, a character, among the intact records of other versions at the last
    /// inspection.
    pub fn other_version(&self) -> Option<u8> {
        self.damages().filter_map(Damage::other_version).max()
    }

    /// Appends a record. Returns the number of slots that failed before a slot took the record.
    ///
    /// # Errors
    /// The memory does not work or is too small, the record does not fit, no slot takes it, or it must not be written.
    #[inline(never)]
    pub fn save(&mut self, record: &StoredCalibration) -> Result<usize, StoreError<M::Error>> {
        self.reading = None;
        self.scan_once()?;
        self.refuse_newer()?;
        let holds = Holds::of(record);
        if holds == Holds::Rejected && self.rejected_in_a_row() >= REJECTED_IN_A_ROW {
            return Err(StoreError::Rejected);
        }
        let (tail, states) = (self.tail(), &mut self.states);
        let (at, failed) = self.slots.append(&tail, record, &mut |place, change| note(states, place, change.into()))?;
        note(&mut self.states, at.place, Slot::Frame { sequence: at.sequence, holds });
        Ok(failed)
    }

    /// Completes an erase that was cut by a loss of power, and prepares the place of the next record. In flash this may
    /// need an erase, so call it at power-up, when no sample waits.
    ///
    /// # Errors
    /// The memory does not work or is too small, or no place can be prepared.
    #[inline(never)]
    pub fn prepare(&mut self) -> Result<(), StoreError<M::Error>> {
        self.scan_once()?;
        if self.tail().is_tombstone {
            // If a part of the memory cannot be erased, the rest of it may still take a record.
            let _ = self.erase();
            self.scan_once()?;
        }
        self.refuse_newer()?;
        let (tail, states) = (self.tail(), &mut self.states);
        self.slots.prepare(&tail, 1, &mut |place, change| note(states, place, change.into()))
    }

    /// Erases everything, including records of newer software.
    ///
    /// # Errors
    /// The memory does not work, is too small, or is not blank after the erase.
    #[inline(never)]
    pub fn erase(&mut self) -> Result<(), StoreError<M::Error>> {
        // A memory that cannot be inspected is erased too.
        let _ = self.scan();
        let tail = self.tail();
        self.states.clear();
        self.reading = None;
        self.slots.erase(&tail)?;
        // The memory is blank, and no access has to search it. There is room for the state of every slot.
        let count = self.slots.count()?;
        self.states.resize(count, Slot::Empty).unwrap_or_default();
        Ok(())
    }

    // --------------------------------------------------------------------------------------------------------- reading

    fn scan_once(&mut self) -> Result<(), StoreError<M::Error>> {
        if self.states.is_empty() { self.scan() } else { Ok(()) }
    }

    fn scan(&mut self) -> Result<(), StoreError<M::Error>> {
        self.states.clear();
        let mut states = Vec::new();
        // `states` has room for every slot, so the push cannot fail.
        self.slots.scan(|_, content, bytes| states.push(Slot::of(content, bytes)).unwrap_or_default())?;
        self.states = states;
        Ok(())
    }

    /// Sequence number and record of a slot that was intact when it was inspected; `None` if it no longer is.
    fn read(&mut self, place: usize) -> Result<Option<(u32, StoredCalibration)>, StoreError<M::Error>> {
        let mut slot = Calibrations::BLANK;
        Ok(match self.slots.inspect(place, &mut slot)? {
            Content::Frame(frame) => record(frame, &slot).ok().map(|record| (frame.sequence, record)),
            Content::Blank | Content::Damaged(_) => None,
        })
    }

    // --------------------------------------------------------------------------------------------------- what there is

    /// What keeps slots from being read.
    fn damages(&self) -> impl Iterator<Item = Damage> + '_ {
        let damaged = self.states.iter().filter_map(|slot| match slot {
            Slot::Damaged(damage) => Some(*damage),
            Slot::Empty | Slot::Frame { .. } => None,
        });
        damaged.chain(self.frames().filter_map(|frame| match frame.holds {
            Holds::Unread(damage) => Some(damage),
            Holds::Accepted | Holds::Rejected | Holds::Tombstone => None,
        }))
    }

    fn damage(&self) -> Option<Damage> {
        let newer = self.newer_version().map(Damage::Version);
        newer
            .or_else(|| self.damages().find(|damage| damage.other_version().is_none()))
            .or_else(|| self.damages().next())
    }

    /// The version of a record of newer software.
    fn newer_version(&self) -> Option<u8> {
        self.damages().filter_map(Damage::other_version).find(|version| *version > FORMAT_VERSION)
    }

    fn refuse_newer(&self) -> Result<(), StoreError<M::Error>> {
        self.newer_version().map_or(Ok(()), |version| Err(StoreError::Newer(version)))
    }

    /// The intact frames that were not erased, also those whose records cannot be read.
    fn frames(&self) -> impl Iterator<Item = Framed> + '_ {
        let tombstone = newest(self.all_frames().filter(|frame| frame.holds == Holds::Tombstone));
        self.all_frames().filter(move |frame| !tombstone.is_some_and(|tombstone| tombstone.at.is_after(frame.at)))
    }

    fn all_frames(&self) -> impl Iterator<Item = Framed> + '_ {
        (0..).zip(&self.states).filter_map(|(place, slot)| match *slot {
            Slot::Frame { sequence, holds } => Some(Framed { at: Position { place, sequence }, holds }),
            Slot::Empty | Slot::Damaged(_) => None,
        })
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
        let newest = entry.at.sequence;
        let age = |good: &Framed| newest.wrapping_sub(good.at.sequence);
        for _ in 0..back {
            entry = self.good().filter(|good| age(good) > age(&entry)).min_by_key(age)?;
        }
        Some(entry.at.place)
    }

    fn rejected_in_a_row(&self) -> usize {
        let accepted = self.newest_accepted();
        self.good().filter(|good| accepted.is_none_or(|accepted| good.at.is_after(accepted.at))).count()
    }

    fn tail(&self) -> Tail {
        let newest = newest(self.frames());
        let unreadable = self.states.iter().filter(|slot| **slot == Slot::Damaged(Damage::Unreadable)).count();
        Tail {
            newest: newest.map(|newest| newest.at),
            is_tombstone: newest.is_some_and(|newest| newest.holds == Holds::Tombstone),
            kept: self.newest_accepted().map(|newest| newest.at),
            unreadable: unreadable as u32,
        }
    }
}

impl Slot {
    fn of(content: Content, bytes: &[u8]) -> Self {
        match content {
            Content::Blank => Self::Empty,
            Content::Frame(frame) => Self::Frame { sequence: frame.sequence, holds: Holds::in_frame(frame, bytes) },
            Content::Damaged(damage) => Self::Damaged(damage),
        }
    }
}

impl From<Change> for Slot {
    fn from(change: Change) -> Self {
        match change {
            Change::Blanked => Self::Empty,
            Change::Failed => Self::Damaged(Damage::Worn),
        }
    }
}

fn note(states: &mut [Slot], place: usize, slot: Slot) {
    if let Some(noted) = states.get_mut(place) {
        *noted = slot;
    }
}

fn record(frame: Frame, slot: &[u8]) -> Result<StoredCalibration, Damage> {
    Calibrations::decode(frame.version, frame.payload(slot))
}

fn newest(frames: impl Iterator<Item = Framed>) -> Option<Framed> {
    frames.reduce(|first, second| if second.at.is_after(first.at) { second } else { first })
}
