//! The two-stage method of the paper (Bai et al., Sensors 2019, 19, 4005, section 3): its differences from the joint
//! method.
//!
//! - Stage 1 uses (B11) at the stops of period one. Bai takes differences to the first stop, z1 = f_a0 - R^T f_a. The
//!   differences remove the specific force of the base, and the error of the first stop becomes common to all
//!   differences. Here the specific force of the base is a state instead: roll, pitch, and a scale common to the three
//!   accelerometers. The estimate is the same, and the covariance is right.
//! - The heading comes from gyrocompassing at the first stop, or from the configuration.
//! - Stage 2 uses (B13) in the moves of period two, integrated over each move. The mounting angles and the levelled
//!   attitude of stage 1 are only considered: their values do not change, but their uncertainty counts.
//! - With one period only, both measurements are taken from this period in one sweep. Then no state is only considered,
//!   because the same encoder errors act on both stages.
//!
//! # Gains of stage 1
//! The gains for (B11) are those of Bai. They assume noise that is the same in all directions. The true noise of (B11)
//! is the white noise of the accelerometers and the effect of the encoder errors. The encoder errors act in some
//! directions only: a stop is nearly free of them along gravity, and along an axis that is not turned. The optimal
//! gain would use those directions alone. It would give the errors that this method takes as zero, such as biases,
//! hundreds of times the weight of the noise. The result would be wrong by 130" with the errors of a real unit. A gain
//! for noise of gravity times the encoder error in every direction costs little accuracy and avoids this error.
//!
//! A filter with the states of (B11) gives these gains. Its covariance is not used. The covariance of the estimate
//! under the true noise follows from the gains.

use super::configuration::{ACCEL_SCALE, BEFORE_PARAMETERS, COMMON_SCALE_SIGMA, STATES};
use super::filter::{Measurement, UdFilter, entries_above_diagonal};
use crate::base::angle::ticks_to_rad;
use crate::base::linear::{Real, Vector, real};
use crate::base::units::DEG;
use crate::model::error_model::block;
use crate::segment::{Segment, SegmentKind};
use core::ops::Range;

/// The measurements of a segment that are used, and the states that are only considered.
#[derive(Clone, Copy)]
pub(super) struct Use {
    /// Use the mean force of a stop.
    pub(super) force: bool,
    /// Use the rotation of a stop or a move.
    pub(super) rotation: bool,
    /// Only consider the states of stage 1.
    pub(super) considered: bool,
}

impl Use {
    /// Measurements that the two-stage method uses of a segment after `moves_before` moves. `period_moves` is `None` if
    /// there is only one period. `gyrocompass` says that the segment is the first stop and its gyros give the heading.
    pub(super) fn in_two_stages(
        is_stop: bool,
        moves_before: u16,
        period_moves: Option<u16>,
        gyrocompass: bool,
    ) -> Self {
        match period_moves {
            None => Self { force: is_stop, rotation: !is_stop || gyrocompass, considered: false },
            Some(period) if moves_before < period || (is_stop && moves_before == period) => {
                Self { force: is_stop, rotation: gyrocompass, considered: false }
            }
            Some(_) => Self { force: false, rotation: !is_stop, considered: true },
        }
    }
}

/// The states of stage 1 that stage 2 only considers. The heading is not one of them, because the gyros give the
/// heading.
pub(super) const STAGE_ONE: Range<usize> =
    BEFORE_PARAMETERS + block::ACCEL_NON_ORTHOGONALITY..BEFORE_PARAMETERS + block::HEADING;

/// Direction of the scale error common to the three accelerometers, times its prior sigma. This scale error represents
/// the unknown magnitude of the specific force, which (B11) does not use.
pub(super) fn common_accel_scale<T: Real>() -> Vector<T, STATES> {
    Vector::from_fn(|state, _| if ACCEL_SCALE.contains(&state) { real(COMMON_SCALE_SIGMA) } else { T::zero() })
}

/// Number of moves in period one, if the angles of the stops repeat exactly once. `None` if they do not repeat.
pub(super) fn find_period<T: Real>(segments: &[Segment<T>]) -> Option<u16> {
    const SAME_RAD: f64 = DEG;
    let stops = || segments.iter().filter(|segment| segment.kind() == SegmentKind::Stop);
    let moves = stops().count().checked_sub(1)?;
    let half = moves / 2;
    let near = |a: &Segment<T>, b: &Segment<T>| {
        let apart = |ticks: i32| ticks_to_rad::<f64>(ticks.into()).abs();
        apart(a.outer.since(b.outer)) < SAME_RAD && apart(a.inner.since(b.inner)) < SAME_RAD
    };
    let repeats = moves > 0 && moves % 2 == 0 && stops().zip(stops().skip(half)).all(|(a, b)| near(a, b));
    repeats.then_some(half as u16)
}

/// Number of states that (B11) depends on.
const STATES_SEEN: usize = 9;

const fn states(first: usize, count: usize) -> Range<usize> {
    BEFORE_PARAMETERS + first..BEFORE_PARAMETERS + first + count
}

/// Indices of these states among all states. The scale errors of the three accelerometers are one state.
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

/// Filter that computes the gains of stage 1.
#[derive(Clone, Debug)]
pub(super) struct StageOneGains<T: Real>(UdFilter<T, STATES_SEEN, { entries_above_diagonal(STATES_SEEN) }>);

impl<T: Real> StageOneGains<T> {
    /// A filter without a prior. It must be restarted before use.
    pub(super) const NONE: Self = Self(UdFilter::CERTAIN);

    /// Restarts the filter with these sigmas of all states.
    pub(super) fn restart(&mut self, sigmas: &Vector<T, STATES>) {
        let mut seen = SEEN.iter().map(|range| sigmas.iter().nth(range.start).copied().unwrap_or(T::zero()));
        let sigmas = Vector::from_fn(|_, _| seen.next().unwrap_or(T::zero()));
        self.0.restart(&sigmas, STATES_SEEN, None);
    }

    /// Gain of a measurement with row `h` and noise variance `r`. The noise is the same in all directions.
    // Not inlined, so that the joint method does not need its stack.
    #[inline(never)]
    pub(super) fn gain(&mut self, h: &Vector<T, STATES>, r: T) -> Vector<T, STATES> {
        let mut rows =
            SEEN.iter().map(|range| h.iter().take(range.end).skip(range.start).fold(T::zero(), |sum, h| sum + *h));
        let h = Vector::from_fn(|_, _| rows.next().unwrap_or(T::zero()));
        let (_, gain) = self.0.update(&Measurement { z: T::zero(), h, r });
        let mut chosen = Vector::<T, STATES>::zeros();
        for (range, gain) in SEEN.iter().zip(gain.iter()) {
            chosen.iter_mut().take(range.end).skip(range.start).for_each(|chosen| *chosen = *gain);
        }
        chosen
    }
}
