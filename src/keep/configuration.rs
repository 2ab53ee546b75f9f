//! The configuration of a unit as a kind of record: `"RSU"` in the [frame](super::frame), and [`UnitConfiguration`] as
//! the payload.

use super::slots::Kind;
use crate::run::unit::UnitConfiguration;

/// Version of the format that is read and written. Count it up whenever the bytes of a [`UnitConfiguration`] change.
pub const CONFIGURATION_VERSION: u8 = b'2';
/// Memory of one configuration, bytes.
pub const CONFIGURATION_BYTES: usize = 3072;

/// Configurations of the unit.
#[derive(Debug)]
pub enum Configurations {}

impl Kind for Configurations {
    const MAGIC: [u8; 3] = *b"RSU";
    const VERSION: u8 = CONFIGURATION_VERSION;
    type Slot = [u8; CONFIGURATION_BYTES];
    const BLANK: [u8; CONFIGURATION_BYTES] = [0xff; CONFIGURATION_BYTES];
    type Record = UnitConfiguration;
}
