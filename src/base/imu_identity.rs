//! Which IMU an instrument has.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Which IMU an instrument has, as the IMU reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ImuIdentity {
    /// Product number, such as 16495.
    pub product: u16,
    /// Serial number.
    pub serial: u32,
}

impl fmt::Display for ImuIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} no. {}", self.product, self.serial)
    }
}
