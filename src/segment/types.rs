//! The types of a segment. A segment is a stop or a move with its sufficient sums. It is the unit of information from
//! sampling to report.

use super::readings::Readings;
use super::scatter::Scatter;
use crate::base::angle::{Angle, rad_to_ticks};
use crate::base::linear::{Real, Vector3};
use crate::base::sample::CHANNELS;
use crate::base::units::seconds;
use serde::{Deserialize, Serialize};

/// Longest interval between two samples that a segment may have, us. During a longer gap at a stop, the axes may have
/// moved away and back. During a longer gap in a move, rotation is lost.
pub const LONGEST_GAP_US: u64 = 100_000;

/// Stop or move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SegmentKind {
    /// Both axes are at rest.
    Stop,
    /// One axis turns, or both axes turn. The window includes the guard before the motion and the settling after it.
    Move,
}

/// A finished stop or move.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment<T: Real> {
    /// Time of the last sample before the segment, us.
    pub start_us: u64,
    /// Duration, us.
    pub duration_us: u64,
    /// Number of samples.
    pub samples: u32,
    /// Longest interval between two samples, us. The value is at most 2^32 - 1, which is 71 minutes.
    pub longest_interval_us: u32,
    /// Readings that repeat.
    pub held: Held,
    /// Mean IMU temperature, deg C.
    pub temperature_c: f32,
    /// Integral of the gyro outputs over time, rad.
    pub rotation_g: Vector3<T>,
    /// Outer angle: the mean over a stop, or the last reading of a move.
    pub outer: Angle,
    /// Inner angle: the mean over a stop, or the last reading of a move.
    pub inner: Angle,
    /// Angles by which the axes turn. At a stop, the hunting of the servos turns them.
    pub turned: Turned<T>,
    /// Stop or move, with the sums that only this kind has.
    pub course: Course<T>,
}

impl<T: Real> Segment<T> {
    /// The kind of the segment.
    pub fn kind(&self) -> SegmentKind {
        match self.course {
            Course::Stop(_) => SegmentKind::Stop,
            Course::Move(_) => SegmentKind::Move,
        }
    }

    /// Measurements at a stop. `None` for a move.
    pub fn standing(&self) -> Option<&Standing<T>> {
        match &self.course {
            Course::Stop(standing) => Some(standing),
            Course::Move(_) => None,
        }
    }

    /// Integrals over the gimbal angles. At a stop the angles are taken as constant, and an encoder error is the same
    /// at both ends.
    pub fn integrals(&self) -> AngleIntegrals<T> {
        match self.course {
            Course::Move(integrals) => integrals,
            Course::Stop(_) => {
                let duration_s = self.duration_s();
                let ((so, co), (si, ci)): ((T, T), (T, T)) = (self.outer.sin_cos(), self.inner.sin_cos());
                let one = T::one();
                let attitude = |inner: T| [one, co, so].map(|outer| (inner * outer * duration_s).widened() as f32);
                AngleIntegrals { attitude_s: [one, ci, si].map(attitude), ..AngleIntegrals::default() }
            }
        }
    }

    /// Inner angle at the start of the segment.
    pub fn inner_from(&self) -> Angle {
        self.inner.turned(-rad_to_ticks(self.turned.inner.widened()) as i32)
    }

    /// Outer angle at the start of the segment.
    pub fn outer_from(&self) -> Angle {
        self.outer.turned(-rad_to_ticks(self.turned.outer.widened()) as i32)
    }

    /// The way of the gyros in a move. `None` for a stop.
    pub fn gyro_path(&self) -> Option<&GyroPath> {
        match &self.course {
            Course::Stop(_) => None,
            Course::Move(integrals) => Some(&integrals.gyro_path),
        }
    }

    /// Duration, s.
    pub fn duration_s(&self) -> T {
        seconds(self.duration_us)
    }

