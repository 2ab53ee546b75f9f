//! How far the final pass has come: one sweep over the segments, the passes made of sweeps, and the steps of the
//! heading.

use crate::base::linear::{Real, Vector, real};
use crate::model::error_model::PARAMETERS;

/// One run of the filter over the stored segments, as far as it has come.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    /// The segment that is next.
    pub(super) next: usize,
    /// Moves before it.
    pub(super) moves: u16,
    /// Moves of period one, for the two-stage method.
    pub(super) period_moves: Option<u16>,
}

/// Where the final pass is.
#[derive(Clone, Copy, Debug)]
pub(super) enum Pass<T: Real> {
    /// Not begun, or done.
    Idle,
    /// Sweeping until the estimate has converged: `made` sweeps so far, the estimate before the present sweep, and the
    /// steps of the heading.
    Iterating { sweep: Sweep, made: u8, before: Vector<T, PARAMETERS>, heading: HeadingSteps<T> },
    /// One sweep that leaves the live estimate better linearized.
    Refreshing { sweep: Sweep },
    /// The last sweep, about the solution: its innovations are reported, and the covariance is that of the solution.
    Closing { sweep: Sweep },
    /// Testing for changes that begin with segment `onset`, in several sweeps, about the solution.
    Testing { sweep: Sweep, onset: usize, part: usize },
}

/// Least part of a step of the heading that is taken, and the longest step: beyond, nothing is linear.
const LEAST_PART: f64 = 0.1;

const LONGEST_STEP_RAD: f64 = 1.0;

/// Steps of the heading from sweep to sweep.
///
/// The gyros show the direction of a step by the horizontal Earth rate that they measure, and the step's size is
/// divided by the true horizontal Earth rate. Near the poles, noise can make the measured rate more than twice as
/// large as the true one. Then Gauss-Newton steps are too long and never converge. So steps of alternating sign are
/// shortened: two successive steps determine by how much (Aitken's extrapolation).
#[derive(Clone, Copy, Debug)]
pub(super) struct HeadingSteps<T: Real> {
    /// The last one, before it was cut.
    last: T,
    /// Part of it that was taken.
    part: T,
}

impl<T: Real> HeadingSteps<T> {
    /// No step yet.
    pub(super) const NONE: Self = Self { last: T::ZERO, part: T::ZERO };

    /// The part of the next step that is to be taken.
    pub(super) fn next(&mut self, step: T) -> T {
        let swings = step * self.last < T::zero();
        let rest = T::one() - step / self.last;
        let extrapolates = self.part > T::zero() && (swings || self.part < T::one()) && rest > self.part;
        let part = if extrapolates { (self.part / rest).max(real(LEAST_PART)) } else { T::one() };
        (self.part, self.last) = (part.min(real::<T>(LONGEST_STEP_RAD) / step.abs()), step);
        self.part
    }
}
