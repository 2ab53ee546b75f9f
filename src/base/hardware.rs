//! Imperfections of real hardware: how large each effect is in a unit of this kind.
//!
//! The 28 parameters and white noise describe no instrument that exists. A size is the standard deviation that an
//! effect has among units of one kind. The estimator takes it as its prior. An effect of size zero is absent and costs
//! nothing.

use crate::base::units::{ARCSEC, DEG, DEG_H, HOUR_S, MICRO_G, PPM};
use serde::{Deserialize, Serialize};

const SQRT_HOUR: f64 = 60.0;

/// Rate to which the size of the gyro scale against rate refers, rad/s.
pub const REFERENCE_RATE_RAD_S: f64 = 20.0 * DEG;

/// Power density of 1/f noise at 1 Hz, in units of the squared Allan floor: 1 / (2 ln 2).
pub const FLICKER_DENSITY: f64 = 0.721;

/// Sizes of the effects, one standard deviation of a unit, SI units and radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hardware {
    /// Accelerometer quadratic: the output grows with the square of the force; m/s^2 at 1 g.
    pub accel_quadratic: f32,
    /// Accelerometer scale asymmetry: the output grows with the magnitude of the force; a ratio.
    pub accel_asymmetry: f32,
    /// Accelerometer cross-quadratic: the output grows with the product of the forces along two axes; m/s^2 at 1 g
    /// along both.
    pub accel_cross_quadratic: f32,
    /// Allan floor of the accelerometers, m/s^2: 1/f noise.
    pub accel_floor: f32,
    /// Random walk of the accelerometer biases, m/s^2/sqrt(s).
    pub accel_walk: f32,
    /// Allan floor of the gyros, rad/s: 1/f noise.
    pub gyro_floor: f32,
    /// Random walk of the gyro biases, rad/s/sqrt(s).
    pub gyro_walk: f32,
    /// Gyro scale asymmetry: the scale depends on the sign of the rate; a ratio.
    pub gyro_asymmetry: f32,
    /// Gyro scale against rate: the change of the scale at [`REFERENCE_RATE_RAD_S`], a ratio, proportional to the
    /// magnitude of the rate.
    pub gyro_rate_scale: f32,
    /// Gyro g-sensitivity, each of nine numbers, rad/s at 1 g.
    pub gyro_g_sensitivity: f32,
    /// Warm-up of the accelerometer biases, m/s^2.
    pub accel_warm_up: f32,
    /// Warm-up of the gyro biases, rad/s.
    pub gyro_warm_up: f32,
    /// Warm-up of all scale factors, a ratio.
    pub scale_warm_up: f32,
    /// First to fourth harmonic of the error of an encoder, rad.
    pub encoder_harmonics: [f32; 4],
    /// Sub-division error of the encoders, rad: new at every angle.
    pub encoder_subdivision: f32,
    /// Half of the difference between the readings after arrival from either side, rad.
    pub backlash: f32,
    /// Wobble of an axis, once and twice a turn, rad.
    pub wobble: [f32; 2],
    /// Sag of the inner axis, and tilt of the base under unbalance, against the outer angle, rad.
    pub sag: f32,
    /// Drift of roll and pitch of the base, rad/s.
    pub base_drift: f32,
    /// Rocking of the base at 0.1 to 5 Hz, rad.
    pub base_rocking: f32,
    /// Increment of the pulse output of the gyros, rad; 0 for outputs that are not pulses.
    pub gyro_pulse: f32,
    /// Increment of the pulse output of the accelerometers, m/s; 0 for outputs that are not pulses.
    pub accel_pulse: f32,
}

/// One size: its name, its unit, and where it is.
#[derive(Clone, Copy)]
pub struct HardwareSize {
    /// Name, as a key of the unit description.
    pub key: &'static str,
    /// Symbol of the unit.
    pub unit: &'static str,
    /// Value of one unit in SI units and radians.
    pub unit_si: f64,
    /// Largest permitted size, in `unit`. It is above the range of any unit that can be calibrated.
    pub largest: f64,
    field: fn(&mut Hardware) -> &mut f32,
}

impl HardwareSize {
    /// The size of this key.
    pub fn named(key: &str) -> Option<&'static Self> {
        HARDWARE.iter().find(|size| size.key == key)
    }

    /// The size in SI units and radians.
    pub fn get(&self, hardware: &Hardware) -> f64 {
        let mut hardware = *hardware;
        f64::from(*(self.field)(&mut hardware))
    }

    /// Sets the size, in SI units and radians.
    pub fn set(&self, hardware: &mut Hardware, size: f64) {
        *(self.field)(hardware) = size as f32;
    }
}

const fn size(
    key: &'static str,
    unit: &'static str,
    unit_si: f64,
    largest: f64,
    field: fn(&mut Hardware) -> &mut f32,
) -> HardwareSize {
    HardwareSize { key, unit, unit_si, largest, field }
}

