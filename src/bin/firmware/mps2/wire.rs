//! The constants that the emulated board and the host's bench share. The host includes this file by its path.

use rins_selfcal::drivers::biss::CAPTURE_BYTES;

/// Numbers of the chips on the bus.
pub mod chip {
    /// The IMU, or the receiver of its serial line.
    pub const IMU: u8 = 0;
    /// Not a chip: one control period, with all data that the control interrupt exchanges. See [`super::PERIOD_BYTES`].
    pub const PERIOD: u8 = 3;
    /// The line that switches both bridges off until the next period. The request has no bytes and no answer.
    pub const MOTORS_OFF: u8 = 4;
}

/// Length of the longest SPI transfer, bytes.
pub const MAX_TRANSFER_BYTES: usize = 96;

/// Length of the transfer of a control period, bytes:
///
/// ```text
/// sent      0-5    duty of the outer bridge, u16, low byte first, and bits of `pin`; the same of the inner bridge
/// received  0      bits of `input`
///           1-24   96 bits of the outer and of the inner encoder's line
/// ```
pub const PERIOD_BYTES: usize = 1 + 2 * CAPTURE_BYTES;

/// Number of steps of the PWM's duty from 0 to 1: 20 kHz from a timer of 160 MHz.
pub const DUTY_STEPS: u16 = 8000;

/// Bits of a bridge's pins.
pub mod pin {
    /// The direction pin is high.
    pub const DIRECTION: u8 = 1;
    /// The enable pin is high.
    pub const ENABLE: u8 = 2;
}

/// Bits of the inputs.
pub mod input {
    /// The instrument is switched on.
    pub const POWERED: u8 = 1;
    /// The IMU asks for its interrupt: its data-ready line had an edge, or it sent bytes.
    pub const IMU: u8 = 2;
    /// The fault lines of the outer and the inner bridge. A line is high if its bridge has no fault.
    pub const FAULT: [u8; 2] = [4, 8];
}

/// Ticks of the board's clock per second.
pub const TICKS_PER_S: u32 = 25_000_000;
