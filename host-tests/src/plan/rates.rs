//! The rate of the axes: what the best scheme reaches at each of several rates. A fast move leaves more time for the
//! stops; a slow one needs less motor, and effects that grow with the rate are smaller. Zhang et al. (Optimal Rotational
//! Angular Velocity Determination Method, Sensors 2022) ask for the rate of Bai's instrument.

use super::planning::{PlanError, Planned, found, plan};
use super::request::PlanRequest;
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::Turning;
use serde::Serialize;

/// Number of rates of a sweep, with those at both ends.
pub const RATES: u32 = 9;

/// What the best scheme reaches at one rate of the axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AtRate {
    /// Rate of the axes, deg/s.
    pub rate_deg_s: f64,
    /// Predicted value of the objective; `None` if no scheme fits the time.
    pub value: Option<f64>,
}

/// Plans at [`RATES`] rates from the lowest to the highest, rad/s, each the same factor above the one before, with an equal
/// part of the evaluations. Then plans at the best of them with all evaluations.
///
/// # Errors
/// No scheme is found at any rate.
pub fn plan_over_rates(
    request: &PlanRequest,
    [lowest_rad_s, highest_rad_s]: [f64; 2],
    name: &str,
    progress: &(impl Fn(u64, f64) + Sync),
) -> Result<(Planned, Vec<AtRate>), PlanError> {
    let factor = (highest_rad_s / lowest_rad_s).powf(f64::from(RATES - 1).recip());
    let at = |rate_rad_s: f64, evaluations: u64| {
        let turning = Turning { rate_rad_s, ..request.turning };
        PlanRequest { turning, evaluations, ..request.clone() }
    };
    let mut best: Option<(f64, f64)> = None;
    let mut rates = Vec::new();
    for number in 0..RATES {
        let rate_rad_s = lowest_rad_s * factor.powi(number.cast_signed());
        let value = found(&at(rate_rad_s, request.evaluations / u64::from(RATES)), progress).map(|(value, _)| value);
        if let Some(value) = value
            && best.is_none_or(|(least, _)| value < least)
        {
            best = Some((value, rate_rad_s));
        }
        rates.push(AtRate { rate_deg_s: rate_rad_s / DEG, value });
    }
    let (_, rate_rad_s) = best.ok_or(PlanError::TooShort)?;
    Ok((plan(&at(rate_rad_s, request.evaluations), name, progress)?, rates))
}
