//! Identity of the IMU that is fitted.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Product and serial number that an IMU reports. A calibration belongs to one IMU, so a record with another identity is
/// that of an IMU that has been replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ImuIdentity {
    /// Product number, such as 16495 of an ADIS16495.
    pub product: u16,
    /// Serial number. Its maker decides among which units it is unique: a product, or a production lot.
    pub serial: u32,
}

impl fmt::Display for ImuIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} no. {}", self.product, self.serial)
    }
}
