//! Checks whether the segments agree with the model, and whether the configured values agree with the segments.

use super::assessment::{Assessment, Verdict};
use super::limits::{VerdictLimits, implausible};
use super::reason::Reason;
use super::setting::{Explanation, wrong_setting};
use crate::base::hardware::Hardware;
use crate::base::linear::{ComplexField, Real};
use crate::estimator::Solution;
use crate::estimator::constancy::{Change, Suspicion};
use crate::model::effects::{EFFECT_STATES, EFFECTS, FLICKER_KIND, effect};
use crate::segment::white_noise::chi_square_quantile;

/// Upper bound of the chi-square of the fit, as a normal deviate. Its probability is 2e-4.
const CHI_SQUARE_UPPER_Z: f64 = 3.6;

const CHI_SQUARE_LOWER_Z: f64 = -5.0;

/// Largest normalized innovation. Its probability is 6e-7 for one measurement and 1e-4 for 168 measurements.
const INNOVATION_LIMIT: f64 = 5.0;

/// Whether the chi-square of the residuals is within its bounds.
pub fn is_good_fit(chi_square: f64, degrees_of_freedom: u32, hardware: &Hardware) -> bool {
    let [low, high] = chi_square_bounds(degrees_of_freedom, hardware);
    (low..=high).contains(&chi_square)
}

/// Bounds of the chi-square. With imperfections configured there is no lower bound: a unit may be better than others of
/// its kind.
pub(super) fn chi_square_bounds(degrees_of_freedom: u32, hardware: &Hardware) -> [f64; 2] {
    let [low, high] = [CHI_SQUARE_LOWER_Z, CHI_SQUARE_UPPER_Z].map(|z| chi_square_quantile(degrees_of_freedom, z));
    [if *hardware == Hardware::IDEAL { low } else { 0.0 }, high]
}

/// The reason for a founded suspicion.
fn named(suspicion: &Suspicion, configured: &[f64; EFFECTS]) -> Reason {
    let Change::Effect(effect) = suspicion.change else { return Reason::Changing(*suspicion) };
    let configured = configured.get(usize::from(effect)).copied().unwrap_or(0.0);
    let of_test = suspicion.size / suspicion.sigmas;
    // The test of an effect with a state is about its deviation from the prior, so that sigma contains the configured size.
    let prior = if usize::from(effect) < EFFECT_STATES { configured } else { 0.0 };
    let sigma = ComplexField::sqrt((of_test * of_test - prior * prior).max(0.0));
    Reason::Hardware { effect, size: suspicion.size, sigma, configured }
}

/// Whether the flicker of the accelerometers is larger than configured.
fn is_flicker(suspicion: &Suspicion) -> bool {
    suspicion.is_founded() && suspicion.change == Change::Kind(FLICKER_KIND)
}

/// Larger flicker is also seen as drift and as noise within the stops, so it is judged before them.
pub(super) fn judge_flicker<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>) {
    let Solution { suspicion, .. } = assessment.solution;
    if is_flicker(suspicion) {
        verdict.doubt(Reason::Changing(*suspicion));
    }
}

pub(super) fn judge_fit<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, limits: &VerdictLimits) {
    let Assessment { solution, site, .. } = assessment;
    // An error of the instrument may look like a wrong setting. A wrong setting does not look like an error of the
    // instrument.
    let sound = verdict.accepted() && implausible(solution, limits).next().is_none();
    let latitude_sigma_rad = assessment.effect_sigmas.get(effect::LATITUDE).copied().unwrap_or(0.0);
    let wrong = if sound { wrong_setting(solution, site, latitude_sigma_rad) } else { None };
    if let Some(Explanation { setting, .. }) = &wrong {
        verdict.doubt(Reason::Setting(*setting));
    }
    let suspicion = &solution.suspicion;
    if suspicion.is_founded() && !is_flicker(suspicion) && !wrong.is_some_and(|wrong| wrong.only) {
        verdict.doubt(named(suspicion, assessment.effect_sigmas));
    }
    if solution.fit.refused > 0 {
        verdict.doubt(Reason::Refused(solution.fit.refused));
    }
    if !solution.converged {
        verdict.doubt(Reason::NotConverged(solution.sweeps));
    }
    let degrees_of_freedom = solution.degrees_of_freedom;
    let chi_square = solution.fit.chi_square;
    let [low, high] = chi_square_bounds(degrees_of_freedom, assessment.hardware);
    if degrees_of_freedom > 0 && !(low..=high).contains(&chi_square) {
        verdict.doubt(Reason::ChiSquare { chi_square, degrees_of_freedom, low, high });
    }
    let largest = solution.fit.largest;
    if largest.normalized.abs() > INNOVATION_LIMIT {
        let (segment, channel) = (largest.segment, largest.channel);
        verdict.doubt(Reason::Innovation { segment, channel, normalized: largest.normalized });
    }
}
