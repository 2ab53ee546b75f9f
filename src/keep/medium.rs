//! The memories that can hold records. The bytes of an EEPROM can be written at any time. The words of a NOR flash can
//! be written once after their sector was erased.

use core::ops::Range;
use embedded_storage::Storage;
use embedded_storage::nor_flash::NorFlash;

/// Bytes that are erased at once in a memory without sectors: whole pages of every EEPROM.
const BLANK: [u8; 128] = [0xff; 128];

/// A memory as stores and journals use it.
pub trait Medium {
    /// What the memory reports when it fails.
    type Error;
    /// The smallest part that can be erased, bytes. Bytes can then be written only while they are blank. `None` if any
    /// byte can be written at any time.
    const ERASE_BYTES: Option<usize>;
    /// Whether a failed read shows a damaged slot, such as a word that was half written and fails its error correction.
    /// If not, a failed read shows that the memory does not answer, and its content must not be overwritten.
    const READ_FAULT_IS_DAMAGE: bool;

    /// Size of the memory, bytes.
    fn capacity(&self) -> usize;

    /// Reads bytes from this address on. Address and length are multiples of 32 bytes.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), Self::Error>;

    /// Writes bytes from this address on. Address and length are multiples of 32 bytes.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), Self::Error>;

    /// Sets all bits of this many bytes. Address and length are multiples of [`Self::ERASE_BYTES`], or of 32 bytes.
    ///
    /// # Errors
    /// The memory reports a fault.
    fn erase(&mut self, address: u32, length: usize) -> Result<(), Self::Error>;
}

/// Memory whose bytes can be written at any time.
#[derive(Clone, Debug)]
pub struct Eeprom<S>(pub S);

impl<S: Storage> Medium for Eeprom<S> {
    type Error = S::Error;
    const ERASE_BYTES: Option<usize> = None;
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

    fn erase(&mut self, address: u32, length: usize) -> Result<(), S::Error> {
        let (mut address, mut left) = (address, length);
        while left > 0 {
            let piece = left.min(BLANK.len());
            self.0.write(address, BLANK.get(..piece).unwrap_or_default())?;
            (address, left) = (address.wrapping_add(piece as u32), left - piece);
        }
        Ok(())
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
    const ERASE_BYTES: Option<usize> = {
        assert!(32_usize.is_multiple_of(F::WRITE_SIZE), "records are written by 32 bytes");
        assert!(32_usize.is_multiple_of(F::READ_SIZE), "records are read by 32 bytes");
        Some(F::ERASE_SIZE)
    };
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

    fn erase(&mut self, address: u32, length: usize) -> Result<(), F::Error> {
        let start = self.range.start.wrapping_add(address);
        self.flash.erase(start, start.wrapping_add(length as u32))
    }
}
