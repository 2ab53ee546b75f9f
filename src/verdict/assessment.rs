//! The input of the verdict, and the verdict.

use super::reason::Reason;
use crate::base::clock_check::ClockFault;
use crate::base::hardware::Hardware;
use crate::base::linear::{ComplexField, Real};
use crate::base::site::Site;
use crate::estimator::constancy::{Change, Suspicion};
use crate::estimator::{Estimate, Solution};
use crate::model::effects::{self, EFFECTS, is_of_axes, size_of, size_of_kind};
use crate::model::error_model::PARAMETERS;
use crate::segment::Segment;
use crate::segment::intake::IntakeCounts;
use crate::segment::white_noise::Noise;
use serde::{Deserialize, Serialize};

/// Largest number of reasons in a verdict. Further reasons are only counted.
pub(super) const MAX_REASONS: usize = 12;

/// The verdict: accepted, or rejected with reasons.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Verdict {
    /// Doubts, in the order in which they were found. Without doubts, the result is accepted.
    pub reasons: heapless::Vec<Reason, MAX_REASONS>,
    /// Number of doubts that did not fit.
    pub more: u16,
    /// Changes from the stored calibration that the limits permit, and other remarks that are no doubts.
    pub changes: heapless::Vec<Reason, MAX_REASONS>,
}

impl Verdict {
    /// Whether the result may be stored and used.
    pub fn accepted(&self) -> bool {
        self.reasons.is_empty()
    }

    /// Puts an explanation before the doubts, if there are doubts.
    pub fn explain(&mut self, explanation: Reason) {
        if self.accepted() {
            return;
        }
        if self.reasons.is_full() && self.reasons.pop().is_some() {
            self.more = self.more.saturating_add(1);
        }
        // The vector is not full now, so the insertion cannot fail.
        let _ = self.reasons.insert(0, explanation);
    }

    /// The configured hardware with the size enlarged that the verdict names as too small, to the size of the effect in
    /// this unit; `None` if the verdict names none. Wobble and sag of the axes are never enlarged: their motions
    /// resemble each other, and the wrong one would bend the result.
    pub fn enlarged(&self, configured: &Hardware) -> Option<Hardware> {
        let named = |reason: &Reason| match *reason {
            Reason::Hardware { effect, size, sigma, .. } if !is_of_axes(effect.into()) => {
                Some((size_of(effect.into())?, ComplexField::hypot(size, sigma)))
            }
            Reason::Changing(Suspicion { change: Change::Kind(kind), size, .. }) => {
                let row = size_of_kind(kind)?;
                let of_axes = effects::kind(kind.into()).any(|effect| is_of_axes(effect.into()));
                (!of_axes).then(|| (row, size * row.get(configured)))
            }
            _ => None,
        };
        let (row, size) = self.reasons.iter().find_map(named)?;
        let size = size.min(row.largest * row.unit_si);
        let mut enlarged = *configured;
        (size > row.get(configured)).then(|| {
            row.set(&mut enlarged, size);
            enlarged
        })
    }

    /// Takes account of the clock of the time stamps: a doubt, or for a clock that was not checked a remark beside the
    /// changes.
    pub fn note_clock(&mut self, fault: Option<ClockFault>) {
        match fault {
            Some(fault) if fault.rejects() => self.doubt(Reason::Clock(fault)),
            // If the vector is full, the changes say more than the remark.
            Some(fault) => drop(self.changes.push(Reason::Clock(fault))),
            None => {}
        }
    }

    /// Adds a doubt.
    pub(super) fn doubt(&mut self, reason: Reason) {
        if self.reasons.push(reason).is_err() {
            self.more = self.more.saturating_add(1);
        }
    }
}

/// Everything that the verdict uses.
#[derive(Clone, Copy, Debug)]
pub struct Assessment<'a, T: Real> {
    /// The solution after all sweeps.
    pub solution: &'a Solution,
    /// Prior sigmas, SI; 0 for a parameter that the method does not estimate.
    pub prior_sigmas: &'a [f64; PARAMETERS],
    /// The segments of the run.
    pub segments: &'a [Segment<T>],
    /// The configured noise.
    pub noise: &'a Noise,
    /// The configured imperfections of the hardware.
    pub hardware: &'a Hardware,
    /// Prior sigmas of the effects of the hardware, SI; 0 for an effect that is absent.
    pub effect_sigmas: &'a [f64; EFFECTS],
    /// The site of the calibration.
    pub site: &'a Site,
    /// The counts of admitted and refused samples.
    pub counts: IntakeCounts,
    /// The calibration in the store, if there is one.
    pub stored: Option<&'a Estimate>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_clock_rejects_and_one_that_is_not_checked_is_told() {
        let noted = |fault| {
            let mut verdict = Verdict::default();
            verdict.note_clock(fault);
            (verdict.accepted(), verdict.reasons.len(), verdict.changes.len())
        };
        assert_eq!(noted(None), (true, 0, 0));
        assert_eq!(noted(Some(ClockFault::Absent)), (false, 1, 0));
        assert_eq!(noted(Some(ClockFault::Off(-51.0))), (false, 1, 0));
        assert_eq!(noted(Some(ClockFault::Unchecked)), (true, 0, 1));
    }
}