    /// Sets the resolutions of the encoders, ticks. Later segments may show a resolution that this segment did not
    /// show.
    pub fn know_resolution(&mut self, resolution_ticks: [u32; 2]) {
        let Course::Stop(standing) = &mut self.course else { return };
        for (readings, resolution_ticks) in standing.readings.iter_mut().zip(resolution_ticks) {
            readings.resolution_ticks = resolution_ticks;
        }
    }

    /// Sets the increments of the outputs, m/s^2 and rad/s. Later segments may show that the outputs are no pulses.
    pub fn know_increments(&mut self, increments: [f32; CHANNELS]) {
        if let Course::Stop(standing) = &mut self.course {
            standing.increments = increments;
        }
    }

    /// Whether a gap between samples is so long that the sums do not describe the stop or the move.
    pub fn is_broken(&self) -> bool {
        u64::from(self.longest_interval_us) > LONGEST_GAP_US
    }
}

/// The kind of a segment, with the sums that only this kind has.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Course<T: Real> {
    /// Both axes are at rest.
    Stop(Standing<T>),
    /// One axis turns, or both axes turn.
    Move(AngleIntegrals<T>),
}

/// Measurements while both axes are at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Standing<T: Real> {
    /// Mean of the accelerometer outputs, m/s^2.
    pub force_a: Vector3<T>,
    /// Scatter of the block means.
    pub scatter: Scatter,
    /// Readings of the outer and the inner encoder.
    pub readings: [Readings; 2],
    /// Increments of the outputs per channel, m/s^2 and rad/s, if the outputs are pulses; otherwise 0.
    pub increments: [f32; CHANNELS],
}

/// Angles by which the axes turn over a segment, and integrals over the outer angle, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Turned<T> {
    /// Increment of the outer angle.
    pub outer: T,
    /// Increment of the inner angle.
    pub inner: T,
    /// Integral of cos(inner) over the outer angle.
    pub outer_cos_inner: T,
    /// Integral of sin(inner) over the outer angle.
    pub outer_sin_inner: T,
}

/// Further sums over the gimbal angles. With [`Turned`] they determine the integrals of (M3) for any
/// non-perpendicularity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AngleIntegrals<T> {
    /// Integral of (1, cos, sin)(inner) x (1, cos, sin)(outer) over time, s. Rows are inner, columns are outer. The
    /// integrals weight the Earth rate, so `f32` gives an error of 0.0002" over a stop of 200 s. `f32` saves memory,
    /// because many segments are kept.
    pub attitude_s: [[f32; 3]; 3],
    /// As [`Turned::outer_cos_inner`], weighted with the time since the segment's start, rad s.
    pub late_cos_inner_s: T,
    /// As [`Turned::outer_sin_inner`], weighted with the time since the segment's start, rad s.
    pub late_sin_inner_s: T,
    /// Sums for the harmonics of the encoder errors.
    pub harmonics: HarmonicSums,
    /// Sums for effects of the gyros that are not linear in the rate.
    pub gyro_path: GyroPath,
}

/// Integrals of the magnitude of the gyro outputs w over time. They are `f32` for the same reason as [`HarmonicSums`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroPath {
    /// Integral of |w|, rad.
    pub absolute_rad: [f32; 3],
    /// Integral of w |w|, rad^2/s.
    pub squared_rad2_s: [f32; 3],
}

impl GyroPath {
    /// The sums before the first sample.
    pub const ZERO: Self = Self { absolute_rad: [0.0; 3], squared_rad2_s: [0.0; 3] };

    /// Adds what the gyros have turned over a time, s, in which their rates hardly change.
    pub fn add(&mut self, turned_rad: [f32; 3], duration_s: f32) {
        let sums = self.absolute_rad.iter_mut().zip(&mut self.squared_rad2_s);
        for ((absolute, squared), turned) in sums.zip(turned_rad) {
            *absolute += turned.abs();
            *squared += turned * turned.abs() / duration_s;
        }
    }
}

