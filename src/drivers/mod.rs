//! Drivers of the devices over embedded-hal 1.0. Each driver follows a public data sheet, named at the top of its file.
//!
//! ```text
//! bridge     motor bridge, PWM and direction    duty from -1 to 1         -> pins
//! one_pulse  numbers of a PWM that stops        clock, frequencies        -> register values
//! biss       absolute encoder, BiSS-C           bits clocked in over SPI  -> Angle
//! adis16495  IMU on SPI with data-ready         burst of 20 words         -> ImuReading
//! kvh1750    fibre-optic IMU on RS-422          bytes of a UART           -> ImuReading
//! stm32h743  decisions of the board             values of registers       -> outcome
//! ```
//! A driver returns a fault instead of a measurement that its device does not guarantee. No driver reads a clock: times
//! are arguments.

pub mod adis16495;
pub mod biss;
pub mod bridge;
pub mod imu;
pub mod kvh1750;
pub mod one_pulse;
pub mod stm32h743;

pub use imu::{ImuFault, ImuReading};
