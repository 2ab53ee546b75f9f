//! The units that a mapping may name.

use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G};
use std::f64::consts::TAU;

/// Standard gravity, m/s^2.
const G: f64 = MICRO_G * 1e6;

/// A unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Name in a mapping.
    pub name: &'static str,
    /// `value_si = value * si`.
    pub si: f64,
    /// Whether values are increments over the sample interval. Division by the interval gives SI.
    pub is_increment: bool,
}

const fn rate(name: &'static str, si: f64) -> Unit {
    Unit { name, si, is_increment: false }
}

const fn increment(name: &'static str, si: f64) -> Unit {
    Unit { name, si, is_increment: true }
}

/// Units of gyros: rates and angle increments.
pub const GYRO_UNITS: [Unit; 7] = [
    rate("rad/s", 1.0),
    rate("deg/s", DEG),
    rate("deg/h", DEG_H),
    rate("arcsec/s", ARCSEC),
    increment("rad", 1.0),
    increment("deg", DEG),
    increment("arcsec", ARCSEC),
];
/// Units of accelerometers: specific forces and velocity increments.
pub const ACCEL_UNITS: [Unit; 6] = [
    rate("m/s^2", 1.0),
    rate("g", G),
    rate("mg", G * 1e-3),
    rate("ug", MICRO_G),
    increment("m/s", 1.0),
    increment("g*s", G),
];
/// Units of encoders. `counts` needs `counts_per_turn`.
pub const ANGLE_UNITS: [Unit; 5] =
    [rate("rad", 1.0), rate("deg", DEG), rate("arcsec", ARCSEC), rate("turns", TAU), rate("counts", TAU)];
/// Units of time stamps.
pub const TIME_UNITS: [Unit; 4] = [rate("s", 1.0), rate("ms", 1e-3), rate("us", 1e-6), rate("ns", 1e-9)];
/// Units of temperatures.
pub(super) const TEMPERATURE_UNITS: [Unit; 2] = [rate("C", 1.0), rate("K", 1.0)];

/// The unit of this name.
///
/// # Errors
/// The name is unknown; the text lists the known names.
pub(super) fn named(units: &[Unit], name: &str) -> Result<Unit, String> {
    let known = || units.iter().map(|unit| unit.name).collect::<Vec<_>>().join(", ");
    units
        .iter()
        .copied()
        .find(|unit| unit.name == name)
        .ok_or_else(|| format!("unknown unit '{name}'; known: {}", known()))
}