/// Number of sizes.
pub const HARDWARE_SIZES: usize = 26;

/// All sizes, in the order of [`Hardware`].
pub static HARDWARE: [HardwareSize; HARDWARE_SIZES] = [
    size("accel_quadratic_ug_g2", "ug/g^2", MICRO_G, 5000.0, |h| &mut h.accel_quadratic),
    size("accel_asymmetry_ppm", "ppm", PPM, 5000.0, |h| &mut h.accel_asymmetry),
    size("accel_cross_quadratic_ug_g2", "ug/g^2", MICRO_G, 5000.0, |h| &mut h.accel_cross_quadratic),
    size("accel_floor_ug", "ug", MICRO_G, 1000.0, |h| &mut h.accel_floor),
    size("accel_walk_ug_sqrt_h", "ug/sqrt(h)", MICRO_G / SQRT_HOUR, 10_000.0, |h| &mut h.accel_walk),
    size("gyro_floor_deg_h", "deg/h", DEG_H, 100.0, |h| &mut h.gyro_floor),
    size("gyro_walk_deg_h_sqrt_h", "deg/h/sqrt(h)", DEG_H / SQRT_HOUR, 1000.0, |h| &mut h.gyro_walk),
    size("gyro_asymmetry_ppm", "ppm", PPM, 5000.0, |h| &mut h.gyro_asymmetry),
    size("gyro_rate_scale_ppm", "ppm at 20 deg/s", PPM, 5000.0, |h| &mut h.gyro_rate_scale),
    size("gyro_g_sensitivity_deg_h_g", "deg/h/g", DEG_H, 500.0, |h| &mut h.gyro_g_sensitivity),
    size("accel_warm_up_ug", "ug", MICRO_G, 20_000.0, |h| &mut h.accel_warm_up),
    size("gyro_warm_up_deg_h", "deg/h", DEG_H, 1000.0, |h| &mut h.gyro_warm_up),
    size("scale_warm_up_ppm", "ppm", PPM, 5000.0, |h| &mut h.scale_warm_up),
    size("encoder_harmonic_1_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.encoder_harmonics[0]),
    size("encoder_harmonic_2_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.encoder_harmonics[1]),
    size("encoder_harmonic_3_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.encoder_harmonics[2]),
    size("encoder_harmonic_4_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.encoder_harmonics[3]),
    size("encoder_subdivision_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.encoder_subdivision),
    size("backlash_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.backlash),
    size("wobble_1_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.wobble[0]),
    size("wobble_2_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.wobble[1]),
    size("sag_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.sag),
    size("base_drift_arcsec_h", "arcsec/h", ARCSEC / HOUR_S, 3600.0, |h| &mut h.base_drift),
    size("base_rocking_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.base_rocking),
    size("gyro_pulse_arcsec", "arcsec", ARCSEC, 60.0, |h| &mut h.gyro_pulse),
    size("accel_pulse_mm_s", "mm/s", 1e-3, 50.0, |h| &mut h.accel_pulse),
];

impl Hardware {
    /// No effects: the 28 parameters and white noise are the whole instrument.
    pub const IDEAL: Self = Self {
        accel_quadratic: 0.0,
        accel_asymmetry: 0.0,
        accel_cross_quadratic: 0.0,
        accel_floor: 0.0,
        accel_walk: 0.0,
        gyro_floor: 0.0,
        gyro_walk: 0.0,
        gyro_asymmetry: 0.0,
        gyro_rate_scale: 0.0,
        gyro_g_sensitivity: 0.0,
        accel_warm_up: 0.0,
        gyro_warm_up: 0.0,
        scale_warm_up: 0.0,
        encoder_harmonics: [0.0; 4],
        encoder_subdivision: 0.0,
        backlash: 0.0,
        wobble: [0.0; 2],
        sag: 0.0,
        base_drift: 0.0,
        base_rocking: 0.0,
        gyro_pulse: 0.0,
        accel_pulse: 0.0,
    };

    /// A unit of navigation grade.
    pub const NAVIGATION: Self = Self {
        accel_quadratic: (6.0 * MICRO_G) as f32,
        accel_asymmetry: (5.0 * PPM) as f32,
        accel_cross_quadratic: (4.0 * MICRO_G) as f32,
        accel_floor: (2.0 * MICRO_G) as f32,
        accel_walk: 0.0,
        gyro_floor: (0.002 * DEG_H) as f32,
        gyro_walk: 0.0,
        gyro_asymmetry: (1.0 * PPM) as f32,
        gyro_rate_scale: (4.0 * PPM) as f32,
        gyro_g_sensitivity: (0.005 * DEG_H) as f32,
        accel_warm_up: (10.0 * MICRO_G) as f32,
        gyro_warm_up: (0.02 * DEG_H) as f32,
        scale_warm_up: (5.0 * PPM) as f32,
        encoder_harmonics: [(0.6 * ARCSEC) as f32, (0.4 * ARCSEC) as f32, (0.2 * ARCSEC) as f32, (0.2 * ARCSEC) as f32],
        encoder_subdivision: (0.2 * ARCSEC) as f32,
        backlash: (0.6 * ARCSEC) as f32,
        wobble: [(0.3 * ARCSEC) as f32, (0.15 * ARCSEC) as f32],
        sag: (0.3 * ARCSEC) as f32,
        base_drift: 0.0,
        base_rocking: (0.2 * ARCSEC) as f32,
        gyro_pulse: (0.05 * ARCSEC) as f32,
        accel_pulse: 0.02e-3,
    };

    /// A unit of tactical grade: orders of magnitude of fibre-optic gyros and quartz accelerometers.
    pub const TACTICAL: Self = Self {
        accel_quadratic: (30.0 * MICRO_G) as f32,
        accel_asymmetry: (20.0 * PPM) as f32,
        accel_cross_quadratic: (20.0 * MICRO_G) as f32,
        accel_floor: (20.0 * MICRO_G) as f32,
        gyro_floor: (0.1 * DEG_H) as f32,
        gyro_asymmetry: (10.0 * PPM) as f32,
        gyro_rate_scale: (20.0 * PPM) as f32,
        gyro_g_sensitivity: (0.05 * DEG_H) as f32,
        accel_warm_up: (100.0 * MICRO_G) as f32,
        gyro_warm_up: (0.5 * DEG_H) as f32,
        scale_warm_up: (50.0 * PPM) as f32,
        encoder_harmonics: [(5.0 * ARCSEC) as f32, (3.0 * ARCSEC) as f32, (2.0 * ARCSEC) as f32, (2.0 * ARCSEC) as f32],
        encoder_subdivision: (1.0 * ARCSEC) as f32,
        backlash: (3.0 * ARCSEC) as f32,
        wobble: [(3.0 * ARCSEC) as f32, (1.5 * ARCSEC) as f32],
        sag: (3.0 * ARCSEC) as f32,
        base_rocking: (0.5 * ARCSEC) as f32,
        gyro_pulse: (0.5 * ARCSEC) as f32,
        accel_pulse: 0.2e-3,
        ..Self::IDEAL
    };

    /// A unit with MEMS sensors: orders of magnitude of good ones.
    pub const MEMS: Self = Self {
        accel_quadratic: (100.0 * MICRO_G) as f32,
        accel_asymmetry: (100.0 * PPM) as f32,
        accel_cross_quadratic: (100.0 * MICRO_G) as f32,
        accel_floor: (20.0 * MICRO_G) as f32,
        gyro_floor: (2.0 * DEG_H) as f32,
        gyro_asymmetry: (50.0 * PPM) as f32,
        gyro_rate_scale: (100.0 * PPM) as f32,
        gyro_g_sensitivity: (5.0 * DEG_H) as f32,
        accel_warm_up: (1000.0 * MICRO_G) as f32,
        gyro_warm_up: (20.0 * DEG_H) as f32,
        scale_warm_up: (300.0 * PPM) as f32,
        ..Self::TACTICAL
    };

    /// The profiles by name.
    pub const PROFILES: [(&'static str, Self); 4] =
        [("ideal", Self::IDEAL), ("navigation", Self::NAVIGATION), ("tactical", Self::TACTICAL), ("mems", Self::MEMS)];

    /// The profile of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::PROFILES.iter().find(|(known, _)| *known == name).map(|(_, hardware)| *hardware)
    }

    /// The first size that is not finite, negative or too large.
    pub fn first_wrong(&self) -> Option<&'static HardwareSize> {
        HARDWARE.iter().find(|size| {
            let value = size.get(self);
            !(0.0..=size.largest * size.unit_si * (1.0 + 1e-6)).contains(&value)
        })
    }

    /// All sizes multiplied by `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for size in &HARDWARE {
            let scaled = size.get(&self) * factor;
            size.set(&mut self, scaled);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_profile_is_permitted_and_every_size_has_its_own_place() {
        for (name, hardware) in Hardware::PROFILES {
            assert!(hardware.first_wrong().is_none(), "{name}");
            assert_eq!(Hardware::named(name), Some(hardware));
        }
        for one in &HARDWARE {
            let mut hardware = Hardware::IDEAL;
            one.set(&mut hardware, one.unit_si);
            for other in &HARDWARE {
                assert_eq!(other.get(&hardware) > 0.0, one.key == other.key, "{} and {}", one.key, other.key);
            }
            assert_eq!(HardwareSize::named(one.key).map(|named| named.key), Some(one.key));
            one.set(&mut hardware, 1.1 * one.largest * one.unit_si);
            assert_eq!(hardware.first_wrong().map(|wrong| wrong.key), Some(one.key));
        }
        assert!(HardwareSize::named("accel_quadric").is_none());
    }
}
