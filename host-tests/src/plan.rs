//! Finds rotation schemes: the stops, in which order and for how long, that make the parameters that matter as good as
//! they can be within a given time.
//!
//! - `information`: what a scheme will bring, from its geometry alone, in a twentieth of a millisecond
//! - `objective`: which parameters matter, and how they are weighed
//! - `search`: simulated annealing over the stops
//! - `bound`: what no scheme can go below

pub mod bound;
pub mod information;
pub mod objective;
pub mod search;

use crate::calibration::Setup;
use crate::prediction::duration_s;
use crate::virtual_run::SETTLING_S;
use information::Forecast;
use objective::Objective;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::{BASIC_STATES, FULL_STATES, MAX_SEGMENTS};
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme, Turning};
use rins_selfcal::segment::GUARD_S;
use search::{Problem, search};

/// Most legs of a scheme that the core can hold all segments of.
pub const MOST_LEGS: usize = if MAX_LEGS < (MAX_SEGMENTS - 1) / 2 { MAX_LEGS } else { (MAX_SEGMENTS - 1) / 2 };
/// Free angles are found to this, rad: nothing is lost, and the file is good to read.
const FREE_ANGLE_RAD: f64 = 0.1 * DEG;
/// Three blocks of 0.1 s, of which the verdict takes the scatter, and a part of one.
const LEAST_USABLE_S: f64 = 0.4;

/// Angles that an axis may stand at, rad, counted over whole turns; zero is one of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Travel {
    /// Lowest.
    pub lowest_rad: f64,
    /// Highest.
    pub highest_rad: f64,
}

impl Default for Travel {
    /// The core's usual axis.
    fn default() -> Self {
        let AxisLimits { lowest_rad, highest_rad, .. } = AxisLimits::default();
        Self { lowest_rad, highest_rad }
    }
}

/// What is asked for.
#[derive(Clone, Debug)]
pub struct PlanRequest {
    /// The unit and what is estimated.
    pub setup: Setup,
    /// Time for everything, first stop, ramps and settling included, s.
    pub time_s: f64,
    /// How the axes turn.
    pub turning: Turning,
    /// Time after a move that the accelerometers need to settle, s; the core waits 0.3 s in any case.
    pub settling_s: f64,
    /// Travel of the outer and the inner axis.
    pub travel: [Travel; 2],
    /// Stops are at multiples of this, rad; `None`: at any angle.
    pub angle_step_rad: Option<f64>,
    /// What shall be small.
    pub objective: Objective,
    /// Schemes to be looked at.
    pub evaluations: u64,
    /// Of everything random.
    pub seed: u64,
}

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
    Ok(Planned { scheme, value, bound: bound::lower_bound(request) })
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
