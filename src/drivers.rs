//! Drivers of the instrument's devices over embedded-hal 1.0, each from a public data sheet named in its head.
//!
//! ```text
//! bridge     motor bridge, PWM and direction    duty from -1 to 1         -> pins
//! biss       absolute encoder, BiSS-C           bits clocked in over SPI  -> Angle
//! ```
//! A driver refuses what its device does not vouch for, and says why. Nothing here reads a clock: times are arguments.

pub mod biss;
pub mod bridge;
