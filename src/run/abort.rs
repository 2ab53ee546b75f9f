//! Why a run was given up, and where.

use super::state::State;
use crate::gimbal::Fault;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Why a run was given up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum AbortReason {
    /// The operator or the navigation software asked for it.
    Commanded,
    /// The base was not still for a second within a minute of the run's start.
    NotStill,
    /// A move did not end in time.
    TurnTimeout,
    /// Something is wrong with an axis, and both were stopped for it.
    Gimbal(Fault),
    /// Samples were missing or unusable for too long.
    SampleLoss,
}

impl AbortReason {
    /// Whether something failed, rather than somebody asked.
    pub(super) fn is_fault(self) -> bool {
        self != Self::Commanded
    }

    /// Whether the axes may be turned again after it.
    pub(super) fn allows_parking(self) -> bool {
        if let Self::Gimbal(fault) = self { fault.allows_parking() } else { true }
    }
}

/// A run that was given up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Abort {
    /// Why.
    pub reason: AbortReason,
    /// Where the run was.
    pub during: State,
}

impl fmt::Display for AbortReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Commanded => write!(f, "given up on command"),
            Self::NotStill => write!(f, "the base was not still for 1 s within 60 s of the start of the run"),
            Self::TurnTimeout => write!(f, "the axes did not arrive in time"),
            Self::Gimbal(fault) => write!(f, "{fault}"),
            Self::SampleLoss => write!(f, "no usable samples for 1 s, or for 0.1 s while the axes turned"),
        }
    }
}

/// Segments are counted as in a result: the first stop is 0, the move of leg 1 is 1.
impl fmt::Display for Abort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.during {
            State::AwaitStill => write!(f, "before anything moved: ")?,
            State::Turn(0) => write!(f, "on the way to the start: ")?,
            State::Turn(leg) => write!(f, "segment {}, move of leg {leg}: ", 2 * leg - 1)?,
            State::Settle(0) | State::Dwell(0) | State::Weigh(0) => write!(f, "segment 0, first stop: ")?,
            State::Settle(leg) | State::Dwell(leg) | State::Weigh(leg) => {
                write!(f, "segment {}, stop of leg {leg}: ", 2 * leg)?;
            }
            State::Compute | State::Verdict => write!(f, "all measured, solving: ")?,
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

    #[test]
    fn a_text_names_segment_axis_angle_and_number() {
        let kind = FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: (20.0 * DEG) as f32 };
        let stalled = AbortReason::Gimbal(Fault { axis: 1, angle_rad: (-37.25 * DEG) as f32, kind });
        let cases = [
            (
                State::Turn(3),
                stalled,
                "segment 5, move of leg 3: inner axis at -37.25 deg: stalled at 0.0 deg/s, commanded 20.0 deg/s",
            ),
            (State::Turn(0), AbortReason::TurnTimeout, "on the way to the start: the axes did not arrive in time"),
            (State::Dwell(0), AbortReason::Commanded, "segment 0, first stop: given up on command"),
            (State::Settle(18), AbortReason::Commanded, "segment 36, stop of leg 18: given up on command"),
            (State::Compute, AbortReason::Commanded, "all measured, solving: given up on command"),
            (State::PowerUp, AbortReason::Commanded, "given up on command"),
        ];
        for (during, reason, text) in cases {
            assert_eq!(Abort { reason, during }.to_string(), text);
        }
    }
}
