//! Configuration of the estimator, and prior sigmas before the first segment.

use crate::base::bounds::{ARCSECONDS, Bounded, DEGREES, Unit};
use crate::base::hardware::Hardware;
use crate::base::linear::{ComplexField, Real, Vector, real};
use crate::base::method::Method;
use crate::base::site::Site;
use crate::base::units::{ARCSEC, DEG, DEG_H};
use crate::model::effects::{self, EFFECT_STATES, EFFECTS, FLICKER_STATES, SiteSigmas};
use crate::model::error_model::{INSTALLATION_STATES, PARAMETERS, block};
use crate::model::measurement::ENCODER_ERRORS;
use crate::segment::white_noise::Noise;
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// States of the filter before the parameters: encoder errors, the gyros' errors at the ends of a segment, and flicker.
/// They are driven by noise, which costs least in the first places.
pub const BEFORE_PARAMETERS: usize = BEFORE_FLICKER + FLICKER_STATES;

/// States of the filter before the flicker.
pub(super) const BEFORE_FLICKER: usize = ENCODER_ERRORS + GYRO_ENDS;

/// Errors of the three gyros' angles at both ends of a segment: rocking of the base, and what does not fill a pulse.
/// The error at the end of a segment is that at the start of the next one.
pub(super) const GYRO_ENDS: usize = 6;

/// States of the filter before the effects of real hardware.
pub const BEFORE_EFFECTS: usize = BEFORE_PARAMETERS + PARAMETERS;

/// States of the filter, `[encoder errors (4), gyro errors at the ends (6), flicker (6), parameters (28), effects
/// (67)]`. Only effects with a size are in use, without gaps.
pub const STATES: usize = BEFORE_EFFECTS + EFFECT_STATES;

/// With a larger sigma, the latitude counts as unknown, rad: the gyros find it.
pub const KNOWN_LATITUDE_RAD: f64 = 0.1;

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

/// The permitted range of every number of [`HeadingSource`].
pub static HEADING_BOUNDS: [Bounded<HeadingSource>; 2] = [
    Bounded::new("heading", DEGREES, [-1e6, 1e6], |source| match source {
        HeadingSource::Configured { heading_rad, .. } => *heading_rad,
        HeadingSource::Gyrocompass => 0.0,
    }),
    Bounded::new("sigma of the heading", DEGREES, [1e-9, 1e6], |source| match source {
        HeadingSource::Configured { sigma_rad, .. } => *sigma_rad,
        HeadingSource::Gyrocompass => 1.0,
    }),
];

/// P0 and Q of the paper's method. Its R follows from [`Noise`]: see `bai.rs`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BaiTuning {
    /// Sigma of each of the twelve states before any data, rad. P0 is its square times the unit matrix.
    pub initial_sigma_rad: f64,
    /// Random walk of each of the twelve states, rad/sqrt(s). Q over a time t is its square times t.
    pub walk_rad_sqrt_s: f64,
}

impl BaiTuning {
    /// Three degrees, which adds almost no information, and constant states.
    pub const STATED: Self = Self { initial_sigma_rad: INSTALLATION_SIGMA_RAD, walk_rad_sqrt_s: 0.0 };
}

impl Default for BaiTuning {
    fn default() -> Self {
        Self::STATED
    }
}

/// The permitted range of every number of [`BaiTuning`].
pub static TUNING_BOUNDS: [Bounded<BaiTuning>; 2] = [
    Bounded::new("initial sigma of Bai's states", ARCSECONDS, [0.1, 36_000.0], |tuning| tuning.initial_sigma_rad),
    Bounded::new(
        "random walk of Bai's states",
        Unit { symbol: "arcsec/sqrt(s)", si: ARCSEC },
        [0.0, 3600.0],
        |tuning| tuning.walk_rad_sqrt_s,
    ),
];

/// Configuration of the estimator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EstimatorConfig {
    /// Joint method, or the paper's.
    pub method: Method,
    /// Site of the instrument.
    pub site: Site,
    /// Noise of the sensors and the encoders.
    pub noise: Noise,
    /// Source of the heading.
    pub heading: HeadingSource,
    /// Number of moves in period one, for the paper's method. With `None` the periods are found from the angles of
    /// the stops.
    pub period_moves: Option<u16>,
    /// Gate: a measurement with a larger normalized innovation is not used, but counted. `None` uses all measurements.
    pub gate_sigma: Option<f64>,
    /// Imperfections of the hardware, for the joint method.
    pub hardware: Hardware,
    /// How well the site is known, for the joint method.
    pub site_sigmas: SiteSigmas,
    /// P0 and Q, for the paper's method. They are not sent over the link: an instrument has those of its firmware, which
    /// are [`BaiTuning::STATED`] unless its source says otherwise.
    #[serde(skip)]
    pub tuning: BaiTuning,
}

