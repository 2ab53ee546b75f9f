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
    /// The sample counter and the data-ready edges do not agree with the settings of the IMU, as after a restart of the
    /// IMU during operation. No sample is returned until the settings hold again.
    Restarted,
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

/// Compares the sample counter of an IMU with the times of its data-ready edges. Both must advance alike: an IMU that has
/// restarted counts from zero, and with its initial settings it samples at another rate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cadence {
    interval_us: f32,
    /// Edge and number of the last sample; `None` before the first sample.
    last: Option<(u64, u16)>,
    /// Time of the first edge of the window, us, and number of intervals since.
    window: (u64, u32),
}

impl Cadence {
    /// Largest difference between counter and edges that is not a restart, samples, beside the tolerance of the interval. An
    /// edge is noted late if its interrupt is delayed.
    const SLACK: f32 = 2.0;
    /// Tolerance of the interval. The internal clock of an ADIS16495 is 6 % faster than an external clock of 4000 Hz.
    const TOLERANCE: f32 = 0.05;
    /// Length of a window, samples. A delay of an edge by two samples is 3 % of a window.
    const WINDOW: u32 = 64;

    /// The IMU samples once in this interval, us.
    pub(super) const fn new(interval_us: f32) -> Self {
        Self { interval_us, last: None, window: (0, 0) }
    }

    /// Takes the edge and the number of a good sample. Returns whether they agree with the interval. If they do not, the
    /// next sample is a first sample again.
    pub(super) fn agrees(&mut self, edge_us: u64, count: u16) -> bool {
        let Some((last_us, last)) = self.last.replace((edge_us, count)) else {
            self.window = (edge_us, 0);
            return true;
        };
        let advance = count.wrapping_sub(last);
        let agrees = self.is_step(edge_us.saturating_sub(last_us) as f32, advance) && self.is_rate(edge_us, advance);
        if !agrees {
            self.last = None;
        }
        agrees
    }

    /// Whether the counter advances as far as the time between two edges. The counter may wrap in this time.
    fn is_step(&self, elapsed_us: f32, advance: u16) -> bool {
        let expected = elapsed_us / self.interval_us;
        let off = advance.wrapping_sub((expected + 0.5) as u32 as u16).cast_signed().unsigned_abs();
        f32::from(off) <= Self::SLACK + Self::TOLERANCE * expected
    }

    /// Whether the mean interval over a window is the expected one. After a disagreement the measured interval is the
    /// expected one: if the settings hold, the clock of the IMU is different.
    fn is_rate(&mut self, edge_us: u64, advance: u16) -> bool {
        let (start_us, intervals) = self.window;
        let intervals = intervals.saturating_add(advance.into());
        if intervals < Self::WINDOW {
            self.window = (start_us, intervals);
            return true;
        }
        self.window = (edge_us, 0);
        let mean_us = edge_us.saturating_sub(start_us) as f32 / intervals as f32;
        let agrees = (mean_us - self.interval_us).abs() <= Self::TOLERANCE * self.interval_us;
        if !agrees {
            self.interval_us = mean_us;
        }
        agrees
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of the first sample that does not agree, if there is one. The samples are `(edge, count)`.
    fn disagrees(cadence: &mut Cadence, samples: impl IntoIterator<Item = (u64, u16)>) -> Option<usize> {
        samples.into_iter().position(|(edge_us, count)| !cadence.agrees(edge_us, count))
    }

    #[test]
    fn late_edges_lost_samples_and_a_wrap_agree() {
        // Every edge is up to 2 ms late, every seventh sample is lost, and the counter wraps.
        let samples = (0..100_000_u64).filter(|k| k % 7 != 0).map(|k| (5000 * k + (k * 977) % 2000, k as u16));
        assert_eq!(disagrees(&mut Cadence::new(5000.0), samples), None);
    }

    #[test]
    fn a_restart_is_found_at_any_count() {
        for last in (0..=u16::MAX).step_by(251).filter(|last| !(0xff80..).contains(last)) {
            let mut cadence = Cadence::new(5000.0);
            assert!(cadence.agrees(1_000_000, last));
            // The IMU was off for 0.3 s and then counts from zero.
            assert!(!cadence.agrees(1_300_000, 0), "{last}");
        }
    }

    #[test]
    fn another_rate_is_found_within_a_window() {
        for interval_us in [235, 4706, 5300] {
            let samples = (0..200).map(|k| (k * interval_us, k as u16));
            let found = disagrees(&mut Cadence::new(5000.0), samples);
            assert_eq!(found, Some(Cadence::WINDOW as usize), "{interval_us}");
        }
    }

    #[test]
    fn a_clock_that_is_slightly_off_agrees() {
        for interval_us in [4800, 5200] {
            assert_eq!(disagrees(&mut Cadence::new(5000.0), (0..1000).map(|k| (k * interval_us, k as u16))), None);
        }
    }

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
