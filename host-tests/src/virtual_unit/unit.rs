//! One instrument: its errors, its effects, its base and its site.

use super::imperfections::Imperfections;
use super::vec3::{Vec3, add, scale};
use crate::files::unit_file::Noise;
use rins_selfcal::base::linear::{Vector3, exp_so3};
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G, PPM};
use rins_selfcal::model::effects::{EFFECT_STATES, effect};
use rins_selfcal::model::error_model::InstrumentErrors;
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
    /// Imperfections of the hardware.
    pub hardware: Imperfections,
    /// Resolution of the encoders, bits per turn. Not quantized if absent.
    pub encoder_bits: Option<u8>,
    /// Amplitude of the hunting of both axes, arcsec. Used in open loop only; in closed loop the servos set the motion.
    pub hunting_arcsec: f64,
    /// Frequency of the hunting, Hz.
    pub hunting_hz: f64,
    /// Bandwidth of all inertial sensors, Hz: they follow with a lag of first order. Unlimited if absent.
    pub sensor_bandwidth_hz: Option<f64>,
    /// Time by which the inertial sensors are later than the encoders, ms.
    pub sensor_delay_ms: f64,
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
    /// Checks that every number is one that a unit can have.
    ///
    /// # Errors
    /// The key and what is wrong with its value.
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        let limits = [
            ("max_rate_deg_s", self.max_rate_deg_s),
            ("max_acceleration_deg_s2", self.max_acceleration_deg_s2),
            ("sensor_bandwidth_hz", self.sensor_bandwidth_hz),
        ];
        let not_negative = [
            ("accel_bias_walk_ug_sqrt_h", self.accel_bias_walk_ug_sqrt_h),
            ("gyro_bias_walk_deg_h_sqrt_h", self.gyro_bias_walk_deg_h_sqrt_h),
            ("sensor_delay_ms", self.sensor_delay_ms),
            ("hunting_arcsec", self.hunting_arcsec),
            ("hunting_hz", self.hunting_hz),
        ];
        let finite: [(&str, &[f64]); 6] = [
            ("lever_arm_m", &self.lever_arm_m),
            ("accel_bias_ramp_ug_h", &self.accel_bias_ramp_ug_h),
            ("gyro_bias_ramp_deg_h_h", &self.gyro_bias_ramp_deg_h_h),
            ("base_tilt_drift_arcsec_h", &self.base_tilt_drift_arcsec_h),
            ("temperature_c", self.temperature_c.as_slice()),
            ("temperature_ramp_c_h", &[self.temperature_ramp_c_h]),
        ];
        let is_wrong = |limit: Option<f64>| limit.is_some_and(|limit| !limit.is_finite() || limit <= 0.0);
        let limits = limits.iter().find(|(_, limit)| is_wrong(*limit)).map(|(key, _)| (key, "must be positive"));
        let not_negative = not_negative.iter().find(|(_, number)| !number.is_finite() || *number < 0.0);
        let not_negative = not_negative.map(|(key, _)| (key, "must be finite and not negative"));
        let finite = finite.iter().find(|(_, numbers)| !numbers.iter().all(|number| number.is_finite()));
        let finite = finite.map(|(key, _)| (key, "must be finite"));
        let bits = self.encoder_bits.filter(|bits| !(1..=32).contains(bits));
        let bits = bits.map(|_| (&"encoder_bits", "must be from 1 to 32"));
        match limits.or(not_negative).or(finite).or(bits) {
            Some((key, what)) => Err(((*key).into(), what.into())),
            None => self.hardware.check().map_err(|(key, what)| (format!("hardware.{key}"), what)),
        }
    }
}

