//! Drivers of the instrument's devices over embedded-hal 1.0, each from a public data sheet named in its head.
//!
//! ```text
//! bridge     motor bridge, PWM and direction    duty from -1 to 1         -> pins
//! biss       absolute encoder, BiSS-C           bits clocked in over SPI  -> Angle
//! adis16495  IMU on SPI with data-ready         burst of 20 words         -> ImuReading
//! kvh1750    fibre-optic IMU on RS-422          bytes of a UART           -> ImuReading
//! ```
//! A driver refuses what its device does not vouch for, and says why. No driver reads a clock: times are arguments.

pub mod adis16495;
pub mod biss;
pub mod bridge;
pub mod imu;
pub mod kvh1750;

pub use imu::{ImuFault, ImuReading};
