//! Registers of the machine. This is the only file that reads and writes addresses.
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

    /// The value of the register.
    pub fn read(self) -> u32 {
        // Safety: the address belongs to a peripheral. No peripheral of this machine changes memory.
        unsafe { ptr::read_volatile(self.0 as *const u32) }
    }

    /// Sets the value of the register.
    pub fn write(self, value: u32) {
        // Safety: as above.
        unsafe { ptr::write_volatile(self.0 as *mut u32, value) }
    }
}

/// A CMSDK timer. It counts down.
pub struct Timer {
    /// Enables the timer and its interrupt.
    pub control: Register,
    /// The count.
    pub value: Register,
    /// The count continues from this value after 0. If the value is 0, the timer stops.
    pub reload: Register,
    /// Clears the interrupt.
    pub interrupt_clear: Register,
}

impl Timer {
    /// Bit of `control`: the timer runs.
    pub const ENABLE: u32 = 1;
    /// Bit of `control`: the timer raises its interrupt at 0.
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
