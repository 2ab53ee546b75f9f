//! The records in bank 2 of the chip's flash, as a memory that reports an error when it cannot read a word.
//!
//! A power cut during a write can leave words that the flash's error correction cannot correct. A read of such a word
//! causes a bus fault (RM0433, error correction of the flash). Here the read returns an error, which the store can
//! handle.
//!
//! The HAL's own functions take every flag of the bank for a failure of their operation, also those that revision V sets
//! for reads without a reason. So this file programs and erases by itself, in the order of RM0433, sections "single write
//! sequence" and "sector erase sequence".
#![allow(unsafe_code)]

use super::{clock, protection};
use crate::watchdog;
use core::arch::asm;
use core::ops::Range;
use core::ptr;
use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::SCB;
use embassy_stm32::Peri;
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use rins_selfcal::drivers::stm32h743::{FlashError, flash_is_busy, flash_outcome};

/// Address of the flash.
const START: usize = 0x0800_0000;
/// Size of the flash, and offset of its bank 2, bytes.
const BYTES: usize = 2 * 1024 * 1024;
const BANK_2: usize = 1024 * 1024;
const SECTOR: usize = 128 * 1024;
/// Length of a flash word and of a cache line, bytes.
const WORD: usize = 32;
/// Index of the flash bank that holds the records.
const BANK: usize = 1;
/// Bit of CCR: handlers of the highest priorities ignore faults of the data bus.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;
/// Bits of SR that CCR clears: RM0433, FLASH_CCR.
const CLEARABLE: u32 = 0x1fef_0000;
/// Programming and erasing by 64 bits at once: the fastest. The supply is above 2.7 V.
const PARALLELISM: u8 = 3;
/// Longest times of the operations, with a margin: 0.2 ms for a word and 2 s for a sector (data sheet DS12110).
const PROGRAM_US: u64 = 2_000;
const ERASE_US: u64 = 4_500_000;

/// A fault of the flash.
#[derive(Clone, Copy, Debug)]
pub enum FlashFault {
    /// A word cannot be read.
    Unreadable,
    /// An operation failed. The log says why.
    Failed,
    /// The caller's addresses are wrong.
    Misuse(NorFlashErrorKind),
}

impl NorFlashError for FlashFault {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Misuse(kind) => *kind,
            Self::Unreadable | Self::Failed => NorFlashErrorKind::Other,
        }
    }
}

