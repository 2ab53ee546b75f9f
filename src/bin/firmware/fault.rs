//! Panics and faults of the processor: the board stops the motors, records why, and resets.
#![allow(unsafe_code)]

use crate::board::{Board, ThisBoard};
use crate::stack;
use core::arch::naked_asm;
use core::panic::PanicInfo;
use core::{ptr, slice, str};
use cortex_m::peripheral::SCB;
use rins_selfcal::base::restart::{FatalError, Registers};

/// Linked only if something can panic.
#[panic_handler]
#[inline(never)]
fn panic(information: &PanicInfo<'_>) -> ! {
    let (file, line) = information.location().map_or(("?", 0), |location| (location.file(), location.line()));
    // Safety: address and length of a string.
    unsafe { panicked(file.as_ptr(), file.len(), line) }
}

/// Kept in every image, so that it can be tried.
#[used]
static PANICKED: unsafe extern "C" fn(*const u8, usize, u32) -> ! = panicked;

/// # Safety
/// Address and length are those of text.
#[inline(never)]
unsafe extern "C" fn panicked(file: *const u8, length: usize, line: u32) -> ! {
    // Safety: as demanded.
    let file = unsafe { slice::from_raw_parts(file, length) };
    ThisBoard::stop(&FatalError::panic(str::from_utf8(file).unwrap_or("?"), line))
}

/// Moves to the top of the stack, which may have overflowed, and reports.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs r0, MSP", "ldr r1, =_stack_start", "msr MSP, r1", "b {report}",
        report = sym report_hard_fault
    )
}

/// `frame`: where the processor has put its registers.
extern "C" fn report_hard_fault(frame: usize) -> ! {
    // Safety: nothing else runs any more.
    let scb = unsafe { &*SCB::PTR };
    // A failed access of the data bus has an address of its own.
    let status = scb.cfsr.read();
    let address = if status & 0x8000 != 0 { scb.bfar.read() } else { scb.mmfar.read() };
    // Bits of the status: stacking failed, or the address of a forbidden access is valid.
    let stacking = status & 0x1010 != 0;
    let overflow = stacking || status & 0x80 != 0 && stack::guarded().contains(&(address as usize));
    // Return address and address of the instruction are the sixth and the seventh word.
    let [lr, pc] = [frame + 20, frame + 24].map(|place| word(place).filter(|_| !stacking).unwrap_or(0));
    ThisBoard::stop(&if overflow {
        FatalError::StackOverflow { pc }
    } else {
        FatalError::Fault(Registers { pc, lr, status, address })
    })
}

/// A word of the stack.
fn word(place: usize) -> Option<u32> {
    let usable = stack::guarded().end..stack::top();
    // Safety: an address within the stack, which may be read.
    (usable.contains(&place) && place.is_multiple_of(4)).then(|| unsafe { ptr::read_volatile(place as *const u32) })
}
