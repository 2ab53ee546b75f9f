//! Limits of a result that do not follow from statistics: plausible values and required sigmas.

use crate::base::bounds::{Bounded, DEGREES, DEGREES_PER_H, MICROGRAVITIES, PARTS_PER_MILLION, Unit};
use crate::base::units::{DEG, DEG_H, MICRO_G, PPM};
use crate::estimator::Solution;
use crate::model::error_model::{INSTALLATION_STATES, PARAMETERS, block};
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// The twelve installation errors of the paper.
pub(super) const INSTALLATION: Range<usize> = 0..INSTALLATION_STATES;

/// Limits of a result that do not follow from statistics. [`LIMIT_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VerdictLimits {
    /// Largest plausible non-orthogonality and mounting angle, rad.
    pub installation_rad: f64,
    /// Largest plausible accelerometer bias, m/s^2.
    pub accel_bias_m_s2: f64,
    /// Largest plausible gyro bias, rad/s.
    pub gyro_bias_rad_s: f64,
    /// Largest plausible scale-factor error.
    pub scale: f64,
    /// Largest plausible non-perpendicularity, rad.
    pub non_perpendicularity_rad: f64,
    /// Largest plausible tilt of the base, rad.
    pub base_tilt_rad: f64,
    /// Largest permitted sigmas, in the order of the parameter vector, SI; infinite for a parameter without
    /// requirement.
    pub required_sigmas: Option<[f64; PARAMETERS]>,
}

/// The permitted range of every number of [`VerdictLimits`]. A limit of zero would reject every result.
pub static LIMIT_BOUNDS: [Bounded<VerdictLimits>; 7] = [
    Bounded::new("installation errors", DEGREES, [1e-6, 90.0], |limits| limits.installation_rad),
    Bounded::new("accelerometer biases", MICROGRAVITIES, [1e-3, 1e7], |limits| limits.accel_bias_m_s2),
    Bounded::new("gyro biases", DEGREES_PER_H, [1e-6, 1e6], |limits| limits.gyro_bias_rad_s),
    Bounded::new("scale-factor errors", PARTS_PER_MILLION, [1e-3, 1e6], |limits| limits.scale),
    Bounded::new("non-perpendicularity", DEGREES, [1e-6, 90.0], |limits| limits.non_perpendicularity_rad),
    Bounded::new("tilt of the base", DEGREES, [1e-6, 180.0], |limits| limits.base_tilt_rad),
    Bounded::new("required sigmas", Unit::si("SI"), [1e-15, f64::INFINITY], |limits| {
        let smallest = limits.smallest_required();
        if smallest == f64::INFINITY { 1.0 } else { smallest }
    }),
];

impl VerdictLimits {
    /// The smallest required sigma, SI; infinite if nothing is required, and not a number if a required sigma is none.
    fn smallest_required(&self) -> f64 {
        let required = self.required_sigmas.iter().flatten();
        required.fold(f64::INFINITY, |least, sigma| if *sigma < least || sigma.is_nan() { *sigma } else { least })
    }

    /// Requires at most this sigma, rad, of each of the twelve installation errors.
    #[must_use]
    pub fn requiring(self, sigma_rad: f64) -> Self {
        let mut required = [f64::INFINITY; PARAMETERS];
        required.iter_mut().take(INSTALLATION.end).for_each(|required| *required = sigma_rad);
        Self { required_sigmas: Some(required), ..self }
    }

    /// Parameters whose sigma exceeds the required sigma: index, sigma and required sigma, SI.
    pub fn unmet<'a>(&'a self, sigmas: &'a [f64; PARAMETERS]) -> impl Iterator<Item = (u8, f64, f64)> + 'a {
        let required = self.required_sigmas.iter().flatten();
        let pairs = (0_u8..).zip(sigmas.iter().zip(required));
        pairs
            .filter(|(_, (sigma, required))| sigma > required)
            .map(|(parameter, (sigma, required))| (parameter, *sigma, *required))
    }
}

impl Default for VerdictLimits {
    /// 5 deg; 20 mg; 20 deg/h; 5000 ppm; 0.5 deg; 15 deg; no required sigmas.
    fn default() -> Self {
        Self {
            installation_rad: 5.0 * DEG,
            accel_bias_m_s2: 20_000.0 * MICRO_G,
            gyro_bias_rad_s: 20.0 * DEG_H,
            scale: 5000.0 * PPM,
            non_perpendicularity_rad: 0.5 * DEG,
            base_tilt_rad: 15.0 * DEG,
            required_sigmas: None,
        }
    }
}

/// Largest plausible magnitude of a parameter, SI.
pub(super) fn plausible(parameter: usize, limits: &VerdictLimits) -> f64 {
    match parameter {
        block::GYRO_NON_ORTHOGONALITY..block::ACCEL_BIAS => limits.installation_rad,
        block::ACCEL_BIAS..block::ACCEL_SCALE => limits.accel_bias_m_s2,
        block::GYRO_BIAS..block::GYRO_SCALE => limits.gyro_bias_rad_s,
        block::ACCEL_SCALE..block::GYRO_BIAS | block::GYRO_SCALE..block::NON_PERPENDICULARITY => limits.scale,
        block::NON_PERPENDICULARITY => limits.non_perpendicularity_rad,
        block::HEADING => f64::INFINITY,
        _ => limits.base_tilt_rad,
    }
}

/// Parameters outside their plausible ranges: index, value and limit, SI.
pub(super) fn implausible(solution: &Solution, limits: &VerdictLimits) -> impl Iterator<Item = (u8, f64, f64)> {
    let values = solution.estimate.errors.to_vector().data.0[0];
    let limits = core::array::from_fn::<_, PARAMETERS, _>(|parameter| plausible(parameter, limits));
    let all = (0_u8..).zip(values).zip(limits).map(|((parameter, value), limit)| (parameter, value, limit));
    all.filter(|(_, value, limit)| value.abs() > *limit)
}
