//! How a command ends.

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Done, or the calibration is accepted: status 0.
    Done,
    /// The calibration is not accepted, or two results differ: status 2.
    NotAccepted,
}
