//! Parameters in report units: headings within a turn, errors against a truth, numbers with as many digits as their
//! sigma justifies.

use rins_selfcal::model::effects::{EFFECT_INFO, EFFECT_STATES};
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETER_INFO, PARAMETERS, ParameterInfo};

/// Number of the parameters and of the effects of the hardware that have a state. The effects come last.
pub const STATES: usize = PARAMETERS + EFFECT_STATES;

/// The heading is the only parameter that may be an angle of any size.
pub use rins_selfcal::model::error_model::block::HEADING;

/// Larger numbers are printed in scientific notation.
const HUGE: f64 = 1e6;

/// Significant digits of a sigma.
const SIGMA_DIGITS: i32 = 3;

/// Names and units of all states, in the order of the states.
pub fn states() -> impl Iterator<Item = &'static ParameterInfo> + Clone {
    PARAMETER_INFO.iter().chain(EFFECT_INFO.iter().take(EFFECT_STATES))
}

/// Index of the parameter of this name.
pub fn parameter(name: &str) -> Option<usize> {
    PARAMETER_INFO.iter().position(|info| info.name == name)
}

/// Estimates in report units, the heading in 0 to 360 deg.
pub fn values(errors: &InstrumentErrors<f64>) -> [f64; PARAMETERS] {
    let x = errors.to_vector();
    std::array::from_fn(|index| value(index, x[index] / PARAMETER_INFO[index].unit_si))
}

/// A parameter in report units, a heading in 0 to 360 deg.
pub fn value(index: usize, value: f64) -> f64 {
    if index == HEADING { within_turn_deg(value) } else { value }
}

/// Sigmas, SI, in report units.
pub fn sigmas(sigmas: &[f64; PARAMETERS]) -> [f64; PARAMETERS] {
    std::array::from_fn(|index| sigmas[index] / PARAMETER_INFO[index].unit_si)
}

/// Estimate less truth of a parameter in report units, the heading's within 180 deg either way.
pub fn error(index: usize, estimate: f64, truth: f64) -> f64 {
    let error = estimate - truth;
    if index == HEADING { within_turn_deg(error + 180.0) - 180.0 } else { error }
}

/// [`error`] of all parameters.
pub fn errors(estimate: &InstrumentErrors<f64>, truth: &InstrumentErrors<f64>) -> [f64; PARAMETERS] {
    let (estimate, truth) = (values(estimate), values(truth));
    std::array::from_fn(|index| error(index, estimate[index], truth[index]))
}

/// An angle in 0 to 360 deg, 360 not included.
fn within_turn_deg(angle_deg: f64) -> f64 {
    let rest = angle_deg.rem_euclid(360.0);
    // `rem_euclid` rounds a tiny negative angle to a full turn.
    if rest < 360.0 { rest } else { 0.0 }
}

/// Decimals that show a sigma with three significant digits. Zero decimals if the sigma is zero or not a number.
pub fn decimals(sigma: f64) -> usize {
    if !sigma.is_normal() {
        return 0;
    }
    let leading = sigma.abs().log10().floor() as i32;
    (SIGMA_DIGITS - 1 - leading).clamp(0, 12) as usize
}

/// `value` with the decimals that show `sigma` with three significant digits.
pub fn rounded(value: f64, sigma: f64) -> String {
    fixed(value, decimals(sigma))
}

/// `value` with this number of decimals, or in scientific notation if it is huge.
pub fn fixed(value: f64, decimals: usize) -> String {
    if value.abs() < HUGE { format!("{value:.decimals$}") } else { format!("{value:.3e}") }
}

/// `value` with three significant digits.
pub fn significant(value: f64) -> String {
    rounded(value, value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::units::DEG;

    #[test]
    fn heading_errors_go_the_shorter_way() {
        let heading = |deg: f64| InstrumentErrors { heading: deg * DEG, ..Default::default() };
        assert!((errors(&heading(359.0), &heading(1.0))[HEADING] + 2.0).abs() < 1e-9);
        assert!((errors(&heading(-179.0), &heading(179.0))[HEADING] - 2.0).abs() < 1e-9);
        assert!((0.0..360.0).contains(&values(&heading(-1e-20))[HEADING]));
        assert!((values(&heading(-28.0))[HEADING] - 332.0).abs() < 1e-9);
    }

    #[test]
    fn digits_follow_the_sigma() {
        assert_eq!(rounded(-233.614_9, 0.3614), "-233.615");
        assert_eq!(rounded(-233.614_9, 36.14), "-233.6");
        assert_eq!(rounded(1.2, 0.0), "1");
        assert_eq!(significant(0.000_123_456), "0.000123");
        assert_eq!(significant(1234.5), "1234");
        assert_eq!((significant(999_999.0).as_str(), significant(-1.234_56e12).as_str()), ("999999", "-1.235e12"));
        assert_eq!(rounded(123_456_789_012.3, 0.1), "1.235e11");
    }
}
