//! Why a run was given up, and where.

use super::state::State;
use crate::gimbal::Fault;
use core::fmt;
use serde::{Deserialize, Serialize};

/// The reason why a run was given up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AbortReason {
    /// The operator or the navigation software gave the command to abort.
    Commanded,
    /// Base and axes were not at rest for a second within a minute of the start of the run.
    NotStill,
    /// A move did not end within its permitted time.
    TurnTimeout,
    /// An axis has a fault, and both axes were stopped.
    Gimbal(Fault),
    /// Samples were missing or unusable for too long.
    SampleLoss,
    /// The operator or the navigation software gave the command to stop all motion.
    Stopped,
    /// The samples come at another rate than the configured one.
    SampleRate,
    /// The memory did not take the mark that the axes move, so they must not move.
    NotMarked,
    /// The IMU has restarted in the run.
    ImuRestarted,
}

impl AbortReason {
    /// Short name of the reason. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Commanded => "commanded",
            Self::Stopped => "stopped",
            Self::NotStill => "not-still",
            Self::TurnTimeout => "turn-timeout",
            Self::Gimbal(fault) => fault.kind.code(),
            Self::SampleLoss => "sample-loss",
            Self::SampleRate => "sample-rate",
            Self::NotMarked => "not-marked",
            Self::ImuRestarted => "imu-restarted",
        }
    }

    /// Whether the reason is a fault and not a command.
    pub(super) fn is_fault(self) -> bool {
        !matches!(self, Self::Commanded | Self::Stopped)
    }

    /// Whether the axes may still be turned.
    pub(super) fn allows_parking(self) -> bool {
        if let Self::Gimbal(fault) = self { fault.allows_parking() } else { true }
    }
}

/// A run that was given up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Abort {
    /// The reason.
    pub reason: AbortReason,
    /// The state of the run when it was given up.
    pub during: State,
}

/// The [code](AbortReason::code) in brackets, then the text in one line.
impl fmt::Display for AbortReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Self::Commanded => "the run was aborted by a command",
            Self::Stopped => "all motion was stopped by a command",
            Self::NotStill => "base and axes were not at rest for 1 s within 60 s of the start of the run",
            Self::TurnTimeout => "the axes did not arrive within 10 s after the planned end of the move",
            Self::Gimbal(fault) => return fault.fmt(f),
            Self::SampleLoss => "no usable sample arrived for 1 s, or for 0.1 s during a move",
            Self::ImuRestarted => "the IMU has restarted in the run: its supply or its settings were lost",
            Self::NotMarked => {
                "the memory did not take the mark that the axes move, so that the turn would be unknown after a loss of \
                 power"
            }
            Self::SampleRate => {
                "the samples come at another rate than the configured one: the IMU has restarted, or its settings are \
                 wrong"
            }
        };
        write!(f, "[{}] {text}", self.code())
    }
}

/// Segments are counted as in a result: the first stop is 0, the move of leg 1 is 1.
impl fmt::Display for Abort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.during {
            State::AwaitStill => write!(f, "before the first move: ")?,
            State::Turn(0) => write!(f, "on the way to the start angles: ")?,
            State::Turn(leg) => write!(f, "segment {}, move of leg {leg}: ", 2 * leg - 1)?,
            State::Settle(0) | State::Dwell(0) | State::Weigh(0) => write!(f, "segment 0, first stop: ")?,
            State::Settle(leg) | State::Dwell(leg) | State::Weigh(leg) => {
                write!(f, "segment {}, stop of leg {leg}: ", 2 * leg)?;
            }
            State::Compute | State::Verdict => write!(f, "after all measurements, during the solution: ")?,
            _ => {}
        }
        self.reason.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::DEG;
    use crate::gimbal::FaultKind;
    use std::format;

    #[test]
    fn a_text_names_segment_axis_angle_and_number() {
        let kind = FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: (20.0 * DEG) as f32 };
        let stalled = AbortReason::Gimbal(Fault { axis: 1, angle_rad: (-37.25 * DEG) as f32, kind });
        let commanded = |during: &str| format!("{during}[commanded] the run was aborted by a command");
        let cases = [
            (
                State::Turn(3),
                stalled,
                format!("segment 5, move of leg 3: {stalled}"),
            ),
            (
                State::Turn(0),
                AbortReason::TurnTimeout,
                "on the way to the start angles: [turn-timeout] the axes did not arrive within 10 s after the planned end of \
                 the move"
                    .into(),
            ),
            (State::Dwell(0), AbortReason::Commanded, commanded("segment 0, first stop: ")),
            (State::Settle(18), AbortReason::Commanded, commanded("segment 36, stop of leg 18: ")),
            (State::Compute, AbortReason::Commanded, commanded("after all measurements, during the solution: ")),
            (State::PowerUp, AbortReason::Commanded, commanded("")),
        ];
        for (during, reason, text) in cases {
            assert_eq!(Abort { reason, during }.to_string(), text);
        }
        assert!(stalled.to_string().starts_with("[stall] inner axis at -37.25 deg: "), "{stalled}");
    }
}
