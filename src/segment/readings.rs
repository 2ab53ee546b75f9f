//! Quality of single readings of an encoder, from the readings while the axis is held.
//!
//! Stops and moves begin and end with single readings. A coarse encoder reads in steps, and other encoders read with
//! noise. While a servo hunts, these errors change the angles at the ends of a segment, and they change the rates over
//! 0.1 s even more. Two properties of the readings show how large the errors are:
//! ```text
//! noise       From second differences of the readings. Their mean square is six times the variance of white noise.
//!             The slow motion of a held axis adds almost nothing to the second differences.
//! resolution  From readings that repeat. Two such readings are whole steps apart, and the step of a binary encoder is
//!             2^-n of a turn. So the resolution is the lowest bit in which any two readings have differed.
//! ```

use crate::base::angle::{Angle, RAD_PER_TICK};
use serde::{Deserialize, Serialize};

/// Tolerance of a whole number of steps, ticks. A log has a limited number of digits, so its angles are rounded.
const ROUNDING_TICKS: i32 = 2;
/// Larger steps are not taken for a resolution. An axis that always rests at whole degrees does not show its
/// resolution.
const COARSEST_TICKS: u32 = 1 << 18;
/// Number of changes by one step over a stop after which the mean of the readings is free of the steps.
const DITHERED_CHANGES: f64 = 8.0;

/// Estimator of the resolution of an encoder.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steps {
    last_held: Option<Angle>,
    differing_bits: u32,
}

impl Steps {
    /// The state before the first reading.
    pub const UNKNOWN: Self = Self { last_held: None, differing_bits: 0 };

    /// Processes an angle that the encoder has read twice in a row.
    pub fn hold(&mut self, angle: Angle) {
        let Some(last) = self.last_held.replace(angle) else { return };
        let way = angle.since(last).wrapping_add(ROUNDING_TICKS);
        self.differing_bits |= (way - way.rem_euclid(2 * ROUNDING_TICKS)).cast_unsigned();
    }

    /// Resolution, ticks; 0 if the readings have not shown the resolution.
    pub fn resolution_ticks(&self) -> u32 {
        let lowest = self.differing_bits & self.differing_bits.wrapping_neg();
        if lowest < COARSEST_TICKS { lowest } else { 0 }
    }
}

/// Readings of one encoder over a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Readings {
    /// Sum of the squares of second differences, ticks^2.
    pub jumps_ticks2: f32,
    /// Number of second differences.
    pub count: u32,
    /// Resolution, ticks; 0 if it is not known.
    pub resolution_ticks: u32,
}

impl Readings {
    /// No readings.
    pub const NONE: Self = Self { jumps_ticks2: 0.0, count: 0, resolution_ticks: 0 };

    /// Variance of a single reading about the mean of a stop, rad^2. Only the encoder's part is included, not the
    /// motion of the axis.
    pub fn variance(&self) -> f64 {
        if self.jumps_ticks2 == 0.0 {
            return 0.0;
        }
        let noise = f64::from(self.jumps_ticks2) / (6.0 * f64::from(self.count.max(1))) * RAD_PER_TICK * RAD_PER_TICK;
        noise.max(self.step_variance())
    }

    /// Variance of the mean of a stop, rad^2. If the reading does not change, all readings are within the same step,
    /// and the mean is not better than a single reading.
    pub fn mean_variance(&self) -> f64 {
        let resolution = f64::from(self.resolution_ticks);
        let dithered = f64::from(self.jumps_ticks2) > 2.0 * DITHERED_CHANGES * resolution * resolution;
        if dithered { 0.0 } else { self.step_variance() }
    }

    /// Variance of an angle that lies anywhere within a step, rad^2.
    fn step_variance(&self) -> f64 {
        let step_rad = f64::from(self.resolution_ticks) * RAD_PER_TICK;
        step_rad * step_rad / 12.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::ARCSEC;

    /// Resolution found for an encoder of 2^20 steps per turn that reads each of these angles, in steps, twice.
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
        assert_eq!(resolution_of(&[-3.5, -4.5, 5.5]), 4096, "for any zero");
        assert_eq!(resolution_of(&[17.0, 19.0]), 8192, "until a single step is seen");
        assert_eq!(resolution_of(&[17.0, 18.000_2, 20.999_8]), 4096, "with the rounding of a log");
        assert_eq!(resolution_of(&[0.0, 262_144.0, 524_288.0]), 0, "quarter turns show nothing");
        assert_eq!(resolution_of(&[5.0]), 0);
        assert!(resolution_of(&[0.0, 0.123, 1.456, 3.777]) < 64, "an encoder of many more bits");
    }

    #[test]
    fn variance_is_that_of_noise_or_steps_whichever_is_larger() {
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
