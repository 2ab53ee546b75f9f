//! What is asked for of a plan.

use super::objective::Objective;
use crate::calibration::Setup;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::scheme::Turning;

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
