//! The EEPROM on the bit-banged I2C bus.

use super::bit_bang_i2c::BitBangI2c;
use super::register::Register;
use crate::watchdog;
use core::convert::Infallible;
use eeprom24x::{Eeprom24x, SlaveAddr, addr_size, page_size, unique_serial};
use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use rins_selfcal::keep::medium;

const I2C_SET: Register = Register::at(0x4002_a000);
const I2C_CLEAR: Register = Register::at(0x4002_a004);

/// Delays that count instructions. The emulator executes one instruction in 2 ns.
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        cortex_m::asm::delay(ns.div_ceil(2));
    }
}

/// The delay for the write of a page. It reports that the main loop still runs, because all pages together take
/// seconds.
pub struct PageDelay;

impl DelayNs for PageDelay {
    fn delay_ns(&mut self, ns: u32) {
        watchdog::progress(super::uptime_us());
        Delay.delay_ns(ns);
    }
}

/// A line of the bit-banged I2C bus. It is open-drain, so it is input and output at once.
pub struct Line(u32);

const SCL: Line = Line(1);
const SDA: Line = Line(2);

impl ErrorType for Line {
    type Error = Infallible;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Infallible> {
        I2C_CLEAR.write(self.0);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        I2C_SET.write(self.0);
        Ok(())
    }
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(I2C_SET.read() & self.0 != 0)
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The EEPROM, a 24x128 of 16 KiB.
pub type Eeprom = medium::Eeprom<
    eeprom24x::Storage<
        BitBangI2c<Line, Line, Delay>,
        page_size::B64,
        addr_size::TwoBytes,
        unique_serial::No,
        PageDelay,
    >,
>;

/// The EEPROM of the board.
pub fn eeprom() -> Eeprom {
    let i2c = BitBangI2c::new(SCL, SDA, Delay);
    medium::Eeprom(eeprom24x::Storage::new(Eeprom24x::new_24x128(i2c, SlaveAddr::default()), PageDelay))
}
