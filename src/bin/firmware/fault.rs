//! Panics and faults of the processor: the board stops the motors, records the reason, and resets.
#![allow(unsafe_code)]

use crate::board::{Board, ThisBoard};
use crate::stack;
use core::arch::naked_asm;
use core::panic::PanicInfo;
use core::{ptr, slice, str};
use cortex_m::peripheral::SCB;
use rins_selfcal::base::restart::{FatalError, Registers};

/// Linked only if some code can panic.
#[panic_handler]
#[inline(never)]
fn panic(information: &PanicInfo<'_>) -> ! {
    let (file, line) = information.location().map_or(("?", 0), |location| (location.file(), location.line()));
    // Safety: address and length belong to a string.
    unsafe { panicked(file.as_ptr(), file.len(), line) }
}

/// Kept in every image, so that a test can call it.
#[used]
static PANICKED: unsafe extern "C" fn(*const u8, usize, u32) -> ! = panicked;

/// # Safety
/// Address and length must belong to bytes that may be read.
#[inline(never)]
unsafe extern "C" fn panicked(file: *const u8, length: usize, line: u32) -> ! {
    // Safety: the caller guarantees it.
    let file = unsafe { slice::from_raw_parts(file, length) };
    ThisBoard::stop(&FatalError::panic(str::from_utf8(file).unwrap_or("?"), line))
}

/// Sets the stack pointer to the top of the stack, which may have overflowed, and reports the fault.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs r0, MSP", "ldr r1, =_stack_start", "msr MSP, r1", "b {report}",
        report = sym report_hard_fault
    )
}

/// `frame` is the address where the processor has saved its registers.
extern "C" fn report_hard_fault(frame: usize) -> ! {
    // Safety: no other code runs any more.
    let scb = unsafe { &*SCB::PTR };
    // A failed data access has its own address register.
    let status = scb.cfsr.read();
    let address = if status & 0x8000 != 0 { scb.bfar.read() } else { scb.mmfar.read() };
    // Bits of the status: saving the registers failed, or the address of a forbidden access is valid.
    let stacking = status & 0x1010 != 0;
    let overflow = stacking || status & 0x80 != 0 && stack::guarded().contains(&(address as usize));
    // The saved return address and the saved program counter are the sixth and the seventh word of the frame.
    let [lr, pc] = [frame + 20, frame + 24].map(|place| word(place).filter(|_| !stacking).unwrap_or(0));
    ThisBoard::stop(&if overflow {
        FatalError::StackOverflow { pc }
    } else {
        FatalError::Fault(Registers { pc, lr, status, address })
    })
}

/// A word of the stack; `None` if the address is not in the stack.
fn word(place: usize) -> Option<u32> {
    let usable = stack::guarded().end..stack::top();
    // Safety: the address is within the stack, which may be read.
    (usable.contains(&place) && place.is_multiple_of(4)).then(|| unsafe { ptr::read_volatile(place as *const u32) })
}
