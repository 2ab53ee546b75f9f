//! Panics and faults of the processor: told by the board, which then ends the program.
#![allow(unsafe_code)]

use crate::board::{Board, ThisBoard};
use crate::stack;
use core::arch::naked_asm;
use core::panic::PanicInfo;
use cortex_m::peripheral::SCB;

/// Linked only if something can panic.
#[panic_handler]
#[inline(never)]
fn panic(information: &PanicInfo<'_>) -> ! {
    let (file, line) = information.location().map_or(("?", 0), |location| (location.file(), location.line()));
    ThisBoard::stop(file, &[line])
}

/// Moves to the top of the stack, which may have overflowed, and reports.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!("ldr r0, =_stack_start", "msr MSP, r0", "b {report}", report = sym report_hard_fault)
}

extern "C" fn report_hard_fault() -> ! {
    // Safety: nothing else runs any more.
    let scb = unsafe { &*SCB::PTR };
    let (status, address) = (scb.cfsr.read(), scb.mmfar.read());
    // Bits of the status: stacking failed, or the address is valid.
    let stacking = status & 0x10 != 0;
    let overflow = stacking || status & 0x80 != 0 && stack::guarded().contains(&(address as usize));
    ThisBoard::stop(if overflow { "stack overflow" } else { "hard fault" }, &[status, address])
}
