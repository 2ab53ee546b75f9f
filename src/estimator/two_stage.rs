//! Weights of the two-stage method for (11), in Bai's way: noise that is the same in all directions.
//!
//! The noise of (11) is that of the accelerometers, which is white, and what the encoders' errors do, which has
//! directions: along gravity, and along an axis that is not turned, a stop is nearly free of it. The optimal gain rests on
//! those directions alone, and gives what this method takes as zero, such as biases, hundreds of times the weight of the
//! noise: 130" from the errors of a real unit. A gain for noise of gravity times the encoders' error in every
//! direction costs little and does not.
//!
//! This filter, of the states that (11) sees, gives the gains. Its covariance is not used: that of the estimate, under the
//! noise there is, follows from the gains.

use crate::base::linear::{Real, Vector};
use crate::estimator::filter::{Measurement, UdFilter};
use crate::model::error_model::block;
use crate::model::measurement::ENCODER_ERRORS;
use core::ops::Range;

/// States that (11) sees.
const STATES_SEEN: usize = 9;

const fn states(first: usize, count: usize) -> Range<usize> {
    ENCODER_ERRORS + first..ENCODER_ERRORS + first + count
}

/// Where they are among all states. The accelerometers' scale errors are one.
const SEEN: [Range<usize>; STATES_SEEN] = [
    states(block::ACCEL_NON_ORTHOGONALITY, 1),
    states(block::ACCEL_NON_ORTHOGONALITY + 1, 1),
    states(block::ACCEL_NON_ORTHOGONALITY + 2, 1),
    states(block::MOUNTING, 1),
    states(block::MOUNTING + 1, 1),
    states(block::MOUNTING + 2, 1),
    states(block::ACCEL_SCALE, 3),
    states(block::ATTITUDE, 1),
    states(block::ATTITUDE + 1, 1),
];

/// Gives the gains of stage 1.
#[derive(Clone, Debug)]
pub struct Weights<T: Real>(UdFilter<T, STATES_SEEN>);

impl<T: Real> Weights<T> {
    /// Memory, to be restarted.
    pub const NONE: Self = Self(UdFilter::CERTAIN);

    /// Begins anew with these sigmas of all states.
    pub fn restart<const STATES: usize>(&mut self, sigmas: &Vector<T, STATES>) {
        let mut seen = SEEN.iter().map(|range| sigmas.iter().nth(range.start).copied().unwrap_or(T::zero()));
        self.0.restart(&Vector::from_fn(|_, _| seen.next().unwrap_or(T::zero())), None);
    }

    /// Gain of a measurement with this row, and noise that is the same in all directions.
    // Not inlined: the joint method does not need it on the stack.
    #[inline(never)]
    pub fn gain<const STATES: usize>(&mut self, h: &Vector<T, STATES>, r: T) -> Vector<T, STATES> {
        let mut rows =
            SEEN.iter().map(|range| h.iter().take(range.end).skip(range.start).fold(T::zero(), |sum, h| sum + *h));
        let h = Vector::from_fn(|_, _| rows.next().unwrap_or(T::zero()));
        let (_, gain) = self.0.update(&Measurement { z: T::zero(), h, r }, |_| ());
        let mut chosen = Vector::<T, STATES>::zeros();
        for (range, gain) in SEEN.iter().zip(gain.iter()) {
            chosen.iter_mut().take(range.end).skip(range.start).for_each(|chosen| *chosen = *gain);
        }
        chosen
    }
}
