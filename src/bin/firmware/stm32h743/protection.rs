//! The memory protection unit, beside the guard of the stack: addresses that nothing may read, and that the Cortex-M7
//! must not read ahead.

use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::MPU;
use rins_selfcal::drivers::stm32h743::ClosedRegion;

/// Numbers of the regions. The guard of the stack has region 0. A higher number wins where two regions overlap.
const EXTERNAL: u32 = 1;
const SYSTEM_MEMORY: u32 = 2;
const BANK_2: u32 = 3;

/// Closes what the board never uses.
pub fn start() {
    set(EXTERNAL, ClosedRegion::EXTERNAL, true);
    set(SYSTEM_MEMORY, ClosedRegion::SYSTEM_MEMORY, true);
}

/// Calls `erase` with bank 2 of the flash closed: a read ahead in a sector that is being erased sets the flags of errors.
pub fn with_bank_2_closed<R>(erase: impl FnOnce() -> R) -> R {
    set(BANK_2, ClosedRegion::BANK_2, true);
    let outcome = erase();
    set(BANK_2, ClosedRegion::BANK_2, false);
    outcome
}

fn set(number: u32, region: ClosedRegion, closed: bool) {
    critical_section::with(|_| {
        // Safety: interrupts are off, and only this function and the start write these registers. The regions close
        // addresses that no code uses while they are closed.
        let mpu = unsafe { &*MPU::PTR };
        dsb();
        unsafe {
            mpu.rbar.write(region.base(number));
            mpu.rasr.write(if closed { region.attributes() } else { 0 });
        }
        dsb();
        isb();
        compiler_fence(Ordering::SeqCst);
    });
}