/// One instrument, its base and its site.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VirtualUnit {
    /// The 28 true errors, SI. The attitude of the base is the attitude of the frame b = r0 at time zero.
    pub errors: InstrumentErrors<f64>,
    /// Site of the unit as it is configured. [`Imperfections`] may have errors of it.
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
        let warm_up = &effects.hardware.warm_up;
        let left = warm_up.left(time_s);
        let plus = |a: Vec3, ramp: Vec3, ramp_unit: f64, amplitude: Vec3, unit: f64| {
            add(add(a, scale(ramp, ramp_unit * hours)), scale(amplitude, unit * left))
        };
        let errors = &self.errors;
        InstrumentErrors {
            accel_bias_a: plus(errors.accel_bias_a, effects.accel_bias_ramp_ug_h, MICRO_G, warm_up.accel_ug, MICRO_G),
            gyro_bias_g: plus(errors.gyro_bias_g, effects.gyro_bias_ramp_deg_h_h, DEG_H, warm_up.gyro_deg_h, DEG_H),
            accel_scale: add(errors.accel_scale, scale(warm_up.accel_scale_ppm, PPM * left)),
            gyro_scale: add(errors.gyro_scale, scale(warm_up.gyro_scale_ppm, PPM * left)),
            base_roll: rot_nb[(2, 1)].atan2(rot_nb[(2, 2)]),
            base_pitch: -rot_nb[(2, 0)].asin(),
            heading: -rot_nb[(1, 0)].atan2(rot_nb[(0, 0)]),
            ..self.errors
        }
    }

    /// The true effects that the core has states for, SI; `None` for a state that is no quantity of the unit by itself.
    /// The drift of the base refers to this time.
    pub fn effect_states(&self, time_s: f64) -> [Option<f64>; EFFECT_STATES] {
        let (start, end) = (self.errors_at(0.0), self.errors_at(time_s));
        let of = &self.effects.hardware;
        let arcsec = |wave: [f64; 2]| wave.map(|part| Some(part * ARCSEC));
        let mut states = [None; EFFECT_STATES];
        let mut set =
            |first: usize, values: &[Option<f64>]| states[first..first + values.len()].copy_from_slice(values);
        let scaled = |values: Vec3, unit: f64| values.map(|value| Some(value * unit));
        set(effect::ACCEL_QUADRATIC.start, &scaled(of.accel_quadratic_ug_g2, MICRO_G));
        set(effect::ACCEL_ASYMMETRY.start, &scaled(of.accel_asymmetry_ppm, PPM));
        set(effect::GYRO_ASYMMETRY.start, &scaled(of.gyro_asymmetry_ppm, PPM));
        set(effect::GYRO_RATE_SCALE.start, &scaled(of.gyro_rate_scale_ppm, PPM));
        for n in 0..4 {
            for axis in 0..2 {
                set(effect::GEOMETRY.start + 4 * n + 2 * axis, &arcsec(of.encoder_harmonics_arcsec[axis][n]));
            }
        }
        // The tilt of the base acts as the first harmonic of the outer encoder and as the wobble of the outer axis.
        let plus = |a: [f64; 2], b: [f64; 2], sign: f64| [a[0] + sign * b[0], a[1] + sign * b[1]];
        let [tilt_x, tilt_y] = of.base_tilt_arcsec;
        set(effect::GEOMETRY.start, &arcsec(plus(of.encoder_harmonics_arcsec[0][0], tilt_x, -1.0)));
        set(effect::GEOMETRY.start + 16, &arcsec(of.backlash_arcsec));
        let wobbles = of.outer_wobble_arcsec.into_iter().zip(of.inner_wobble_arcsec);
        for ((outer, inner), first) in wobbles.zip([18, 28]) {
            let all = outer.into_iter().chain(inner).enumerate();
            all.for_each(|(n, wave)| set(effect::GEOMETRY.start + first + 2 * n, &arcsec(wave)));
        }
        set(effect::GEOMETRY.start + 18, &arcsec(plus(of.outer_wobble_arcsec[0][0], tilt_y, 1.0)));
        set(effect::GEOMETRY.start + 26, &arcsec(of.sag_arcsec));
        let drift = [end.base_roll - start.base_roll, end.base_pitch - start.base_pitch].map(|way| Some(way / time_s));
        set(effect::BASE_DRIFT.start, &drift);
        set(effect::LATITUDE, &[Some(of.latitude_error_deg * DEG)]);
        // The filter computes gravity from its latitude, so only the rest is for this state.
        let truth = of.true_site(&self.site);
        let computed = Site { latitude_rad: truth.latitude_rad, ..self.site };
        set(effect::GRAVITY, &[Some(truth.gravity_m_s2() - computed.gravity_m_s2())]);
        states
    }
}
