//! Partitions: one memory for several kinds of records. What is written or erased in one partition leaves the others as
//! they are.

use super::medium::Medium;
use core::cell::RefCell;
use core::ops::Range;

/// A part of a memory. All parts of a memory borrow it, each for one access at a time.
#[derive(Clone, Debug)]
pub struct Partition<'m, M> {
    memory: &'m RefCell<M>,
    range: Range<u32>,
}

impl<'m, M: Medium> Partition<'m, M> {
    /// The bytes of `memory` in `range`. In a flash the range is whole sectors; in an EEPROM it is whole pages.
    pub fn new(memory: &'m RefCell<M>, range: Range<u32>) -> Self {
        Self { memory, range }
    }

    fn access<R>(&self, act: impl FnOnce(&mut M) -> Result<R, M::Error>) -> Result<R, PartitionFault<M::Error>> {
        let mut memory = self.memory.try_borrow_mut().map_err(|_| PartitionFault::Busy)?;
        act(&mut memory).map_err(PartitionFault::Memory)
    }
}

/// Fault of a partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PartitionFault<E> {
    /// The memory is borrowed elsewhere. The partitions never do this to each other.
    Busy,
    /// The memory reports a fault.
    Memory(E),
}

impl<M: Medium> Medium for Partition<'_, M> {
    type Error = PartitionFault<M::Error>;
    const ERASE_BYTES: Option<usize> = M::ERASE_BYTES;
    const READ_FAULT_IS_DAMAGE: bool = M::READ_FAULT_IS_DAMAGE;

    fn capacity(&self) -> usize {
        let whole = self.memory.try_borrow().map_or(0, |memory| memory.capacity());
        whole.min(self.range.end as usize).saturating_sub(self.range.start as usize)
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.access(|memory| memory.read(self.range.start.wrapping_add(address), bytes))
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.access(|memory| memory.write(self.range.start.wrapping_add(address), bytes))
    }

    fn erase(&mut self, address: u32, length: usize) -> Result<(), Self::Error> {
        self.access(|memory| memory.erase(self.range.start.wrapping_add(address), length))
    }
}

/// Where a memory holds which records. No two ranges share a page of an EEPROM or a sector of a flash.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Layout {
    /// Addresses of the calibrations.
    pub calibrations: Range<u32>,
    /// Addresses of the configuration of the unit.
    pub configuration: Range<u32>,
    /// Addresses of the marks of motion.
    pub marks: Range<u32>,
}

impl Layout {
    /// An EEPROM of 16 KiB: 10 calibrations, 2 configurations and 32 marks.
    pub const EEPROM_16_KIB: Self = Self { calibrations: 0..8192, configuration: 8192..14_336, marks: 14_336..16_384 };
}
