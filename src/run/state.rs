//! The states of a run.

use core::fmt;
use serde::{Deserialize, Serialize};

/// The state of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Nothing is decided yet.
    PowerUp,
    /// Waiting until base and axes are at rest.
    AwaitStill,
    /// Turning to the stop of this leg.
    Turn(u16),
    /// Waiting until servo and structure have settled, before the stop of this leg.
    Settle(u16),
    /// At rest at the stop of this leg, measuring.
    Dwell(u16),
    /// Checking whether the segments so far are sufficient, after the stop of this leg.
    Weigh(u16),
    /// All segments are being processed, one piece at a time.
    Compute,
    /// The result is being judged.
    Verdict,
    /// The accepted calibration is being stored.
    Store,
    /// Samples are being corrected.
    Correcting,
    /// There is no calibration, and a run begins on command only.
    StandBy,
    /// Bringing the axes to rest after a run, and waiting until the base is at rest too.
    Stopping,
    /// Turning back to (0, 0).
    Parking,
    /// At rest at (0, 0). This run gave no calibration.
    Parked,
    /// At rest where the axes stopped and no longer controlled, because an axis cannot be trusted.
    Stranded,
    /// Held at rest where the axes stopped, because a command stopped them, or because nothing may turn now.
    Stopped,
}

impl State {
    /// The leg of the run, if the run is at a leg.
    pub fn leg(self) -> Option<u16> {
        match self {
            Self::Turn(leg) | Self::Settle(leg) | Self::Dwell(leg) | Self::Weigh(leg) => Some(leg),
            _ => None,
        }
    }

    /// Whether no run is under way and a command may start a run.
    pub fn is_idle(self) -> bool {
        matches!(self, Self::Correcting | Self::StandBy | Self::Parked | Self::Stranded | Self::Stopped)
    }

    /// Whether a run is under way. It ends when the axes come to rest.
    pub fn is_under_way(self) -> bool {
        matches!(
            self,
            Self::AwaitStill
                | Self::Turn(_)
                | Self::Settle(_)
                | Self::Dwell(_)
                | Self::Weigh(_)
                | Self::Compute
                | Self::Verdict
        )
    }

    /// Whether the axes are turning or coming to rest. Samples lost during a move cannot be measured again.
    pub fn is_turning(self) -> bool {
        matches!(self, Self::Turn(_) | Self::Settle(_) | Self::Stopping | Self::Parking)
    }
}

/// What the instrument does, in words.
impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PowerUp => "powering up",
            Self::AwaitStill => "waiting until base and axes are at rest",
            Self::Turn(_) => "turning",
            Self::Settle(_) => "settling",
            Self::Dwell(_) => "measuring",
            Self::Weigh(_) => "checking the stop",
            Self::Compute => "computing",
            Self::Verdict => "judging",
            Self::Store => "storing",
            Self::Correcting => "correcting samples",
            Self::StandBy => "standing by without a calibration",
            Self::Stopping => "bringing the axes to rest",
            Self::Parking => "returning to (0, 0)",
            Self::Parked => "parked",
            Self::Stranded => "stranded: the axes are released, because an axis cannot be trusted",
            Self::Stopped => "stopped: the axes are held where they are",
        })?;
        self.leg().map_or(Ok(()), |leg| write!(f, ", leg {leg}"))
    }
}
