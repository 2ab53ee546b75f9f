//! What the instrument tells while it runs. How it gets to whoever listens is `link`'s business.

use crate::base::loss::LossCounts;
use crate::base::restart::Restart;
use crate::estimator::Estimate;
use crate::estimator::{SegmentInnovations, Solution};
use crate::gimbal::Fault;
use crate::model::error_model::PARAMETERS;
use crate::run::abort::Abort;
use crate::run::config::ConfigError;
use crate::run::policy::Decision;
use crate::run::state::State;
use crate::segment::SegmentKind;
use crate::segment::intake::IntakeCounts;
use crate::verdict::Verdict;
use serde::{Deserialize, Serialize};

/// A finished segment and the live estimate after it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Segments so far.
    pub segments: u16,
    /// Stop or move.
    pub kind: SegmentKind,
    /// Time of the segment's end, us.
    pub end_us: u64,
    /// The live estimate.
    pub estimate: Estimate,
}

/// What the instrument tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// What the calibration store held at power-up.
    Store {
        /// A good record was found.
        found: bool,
        /// A slot is damaged, or holds a record of another version of the format.
        damaged: bool,
        /// The memory does not answer, or is too small.
        fault: bool,
    },
    /// What is done at power-up or on command, and why.
    Decided(Decision),
    /// The axes are brought to rest, and controlled no longer.
    Released,
    /// The configuration is refused.
    Refused(ConfigError),
    /// The run has entered a state.
    State {
        /// Time, us.
        time_us: u64,
        /// The state.
        state: State,
        /// Legs of the whole run.
        legs: u16,
    },
    /// A segment has ended.
    Segment(Progress),
    /// How far a segment is from what all others say.
    Innovations(SegmentInnovations),
    /// All segments are processed.
    Solved {
        /// The solution.
        solution: Solution,
        /// What became of the samples.
        counts: IntakeCounts,
    },
    /// One row of the covariance of the parameters, SI.
    Covariance {
        /// Parameter of the row.
        row: u8,
        /// The row.
        values: [f64; PARAMETERS],
    },
    /// The solution is judged.
    Judged(Verdict),
    /// The run was given up.
    Aborted(Abort),
    /// Storing has ended; whether it went well.
    Saved(bool),
    /// A corrected sample, once a second.
    Corrected {
        /// Time, us.
        time_us: u64,
        /// Specific force in the IMU frame, m/s^2.
        force_s: [f64; 3],
        /// Inertial angular rate of the IMU frame in the IMU frame, rad/s.
        omega_is_s: [f64; 3],
    },
    /// At the end: samples taken from the queue, and samples that never got there.
    Queue {
        /// Samples taken.
        samples: u64,
        /// Samples missing.
        losses: LossCounts,
    },
    /// Something is wrong with an axis, and both are stopped for it.
    Fault(Fault),
    /// At power-up: why the software has started.
    Restarted(Restart),
}

/// Tells a message, which is large, and built here: whoever tells it needs no room for it on the stack.
#[inline(never)]
pub fn tell(report: &mut impl FnMut(&Message), message: impl FnOnce() -> Message) {
    report(&message());
}