impl EstimatorConfig {
    /// Prior sigmas of the parameters, SI; 0 for a parameter that the method takes as known.
    pub fn prior_sigmas(&self) -> [f64; PARAMETERS] {
        let prior = prior_sigmas::<f64>(self);
        let mut sigmas = [0.0; PARAMETERS];
        sigmas.iter_mut().zip(prior.iter().skip(BEFORE_PARAMETERS)).for_each(|(sigma, prior)| *sigma = *prior);
        sigmas
    }

    /// Prior sigmas of the effects, SI; 0 for an effect that is absent. The paper's method knows no effects.
    pub fn effect_sigmas(&self) -> [f64; EFFECTS] {
        match self.method {
            Method::Joint => effects::prior_sigmas(&self.hardware, &self.site_sigmas),
            Method::Bai => [0.0; EFFECTS],
        }
    }

    /// Prior sigma of the latitude, rad. The paper's method takes the latitude as known.
    pub(super) fn latitude_sigma_rad(&self) -> f64 {
        match self.method {
            Method::Joint => self.site_sigmas.latitude_rad,
            Method::Bai => 0.0,
        }
    }

    /// The hardware that the method takes into account. The paper's method takes it as ideal.
    pub fn modelled_hardware(&self) -> &Hardware {
        match self.method {
            Method::Joint => &self.hardware,
            Method::Bai => &Hardware::IDEAL,
        }
    }

    /// Used until a configuration arrives.
    pub(super) const UNKNOWN: Self = Self {
        method: Method::Joint,
        site: Site { latitude_rad: 0.0, height_m: 0.0, measured_gravity_m_s2: None },
        noise: Noise { accel_psd_sqrt: 0.0, gyro_psd_sqrt: 0.0, encoder_sigma_rad: 0.0, margin: 1.0 },
        heading: HeadingSource::Gyrocompass,
        period_moves: None,
        gate_sigma: None,
        hardware: Hardware::IDEAL,
        site_sigmas: SiteSigmas::EXACT,
        tuning: BaiTuning::STATED,
    };
}

/// Variance of the error of an encoder at a stop, rad^2.
pub(super) fn encoder_variance(config: &EstimatorConfig) -> f64 {
    let sigma = config.noise.encoder_sigma_rad;
    sigma * sigma + effects::encoder_noise(&config.hardware)
}

/// Prior sigma of a block of parameters. It is so wide that it adds almost no information.
struct Prior {
    states: Range<usize>,
    sigma: f64,
}

const fn prior(first: usize, count: usize, sigma: f64) -> Prior {
    let first = BEFORE_PARAMETERS + first;
    Prior { states: first..first + count, sigma }
}

/// Prior sigma of the twelve installation errors, rad.
const INSTALLATION_SIGMA_RAD: f64 = 3.0 * DEG;

const PRIORS: [Prior; 8] = [
    prior(0, INSTALLATION_STATES, INSTALLATION_SIGMA_RAD),
    prior(block::ACCEL_BIAS, 3, 0.2),
    prior(block::ACCEL_SCALE, 3, 0.02),
    prior(block::GYRO_BIAS, 3, 20.0 * DEG_H),
    prior(block::GYRO_SCALE, 3, 0.02),
    prior(block::NON_PERPENDICULARITY, 1, 0.3 * DEG),
    prior(block::ATTITUDE, 2, 20.0 * DEG),
    prior(block::HEADING, 1, 2.0),
];

/// Prior sigmas of all states, (111), with those of the effects in use behind the parameters. A sigma is wide for a
/// parameter that the method estimates, and zero for a parameter that the method takes as known.
pub(super) fn prior_sigmas<T: Real>(config: &EstimatorConfig) -> Vector<T, STATES> {
    let mut sigmas = Vector::<T, STATES>::zeros();
    if config.method == Method::Bai {
        sigmas.fixed_rows_mut::<INSTALLATION_STATES>(BEFORE_PARAMETERS).fill(real(config.tuning.initial_sigma_rad));
        return sigmas;
    }
    sigmas.fixed_rows_mut::<ENCODER_ERRORS>(0).fill(real(ComplexField::sqrt(encoder_variance(config))));
    for prior in &PRIORS {
        for sigma in sigmas.iter_mut().take(prior.states.end).skip(prior.states.start) {
            *sigma = real(prior.sigma);
        }
    }
    let flicker = effects::flicker_sigmas(&config.hardware);
    for (sigma, prior) in sigmas.iter_mut().skip(BEFORE_FLICKER).zip(flicker) {
        *sigma = real(prior);
    }
    let in_use = config.effect_sigmas().into_iter().take(EFFECT_STATES).filter(|prior| *prior > 0.0);
    for (sigma, prior) in sigmas.iter_mut().skip(BEFORE_EFFECTS).zip(in_use) {
        *sigma = real(prior);
    }
    let heading = sigmas.get_mut(BEFORE_PARAMETERS + block::HEADING);
    if let (HeadingSource::Configured { sigma_rad, .. }, Some(heading)) = (config.heading, heading) {
        *heading = real(sigma_rad);
    }
    sigmas
}
