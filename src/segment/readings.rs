//! How good single readings of an encoder are, as it shows while its axis is held.
//!
//! Stops and moves begin and end with single readings. A coarse encoder reads in steps, another one with noise; while a
//! servo hunts, so do the ends' angles, and rates over a tenth of a second more so. Two things tell how much:
//! ```text
//! noise       second differences of the readings: white noise gives six times its variance, the slow motion of a held
//!             axis next to nothing
//! resolution  two readings that repeat are whole steps apart, and the steps of a binary encoder are 2^-n of a turn: the
//!             lowest bit in which any two have differed
//! ```

use crate::base::angle::{Angle, RAD_PER_TICK};
use serde::{Deserialize, Serialize};

/// Steps are whole to so many ticks, for the digits that a log is written with.
const ROUNDING_TICKS: i32 = 2;
/// Coarser steps are none: an axis that always stands at whole degrees has not shown its resolution.
const COARSEST_TICKS: u32 = 1 << 18;
/// The mean of readings that have changed as often is not bound to the steps.
const DITHERED_CHANGES: f64 = 8.0;

/// What an encoder has shown of its resolution so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steps {
    last_held: Option<Angle>,
    differing_bits: u32,
}

impl Steps {
    /// Nothing.
    pub const UNKNOWN: Self = Self { last_held: None, differing_bits: 0 };

    /// The encoder has read this angle twice.
    pub fn hold(&mut self, angle: Angle) {
        let Some(last) = self.last_held.replace(angle) else { return };
        let way = angle.since(last).wrapping_add(ROUNDING_TICKS);
        self.differing_bits |= (way - way.rem_euclid(2 * ROUNDING_TICKS)).cast_unsigned();
    }

    /// Resolution, ticks; 0 where none has shown.
    pub fn resolution_ticks(&self) -> u32 {
        let lowest = self.differing_bits & self.differing_bits.wrapping_neg();
        if lowest < COARSEST_TICKS { lowest } else { 0 }
    }
}

/// Readings of one encoder over a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Readings {
    /// Sum of the squares of second differences, ticks^2.
    pub jumps_ticks2: f32,
    /// Their number.
    pub count: u32,
    /// Resolution as far as it is known, ticks.
    pub resolution_ticks: u32,
}

impl Readings {
    /// None.
    pub const NONE: Self = Self { jumps_ticks2: 0.0, count: 0, resolution_ticks: 0 };

    /// Variance of a single reading about the mean of a stop, rad^2, as far as the encoder makes it.
    pub fn variance(&self) -> f64 {
        if self.jumps_ticks2 == 0.0 {
            return 0.0;
        }
        let noise = f64::from(self.jumps_ticks2) / (6.0 * f64::from(self.count.max(1))) * RAD_PER_TICK * RAD_PER_TICK;
        noise.max(self.step_variance())
    }

    /// Variance of the mean of a stop, rad^2: where the reading stays, all of it is within the same step.
    pub fn mean_variance(&self) -> f64 {
        let resolution = f64::from(self.resolution_ticks);
        let dithered = f64::from(self.jumps_ticks2) > 2.0 * DITHERED_CHANGES * resolution * resolution;
        if dithered { 0.0 } else { self.step_variance() }
    }

    /// Of an angle somewhere within a step.
    fn step_variance(&self) -> f64 {
        let step_rad = f64::from(self.resolution_ticks) * RAD_PER_TICK;
        step_rad * step_rad / 12.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::ARCSEC;

    /// What an encoder of 2^20 steps a turn shows when it is read at these angles, in steps, each twice.
    fn resolution_of(steps: &[f64]) -> u32 {
        let mut seen = Steps::UNKNOWN;
        for step in steps {
            seen.hold(Angle::from_ticks((step * 4096.0).round() as i64 as u32));
        }
        seen.resolution_ticks()
    }

    #[test]
    fn the_lowest_bit_that_differs_is_the_resolution() {
        assert_eq!(resolution_of(&[17.0, 17.0, 18.0, 90_001.0]), 4096);
        assert_eq!(resolution_of(&[-3.5, -4.5, 5.5]), 4096, "whatever the zero");
        assert_eq!(resolution_of(&[17.0, 19.0]), 8192, "until a single step is seen");
        assert_eq!(resolution_of(&[17.0, 18.000_2, 20.999_8]), 4096, "a log has so many digits");
        assert_eq!(resolution_of(&[0.0, 262_144.0, 524_288.0]), 0, "quarter turns show nothing");
        assert_eq!(resolution_of(&[5.0]), 0);
        assert!(resolution_of(&[0.0, 0.123, 1.456, 3.777]) < 64, "an encoder of many more bits");
    }

    #[test]
    fn noise_or_steps_whichever_is_more() {
        let still = Readings { jumps_ticks2: 0.0, count: 1000, resolution_ticks: 4096 };
        assert_eq!(still.variance(), 0.0);
        let step_rad = 4096.0 * RAD_PER_TICK;
        assert!((still.mean_variance() / (step_rad * step_rad / 12.0) - 1.0).abs() < 1e-12);
        let crept = Readings { jumps_ticks2: 2.0 * 4096.0 * 4096.0, ..still };
        assert_eq!((crept.variance(), crept.mean_variance()), (still.mean_variance(), still.mean_variance()));
        let noise_ticks = ARCSEC / RAD_PER_TICK;
        let noisy = Readings { jumps_ticks2: 6.0 * 1000.0 * (noise_ticks * noise_ticks) as f32, ..still };
        assert!((noisy.variance().sqrt() / ARCSEC - 1.0).abs() < 1e-6);
        assert_eq!(noisy.mean_variance(), 0.0);
    }
}
