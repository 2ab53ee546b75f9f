//! The states of a run.

use serde::{Deserialize, Serialize};

/// Where the run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// Nothing decided yet.
    PowerUp,
    /// Waiting until base and axes are still.
    AwaitStill,
    /// Turning to the stop of a leg.
    Turn(u16),
    /// Letting servo and structure come to rest.
    Settle(u16),
    /// Standing, measuring.
    Dwell(u16),
    /// Looking whether what has been measured is enough.
    Weigh(u16),
    /// All segments are being processed, piece by piece.
    Compute,
    /// The result is being judged.
    Verdict,
    /// The accepted calibration is being stored.
    Store,
    /// Samples are being corrected.
    Correcting,
    /// There is no calibration, and no run without a command.
    StandBy,
    /// Bringing the axes to rest after a run that was aborted or rejected.
    Stopping,
    /// Turning back to (0, 0).
    Parking,
    /// Standing at (0, 0), not calibrated by this run.
    Parked,
    /// Standing wherever the axes came to rest, since parking failed.
    Stranded,
}

impl State {
    /// Whether no run is under way, and a command may start one.
    pub fn is_idle(self) -> bool {
        matches!(self, Self::Correcting | Self::StandBy | Self::Parked | Self::Stranded)
    }

    /// Whether a run is under way that a command may give up.
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

    /// Whether the axes are on their way, or coming to rest: what is lost of a move cannot be repeated.
    pub fn is_turning(self) -> bool {
        matches!(self, Self::Turn(_) | Self::Settle(_) | Self::Stopping | Self::Parking)
    }
}
