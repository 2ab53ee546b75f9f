//! Checks whether the segments agree with the model, and whether the configured values agree with the segments.

use super::assessment::{Assessment, Verdict};
use super::limits::{VerdictLimits, implausible};
use super::reason::Reason;
use super::setting::{Explanation, wrong_setting};
use crate::base::linear::Real;
use crate::segment::white_noise::chi_square_quantile;

/// Upper bound of the chi-square of the fit, as a normal deviate. Its probability is 2e-4.
const CHI_SQUARE_UPPER_Z: f64 = 3.6;

const CHI_SQUARE_LOWER_Z: f64 = -5.0;

/// Largest normalized innovation. Its probability is 6e-7 for one measurement and 1e-4 for 168 measurements.
const INNOVATION_LIMIT: f64 = 5.0;

/// Whether the chi-square of the residuals is within its bounds.
pub fn is_good_fit(chi_square: f64, degrees_of_freedom: u32) -> bool {
    let [low, high] = chi_square_bounds(degrees_of_freedom);
    (low..=high).contains(&chi_square)
}

pub(super) fn chi_square_bounds(degrees_of_freedom: u32) -> [f64; 2] {
    [CHI_SQUARE_LOWER_Z, CHI_SQUARE_UPPER_Z].map(|z| chi_square_quantile(degrees_of_freedom, z))
}

pub(super) fn judge_fit<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, limits: &VerdictLimits) {
    let Assessment { solution, site, .. } = assessment;
    // An error of the instrument may look like a wrong setting. A wrong setting does not look like an error of the
    // instrument.
    let sound = verdict.accepted() && implausible(solution, limits).next().is_none();
    let wrong = if sound { wrong_setting(solution, site) } else { None };
    if let Some(Explanation { setting, .. }) = &wrong {
        verdict.doubt(Reason::Setting(*setting));
    }
    if solution.suspicion.is_founded() && !wrong.is_some_and(|wrong| wrong.only) {
        verdict.doubt(Reason::Changing(solution.suspicion));
    }
    if solution.fit.refused > 0 {
        verdict.doubt(Reason::Refused(solution.fit.refused));
    }
    if !solution.converged {
        verdict.doubt(Reason::NotConverged(solution.sweeps));
    }
    let degrees_of_freedom = solution.degrees_of_freedom;
    let chi_square = solution.fit.chi_square;
    let [low, high] = chi_square_bounds(degrees_of_freedom);
    if degrees_of_freedom > 0 && !(low..=high).contains(&chi_square) {
        verdict.doubt(Reason::ChiSquare { chi_square, degrees_of_freedom, low, high });
    }
    let largest = solution.fit.largest;
    if largest.normalized.abs() > INNOVATION_LIMIT {
        let (segment, channel) = (largest.segment, largest.channel);
        verdict.doubt(Reason::Innovation { segment, channel, normalized: largest.normalized });
    }
}
