//! The stack: its limits, its guard, and how many bytes of it were used.
#![allow(unsafe_code)]

use core::ops::Range;
use core::ptr;
use cortex_m::peripheral::MPU;

/// Size of the no-access region at the bottom of the stack, bytes.
const GUARD_BYTES: usize = 256;

unsafe extern "C" {
    static mut _stack_start: u32;
    static mut _stack_end: u32;
}

fn bottom() -> usize {
    (&raw const _stack_end).addr()
}

/// The address after the top of the stack.
pub fn top() -> usize {
    (&raw const _stack_start).addr()
}

/// Size of the stack, bytes.
pub fn bytes() -> usize {
    top() - bottom()
}

/// The addresses of the guard, which no code may use.
pub fn guarded() -> Range<usize> {
    bottom()..bottom() + GUARD_BYTES
}

/// Makes the lowest bytes of the stack inaccessible, so that an overflow causes a fault and damages no memory.
pub fn guard(mpu: &MPU) {
    const REGION_VALID: u32 = 1 << 4;
    const EXECUTE_NEVER: u32 = 1 << 28;
    const SIZE_256: u32 = 7 << 1;
    const ENABLE: u32 = 1;
    const DEFAULT_MAP: u32 = 1 << 2;
    // Safety: the region forbids access only to the guard, which no code may use.
    unsafe {
        mpu.rbar.write(bottom() as u32 | REGION_VALID);
        mpu.rasr.write(EXECUTE_NEVER | SIZE_256 | ENABLE);
        mpu.ctrl.write(DEFAULT_MAP | ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Largest use of the stack since power-up, bytes. Words that were never used still have the paint value.
pub fn used() -> usize {
    // Safety: the address is within the stack, which may be read.
    let painted = |word: usize| unsafe { ptr::read_volatile(word as *const u32) } == cortex_m_rt::STACK_PAINT_VALUE;
    let mut word = guarded().end;
    while word < top() && painted(word) {
        word += 4;
    }
    top() - word
}
