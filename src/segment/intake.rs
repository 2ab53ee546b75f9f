//! Admission of samples. Samples that are repeated, out of order or not finite are not used, but counted.

use crate::base::linear::{ComplexField, Real};
use crate::base::sample::RawSample;
use serde::{Deserialize, Serialize};

/// An interval this many times the nominal one counts as a gap.
const GAP_INTERVALS: f64 = 1.5;
/// An interval is irregular if it is longer or shorter than the nominal interval by more than this part of it.
const IRREGULAR_PART: f64 = 0.2;
/// With this number of consecutive irregular intervals the samples come at another rate.
const OTHER_RATE_INTERVALS: u8 = 20;

/// Counts of samples and gaps since the last restart of the counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct IntakeCounts {
    /// Samples admitted.
    pub admitted: u64,
    /// Samples with the same time as the sample before.
    pub repeated: u32,
    /// Samples with an earlier time than the sample before.
    pub out_of_order: u32,
    /// Samples with a value that is not finite.
    pub non_finite: u32,
    /// Intervals longer than 1.5 nominal sample intervals.
    pub gaps: u32,
    /// Samples that were missing in the gaps.
    pub missing: u32,
}

impl IntakeCounts {
    /// Counts before the first sample.
    pub const NONE: Self = Self { admitted: 0, repeated: 0, out_of_order: 0, non_finite: 0, gaps: 0, missing: 0 };
}

/// Decision about one sample.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Admission {
    /// The sample is admitted.
    Admitted {
        /// Time since the sample before, us; 0 for the first sample.
        interval_us: u64,
        /// Whether samples are missing between the sample before and this sample.
        after_gap: bool,
    },
    /// The sample is refused: its time equals that of the sample before.
    Repeated,
    /// The sample is refused: its time is earlier than that of the sample before.
    OutOfOrder,
    /// The sample is refused: a value is not finite.
    NonFinite,
}

/// Check of every sample before it is used.
#[derive(Clone, Copy, Debug)]
pub struct Intake {
    nominal_us: f64,
    /// Longest interval that does not count as a gap, us.
    regular_us: u64,
    last_us: Option<u64>,
    /// Number of consecutive irregular intervals.
    irregular: u8,
    counts: IntakeCounts,
}

impl Intake {
    /// Intake for samples at the nominal rate `rate_hz`.
    pub const fn new(rate_hz: f64) -> Self {
        let nominal_us = 1e6 / rate_hz;
        let regular_us = (GAP_INTERVALS * nominal_us) as u64;
        Self { nominal_us, regular_us, last_us: None, irregular: 0, counts: IntakeCounts::NONE }
    }

    /// Checks one sample and counts it.
    pub fn admit<T: Real>(&mut self, sample: &RawSample<T>) -> Admission {
        let finite = |v: &T| v.is_finite();
        if !sample.omega_g.as_slice().iter().all(finite) || !sample.force_a.as_slice().iter().all(finite) {
            self.counts.non_finite += 1;
            return Admission::NonFinite;
        }
        let interval_us = match self.last_us {
            Some(last) if sample.time_us == last => {
                self.counts.repeated += 1;
                return Admission::Repeated;
            }
            Some(last) if sample.time_us < last => {
                self.counts.out_of_order += 1;
                return Admission::OutOfOrder;
            }
            Some(last) => sample.time_us - last,
            None => 0,
        };
        let after_gap = self.note_gap(interval_us);
        self.note_rate(interval_us);
        self.last_us = Some(sample.time_us);
        self.counts.admitted += 1;
        Admission::Admitted { interval_us, after_gap }
    }

    /// Sets all counts to zero.
    pub fn restart_counts(&mut self) {
        self.counts = IntakeCounts::NONE;
    }

    /// Continues a sequence of times whose last sample has this time, us.
    pub fn follow(&mut self, last_us: u64) {
        self.last_us = Some(last_us);
    }

    /// Starts a new sequence of times with the next sample. After a loss of samples the clock may have gone back.
    pub fn resume(&mut self) {
        (self.last_us, self.irregular) = (None, 0);
    }

    fn note_gap(&mut self, interval_us: u64) -> bool {
        let gap = interval_us > self.regular_us;
        if gap {
            let missing = ComplexField::round(interval_us as f64 / self.nominal_us) - 1.0;
            self.counts.gaps += 1;
            self.counts.missing = self.counts.missing.saturating_add(missing as u32);
        }
        gap
    }

    fn note_rate(&mut self, interval_us: u64) {
        let off_us = interval_us as f64 - self.nominal_us;
        let irregular = ComplexField::abs(off_us) > IRREGULAR_PART * self.nominal_us;
        self.irregular = if irregular { self.irregular.saturating_add(1) } else { 0 };
    }

    /// Whether the last 20 intervals were all irregular: the IMU samples at another rate than the
    /// configured one.
    pub fn has_other_rate(&self) -> bool {
        self.irregular >= OTHER_RATE_INTERVALS
    }

    /// The counts so far.
    pub fn counts(&self) -> IntakeCounts {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_rate_is_noticed_and_jitter_is_not() {
        let after = |intervals_us: &mut dyn Iterator<Item = u64>| {
            let (mut intake, mut time_us) = (Intake::new(200.0), 0);
            for interval_us in intervals_us {
                time_us += interval_us;
                let _ = intake.admit(&RawSample::<f64> { time_us, ..RawSample::default() });
            }
            intake.has_other_rate()
        };
        assert!(after(&mut [10_000].repeat(21).into_iter()));
        assert!(after(&mut [235].repeat(21).into_iter()), "an ADIS16495 after a reset samples 4250 times a second");
        assert!(!after(&mut [5000].repeat(100).into_iter()));
        assert!(!after(&mut (0..100).map(|k| if k % 2 == 0 { 4100 } else { 5900 })));
        assert!(!after(&mut (0..100).map(|k| if k % 10 == 0 { 5000 } else { 10_000 })));
    }

    #[test]
    fn every_irregular_sample_is_counted() {
        let mut intake = Intake::new(200.0);
        let regular = |interval_us| Admission::Admitted { interval_us, after_gap: false };
        let at = |time_us| RawSample::<f64> { time_us, ..RawSample::default() };
        assert_eq!(intake.admit(&at(1000)), regular(0));
        assert_eq!(intake.admit(&at(6000)), regular(5000));
        assert_eq!(intake.admit(&at(6000)), Admission::Repeated);
        assert_eq!(intake.admit(&at(5000)), Admission::OutOfOrder);
        assert_eq!(intake.admit(&at(26_000)), Admission::Admitted { interval_us: 20_000, after_gap: true });
        let mut bad = at(31_000);
        bad.omega_g.y = f64::NAN;
        assert_eq!(intake.admit(&bad), Admission::NonFinite);
        let expected = IntakeCounts { admitted: 3, repeated: 1, out_of_order: 1, non_finite: 1, gaps: 1, missing: 3 };
        assert_eq!(intake.counts(), expected);
        intake.resume();
        intake.restart_counts();
        assert_eq!(intake.admit(&at(0)), regular(0));
        assert_eq!(intake.counts(), IntakeCounts { admitted: 1, ..IntakeCounts::NONE });
    }
}
