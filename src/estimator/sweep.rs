//! Progress of the final pass: the sweep over the segments, the phase of the pass, and the steps of the heading.

use crate::base::linear::{Real, Vector, real};
use crate::model::error_model::PARAMETERS;

/// Progress of one sweep of the filter over the stored segments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    /// Number of the next segment.
    pub(super) next: usize,
    /// Number of moves before the next segment.
    pub(super) moves: u16,
    /// Number of moves in period one, for the paper's method.
    pub(super) period_moves: Option<u16>,
}

/// Phase of the final pass.
#[derive(Clone, Copy, Debug)]
pub(super) enum Pass<T: Real> {
    /// The pass has not begun, or the pass is done.
    Idle,
    /// Sweeps until the estimate has converged. `made` is the number of sweeps so far, and `before` is the estimate
    /// before the present sweep.
    Iterating { sweep: Sweep, made: u8, before: Vector<T, PARAMETERS>, heading: HeadingSteps<T> },
    /// Sweeps that linearize all segments about the live estimate. `made` is the number of sweeps so far, and `before`
    /// is the estimate before the present sweep.
    Refreshing { sweep: Sweep, made: u8, before: Vector<T, PARAMETERS> },
    /// The last sweep, about the solution. Its innovations are reported, and its covariance is that of the solution.
    Closing { sweep: Sweep },
    /// Sweeps about the solution that test for changes with the onset at segment `onset`. `part` is the number of the
    /// sweep for this onset.
    Testing { sweep: Sweep, onset: usize, part: usize },
}

/// Smallest fraction of a step of the heading that is taken.
const LEAST_PART: f64 = 0.1;

/// Longest step of the heading, rad. Over a longer step the model is not linear.
const LONGEST_STEP_RAD: f64 = 1.0;

/// Steps of the heading from sweep to sweep.
///
/// The gyros show the direction of a step by the horizontal Earth rate that they measure, and the step's size is
/// divided by the true horizontal Earth rate. Near the poles, noise can make the measured rate more than twice as
/// large as the true one. Then Gauss-Newton steps are too long and never converge. So steps of alternating sign are
/// shortened: two successive steps determine by how much (Aitken's extrapolation).
#[derive(Clone, Copy, Debug)]
pub(super) struct HeadingSteps<T: Real> {
    /// The last step, before it was shortened, rad.
    last: T,
    /// Fraction of the last step that was taken.
    part: T,
}

impl<T: Real> HeadingSteps<T> {
    /// No step yet.
    pub(super) const NONE: Self = Self { last: T::ZERO, part: T::ZERO };

    /// Fraction of this step to be taken.
    pub(super) fn next(&mut self, step: T) -> T {
        let swings = step * self.last < T::zero();
        let rest = T::one() - step / self.last;
        let extrapolates = self.part > T::zero() && (swings || self.part < T::one()) && rest > self.part;
        let part = if extrapolates { (self.part / rest).max(real(LEAST_PART)) } else { T::one() };
        (self.part, self.last) = (part.min(real::<T>(LONGEST_STEP_RAD) / step.abs()), step);
        self.part
    }
}