/// Integrals over the outer angle, rad. Through them the harmonics of the encoder errors act on a move. The errors are
/// some arcsec, and an accuracy of 1 % is sufficient. So the sums are `f32` and are not compensated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HarmonicSums {
    /// Integrals of (cos, sin)(inner) x (cos, sin, cos of the double angle, sin of the double angle)(outer).
    pub outer: [[f32; 4]; 2],
    /// Integrals of cos and sin of twice the inner angle, then of three times the inner angle.
    pub inner: [f32; 4],
}

impl HarmonicSums {
    /// The sums before the first step.
    pub const ZERO: Self = Self { outer: [[0.0; 4]; 2], inner: [0.0; 4] };

    /// Adds a step of the outer angle, rad. The arguments are sine and cosine of the outer and of the inner angle.
    pub fn add(&mut self, (so, co): (f32, f32), (si, ci): (f32, f32), step: f32) {
        let (sin_2i, cos_2i) = (2.0 * si * ci, 1.0 - 2.0 * si * si);
        let outer = [co, so, 1.0 - 2.0 * so * so, 2.0 * so * co];
        let inner = [cos_2i, sin_2i, cos_2i * ci - sin_2i * si, sin_2i * ci + cos_2i * si];
        for (row, inner) in self.outer.iter_mut().zip([ci, si]) {
            row.iter_mut().zip(outer).for_each(|(sum, outer)| *sum += inner * outer * step);
        }
        self.inner.iter_mut().zip(inner).for_each(|(sum, inner)| *sum += inner * step);
    }

    pub(super) fn merge(&mut self, other: &Self) {
        let others = other.outer.iter().flatten().chain(&other.inner);
        self.outer.iter_mut().flatten().chain(&mut self.inner).zip(others).for_each(|(sum, other)| *sum += other);
    }
}

/// Readings that repeat to the last bit. Readings with noise do not repeat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Held {
    /// Longest run of samples over which one channel kept the same value.
    pub samples: u16,
    /// Channel with the longest run.
    pub channel: u8,
    /// Number of samples whose six channels all equal those of the sample before.
    pub stale: u16,
}

impl Held {
    /// No reading repeats.
    pub const NONE: Self = Self { samples: 0, channel: 0, stale: 0 };

    pub(super) fn merge(&mut self, other: Self) {
        if other.samples > self.samples {
            (self.samples, self.channel) = (other.samples, other.channel);
        }
        self.stale = self.stale.saturating_add(other.stale);
    }
}

#[cfg(test)]
impl Segment<f64> {
    /// A level stop at (0, 0) without noise, sampled at 200 Hz.
    pub(crate) fn quiet_stop(duration_us: u64) -> Self {
        let blocks = (duration_us / 100_000) as u16;
        let standing = Standing {
            force_a: Vector3::new(0.0, 0.0, 9.8),
            scatter: Scatter { blocks, freedom: blocks - 1, ..Scatter::default() },
            readings: [Readings::NONE; 2],
            increments: [0.0; CHANNELS],
        };
        Self {
            start_us: 0,
            duration_us,
            samples: (duration_us / 5000) as u32,
            longest_interval_us: 5000,
            held: Held::NONE,
            temperature_c: 20.0,
            rotation_g: Vector3::zeros(),
            outer: Angle::default(),
            inner: Angle::default(),
            turned: Turned::default(),
            course: Course::Stop(standing),
        }
    }

    /// Measurements at this stop. A test may change them.
    pub(crate) fn standing_mut(&mut self) -> &mut Standing<f64> {
        match &mut self.course {
            Course::Stop(standing) => standing,
            Course::Move(_) => panic!("a move"),
        }
    }

    /// The mean force of this stop, m/s^2.
    pub(crate) fn force_a(&self) -> Vector3<f64> {
        self.standing().expect("a stop").force_a
    }
}
