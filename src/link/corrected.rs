//! The corrected samples on the serial line: off until a command asks for them.

use super::frame::Payload;
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::sample::{CorrectedSample, SampleStatus};
use serde::{Deserialize, Serialize};

/// Length of the longest frame of a corrected sample, bytes.
pub(super) const MAX_CORRECTED_FRAME_BYTES: usize = 96;

/// One corrected sample. Its frame is about 75 bytes long. At 200 Hz this is one sixth of the capacity of a line at 921
/// 600 baud.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CorrectedReport {
    /// Counts the corrected samples from 0 since the stream was switched on. A gap shows that the outbox had no room
    /// for a sample.
    pub number: u32,
    /// Time of the sample, us.
    pub time_us: u64,
    /// Specific force in the IMU frame, m/s^2.
    pub force_s: [f64; 3],
    /// Inertial angular rate of the IMU frame in the IMU frame, rad/s.
    pub omega_is_s: [f64; 3],
    /// Outer and inner gimbal angle at the time of the sample.
    pub angles: [Angle; 2],
    /// The status of the sample.
    pub status: SampleStatus,
}

impl Payload for CorrectedReport {
    const KIND: u8 = b'S';
}

/// The state of the stream.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stream {
    next: Option<u32>,
}

impl Stream {
    /// A stream that is off.
    pub(super) const fn new() -> Self {
        Self { next: None }
    }

    /// Switches the stream on, with the next number 0, or off.
    pub(super) fn switch(&mut self, on: bool) {
        self.next = on.then_some(0);
    }

    /// The report of a sample, with the next number; `None` while the stream is off.
    pub(super) fn report<T: Real>(
        &mut self,
        sample: &CorrectedSample<T>,
        angles: [Angle; 2],
        status: SampleStatus,
    ) -> Option<CorrectedReport> {
        let number = self.next?;
        self.next = Some(number.wrapping_add(1));
        Some(CorrectedReport {
            number,
            time_us: sample.time_us,
            force_s: sample.force_s.map(Real::widened).into(),
            omega_is_s: sample.omega_is_s.map(Real::widened).into(),
            angles,
            status,
        })
    }
}
