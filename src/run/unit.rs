//! The configuration of one unit, with the name of the unit.

use super::config::SelfCalibrationConfig;
use heapless::String;
use serde::{Deserialize, Serialize};

/// What a unit is called.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UnitName {
    /// Name, chosen by the user.
    pub name: String<32>,
    /// Serial number.
    pub serial: String<16>,
}

/// The configuration that a unit keeps in its memory. Its encoding is that of
/// [`CONFIGURATION_VERSION`](crate::keep::configuration::CONFIGURATION_VERSION).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UnitConfiguration {
    /// The name of the unit.
    pub unit: UnitName,
    /// The configuration of its runs.
    pub run: SelfCalibrationConfig,
}
