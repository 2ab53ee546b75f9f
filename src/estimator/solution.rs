//! Results of the estimator: parameters, their uncertainty, and the agreement of the segments with the model.

use super::constancy::{SettingEvidence, Suspicion};
use super::filter::{UdFilter, Update};
use crate::base::linear::Real;
use crate::base::sample::CHANNELS;
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::model::options::OptionalEstimate;
use serde::{Deserialize, Serialize};

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

/// Parameters with their uncertainty, as `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimate {
    /// The parameters.
    pub errors: InstrumentErrors<f64>,
    /// Standard deviations of the parameters, SI; 0 for a parameter that the method takes as known.
    pub sigmas: [f64; PARAMETERS],
}

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
    /// Optional states. The values of biases, attitude and optional rates are those at the end of the last segment.
    pub optional: OptionalEstimate,
    /// The most significant change of a quantity that should be constant. Joint method only.
    pub suspicion: Suspicion,
    /// Evidence of the segments about the configured site and heading. Joint method only.
    pub settings: SettingEvidence,
}

/// Standard deviations of `COUNT` states from `first` on, SI; 0 for a state that the filter does not have.
pub(super) fn sigmas<T: Real, const STATES: usize, const COUNT: usize>(
    filter: &UdFilter<T, STATES>,
    first: usize,
) -> [f64; COUNT] {
    let mut sigmas = [0.0; COUNT];
    for (sigma, variance) in sigmas.iter_mut().zip(filter.variances().iter().skip(first)) {
        *sigma = variance.sqrt().widened();
    }
    sigmas
}
