//! The two ways to calibrate.

use serde::{Deserialize, Serialize};

/// Which measurements are used, for which parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// All 28 parameters at once, from stops and moves together.
    #[default]
    Joint,
    /// Bai's twelve: accelerometers at the stops of period one, then gyros in the moves of period two.
    TwoStage,
}
