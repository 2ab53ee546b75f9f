//! Registers of the machine: the only place that reads and writes addresses.
#![allow(unsafe_code)]

use core::ptr;

/// A 32-bit register.
#[derive(Clone, Copy)]
pub struct Register(usize);

impl Register {
    /// The register at this address.
    pub const fn at(address: usize) -> Self {
        assert!(address >> 29 == 0b010 && address.is_multiple_of(4), "not a peripheral's");
        Self(address)
    }

    /// Its value.
    pub fn read(self) -> u32 {
        // Safety: an address of a peripheral; none of this machine's changes memory.
        unsafe { ptr::read_volatile(self.0 as *const u32) }
    }

    /// Sets its value.
    pub fn write(self, value: u32) {
        // Safety: as above.
        unsafe { ptr::write_volatile(self.0 as *mut u32, value) }
    }
}

/// One of the CMSDK timers, which count down.
pub struct Timer {
    /// Enables the timer and its interrupt.
    pub control: Register,
    /// Its count.
    pub value: Register,
    /// Where it counts on from after 0; with 0 it stops there.
    pub reload: Register,
    /// Clears the interrupt.
    pub interrupt_clear: Register,
}

impl Timer {
    /// Bit of `control`.
    pub const ENABLE: u32 = 1;
    /// Bit of `control`.
    pub const ENABLE_INTERRUPT: u32 = 8;

    /// The timer at this address.
    pub const fn at(address: usize) -> Self {
        Self {
            control: Register::at(address),
            value: Register::at(address + 4),
            reload: Register::at(address + 8),
            interrupt_clear: Register::at(address + 12),
        }
    }
}
