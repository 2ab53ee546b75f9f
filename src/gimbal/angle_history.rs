//! Angles of one axis over the last milliseconds, interpolated at any time between them.
//!
//! The encoder is read once a millisecond, at times that do not depend on the IMU. The time stamp of an IMU sample is
//! the middle of its interval, which is in the past when the sample arrives. So the angle at the stamp is interpolated
//! between two encoder readings on a straight line. For an axis that accelerates at 60 deg/s^2 the error is at most
//! 0.03 arcsec, and it is zero at the readings themselves.

use crate::base::angle::Angle;

/// Number of stored readings: 31 ms at 1 kHz.
const READINGS: usize = 32;
/// Longest time between two readings for an interpolation, us. One reading may be missing.
const LONGEST_GAP_US: u64 = 2500;

#[derive(Clone, Copy, Debug)]
struct Reading {
    time_us: u64,
    angle: Angle,
}

/// The last readings of one encoder.
#[derive(Clone, Debug)]
pub struct AngleHistory {
    readings: [Reading; READINGS],
    /// Number of readings taken so far; once the memory is full, this count stays between `READINGS` and `2 * READINGS
    /// - 1`.
    count: usize,
}

impl AngleHistory {
    /// A history without readings.
    pub const fn new() -> Self {
        Self { readings: [Reading { time_us: 0, angle: Angle::from_ticks(0) }; READINGS], count: 0 }
    }

    /// Adds a reading. A reading that is not later than the last one is ignored.
    pub fn push(&mut self, time_us: u64, angle: Angle) {
        if self.back(0).is_some_and(|last| last.time_us >= time_us) {
            return;
        }
        if let Some(place) = self.readings.get_mut(self.count % READINGS) {
            *place = Reading { time_us, angle };
            // A full memory stays full: the count wraps to `READINGS`, not to zero.
            self.count = if self.count == 2 * READINGS - 1 { READINGS } else { self.count + 1 };
        }
    }

    /// Angle at a time. `None` unless the time lies between two readings at most 2.5 ms apart.
    pub fn at(&self, time_us: u64) -> Option<Angle> {
        let earlier = (0..READINGS).find(|back| self.back(*back).is_none_or(|reading| reading.time_us <= time_us))?;
        let before = self.back(earlier)?;
        if before.time_us == time_us {
            return Some(before.angle);
        }
        let after = self.back(earlier.checked_sub(1)?)?;
        let gap_us = after.time_us - before.time_us;
        (gap_us <= LONGEST_GAP_US)
            .then(|| before.angle.turned(part(after.angle.since(before.angle), time_us - before.time_us, gap_us)))
    }

    /// The reading `readings` before the last one.
    fn back(&self, readings: usize) -> Option<Reading> {
        let place = self.count.checked_sub(readings + 1)?;
        self.readings.get(place % READINGS).copied()
    }
}

impl Default for AngleHistory {
    fn default() -> Self {
        Self::new()
    }
}

/// `ticks` times `elapsed / whole`, rounded to the nearest tick. `whole` must not be zero.
fn part(ticks: i32, elapsed: u64, whole: u64) -> i32 {
    let (elapsed, whole) = (elapsed as i64, (whole as i64).max(1));
    (2 * i64::from(ticks) * elapsed + whole).div_euclid(2 * whole) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn history(readings: impl IntoIterator<Item = (u64, i32)>) -> AngleHistory {
        let mut history = AngleHistory::new();
        for (time_us, ticks) in readings {
            history.push(time_us, Angle::from_ticks(ticks.cast_unsigned()));
        }
        history
    }

    fn ticks_at(history: &AngleHistory, time_us: u64) -> Option<i32> {
        history.at(time_us).map(|angle| angle.ticks().cast_signed())
    }

    #[test]
    fn only_times_between_readings_have_an_angle() {
        assert_eq!(AngleHistory::new().at(5), None);
        let history = history([(1000, -5), (2000, 5)]);
        assert_eq!(
            [999, 1000, 1500, 1649, 2000, 2001].map(|time_us| ticks_at(&history, time_us)),
            [None, Some(-5), Some(0), Some(1), Some(5), None]
        );
    }

    #[test]
    fn the_oldest_readings_are_dropped_first() {
        for count in [READINGS as u64, 1000, 1001] {
            let history = history((0..count).map(|k| (1000 * k, 7000 * k as i32)));
            let kept = (0..1000 * count).step_by(500).filter(|time_us| {
                let found = ticks_at(&history, *time_us);
                assert!(found.is_none_or(|ticks| ticks == 7 * *time_us as i32), "{time_us}: {found:?}");
                found.is_some()
            });
            assert_eq!(kept.count(), 2 * READINGS - 1);
        }
    }

    #[test]
    fn the_angle_is_interpolated_over_one_missing_reading_but_not_over_two() {
        assert_eq!(ticks_at(&history([(0, 0), (2000, 200)]), 700), Some(70));
        assert_eq!(ticks_at(&history([(0, 0), (3000, 300)]), 700), None);
    }

    #[test]
    fn a_reading_that_is_not_later_is_ignored() {
        let mut before = history([(1000, 1), (2000, 2)]);
        before.push(2000, Angle::from_ticks(9));
        before.push(500, Angle::from_ticks(9));
        assert_eq!(ticks_at(&before, 2000), Some(2));
    }

    proptest! {
        #[test]
        fn interpolation_is_linear_across_a_whole_turn(
            from: u32, step in -40_000_000_i32..40_000_000, at in 0_u64..=1000
        ) {
            let mut history = AngleHistory::new();
            history.push(10, Angle::from_ticks(from));
            history.push(1010, Angle::from_ticks(from).turned(step));
            let turned = history.at(10 + at).unwrap().since(Angle::from_ticks(from));
            let exact = f64::from(step) * at as f64 / 1000.0;
            prop_assert!((f64::from(turned) - exact).abs() <= 0.5 + 1e-6);
        }
    }
}
