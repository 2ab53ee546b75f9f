//! Conversion factors of units outside SI: `value_si = value_in_unit * UNIT`.

use crate::base::linear::{Real, real};
use core::f64::consts::PI;

/// One degree, rad.
pub const DEG: f64 = PI / 180.0;
/// One arcsecond, rad.
pub const ARCSEC: f64 = DEG / 3600.0;
/// One degree per hour, rad/s.
pub const DEG_H: f64 = DEG / 3600.0;
/// One degree per square root of an hour, the unit of angular random walk, rad/sqrt(s).
pub const DEG_SQRT_H: f64 = DEG / 60.0;
/// One micro-g of standard gravity, m/s^2. One micro-g per square root of a hertz is the unit of velocity random walk.
pub const MICRO_G: f64 = 9.806_65e-6;
/// Standard gravity, m/s^2.
pub const STANDARD_GRAVITY_M_S2: f64 = 1e6 * MICRO_G;
/// One milligal, m/s^2.
pub const MGAL: f64 = 1e-5;
/// One hour, s.
pub const HOUR_S: f64 = 3600.0;
/// One part per million.
pub const PPM: f64 = 1e-6;

/// Converts a duration from microseconds to seconds.
pub fn seconds<T: Real>(duration_us: u64) -> T {
    // The processor converts a 32-bit integer in one instruction and a 64-bit integer in dozens.
    let duration_us = u32::try_from(duration_us).map_or_else(|_| duration_us as f64, f64::from);
    real(duration_us * 1e-6)
}
