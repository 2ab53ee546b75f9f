//! Types and tools that all IMU drivers share: a reading or a fault, the fields of a frame, and the sample counter of
//! the IMU.

use crate::base::linear::{Real, Vector3};

/// One measurement of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ImuReading<T: Real> {
    /// Middle of the sample interval, us. Rate and force are means over this interval.
    pub time_us: u64,
    /// Number of samples between the last reading and this reading that are missing without a reported fault. The
    /// counter of the IMU shows the gap.
    pub missed: u32,
    /// Gyro outputs along the gyro axes, rad/s.
    pub omega_g: Vector3<T>,
    /// Accelerometer outputs along the accelerometer axes, m/s^2.
    pub force_a: Vector3<T>,
    /// Temperature, deg C.
    pub temperature_c: f32,
}

/// Why an IMU driver returns no measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImuFault<E> {
    /// The bus transfer failed.
    Bus(E),
    /// The received bytes are not the beginning of an answer.
    NoAnswer,
    /// The answer has a wrong CRC.
    Crc,
    /// The IMU reports faults of its own. The documentation of the driver explains the bits.
    Status(u16),
}

/// The `N` bytes of `frame` from byte `AT`. A field outside its frame does not compile.
pub(super) fn field<const AT: usize, const N: usize, const L: usize>(frame: &[u8; L]) -> [u8; N] {
    const { assert!(AT + N <= L) };
    let mut bytes = [0; N];
    bytes.copy_from_slice(&frame[AT..AT + N]);
    bytes
}

/// Follows the sample counter of an IMU, which counts modulo `2^bits`, and finds missing samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counter {
    mask: u32,
    /// Number of the last sample; `None` before the first sample.
    last: Option<u32>,
    /// Lost samples since the last good sample for which a fault has been reported.
    reported: u32,
}

impl Counter {
    pub(super) const fn new(bits: u32) -> Self {
        Self { mask: (1 << bits) - 1, last: None, reported: 0 }
    }

    /// Notes a lost sample for which a fault has been reported.
    pub(super) fn count_reported(&mut self) {
        self.reported = self.reported.saturating_add(1);
    }

    /// Takes the number of a good sample. Returns how many samples before it are missing without a reported fault. If
    /// the number is behind the last number by less than half the range, the IMU has restarted; no sample is then known
    /// to be missing.
    pub(super) fn take(&mut self, count: u32) -> u32 {
        let ahead = self.last.map_or(0, |last| count.wrapping_sub(last.wrapping_add(1)) & self.mask);
        let missing = if ahead > self.mask / 2 { 0 } else { ahead };
        let missed = missing.saturating_sub(self.reported);
        (self.last, self.reported) = (Some(count), 0);
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_missing_sample_is_reported_once() {
        let mut counter = Counter::new(7);
        assert_eq!(counter.take(126), 0);
        assert_eq!(counter.take(127), 0);
        assert_eq!(counter.take(3), 3, "0, 1 and 2");
        counter.count_reported();
        counter.count_reported();
        assert_eq!(counter.take(7), 1, "4, 5 and 6 are missing, two of them were reported before");
        assert_eq!(counter.take(7), 0, "a number behind the last one: the IMU restarted");
    }
}
