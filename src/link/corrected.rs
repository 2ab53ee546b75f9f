//! The corrected samples on the serial line: off until a command asks for them.

use super::frame::Payload;
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::sample::{CorrectedSample, SampleStatus};
use serde::{Deserialize, Serialize};

/// Length of the longest frame of a corrected sample, bytes.
pub(super) const MAX_CORRECTED_FRAME_BYTES: usize = 96;

/// One corrected sample. Its frame is 76 bytes long after some minutes: at 200 Hz 16.5 % of what a line of 921 600 baud
/// carries.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CorrectedReport {
    /// Counts the corrected samples from 0 since the stream was switched on. A gap shows that a sample was lost: the
    /// outbox had no room for the sample, or the line damaged the frame.
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

    /// Switches the stream on, with the next number 0, or off. A stream that is on already goes on counting, so that a
    /// command that is sent again does no harm.
    pub(super) fn switch(&mut self, on: bool) {
        self.next = on.then(|| self.next.unwrap_or(0));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::Matrix3;
    use crate::base::linear::Vector3;
    use crate::link::{MAX_FRAME_BYTES, encode};

    fn sample() -> CorrectedSample<f64> {
        let (force_s, omega_is_s) = (Vector3::new(0.1, -0.2, 9.79), Vector3::new(-1e-5, 0.35, 7e-5));
        CorrectedSample { time_us: 180_000_000, force_s, omega_is_s, rot_sb: Matrix3::identity() }
    }

    #[test]
    fn a_stream_is_off_until_asked_for_and_counts_from_zero_after_it_was_off() {
        let mut stream = Stream::new();
        let mut next = |on: Option<bool>| {
            on.into_iter().for_each(|on| stream.switch(on));
            stream.report(&sample(), [Angle::default(); 2], SampleStatus::NONE).map(|report| report.number)
        };
        let numbers = [None, Some(true), None, Some(true), Some(false), Some(true)].map(&mut next);
        assert_eq!(numbers, [None, Some(0), Some(1), Some(2), None, Some(0)]);
    }

    #[test]
    fn two_hundred_samples_a_second_take_a_sixth_of_the_line() {
        let mut stream = Stream { next: Some(36_000) };
        let angles = [Angle::from_rad(-1.0), Angle::from_rad(3.0)];
        let status = SampleStatus::NONE.with(SampleStatus::AT_REST, true);
        let report = stream.report(&sample(), angles, status).expect("the stream is on");
        let mut frame = [0; MAX_FRAME_BYTES];
        let bytes = encode(0xffff, &report, &mut frame).expect("it fits").len();
        assert_eq!(bytes, 76);
        assert!(bytes < MAX_CORRECTED_FRAME_BYTES);
        // Ten bits a byte: 0.165 of 921 600 baud.
        assert_eq!(bytes * 10 * 200, 152_000);
    }
}
