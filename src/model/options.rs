//! Optional states and noise: effects that a unit may have in addition to the 28 parameters.
//!
//! All effects act linearly through quantities that the measurement models have: a bias, the attitude of the base, or
//! the encoder errors. Each effect is off by default, because a state that is not needed costs accuracy.
//! ```text
//! (M8) bias(t) = bias + ramp t + random walk,  attitude(t) = attitude + drift t;  t from the end of the run
//! (M9) encoder error (angle) = c1 (cos angle - 1) + s1 sin angle + c2 (cos 2 angle - 1) + s2 sin 2 angle
//! ```
//! The harmonics vanish at angle zero, because the encoder zeros define the rotation frame. Over a move the harmonics
//! act through their integrals along the move ([`measurement`](super::measurement)).

use crate::base::linear::{Matrix, Real};
use crate::base::units::{ARCSEC, DEG_H, MICRO_G};
use crate::model::error_model::{PARAMETERS, ParameterInfo, block};
use crate::model::measurement::{HARMONICS, Prediction};
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// Number of optional states.
pub const OPTIONAL_STATES: usize = 16;

const HOUR_S: f64 = 3600.0;

/// Blocks of the optional states, as ranges of indices.
mod optional {
    use core::ops::Range;
    pub const GYRO_BIAS_RAMP: Range<usize> = 0..3;
    pub const ACCEL_BIAS_RAMP: Range<usize> = 3..6;
    pub const ECCENTRICITY: Range<usize> = 6..10;
    pub const SECOND_HARMONIC: Range<usize> = 10..14;
    pub const TILT_DRIFT: Range<usize> = 14..16;
}

/// Which optional states are estimated, and which noise is allowed for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Options {
    /// Estimate ramps of all biases, as during warm-up.
    pub bias_ramp: bool,
    /// Random walk of the gyro biases, rad/s/sqrt(s).
    pub gyro_bias_walk: f64,
    /// Random walk of the accelerometer biases, m/s^2/sqrt(s).
    pub accel_bias_walk: f64,
    /// Estimate the first harmonic of the encoder errors.
    pub encoder_eccentricity: bool,
    /// Estimate the second harmonic of the encoder errors.
    pub encoder_second_harmonic: bool,
    /// Estimate a constant drift of roll and pitch of the base.
    pub base_tilt_drift: bool,
}

impl Options {
    /// No optional effects.
    pub const NONE: Self = Self {
        bias_ramp: false,
        gyro_bias_walk: 0.0,
        accel_bias_walk: 0.0,
        encoder_eccentricity: false,
        encoder_second_harmonic: false,
        base_tilt_drift: false,
    };

    /// Whether the options need states that a filter of the basic size does not have.
    pub fn needs_states(&self) -> bool {
        self.bias_ramp || self.encoder_eccentricity || self.encoder_second_harmonic || self.base_tilt_drift
    }

    /// Whether both random walks are finite and not negative.
    pub fn are_finite(&self) -> bool {
        [self.gyro_bias_walk, self.accel_bias_walk].iter().all(|walk| walk.is_finite() && *walk >= 0.0)
    }

    /// Prior sigmas of the optional states, SI: wide for a state that is estimated, and 0 for the others.
    pub fn prior_sigmas(&self) -> [f64; OPTIONAL_STATES] {
        let blocks: [(bool, Range<usize>, f64); 5] = [
            (self.bias_ramp, optional::GYRO_BIAS_RAMP, 20.0 * DEG_H / HOUR_S),
            (self.bias_ramp, optional::ACCEL_BIAS_RAMP, 20_000.0 * MICRO_G / HOUR_S),
            (self.encoder_eccentricity, optional::ECCENTRICITY, 120.0 * ARCSEC),
            (self.encoder_second_harmonic, optional::SECOND_HARMONIC, 120.0 * ARCSEC),
            (self.base_tilt_drift, optional::TILT_DRIFT, 600.0 * ARCSEC / HOUR_S),
        ];
        let mut sigmas = [0.0; OPTIONAL_STATES];
        for (_, states, prior) in blocks.into_iter().filter(|(on, ..)| *on) {
            for sigma in sigmas.iter_mut().take(states.end).skip(states.start) {
                *sigma = prior;
            }
        }
        sigmas
    }
}

