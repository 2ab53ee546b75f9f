//! What is judged, and the verdict on it.

use super::reason::Reason;
use crate::base::linear::Real;
use crate::base::site::Site;
use crate::estimator::{Estimate, Solution};
use crate::model::error_model::PARAMETERS;
use crate::segment::Segment;
use crate::segment::intake::IntakeCounts;
use crate::segment::white_noise::Noise;
use serde::{Deserialize, Serialize};

/// Reasons that fit; more are counted.
pub(super) const MAX_REASONS: usize = 12;

/// Accepted, or rejected with reasons.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Doubts, in the order they were found; none means accepted.
    pub reasons: heapless::Vec<Reason, MAX_REASONS>,
    /// Doubts that did not fit.
    pub more: u16,
    /// Changes against the stored calibration that the limits allow.
    pub changes: heapless::Vec<Reason, MAX_REASONS>,
}

impl Verdict {
    /// Whether the result may be stored and used.
    pub fn accepted(&self) -> bool {
        self.reasons.is_empty()
    }

    /// Puts an explanation before the doubts, if there are any.
    pub fn explain(&mut self, explanation: Reason) {
        if self.accepted() {
            return;
        }
        if self.reasons.is_full() && self.reasons.pop().is_some() {
            self.more = self.more.saturating_add(1);
        }
        // There is room now.
        let _ = self.reasons.insert(0, explanation);
    }

    /// Adds a doubt.
    pub(super) fn doubt(&mut self, reason: Reason) {
        if self.reasons.push(reason).is_err() {
            self.more = self.more.saturating_add(1);
        }
    }
}

/// Everything that is judged.
#[derive(Clone, Copy, Debug)]
pub struct Assessment<'a, T: Real> {
    /// The outcome of all sweeps.
    pub solution: &'a Solution,
    /// Prior sigmas, SI; 0 for a parameter that the method takes as known.
    pub prior_sigmas: &'a [f64; PARAMETERS],
    /// The segments.
    pub segments: &'a [Segment<T>],
    /// The configured noise.
    pub noise: &'a Noise,
    /// Where the instrument stands.
    pub site: &'a Site,
    /// What became of the samples.
    pub counts: IntakeCounts,
    /// The calibration in store.
    pub stored: Option<&'a Estimate>,
}
