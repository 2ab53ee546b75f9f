//! The request for a plan.

use super::objective::Objective;
use crate::calibration::Setup;
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::Turning;

/// Range of angles of an axis, rad, continuous over whole turns. The range contains zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Travel {
    /// Lowest angle, rad.
    pub lowest_rad: f64,
    /// Highest angle, rad.
    pub highest_rad: f64,
}

impl Default for Travel {
    /// Two turns in either direction. No scheme gains by more.
    fn default() -> Self {
        Self { lowest_rad: -720.0 * DEG, highest_rad: 720.0 * DEG }
    }
}

/// Request for a plan.
#[derive(Clone, Debug)]
pub struct PlanRequest {
    /// The unit, the method and its options.
    pub setup: Setup,
    /// Duration of the scheme including first stop, ramps and settling, s.
    pub time_s: f64,
    /// Rate and acceleration of the axes.
    pub turning: Turning,
    /// Settling time of the accelerometers after a move, s; the core always waits at least 0.3 s.
    pub settling_s: f64,
    /// Travel of the outer and the inner axis.
    pub travel: [Travel; 2],
    /// Stops are at multiples of this angle, rad; `None` allows any angle.
    pub angle_step_rad: Option<f64>,
    /// What is minimized.
    pub objective: Objective,
    /// Number of schemes to evaluate.
    pub evaluations: u64,
    /// Seed of all random numbers.
    pub seed: u64,
}
