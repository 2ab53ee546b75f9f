//! Which sensor it is.

use serde::{Deserialize, Serialize};

/// What an IMU says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ImuIdentity {
    /// Number of the product, such as 16495.
    pub product: u16,
    /// Serial number.
    pub serial: u32,
}
