//! The memories that can hold a store. The bytes of an EEPROM can be written at any time. The words of a NOR flash can
//! be written once after their sector was erased.

use super::record::SLOT_BYTES;
use core::ops::Range;
use embedded_storage::Storage;
use embedded_storage::nor_flash::NorFlash;

/// Largest number of slots of a store. Only a part of a larger memory is used.
pub const MAX_SLOTS: usize = 64;

/// A memory as the store uses it: blocks of slots. A block is the smallest part that can be erased.
pub trait Medium {
    /// What the memory reports when it fails.
    type Error;
    /// Number of slots at the beginning of a block.
    const SLOTS_PER_BLOCK: usize;
    /// Distance from the beginning of a block to the beginning of the next block, bytes.
    const BLOCK_BYTES: usize;
    /// Whether a slot can be written only while it is blank.
    const ERASES: bool;
    /// Whether a failed read shows a damaged slot, such as a word that was half written and fails its error correction.
    /// If not, a failed read shows that the memory does not answer, and its content must not be overwritten.
    const READ_FAULT_IS_DAMAGE: bool;

    /// Memory for all blocks, bytes.
    fn capacity(&self) -> usize;

    /// Reads bytes from this address on. Address 0 is the beginning of the first block.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), Self::Error>;

    /// Writes bytes from this address on. Address and length are multiples of 32 bytes.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), Self::Error>;

    /// Makes the block at this address blank.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn erase(&mut self, address: u32) -> Result<(), Self::Error>;
}

/// Memory whose bytes can be written at any time. The store begins at its address 0.
#[derive(Clone, Debug)]
pub struct Eeprom<S>(pub S);

impl<S: Storage> Medium for Eeprom<S> {
    type Error = S::Error;
    const SLOTS_PER_BLOCK: usize = 1;
    const BLOCK_BYTES: usize = SLOT_BYTES;
    const ERASES: bool = false;
    const READ_FAULT_IS_DAMAGE: bool = false;

    fn capacity(&self) -> usize {
        self.0.capacity()
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), S::Error> {
        self.0.read(address, bytes)
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), S::Error> {
        self.0.write(address, bytes)
    }

    /// Sets all bits, as they were on delivery.
    fn erase(&mut self, address: u32) -> Result<(), S::Error> {
        self.0.write(address, &[0xff; SLOT_BYTES])
    }
}

/// A part of a NOR flash: whole sectors that nothing else uses.
#[derive(Clone, Debug)]
pub struct Flash<F> {
    flash: F,
    range: Range<u32>,
}

impl<F: NorFlash> Flash<F> {
    /// The sectors of `flash` that lie completely in `range`. The range begins at the beginning of a sector.
    pub fn new(flash: F, range: Range<u32>) -> Self {
        Self { flash, range }
    }

    /// The whole flash.
    pub fn flash(&mut self) -> &mut F {
        &mut self.flash
    }
}

impl<F: NorFlash> Medium for Flash<F> {
    type Error = F::Error;
    const SLOTS_PER_BLOCK: usize = {
        assert!(SLOT_BYTES.is_multiple_of(F::WRITE_SIZE), "a slot is whole words");
        assert!(32_usize.is_multiple_of(F::READ_SIZE), "slots are read by 32 bytes");
        let slots = F::ERASE_SIZE / SLOT_BYTES;
        assert!(slots > 0, "a sector holds a slot");
        // At least two sectors: the newest record is kept in one while the other is erased.
        if slots > MAX_SLOTS / 2 { MAX_SLOTS / 2 } else { slots }
    };
    const BLOCK_BYTES: usize = F::ERASE_SIZE;
    const ERASES: bool = true;
    const READ_FAULT_IS_DAMAGE: bool = true;

    fn capacity(&self) -> usize {
        self.flash.capacity().min(self.range.end as usize).saturating_sub(self.range.start as usize)
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), F::Error> {
        self.flash.read(self.range.start.wrapping_add(address), bytes)
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), F::Error> {
        self.flash.write(self.range.start.wrapping_add(address), bytes)
    }

    fn erase(&mut self, address: u32) -> Result<(), F::Error> {
        let start = self.range.start.wrapping_add(address);
        self.flash.erase(start, start.wrapping_add(F::ERASE_SIZE as u32))
    }
}