const fn info(name: &'static str, unit: &'static str, unit_si: f64) -> ParameterInfo {
    ParameterInfo { name, unit, unit_si }
}

/// Names and units of the optional states.
pub const OPTIONAL_INFO: [ParameterInfo; OPTIONAL_STATES] = [
    info("gyro_bias_ramp_x", "deg/h/h", DEG_H / HOUR_S),
    info("gyro_bias_ramp_y", "deg/h/h", DEG_H / HOUR_S),
    info("gyro_bias_ramp_z", "deg/h/h", DEG_H / HOUR_S),
    info("accel_bias_ramp_x", "ug/h", MICRO_G / HOUR_S),
    info("accel_bias_ramp_y", "ug/h", MICRO_G / HOUR_S),
    info("accel_bias_ramp_z", "ug/h", MICRO_G / HOUR_S),
    info("outer_eccentricity_cos", "arcsec", ARCSEC),
    info("outer_eccentricity_sin", "arcsec", ARCSEC),
    info("inner_eccentricity_cos", "arcsec", ARCSEC),
    info("inner_eccentricity_sin", "arcsec", ARCSEC),
    info("outer_second_harmonic_cos", "arcsec", ARCSEC),
    info("outer_second_harmonic_sin", "arcsec", ARCSEC),
    info("inner_second_harmonic_cos", "arcsec", ARCSEC),
    info("inner_second_harmonic_sin", "arcsec", ARCSEC),
    info("base_roll_drift", "arcsec/h", ARCSEC / HOUR_S),
    info("base_pitch_drift", "arcsec/h", ARCSEC / HOUR_S),
];

/// Optional states with their standard deviations, SI; 0 for a state that is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OptionalEstimate {
    /// Estimated values, SI.
    pub values: [f64; OPTIONAL_STATES],
    /// Standard deviations, SI.
    pub sigmas: [f64; OPTIONAL_STATES],
}

/// Derivative of a measurement by the optional states, (3 x 16).
pub type OptionalColumns<T> = Matrix<T, 3, OPTIONAL_STATES>;

/// Derivative of a measurement by the optional states, from the derivatives by bias, attitude and harmonics. `BIAS` and
/// `RAMP` are the blocks of the sensors that measure. `since_reference_s` is the time from the reference time of
/// biases and attitude to the middle of the segment.
fn columns<T: Real, const BIAS: usize, const RAMP: usize>(
    prediction: &Prediction<T>,
    since_reference_s: T,
) -> OptionalColumns<T> {
    let by = &prediction.by_parameters;
    let mut columns = OptionalColumns::<T>::zeros();
    columns.fixed_columns_mut::<3>(RAMP).copy_from(&by.fixed_columns::<3>(BIAS));
    columns.fixed_columns_mut::<2>(optional::TILT_DRIFT.start).copy_from(&by.fixed_columns::<2>(block::ATTITUDE));
    columns *= since_reference_s;
    columns.fixed_columns_mut::<HARMONICS>(optional::ECCENTRICITY.start).copy_from(&prediction.by_harmonics);
    columns
}

/// Derivative of the mean specific force at a stop by the optional states.
pub fn force_columns<T: Real>(prediction: &Prediction<T>, since_reference_s: T) -> OptionalColumns<T> {
    columns::<T, { block::ACCEL_BIAS }, { optional::ACCEL_BIAS_RAMP.start }>(prediction, since_reference_s)
}

/// Derivative of the rotation over a segment by the optional states.
pub fn rotation_columns<T: Real>(prediction: &Prediction<T>, since_reference_s: T) -> OptionalColumns<T> {
    columns::<T, { block::GYRO_BIAS }, { optional::GYRO_BIAS_RAMP.start }>(prediction, since_reference_s)
}

const _: () = assert!(optional::TILT_DRIFT.end == OPTIONAL_STATES && block::ATTITUDE + 3 == PARAMETERS);
const _: () = assert!(optional::ECCENTRICITY.start + HARMONICS == optional::SECOND_HARMONIC.end);
