//! The two calibration methods.

use serde::{Deserialize, Serialize};

/// Calibration method: which measurements estimate which parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Method {
    /// Estimates all 28 parameters together, from the stops and the moves.
    #[default]
    Joint,
    /// Bai's method with twelve parameters: the stops of period one give the accelerometer parameters, then the moves
    /// of period two give the gyro parameters.
    TwoStage,
}
