//! The methods of calibration.

use serde::{Deserialize, Serialize};

/// How the parameters are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// All 28 parameters from stops and moves together.
    #[default]
    Joint,
    /// Bai's two stages: twelve parameters, accelerometers at the stops first, gyros in the moves after.
    TwoStage,
}

impl Method {
    /// Name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::TwoStage => "two-stage",
        }
    }
}
