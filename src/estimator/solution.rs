//! What the estimator gives: parameters, their uncertainty, and the agreement of the segments with the model.

use super::constancy::{SettingEvidence, Suspicion};
use super::filter::{UdFilter, Update};
use crate::base::linear::Real;
use crate::base::sample::CHANNELS;
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::model::options::OptionalEstimate;
use serde::{Deserialize, Serialize};

/// A parameter is observed if its sigma is at most this part of its prior sigma.
pub const OBSERVED_RATIO: f64 = 0.1;

/// The innovation farthest from what was expected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LargestInnovation {
    /// In units of its standard deviation.
    pub normalized: f64,
    /// Segment, counted from 0.
    pub segment: u16,
    /// Channel: 0 to 2 accelerometers x y z, 3 to 5 gyros x y z.
    pub channel: u8,
}

/// How far the measurements of a segment are from what all others say, in the last sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentInnovations {
    /// Segment, counted from 0.
    pub segment: u16,
    /// Innovation of each channel in units of its standard deviation, accelerometers x y z, gyros x y z; `None` where
    /// nothing was measured, or refused.
    pub normalized: [Option<f32>; CHANNELS],
}

/// Agreement of the segments with the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Sum of squared normalized innovations.
    pub chi_square: f64,
    /// Measurements taken in.
    pub measurements: u32,
    /// Measurements kept out by the gate.
    pub gated: u32,
    /// Measurements refused for a number that is not finite.
    pub refused: u32,
    /// The worst of all, gated ones included.
    pub largest: LargestInnovation,
}

impl Fit {
    /// Before any measurement.
    pub(super) const NONE: Self = Self {
        chi_square: 0.0,
        measurements: 0,
        gated: 0,
        refused: 0,
        largest: LargestInnovation { normalized: 0.0, segment: 0, channel: 0 },
    };

    /// Counts a measurement on this channel of this segment.
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

/// Parameters with their uncertainty, widened to `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The parameters.
    pub errors: InstrumentErrors<f64>,
    /// Their standard deviations, SI; 0 for one that the method takes as known.
    pub sigmas: [f64; PARAMETERS],
}

/// The outcome of all sweeps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Parameters and sigmas.
    pub estimate: Estimate,
    /// Agreement with the model.
    pub fit: Fit,
    /// Measurements less parameters that they determine.
    pub degrees_of_freedom: u32,
    /// Sweeps made.
    pub sweeps: u8,
    /// Whether the estimate has converged.
    pub converged: bool,
    /// Segments processed.
    pub segments: u16,
    /// Segments that are broken by a gap, or did not fit, and were left out.
    pub left_out: u16,
    /// Time from the first segment's start to the last one's end, s.
    pub duration_s: f64,
    /// Mean temperature, deg C; not a number where it is unknown.
    pub temperature_c: f32,
    /// Optional states. Biases, attitude and optional rates hold at the end of the last segment.
    pub optional: OptionalEstimate,
    /// The most significant change of what should be constant; the joint method only.
    pub suspicion: Suspicion,
    /// What the segments say about what was configured; the joint method only.
    pub settings: SettingEvidence,
}

/// Standard deviations of `COUNT` states from `first` on, SI; 0 for those that the filter does not have.
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
