//! One instrument: its errors, its effects, its base and its site.

use super::encoder::Harmonic;
use super::vec3::{add, scale};
use crate::files::unit_file::Noise;
use rins_selfcal::base::linear::{Vector3, exp_so3};
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG_H, MICRO_G};
use rins_selfcal::model::error_model::InstrumentErrors;
use rins_selfcal::model::options::OPTIONAL_STATES;
use serde::{Deserialize, Serialize};

/// Sample rate of the unit in the literature, Hz.
pub const DEFAULT_RATE_HZ: f64 = 200.0;

/// Effects of a unit beyond its 28 errors and white noise. All of them are absent by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Effects {
    /// Lever arm from the intersection of the axes to the IMU, s-frame, m.
    pub lever_arm_m: [f64; 3],
    /// Largest rate of the drives, deg/s. Unlimited if absent.
    pub max_rate_deg_s: Option<f64>,
    /// Largest acceleration of the drives, deg/s^2. Unlimited if absent.
    pub max_acceleration_deg_s2: Option<f64>,
    /// First harmonic of the encoder errors, outer and inner.
    pub encoder_eccentricity: [Harmonic; 2],
    /// Second harmonic of the encoder errors, outer and inner.
    pub encoder_second_harmonic: [Harmonic; 2],
    /// Resolution of the encoders, bits per turn. Not quantized if absent.
    pub encoder_bits: Option<u8>,
    /// Amplitude of the hunting of both axes, arcsec. Used in open loop only; in closed loop the servos set the motion.
    pub hunting_arcsec: f64,
    /// Frequency of the hunting, Hz.
    pub hunting_hz: f64,
    /// Ramp of the accelerometer biases, ug/h.
    pub accel_bias_ramp_ug_h: [f64; 3],
    /// Ramp of the gyro biases, (deg/h)/h.
    pub gyro_bias_ramp_deg_h_h: [f64; 3],
    /// Random walk of the accelerometer biases, ug/sqrt(h).
    pub accel_bias_walk_ug_sqrt_h: f64,
    /// Random walk of the gyro biases, (deg/h)/sqrt(h).
    pub gyro_bias_walk_deg_h_sqrt_h: f64,
    /// Rate at which the base tilts about its x and y axes, arcsec/h.
    pub base_tilt_drift_arcsec_h: [f64; 2],
    /// Temperature at the start, deg C. The unit has no temperature sensor if absent.
    pub temperature_c: Option<f64>,
    /// Rise of the temperature, deg C/h.
    pub temperature_ramp_c_h: f64,
}

impl Effects {
    /// Checks the limits of the drives, the random walks and the hunting.
    ///
    /// # Errors
    /// The key and what is wrong with its value.
    pub(crate) fn check(&self) -> Result<(), (&'static str, &'static str)> {
        let limits =
            [("max_rate_deg_s", self.max_rate_deg_s), ("max_acceleration_deg_s2", self.max_acceleration_deg_s2)];
        let not_negative = [
            ("accel_bias_walk_ug_sqrt_h", self.accel_bias_walk_ug_sqrt_h),
            ("gyro_bias_walk_deg_h_sqrt_h", self.gyro_bias_walk_deg_h_sqrt_h),
            ("hunting_arcsec", self.hunting_arcsec),
            ("hunting_hz", self.hunting_hz),
        ];
        if let Some((key, _)) =
            limits.iter().find(|(_, limit)| limit.is_some_and(|limit| limit.is_nan() || limit <= 0.0))
        {
            return Err((key, "must be positive"));
        }
        match not_negative.iter().find(|(_, walk)| !walk.is_finite() || *walk < 0.0) {
            Some((key, _)) => Err((key, "must be finite and not negative")),
            None => Ok(()),
        }
    }
}

/// One instrument, its base and its site.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VirtualUnit {
    /// The 28 true errors, SI. The attitude of the base is the attitude of the frame b = r0 at time zero.
    pub errors: InstrumentErrors<f64>,
    /// Site of the unit.
    pub site: Site,
    /// Noise of sensors and encoders.
    pub noise: Noise,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Effects beyond the 28 errors.
    pub effects: Effects,
}

impl Default for VirtualUnit {
    /// A perfect instrument, level and facing north, with the default noise.
    fn default() -> Self {
        Self {
            errors: InstrumentErrors::default(),
            site: Site::default(),
            noise: Noise::default(),
            rate_hz: DEFAULT_RATE_HZ,
            effects: Effects::default(),
        }
    }
}

impl VirtualUnit {
    /// The 28 errors after this time, with bias ramps and tilt of the base, but without random walks.
    pub(super) fn errors_at(&self, time_s: f64) -> InstrumentErrors<f64> {
        let (effects, hours) = (&self.effects, time_s / 3600.0);
        let tilt = effects.base_tilt_drift_arcsec_h.map(|drift| drift * ARCSEC * hours);
        let rot_nb = self.errors.rot_nb() * exp_so3(&Vector3::new(tilt[0], tilt[1], 0.0));
        InstrumentErrors {
            accel_bias_a: add(self.errors.accel_bias_a, scale(effects.accel_bias_ramp_ug_h, MICRO_G * hours)),
            gyro_bias_g: add(self.errors.gyro_bias_g, scale(effects.gyro_bias_ramp_deg_h_h, DEG_H * hours)),
            base_roll: rot_nb[(2, 1)].atan2(rot_nb[(2, 2)]),
            base_pitch: -rot_nb[(2, 0)].asin(),
            heading: -rot_nb[(1, 0)].atan2(rot_nb[(0, 0)]),
            ..self.errors
        }
    }

    /// The true optional states, SI, in the order of the core. The states of the base refer to this time.
    pub fn optional_states(&self, time_s: f64) -> [f64; OPTIONAL_STATES] {
        let effects = &self.effects;
        let harmonic = |harmonic: &Harmonic| harmonic.cos_and_sin_rad();
        let of_both = |harmonics: &[Harmonic; 2]| harmonics.iter().flat_map(harmonic).collect::<Vec<_>>();
        let (start, end) = (self.errors_at(0.0), self.errors_at(time_s));
        let drift = [end.base_roll - start.base_roll, end.base_pitch - start.base_pitch].map(|way| way / time_s);
        let blocks = [
            effects.gyro_bias_ramp_deg_h_h.map(|ramp| ramp * DEG_H / 3600.0).to_vec(),
            effects.accel_bias_ramp_ug_h.map(|ramp| ramp * MICRO_G / 3600.0).to_vec(),
            of_both(&effects.encoder_eccentricity),
            of_both(&effects.encoder_second_harmonic),
            drift.to_vec(),
        ];
        blocks.concat().try_into().expect("the core's blocks")
    }
}
