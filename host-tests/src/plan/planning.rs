//! Planning: from a request to a scheme.

use super::bound::lower_bound;
use super::forecast::Forecast;
use super::prediction::duration_s;
use super::request::PlanRequest;
use super::search::{Problem, search};
use crate::calibration::virtual_run::SETTLING_S;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme};
use rins_selfcal::segment::GUARD_S;

/// Largest number of legs with which the core can hold all segments of a scheme.
pub const MOST_LEGS: usize = if MAX_LEGS < (MAX_SEGMENTS - 1) / 2 { MAX_LEGS } else { (MAX_SEGMENTS - 1) / 2 };
/// Step of free angles, rad. It is fine enough for the sigmas, and the angles in the file are short.
const FREE_ANGLE_RAD: f64 = 0.1 * DEG;
/// Shortest usable time of a stop: three blocks of 0.1 s, whose scatter the verdict needs, and a part of a block.
const LEAST_USABLE_S: f64 = 0.4;

/// Result of a search.
#[derive(Clone, Debug)]
pub struct Planned {
    /// The scheme.
    pub scheme: Scheme,
    /// Predicted value of the objective.
    pub value: f64,
    /// Lower bound of the objective for any scheme; `None` if the objective has no bound.
    pub bound: Option<f64>,
}

/// Reasons why no scheme is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// No scheme fits the time.
    #[error("no scheme was found that fits this time; give more time, travel or rate")]
    TooShort,
    /// The name is too long.
    #[error("the name of a scheme may have at most 32 bytes")]
    Name,
    /// The other methods have no forecast.
    #[error("schemes can be planned for the joint method only")]
    Method,
}

/// Finds a scheme. The same request gives the same scheme on any machine with any number of cores. `progress` receives
/// the number of schemes that were evaluated since its last call, and the best value of one chain.
///
/// # Errors
/// The reason why no scheme is found.
pub fn plan(request: &PlanRequest, name: &str, progress: &(impl Fn(u64, f64) + Sync)) -> Result<Planned, PlanError> {
    let name = name.try_into().map_err(|_| PlanError::Name)?;
    if request.setup.method != Method::Joint {
        return Err(PlanError::Method);
    }
    let stands = found(request, progress);
    let (value, stands) = stands.ok_or(PlanError::TooShort)?;
    let scheme = Scheme {
        name,
        rate_rad_s: request.turning.rate_rad_s,
        acceleration_rad_s2: request.turning.acceleration_rad_s2,
        first_stop_s: stands[0].stop_s,
        legs: stands.iter().skip(1).copied().collect(),
        periods: 1,
    };
    debug_assert!(duration_s(&request.setup, &scheme) <= request.time_s + 1e-9);
    Ok(Planned { scheme, value, bound: lower_bound(request) })
}

/// The best stops, and their value. `None` if no scheme fits the time.
pub(super) fn found(request: &PlanRequest, progress: &(impl Fn(u64, f64) + Sync)) -> Option<(f64, Vec<Leg>)> {
    let problem = Problem {
        forecast: Forecast::new(&request.setup, request.turning, request.settling_s),
        objective: &request.objective,
        time_s: request.time_s,
        sample_s: request.setup.rate_hz.recip(),
        travel: request.travel,
        step_rad: request.angle_step_rad.unwrap_or(FREE_ANGLE_RAD),
        least_stop_s: request.settling_s.max(GUARD_S) + GUARD_S + LEAST_USABLE_S - SETTLING_S,
        most_legs: MOST_LEGS,
    };
    search(&problem, request.evaluations, request.seed, progress)
}
