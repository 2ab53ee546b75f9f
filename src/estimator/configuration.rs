//! Configuration of the estimator, and prior sigmas before the first segment.

use super::two_stage::{ACCEL_SCALE, COMMON_SCALE_SIGMA};
use crate::base::linear::{Real, Vector, real};
use crate::base::method::Method;
use crate::base::site::Site;
use crate::base::units::{DEG, DEG_H};
use crate::model::error_model::{PARAMETERS, block};
use crate::model::measurement::ENCODER_ERRORS;
use crate::model::options::{OPTIONAL_STATES, Options};
use crate::segment::white_noise::Noise;
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// States of the filter without options.
pub const BASIC_STATES: usize = ENCODER_ERRORS + PARAMETERS;

/// States of the filter with room for all options.
pub const FULL_STATES: usize = BASIC_STATES + OPTIONAL_STATES;

/// Where the heading comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HeadingSource {
    /// Gyrocompassing: the Earth rate that the gyros measure at the first stop.
    #[default]
    Gyrocompass,
    /// The heading is configured.
    Configured {
        /// Bearing of the base's y axis, clockwise from north, rad.
        heading_rad: f64,
        /// Standard deviation of the heading, rad.
        sigma_rad: f64,
    },
}

/// Configuration of the estimator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EstimatorConfig {
    /// Joint or two-stage method.
    pub method: Method,
    /// Site of the instrument.
    pub site: Site,
    /// Noise of the sensors and the encoders.
    pub noise: Noise,
    /// Source of the heading.
    pub heading: HeadingSource,
    /// Number of moves in period one, for the two-stage method. With `None` the periods are found from the angles of
    /// the stops.
    pub period_moves: Option<u16>,
    /// Gate: a measurement with a larger normalized innovation is not used, but counted. `None` uses all measurements.
    pub gate_sigma: Option<f64>,
    /// Optional effects, for the joint method.
    pub options: Options,
}

impl EstimatorConfig {
    /// Prior sigmas of the parameters, SI; 0 for a parameter that the method takes as known.
    pub fn prior_sigmas(&self) -> [f64; PARAMETERS] {
        let common = |state: &usize| self.method == Method::TwoStage && ACCEL_SCALE.contains(state);
        let prior = prior_sigmas::<f64, BASIC_STATES>(self);
        let mut sigmas = [0.0; PARAMETERS];
        for ((state, prior), sigma) in prior.iter().enumerate().skip(ENCODER_ERRORS).zip(&mut sigmas) {
            *sigma = if common(&state) { COMMON_SCALE_SIGMA } else { *prior };
        }
        sigmas
    }

    /// Used until a configuration arrives.
    pub(super) const UNKNOWN: Self = Self {
        method: Method::Joint,
        site: Site { latitude_rad: 0.0, height_m: 0.0, measured_gravity_m_s2: None },
        noise: Noise { accel_psd_sqrt: 0.0, gyro_psd_sqrt: 0.0, encoder_sigma_rad: 0.0, margin: 1.0 },
        heading: HeadingSource::Gyrocompass,
        period_moves: None,
        gate_sigma: None,
        options: Options::NONE,
    };
}

/// Prior sigma of a block of parameters. It is so wide that it adds almost no information.
struct Prior {
    states: Range<usize>,
    sigma: f64,
    two_stage: bool,
}

const fn prior(first: usize, count: usize, sigma: f64, two_stage: bool) -> Prior {
    let first = ENCODER_ERRORS + first;
    Prior { states: first..first + count, sigma, two_stage }
}

const PRIORS: [Prior; 10] = [
    prior(block::GYRO_NON_ORTHOGONALITY, 6, 3.0 * DEG, true),
    prior(block::ACCEL_NON_ORTHOGONALITY, 3, 3.0 * DEG, true),
    prior(block::MOUNTING, 3, 3.0 * DEG, true),
    prior(block::ACCEL_BIAS, 3, 0.2, false),
    prior(block::ACCEL_SCALE, 3, 0.02, false),
    prior(block::GYRO_BIAS, 3, 20.0 * DEG_H, false),
    prior(block::GYRO_SCALE, 3, 0.02, false),
    prior(block::NON_PERPENDICULARITY, 1, 0.3 * DEG, false),
    prior(block::ATTITUDE, 2, 20.0 * DEG, true),
    prior(block::HEADING, 1, 2.0, true),
];

/// Prior sigmas of all states, (STATES). A sigma is wide for a parameter that the method estimates, and zero for a
/// parameter that the method takes as known. The common scale error of the two-stage method is not included.
pub(super) fn prior_sigmas<T: Real, const STATES: usize>(config: &EstimatorConfig) -> Vector<T, STATES> {
    let mut sigmas = Vector::<T, STATES>::zeros();
    sigmas.fixed_rows_mut::<ENCODER_ERRORS>(0).fill(real(config.noise.encoder_sigma_rad));
    for prior in PRIORS.iter().filter(|prior| prior.two_stage || config.method == Method::Joint) {
        for sigma in sigmas.iter_mut().take(prior.states.end).skip(prior.states.start) {
            *sigma = real(prior.sigma);
        }
    }
    if config.method == Method::Joint {
        for (sigma, prior) in sigmas.iter_mut().skip(BASIC_STATES).zip(config.options.prior_sigmas()) {
            *sigma = real(prior);
        }
    }
    let heading = sigmas.iter_mut().nth(BASIC_STATES - 1);
    if let (HeadingSource::Configured { sigma_rad, .. }, Some(heading)) = (config.heading, heading) {
        *heading = real(sigma_rad);
    }
    sigmas
}
