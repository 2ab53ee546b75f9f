//! The flash of the chip, as a memory that can say that it cannot read a word.
//!
//! A power cut in the middle of a write leaves words that the error correction of the flash cannot mend: reading one is a
//! fault of the bus (RM0433, on its error correction). Here it is an error, which the store knows how to live with.
#![allow(unsafe_code)]

use super::clock;
use crate::watchdog;
use core::arch::asm;
use cortex_m::peripheral::SCB;
use embassy_stm32::flash::{self, Flash};
use embassy_stm32::pac;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

type ChipFlash = Flash<'static, flash::Blocking>;

/// Bytes of a word of the flash, and of a line of the cache.
const WORD: usize = 32;
/// Number of the bank that keeps calibrations.
const BANK: usize = 1;
/// Bit of CCR: handlers of the highest priorities ignore faults of the data bus.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;

/// Bits of SR that CCR clears: RM0433, FLASH_CCR.
const CLEARABLE: u32 = 0x1fef_0000;

/// Fault of the flash.
#[derive(Clone, Copy, Debug)]
pub enum FlashFault {
    /// A word cannot be read.
    Unreadable,
    /// Something else.
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
        // A sector takes up to 4 s.
        watchdog::progress(clock::now_us());
        forget_flags();
        self.0.blocking_erase(from, to).map_err(FlashFault::Chip)
    }
}

/// Clears what earlier reads and writes have left, a corrected bit for one: the HAL takes every flag for a failure of its own.
fn forget_flags() {
    let bank = pac::FLASH.bank(BANK);
    let flags = bank.sr().read().0;
    // A flag of SR is cleared by the same bit of CCR: RM0433, FLASH_CCR.
    bank.ccr().write(|clear| clear.0 = flags & CLEARABLE);
}

/// What was written or erased is not to be read from the cache.
fn forget_cached(offset: u32, length: usize) {
    let address = flash::FLASH_BASE + offset as usize;
    let start = address & !(WORD - 1);
    // Safety: the cache writes through to flash, so that nothing is lost with its lines.
    unsafe { cortex_m::Peripherals::steal().SCB.invalidate_dcache_by_address(start, address + length - start) };
}

/// Reads one word at most, for which every interrupt waits.
fn without_bus_faults<R>(read: impl FnOnce() -> R) -> R {
    critical_section::with(|_| {
        // Safety: nobody else changes the register while interrupts wait; faults are ignored between the two instructions.
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
