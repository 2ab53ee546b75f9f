//! The types of a segment: a stop or a move with its sufficient sums, the unit of information from sampling to report.

use super::readings::Readings;
use super::scatter::Scatter;
use crate::base::angle::{Angle, rad_to_ticks};
use crate::base::linear::{Real, Vector3};
use crate::base::units::seconds;
use serde::{Deserialize, Serialize};

/// A stop with a longer gap between two samples may hide a move and back; a move with one has lost rotation.
pub const LONGEST_GAP_US: u64 = 100_000;

/// Stop or move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SegmentKind {
    /// Both axes stand.
    Stop,
    /// One or both axes turn, with the settling before and after.
    Move,
}

/// A finished stop or move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<T: Real> {
    /// Time of the sample before the first, us.
    pub start_us: u64,
    /// Duration, us.
    pub duration_us: u64,
    /// Number of samples.
    pub samples: u32,
    /// Longest interval between two samples, us; 2^32 - 1, which is 71 minutes, for a longer one.
    pub longest_interval_us: u32,
    /// Readings that repeat.
    pub held: Held,
    /// Mean IMU temperature, deg C.
    pub temperature_c: f32,
    /// Integral of the gyro outputs over time, rad.
    pub rotation_g: Vector3<T>,
    /// Outer angle: mean of a stop, last of a move.
    pub outer: Angle,
    /// Inner angle: mean of a stop, last of a move.
    pub inner: Angle,
    /// What the axes turn; at a stop, by their hunting.
    pub turned: Turned<T>,
    /// Stop or move, with what only that has.
    pub course: Course<T>,
}

impl<T: Real> Segment<T> {
    /// Stop or move.
    pub fn kind(&self) -> SegmentKind {
        match self.course {
            Course::Stop(_) => SegmentKind::Stop,
            Course::Move(_) => SegmentKind::Move,
        }
    }

    /// What is measured at a stop; `None` for a move.
    pub fn standing(&self) -> Option<&Standing<T>> {
        match &self.course {
            Course::Stop(standing) => Some(standing),
            Course::Move(_) => None,
        }
    }

    /// Integrals over the angles. At a stop these are as good as constant, and an encoder error is the same at both ends.
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

    /// Inner angle at the beginning.
    pub fn inner_from(&self) -> Angle {
        self.inner.turned(-rad_to_ticks(self.turned.inner.widened()) as i32)
    }

    /// Duration, s.
    pub fn duration_s(&self) -> T {
        seconds(self.duration_us)
    }

    /// Notes the resolutions of the encoders, ticks, which later segments may show better.
    pub fn know_resolution(&mut self, resolution_ticks: [u32; 2]) {
        let Course::Stop(standing) = &mut self.course else { return };
        for (readings, resolution_ticks) in standing.readings.iter_mut().zip(resolution_ticks) {
            readings.resolution_ticks = resolution_ticks;
        }
    }

    /// Whether samples are missing for so long that the sums are not those of a stop or a move.
    pub fn is_broken(&self) -> bool {
        u64::from(self.longest_interval_us) > LONGEST_GAP_US
    }
}

/// What a segment has of its kind alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Course<T: Real> {
    /// Both axes stand.
    Stop(Standing<T>),
    /// One or both axes turn.
    Move(AngleIntegrals<T>),
}

/// What is measured while both axes stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing<T: Real> {
    /// Mean of the accelerometer outputs, m/s^2.
    pub force_a: Vector3<T>,
    /// Scatter of the block means.
    pub scatter: Scatter,
    /// Readings of outer and inner encoder.
    pub readings: [Readings; 2],
}

/// What the axes turn over a segment, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Turned<T> {
    /// Outer increment.
    pub outer: T,
    /// Inner increment.
    pub inner: T,
    /// Integral of cos(inner) over the outer angle.
    pub outer_cos_inner: T,
    /// Integral of sin(inner) over the outer angle.
    pub outer_sin_inner: T,
}

/// Further sums over the gimbal angles, with [`Turned`] enough for the integrals of (3) with any non-perpendicularity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AngleIntegrals<T> {
    /// Integral of (1, cos, sin)(inner) x (1, cos, sin)(outer) over time, s: row inner, column outer. They weight Earth
    /// rate, so `f32` is good for 0.0002" of a stop of 200 s, and saves memory where many segments are kept.
    pub attitude_s: [[f32; 3]; 3],
    /// As [`Turned::outer_cos_inner`], weighted with the time since the segment's start, rad s.
    pub late_cos_inner_s: T,
    /// As [`Turned::outer_sin_inner`], weighted with the time since the segment's start, rad s.
    pub late_sin_inner_s: T,
    /// For harmonics of the encoder errors.
    pub harmonics: HarmonicSums,
}

/// Integrals over the outer angle, rad, with which harmonics of the encoder errors act on a move. A hundredth of an error of
/// some arcsec is good enough, so `f32` and no compensation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HarmonicSums {
    /// Of (cos, sin)(inner) x (cos, sin, cos of the double, sin of the double)(outer).
    pub outer: [[f32; 4]; 2],
    /// Of cos and sin of twice and of three times the inner angle.
    pub inner: [f32; 4],
}

impl HarmonicSums {
    /// None.
    pub const ZERO: Self = Self { outer: [[0.0; 4]; 2], inner: [0.0; 4] };

    /// Adds a step of the outer angle, rad, at these sines and cosines of outer and inner angle.
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

/// Readings that repeat to the last bit, which noise does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// Longest run of samples over which one channel stayed the same.
    pub samples: u16,
    /// That channel.
    pub channel: u8,
    /// Samples whose six channels were all those of the sample before.
    pub stale: u16,
}

impl Held {
    /// Nothing repeats.
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
    /// A level stop at (0, 0) without noise, of samples at 200 Hz.
    pub(crate) fn quiet_stop(duration_us: u64) -> Self {
        let blocks = (duration_us / 100_000) as u16;
        let standing = Standing {
            force_a: Vector3::new(0.0, 0.0, 9.8),
            scatter: Scatter { blocks, freedom: blocks - 1, ..Scatter::default() },
            readings: [Readings::NONE; 2],
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

    /// What is measured at this stop, to be spoilt.
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
