//! The flash of the chip, as a memory that reports an error when it cannot read a word.
//!
//! A power cut during a write can leave words that the flash's error correction cannot correct. A read of such a word
//! causes a bus fault (RM0433, error correction of the flash). Here the read returns an error, which the store can
//! handle.
#![allow(unsafe_code)]

use super::clock;
use crate::watchdog;
use core::arch::asm;
use cortex_m::peripheral::SCB;
use embassy_stm32::flash::{self, Flash};
use embassy_stm32::pac;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

type ChipFlash = Flash<'static, flash::Blocking>;

/// Length of a flash word and of a cache line, bytes.
const WORD: usize = 32;
/// Number of the flash bank that holds the records.
const BANK: usize = 1;
/// Bit of CCR: handlers of the highest priorities ignore faults of the data bus.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;

/// Bits of SR that CCR clears: RM0433, FLASH_CCR.
const CLEARABLE: u32 = 0x1fef_0000;

/// A fault of the flash.
#[derive(Clone, Copy, Debug)]
pub enum FlashFault {
    /// A word cannot be read.
    Unreadable,
    /// Another fault, as the HAL reports it.
    Chip(flash::Error),
}

impl NorFlashError for FlashFault {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Unreadable => NorFlashErrorKind::Other,
            Self::Chip(error) => error.kind(),
        }
    }
}

/// The flash.
pub struct CheckedFlash(pub ChipFlash);

impl ErrorType for CheckedFlash {
    type Error = FlashFault;
}

impl ReadNorFlash for CheckedFlash {
    const READ_SIZE: usize = <ChipFlash as ReadNorFlash>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFault> {
        forget_cached(offset, bytes.len());
        for (offset, piece) in (offset..).step_by(WORD).zip(bytes.chunks_mut(WORD)) {
            pac::FLASH.bank(BANK).ccr().write(|flags| flags.set_clr_dbeccerr(true));
            without_bus_faults(|| self.0.blocking_read(offset, piece)).map_err(FlashFault::Chip)?;
            if pac::FLASH.bank(BANK).sr().read().dbeccerr() {
                pac::FLASH.bank(BANK).ccr().write(|flags| flags.set_clr_dbeccerr(true));
                return Err(FlashFault::Unreadable);
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

impl NorFlash for CheckedFlash {
    const WRITE_SIZE: usize = <ChipFlash as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = <ChipFlash as NorFlash>::ERASE_SIZE;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFault> {
        forget_flags();
        self.0.blocking_write(offset, bytes).map_err(FlashFault::Chip)
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFault> {
        // An erase of a sector takes up to 4 s.
        watchdog::progress(clock::now_us());
        forget_flags();
        self.0.blocking_erase(from, to).map_err(FlashFault::Chip)
    }
}

/// Clears flags that earlier reads and writes have left, such as that of a corrected bit. The HAL would take every flag
/// for a failure of its own operation.
fn forget_flags() {
    let bank = pac::FLASH.bank(BANK);
    let flags = bank.sr().read().0;
    // A bit of CCR clears the same flag of SR: RM0433, FLASH_CCR.
    bank.ccr().write(|clear| clear.0 = flags & CLEARABLE);
}

/// Removes written or erased words from the cache, so that the next read reads the flash.
fn forget_cached(offset: u32, length: usize) {
    let address = flash::FLASH_BASE + offset as usize;
    let start = address & !(WORD - 1);
    // Safety: the cache writes through to the flash, so no data is lost with the invalidated lines.
    unsafe { cortex_m::Peripherals::steal().SCB.invalidate_dcache_by_address(start, address + length - start) };
}

/// Reads at most one word with bus faults ignored. All interrupts wait for it.
fn without_bus_faults<R>(read: impl FnOnce() -> R) -> R {
    critical_section::with(|_| {
        // Safety: interrupts are off, so nothing else changes the register. Faults are ignored between the two writes
        // only.
        unsafe {
            let control = &(*SCB::PTR).ccr;
            control.modify(|bits| bits | IGNORE_BUS_FAULTS);
            asm!("cpsid f", "dsb", "isb");
            let outcome = read();
            asm!("dsb", "cpsie f", "isb");
            control.modify(|bits| bits & !IGNORE_BUS_FAULTS);
            outcome
        }
    })
}
