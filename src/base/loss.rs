//! Samples that are missing, by the reason of their loss.

use serde::{Deserialize, Serialize};

/// Why a sample is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// The queue was full: the main loop is too slow.
    Overrun,
    /// A bus did not carry a transfer.
    Bus,
    /// A frame arrived damaged.
    Crc,
    /// A device reported a status in place of a measurement.
    Status,
    /// The IMU's sample number says that it was not read in time.
    Unread,
}

/// How many samples are missing since the start, by reason. Each counter stops at its greatest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Losses {
    /// See [`Loss::Overrun`].
    pub overrun: u32,
    /// See [`Loss::Bus`].
    pub bus: u32,
    /// See [`Loss::Crc`].
    pub crc: u32,
    /// See [`Loss::Status`].
    pub status: u32,
    /// See [`Loss::Unread`].
    pub unread: u32,
}

impl Losses {
    /// All missing samples.
    pub fn total(&self) -> u32 {
        [self.overrun, self.bus, self.crc, self.status, self.unread].into_iter().fold(0, u32::saturating_add)
    }
}
