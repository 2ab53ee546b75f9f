//! Counters of missing samples, one for each reason.

use serde::{Deserialize, Serialize};

/// Reason why a sample is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LossReason {
    /// The sample queue was full because the main loop is too slow.
    Overrun,
    /// A bus transfer failed.
    Bus,
    /// A frame of a device has a wrong CRC or a wrong form.
    Crc,
    /// A device reported an error in place of a measurement, or an encoder did not answer.
    Status,
    /// The IMU produced the sample, but the processor did not read it in time. The sample number of the IMU shows the
    /// gap.
    Unread,
    /// The IMU has restarted during operation, or its sample counter and its data-ready edges do not agree with its
    /// settings. The driver refuses its samples until the settings are known to hold.
    Restarted,
}

/// Number of missing samples since the start, by reason. Each counter saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LossCounts {
    /// Samples lost by [`LossReason::Overrun`].
    pub overrun: u32,
    /// Samples lost by [`LossReason::Bus`].
    pub bus: u32,
    /// Samples lost by [`LossReason::Crc`].
    pub crc: u32,
    /// Samples lost by [`LossReason::Status`].
    pub status: u32,
    /// Samples lost by [`LossReason::Unread`].
    pub unread: u32,
    /// Samples lost by [`LossReason::Restarted`].
    pub restarted: u32,
}

impl LossCounts {
    /// Number of missing samples for all reasons together.
    pub fn total(&self) -> u32 {
        let Self { overrun, bus, crc, status, unread, restarted } = *self;
        [overrun, bus, crc, status, unread, restarted].into_iter().fold(0, u32::saturating_add)
    }
}
