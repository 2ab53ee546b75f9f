//! Results of the estimator: parameters, their uncertainty, and the agreement of the segments with the model.

use super::configuration::{EstimatorConfig, KNOWN_LATITUDE_RAD, STATES};
use super::constancy::{SettingEvidence, Suspicion};
use super::filter::entries_above_diagonal;
use super::filter::{UdFilter, Update};
use crate::base::linear::{Real, real};
use crate::base::sample::CHANNELS;
use crate::base::site::Site;
use crate::model::effects::{EFFECT_STATES, effect};
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use serde::{Deserialize, Serialize};
use serde_big_array::BigArray;

/// A parameter is observed if its sigma is at most this fraction of its prior sigma.
pub const OBSERVED_RATIO: f64 = 0.1;

/// The innovation with the largest normalized magnitude.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LargestInnovation {
    /// The innovation in units of its standard deviation.
    pub normalized: f64,
    /// Segment, counted from 0.
    pub segment: u16,
    /// Channel: 0 to 2 accelerometers x y z, 3 to 5 gyros x y z.
    pub channel: u8,
}

/// Innovations of the measurements of one segment in the closing sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SegmentInnovations {
    /// Segment, counted from 0.
    pub segment: u16,
    /// Innovation of each channel in units of its standard deviation: accelerometers x y z, gyros x y z. `None` if the
    /// channel has no measurement, or the measurement was refused.
    pub normalized: [Option<f32>; CHANNELS],
}

/// Agreement of the segments with the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fit {
    /// Sum of squared normalized innovations.
    pub chi_square: f64,
    /// Number of measurements that the filter used.
    pub measurements: u32,
    /// Number of measurements that the gate refused.
    pub gated: u32,
    /// Number of measurements refused because a number is not finite or the noise variance is not positive.
    pub refused: u32,
    /// The largest innovation, including innovations that the gate refused.
    pub largest: LargestInnovation,
}

impl Fit {
    /// The fit before the first measurement.
    pub(super) const NONE: Self = Self {
        chi_square: 0.0,
        measurements: 0,
        gated: 0,
        refused: 0,
        largest: LargestInnovation { normalized: 0.0, segment: 0, channel: 0 },
    };

    /// Counts the outcome of a measurement on this channel of this segment.
    pub(super) fn note<T: Real>(&mut self, update: &Update<T>, segment: usize, channel: u8) {
        let innovation = match update {
            Update::Applied(innovation) => innovation,
            Update::Gated(innovation) => innovation,
            Update::Refused => return,
        };
        let normalized = innovation.normalized().widened();
        if matches!(update, Update::Applied(_)) {
            self.chi_square += normalized * normalized;
            self.measurements += 1;
        }
        if normalized.abs() > self.largest.normalized.abs() {
            self.largest = LargestInnovation { normalized, segment: segment as u16, channel };
        }
    }
}

/// Largest variance of an innovation that is a test, in units of the variance of its noise. From larger ones, of 300 ug
/// and more, the filter learns the parameters, whose priors are wider than any instrument.
const LARGEST_PREDICTED: f64 = 1e4;

/// Chi-square of the innovations of the accelerometers at the stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Forces {
    pub(super) chi_square: f64,
    /// Number of its terms.
    pub(super) freedom: u32,
}

impl Forces {
    pub(super) const NONE: Self = Self { chi_square: 0.0, freedom: 0 };

    /// Counts the outcome of a measurement whose noise has this variance.
    pub(super) fn note<T: Real>(&mut self, update: &Update<T>, noise: T) {
        if let Update::Applied(innovation) = update
            && innovation.variance < noise * real(LARGEST_PREDICTED)
        {
            let normalized = innovation.normalized().widened();
            self.chi_square += normalized * normalized;
            self.freedom += 1;
        }
    }
}

/// Parameters with their uncertainty, as `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimate {
    /// The parameters.
    pub errors: InstrumentErrors<f64>,
    /// Standard deviations of the parameters, SI; 0 for a parameter that the method takes as known.
    pub sigmas: [f64; PARAMETERS],
}

/// Effects of the hardware that have a state, with their standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EffectEstimates {
    /// Estimated values, SI.
    #[serde(with = "BigArray")]
    pub values: [f32; EFFECT_STATES],
    /// Standard deviations, SI; 0 for an effect that is absent.
    #[serde(with = "BigArray")]
    pub sigmas: [f32; EFFECT_STATES],
}

impl EffectEstimates {
    /// No effects.
    pub const NONE: Self = Self { values: [0.0; EFFECT_STATES], sigmas: [0.0; EFFECT_STATES] };
}

/// The filter of the estimator.
pub(super) type Filter<T> = UdFilter<T, STATES, { entries_above_diagonal(STATES) }>;

/// The result of the final pass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Solution {
    /// Parameters and sigmas.
    pub estimate: Estimate,
    /// Agreement with the model.
    pub fit: Fit,
    /// Number of measurements minus the number of parameters that they determine.
    pub degrees_of_freedom: u32,
    /// Number of sweeps until the estimate converged, or until the limit.
    pub sweeps: u8,
    /// Whether the estimate has converged.
    pub converged: bool,
    /// Number of segments.
    pub segments: u16,
    /// Number of segments that were left out, because a gap broke them or because there was no memory for them.
    pub left_out: u16,
    /// Time from the start of the first segment to the end of the last segment, s.
    pub duration_s: f64,
    /// Mean temperature, deg C; NaN if the temperature is unknown.
    pub temperature_c: f32,
    /// Effects of the hardware. The values of biases and attitude are those at the end of the last segment.
    pub effects: EffectEstimates,
    /// The most significant change of a quantity that should be constant. Joint method only.
    pub suspicion: Suspicion,
    /// Evidence of the segments about the configured site and heading. Joint method only.
    pub settings: SettingEvidence,
}

impl Solution {
    /// The site of the calibration: the configured one, with the latitude that the gyros have found if it was not
    /// known.
    pub fn site(&self, config: &EstimatorConfig) -> Site {
        let found = self.effects.values.get(effect::LATITUDE).copied().unwrap_or(0.0);
        let unknown = config.site_sigmas.latitude_rad > KNOWN_LATITUDE_RAD;
        let found_rad = if unknown { f64::from(found) } else { 0.0 };
        Site { latitude_rad: config.site.latitude_rad + found_rad, ..config.site }
    }
}

/// Standard deviations of `COUNT` states from `first` on, SI; 0 for a state that the filter does not have.
pub(super) fn sigmas<T: Real, const COUNT: usize>(filter: &Filter<T>, first: usize) -> [f64; COUNT] {
    let mut sigmas = [0.0; COUNT];
    for (sigma, variance) in sigmas.iter_mut().zip(filter.variances().iter().skip(first)) {
        *sigma = variance.sqrt().widened();
    }
    sigmas
}
