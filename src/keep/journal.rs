//! A journal: a log of which only the newest record counts. [`slots`](super::slots) describes the log.
//!
//! The newest record is never overwritten or erased before the next one is written and read back. What follows it in the
//! memory tells whether a newer record may have been lost: a slot that is damaged by a write that was cut.

use super::frame::Damage;
use super::medium::Medium;
use super::slots::{Content, Kind, Position, Slots, StoreError, Tail};

/// What a journal holds.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Latest<R> {
    /// The newest intact record. `None` if there is none, if everything was erased, or if this software cannot read it;
    /// an older record is not given in its place.
    pub record: Option<R>,
    /// Why a newer record may be lost or cannot be read: the damage of the slot where it would be, or the other version
    /// of its format. Without any intact record, the first damage.
    pub damage: Option<Damage>,
}

/// A journal in a memory.
///
/// ```
/// # use embedded_storage::{ReadStorage, Storage};
/// use rins_selfcal::keep::journal::{Journal, Latest};
/// use rins_selfcal::keep::mark::{Mark, Marks};
/// use rins_selfcal::keep::medium::Eeprom;
///
/// # struct Memory(Vec<u8>);
/// # impl ReadStorage for Memory {
/// #     type Error = std::convert::Infallible;
/// #     fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
/// #         bytes.copy_from_slice(&self.0[at as usize..][..bytes.len()]);
/// #         Ok(())
/// #     }
/// #     fn capacity(&self) -> usize { self.0.len() }
/// # }
/// # impl Storage for Memory {
/// #     fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Self::Error> {
/// #         self.0[at as usize..][..bytes.len()].copy_from_slice(bytes);
/// #         Ok(())
/// #     }
/// # }
/// let mut journal = Journal::<_, Marks>::new(Eeprom(Memory(vec![0xff; 1024])));
/// assert_eq!(journal.load(), Ok(Latest { record: None, damage: None }));
/// journal.write(&Mark::Moving).expect("the memory works");
/// assert_eq!(journal.load(), Ok(Latest { record: Some(Mark::Moving), damage: None }));
/// ```
#[derive(Debug)]
pub struct Journal<M, K> {
    slots: Slots<M, K>,
    /// The end of the log and the first damage, as found at the first access; the end also as written since then.
    found: Option<(Tail, Option<Damage>)>,
}

impl<M: Medium, K: Kind> Journal<M, K> {
    /// The journal in `memory`. The memory is not accessed yet.
    pub fn new(memory: M) -> Self {
        Self { slots: Slots::new(memory), found: None }
    }

    /// The memory. The journal does not see bytes that are written directly after its first access.
    pub fn memory(&mut self) -> &mut M {
        &mut self.slots.memory
    }

    /// Returns the memory.
    pub fn release(self) -> M {
        self.slots.memory
    }

    /// Reads the newest record.
    ///
    /// # Errors
    /// The memory does not work or is too small. Damaged content is not an error; it is part of the result.
    #[inline(never)]
    pub fn load(&mut self) -> Result<Latest<K::Record>, StoreError<M::Error>> {
        let (tail, first_damage) = self.scan_once()?;
        let Some(newest) = tail.newest else { return Ok(Latest { record: None, damage: first_damage }) };
        if tail.is_tombstone {
            return Ok(Latest { record: None, damage: self.after(&tail)? });
        }
        match self.read(newest)? {
            Ok(record) => Ok(Latest { record: Some(record), damage: self.after(&tail)? }),
            Err(damage) => Ok(Latest { record: None, damage: Some(damage) }),
        }
    }

    /// Appends a record. Returns the number of slots that failed before a slot took the record.
    ///
    /// # Errors
    /// The memory does not work or is too small, the record does not fit, or no slot takes it. The newest record is then
    /// still the newest.
    #[inline(never)]
    pub fn write(&mut self, record: &K::Record) -> Result<usize, StoreError<M::Error>> {
        let (tail, damage) = self.scan_once()?;
        let (at, failed) = self.slots.append(&tail, record, &mut |_, _| ())?;
        self.found = Some((Tail { newest: Some(at), kept: Some(at), is_tombstone: false, ..tail }, damage));
        Ok(failed)
    }

    /// Completes an erase that was cut by a loss of power, and does the erases that the next `records` writes would have
    /// to wait for. Call it at power-up, when no sample waits.
    ///
    /// # Errors
    /// The memory does not work or is too small, or no place can be prepared.
    #[inline(never)]
    pub fn prepare(&mut self, records: usize) -> Result<(), StoreError<M::Error>> {
        if self.scan_once()?.0.is_tombstone {
            // If a part of the memory cannot be erased, the rest of it may still take a record.
            let _ = self.erase();
        }
        let (tail, _) = self.scan_once()?;
        self.slots.prepare(&tail, records, &mut |_, _| ())
    }

    /// Erases everything.
    ///
    /// # Errors
    /// The memory does not work, is too small, or is not blank after the erase.
    #[inline(never)]
    pub fn erase(&mut self) -> Result<(), StoreError<M::Error>> {
        // A memory that cannot be searched is erased too.
        let (tail, _) = self.scan_once().unwrap_or_default();
        self.found = None;
        self.slots.erase(&tail)
    }

    fn scan_once(&mut self) -> Result<(Tail, Option<Damage>), StoreError<M::Error>> {
        if let Some(found) = self.found {
            return Ok(found);
        }
        let (mut tail, mut first_damage) = (Tail::default(), None);
        self.slots.scan(|place, content, _| match content {
            Content::Blank => {}
            Content::Frame(frame) => tail.add(Position { place, sequence: frame.sequence }, frame.is_tombstone()),
            Content::Damaged(damage) => {
                tail.unreadable += u32::from(damage == Damage::Unreadable);
                first_damage = first_damage.or(Some(damage));
            }
        })?;
        Ok(*self.found.insert((tail, first_damage)))
    }

    /// The record at this position, or why it cannot be read.
    fn read(&mut self, newest: Position) -> Result<Result<K::Record, Damage>, StoreError<M::Error>> {
        let mut slot = K::BLANK;
        Ok(match self.slots.inspect(newest.place, &mut slot)? {
            Content::Frame(frame) => K::decode(frame.version, frame.payload(slot.as_ref())),
            Content::Damaged(damage) => Err(damage),
            // It was intact when the memory was searched.
            Content::Blank => Err(Damage::Magic),
        })
    }

    /// The damage of the slot after the newest frame, where a newer record would be.
    fn after(&mut self, tail: &Tail) -> Result<Option<Damage>, StoreError<M::Error>> {
        let (count, next, mut slot) = (self.slots.count()?, tail.next().place, K::BLANK);
        let place = if next < count { next } else { 0 };
        Ok(match self.slots.inspect(place, &mut slot)? {
            Content::Damaged(damage) => Some(damage),
            Content::Blank | Content::Frame(_) => None,
        })
    }
}
