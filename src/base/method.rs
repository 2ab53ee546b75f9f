//! The two calibration methods of the core.

use serde::{Deserialize, Serialize};

/// Calibration method: which measurements estimate which parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Method {
    /// Estimates all 28 parameters together, from the stops and the moves.
    #[default]
    Joint,
    /// The method of Bai et al. to the letter, with twelve parameters: the stops of period one give the errors of the
    /// accelerometers and the mounting angles, then the moves of period two give the errors of the gyros.
    Bai,
}
