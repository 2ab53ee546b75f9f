//! The messages that the instrument reports while it runs. The room `link` sends them.

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
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Progress {
    /// Number of segments so far.
    pub segments: u16,
    /// Stop or move.
    pub kind: SegmentKind,
    /// Time of the segment's end, us.
    pub end_us: u64,
    /// The live estimate.
    pub estimate: Estimate,
}

/// A message of the instrument.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Message {
    /// What the calibration store held at power-up.
    Store {
        /// An intact record was found.
        found: bool,
        /// A slot is damaged. An intact record of another version of the format is no damage.
        damaged: bool,
        /// The memory does not answer, or is too small.
        fault: bool,
        /// The highest version of the format, a character, among the records that are intact and that this software
        /// cannot read.
        other_version: Option<u8>,
    },
    /// The decision at power-up or on command, and its reason.
    Decided(Decision),
    /// The axes are brought to rest and then no longer controlled.
    Released,
    /// The configuration was refused.
    Refused(ConfigError),
    /// The run has entered a state.
    State {
        /// Time of the sample, us.
        time_us: u64,
        /// The state entered.
        state: State,
        /// Number of legs of the whole run.
        legs: u16,
    },
    /// A segment has ended.
    Segment(Progress),
    /// The innovations of a segment: its measurements minus what all other segments predict.
    Innovations(SegmentInnovations),
    /// All segments are processed.
    Solved {
        /// The solution.
        solution: Solution,
        /// The counts of admitted and refused samples.
        counts: IntakeCounts,
    },
    /// One row of the covariance of the parameters, SI.
    Covariance {
        /// Index of the row's parameter.
        row: u8,
        /// The row.
        values: [f64; PARAMETERS],
    },
    /// The solution was judged.
    Judged(Verdict),
    /// The run was given up.
    Aborted(Abort),
    /// Storing has ended; `true` if it succeeded.
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
    /// Sent at the end of a recording: the samples taken from the queue, and the samples that did not reach it.
    Queue {
        /// Samples taken.
        samples: u64,
        /// Samples missing.
        losses: LossCounts,
    },
    /// An axis has a fault, and both axes are stopped.
    Fault(Fault),
    /// Sent at power-up: why the software has started.
    Restarted(Restart),
}

/// Reports a message. Messages are large; this function builds the message, so that its caller needs no stack for it.
#[inline(never)]
pub fn tell(report: &mut impl FnMut(&Message), message: impl FnOnce() -> Message) {
    report(&message());
}