/// The flash. Only bank 2 can be written.
pub struct CheckedFlash(Peri<'static, FLASH>);

impl CheckedFlash {
    /// The flash of the chip.
    pub fn new(flash: Peri<'static, FLASH>) -> Self {
        Self(flash)
    }
}

impl ErrorType for CheckedFlash {
    type Error = FlashFault;
}

impl ReadNorFlash for CheckedFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFault> {
        check_read(self, offset, bytes.len()).map_err(FlashFault::Misuse)?;
        let bank = pac::FLASH.bank(BANK);
        forget_cached(offset as usize, bytes.len());
        for (address, piece) in (START + offset as usize..).step_by(WORD).zip(bytes.chunks_mut(WORD)) {
            bank.ccr().write(|flags| flags.set_clr_dbeccerr(true));
            without_bus_faults(|| copy(address, piece));
            if bank.sr().read().dbeccerr() {
                bank.ccr().write(|flags| flags.set_clr_dbeccerr(true));
                return Err(FlashFault::Unreadable);
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl NorFlash for CheckedFlash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFault> {
        check_write(self, offset, bytes.len()).map_err(FlashFault::Misuse)?;
        let words = in_bank_2(offset as usize, bytes.len())?.step_by(WORD).zip(bytes.as_chunks::<WORD>().0);
        unlocked(|| words.into_iter().try_for_each(|(place, word)| program(START + BANK_2 + place, word)))
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFault> {
        check_erase(self, from, to).map_err(FlashFault::Misuse)?;
        let range = in_bank_2(from as usize, (to - from) as usize)?;
        unlocked(|| range.step_by(SECTOR).try_for_each(|place| erase((place / SECTOR) as u8)))
    }
}

/// The same bytes, counted from the beginning of bank 2.
fn in_bank_2(offset: usize, length: usize) -> Result<Range<usize>, FlashFault> {
    let start = offset.checked_sub(BANK_2).ok_or(FlashFault::Misuse(NorFlashErrorKind::OutOfBounds))?;
    Ok(start..start + length)
}

/// Calls `act` with the control register of bank 2 unlocked.
fn unlocked<R>(act: impl FnOnce() -> R) -> R {
    let bank = pac::FLASH.bank(BANK);
    if bank.cr().read().lock() {
        bank.keyr().write_value(0x4567_0123);
        bank.keyr().write_value(0xcdef_89ab);
    }
    let outcome = act();
    bank.cr().modify(|control| control.set_lock(true));
    outcome
}

/// Programs a word. The flash takes its eight parts and begins when it has all of them.
fn program(address: usize, word: &[u8; WORD]) -> Result<(), FlashFault> {
    let bank = pac::FLASH.bank(BANK);
    forget_flags();
    bank.cr().modify(|control| {
        control.set_psize(PARALLELISM);
        control.set_pg(true);
    });
    // The control register must be written before the flash gets the data.
    dsb();
    isb();
    // An interrupt between two parts would do no harm, but a fault would leave half a word in the buffer.
    critical_section::with(|_| {
        for (place, part) in (address..).step_by(4).zip(word.as_chunks::<4>().0) {
            // Safety: the address is within bank 2, which holds no program and no variables, and is a multiple of 4.
            unsafe { ptr::write_volatile(place as *mut u32, u32::from_le_bytes(*part)) };
        }
        dsb();
    });
    let outcome = wait(PROGRAM_US);
    bank.cr().modify(|control| control.set_pg(false));
    forget_flags();
    outcome
}

/// Erases a sector of bank 2.
fn erase(sector: u8) -> Result<(), FlashFault> {
    let bank = pac::FLASH.bank(BANK);
    // An erase of a sector takes up to 2 s.
    watchdog::progress(clock::now_us());
    forget_flags();
    let outcome = protection::with_bank_2_closed(|| {
        bank.cr().modify(|control| {
            control.set_psize(PARALLELISM);
            control.set_ser(true);
            control.set_snb(sector);
        });
        bank.cr().modify(|control| control.set_start(true));
        dsb();
        wait(ERASE_US)
    });
    bank.cr().modify(|control| control.set_ser(false));
    forget_flags();
    outcome
}

/// Waits for the end of an operation.
fn wait(longest_us: u64) -> Result<(), FlashFault> {
    let end_us = clock::now_us() + longest_us;
    loop {
        let status = pac::FLASH.bank(BANK).sr().read().0;
        if !flash_is_busy(status) {
            return flash_outcome(status).map_err(failed);
        }
        if clock::now_us() > end_us {
            return Err(failed(FlashError::Busy));
        }
    }
}

fn failed(error: FlashError) -> FlashFault {
    defmt::warn!("the flash: {}", error);
    FlashFault::Failed
}

/// Clears the flags that earlier reads and operations have left.
fn forget_flags() {
    let bank = pac::FLASH.bank(BANK);
    let flags = bank.sr().read().0;
    // A bit of CCR clears the same flag of SR: RM0433, FLASH_CCR.
    bank.ccr().write(|clear| clear.0 = flags & CLEARABLE);
}

/// Removes written or erased words from the cache, so that the next read reads the flash.
fn forget_cached(offset: usize, length: usize) {
    let address = START + offset;
    let start = address & !(WORD - 1);
    // Safety: the cache writes through to the flash, so no data is lost with the invalidated lines.
    unsafe { cortex_m::Peripherals::steal().SCB.invalidate_dcache_by_address(start, address + length - start) };
}

/// Copies bytes from the flash.
fn copy(address: usize, bytes: &mut [u8]) {
    for (place, byte) in (address..).zip(bytes) {
        // Safety: the caller has checked that the address is within the flash.
        *byte = unsafe { ptr::read_volatile(place as *const u8) };
    }
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
