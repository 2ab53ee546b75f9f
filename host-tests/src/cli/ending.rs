//! How a command ends.

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The command is done, or the calibration is accepted: exit status 0.
    Done,
    /// The calibration is not accepted, or two results differ: exit status 2.
    NotAccepted,
}
