//! A plan: what is tried, and what comes of it.

use super::bound::lower_bound;
use super::information::Forecast;
use super::prediction::duration_s;
use super::request::PlanRequest;
use super::search::{Problem, search};
use crate::calibration::virtual_run::SETTLING_S;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::{BASIC_STATES, FULL_STATES, MAX_SEGMENTS};
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme};
use rins_selfcal::segment::GUARD_S;

/// Most legs of a scheme that the core can hold all segments of.
pub const MOST_LEGS: usize = if MAX_LEGS < (MAX_SEGMENTS - 1) / 2 { MAX_LEGS } else { (MAX_SEGMENTS - 1) / 2 };
/// Free angles are found to this, rad: nothing is lost, and the file is good to read.
const FREE_ANGLE_RAD: f64 = 0.1 * DEG;
/// Three blocks of 0.1 s, of which the verdict takes the scatter, and a part of one.
const LEAST_USABLE_S: f64 = 0.4;

/// What was found.
#[derive(Clone, Debug)]
pub struct Planned {
    /// The scheme.
    pub scheme: Scheme,
    /// Its value by the objective, as forecast.
    pub value: f64,
    /// What no scheme can go below; `None` for an objective without one.
    pub bound: Option<f64>,
}

/// Why there is no plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// Nothing fits.
    #[error("in this time no scheme was found that fits; give it more time, travel or rate")]
    TooShort,
    /// The name does not fit.
    #[error("the name of a scheme has up to 32 bytes")]
    Name,
    /// Bai's method has no forecast.
    #[error("schemes are planned for the joint method")]
    TwoStage,
}

/// Finds a scheme. The same request gives the same scheme on any machine, whatever its cores. `progress` is told the number
/// of schemes looked at since it was told last, and the best value of one chain.
///
/// # Errors
/// Why there is none.
pub fn plan(request: &PlanRequest, name: &str, progress: &(impl Fn(u64, f64) + Sync)) -> Result<Planned, PlanError> {
    let name = name.try_into().map_err(|_| PlanError::Name)?;
    if request.setup.method == Method::TwoStage {
        return Err(PlanError::TwoStage);
    }
    let stands = if request.setup.options.needs_states() {
        found::<FULL_STATES>(request, progress)
    } else {
        found::<BASIC_STATES>(request, progress)
    };
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

fn found<const STATES: usize>(request: &PlanRequest, progress: &(impl Fn(u64, f64) + Sync)) -> Option<(f64, Vec<Leg>)> {
    let problem = Problem {
        forecast: Forecast::<STATES>::new(&request.setup, request.turning, request.settling_s),
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
