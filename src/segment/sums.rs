//! Sums over the blocks of a stop or a move. A segment is made from these sums.

use super::block::{AngleSums, Block};
use super::scatter::Scatter;
use super::types::{AngleIntegrals, Course, GyroPath, HarmonicSums, Held, Segment, Standing, Turned};
use crate::base::angle::{Angle, ticks_to_rad};
use crate::base::linear::{CompensatedSum, Real, Vector3, real};
use crate::base::sample::CHANNELS;
use crate::base::units::seconds;

/// Sums over many blocks. The sums are compensated, so that in `f32` a sum over one hour is as accurate as over a
/// block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums<T> {
    start_us: u64,
    duration_us: u64,
    pub(super) longest_interval_us: u64,
    held: Held,
    temperature_c: f32,
    rotation: [CompensatedSum<T>; 3],
    force: [CompensatedSum<T>; 3],
    outer_cos_inner: CompensatedSum<T>,
    outer_sin_inner: CompensatedSum<T>,
    pub(super) outer: AngleSums,
    pub(super) inner: AngleSums,
}

impl<T: Real> Sums<T> {
    pub(super) const ZERO: Self = Self {
        start_us: 0,
        duration_us: 0,
        longest_interval_us: 0,
        held: Held::NONE,
        temperature_c: 0.0,
        rotation: [CompensatedSum::ZERO; 3],
        force: [CompensatedSum::ZERO; 3],
        outer_cos_inner: CompensatedSum::ZERO,
        outer_sin_inner: CompensatedSum::ZERO,
        outer: AngleSums::NONE,
        inner: AngleSums::NONE,
    };

    pub(super) fn samples(&self) -> u32 {
        self.outer.count
    }

    pub(super) fn is_empty(&self) -> bool {
        self.samples() == 0
    }

    /// Adds the block that follows the last block.
    pub(super) fn add(&mut self, block: &Block<T>) {
        if self.is_empty() {
            self.start_us = block.start_us;
        }
        self.duration_us += block.duration_us;
        self.longest_interval_us = self.longest_interval_us.max(block.longest_interval_us);
        self.held.merge(block.held);
        self.temperature_c += block.temperature_c;
        block.rotation_parts().iter().for_each(|part| add_each(&mut self.rotation, part.as_slice()));
        block.force_parts().iter().for_each(|part| add_each(&mut self.force, part.as_slice()));
        self.outer_cos_inner.add(block.integrals.outer_cos_inner);
        self.outer_sin_inner.add(block.integrals.outer_sin_inner);
        self.outer.merge(&block.outer);
        self.inner.merge(&block.inner);
    }

    /// The stop, with the scatter of its block means.
    pub(super) fn stop(&self, scatter: Scatter) -> Segment<T> {
        let count: T = real(f64::from(self.samples().max(1)));
        let standing = Standing {
            force_a: totals(&self.force) / count,
            scatter,
            readings: [self.outer, self.inner].map(|angles| angles.readings()),
            increments: [0.0; CHANNELS],
        };
        self.segment([self.outer.mean(), self.inner.mean()], Course::Stop(standing))
    }

    pub(super) fn segment(&self, [outer, inner]: [Angle; 2], course: Course<T>) -> Segment<T> {
        Segment {
            start_us: self.start_us,
            duration_us: self.duration_us,
            samples: self.samples(),
            longest_interval_us: u32::try_from(self.longest_interval_us).unwrap_or(u32::MAX),
            held: self.held,
            temperature_c: self.temperature_c / self.samples().max(1) as f32,
            rotation_g: totals(&self.rotation),
            outer,
            inner,
            turned: Turned {
                outer: ticks_to_rad(self.outer.turned_ticks),
                inner: ticks_to_rad(self.inner.turned_ticks),
                outer_cos_inner: self.outer_cos_inner.total(),
                outer_sin_inner: self.outer_sin_inner.total(),
            },
            course,
        }
    }
}

/// Sums over the blocks of a move, with the integrals that only a move has.
#[derive(Clone, Copy, Debug)]
pub(super) struct MoveSums<T> {
    pub(super) all: Sums<T>,
    attitude: [[CompensatedSum<T>; 3]; 3],
    late_cos_inner_s: CompensatedSum<T>,
    late_sin_inner_s: CompensatedSum<T>,
    harmonics: HarmonicSums,
    gyro_path: GyroPath,
}

impl<T: Real> MoveSums<T> {
    pub(super) const ZERO: Self = Self {
        all: Sums::ZERO,
        attitude: [[CompensatedSum::ZERO; 3]; 3],
        late_cos_inner_s: CompensatedSum::ZERO,
        late_sin_inner_s: CompensatedSum::ZERO,
        harmonics: HarmonicSums::ZERO,
        gyro_path: GyroPath::ZERO,
    };

    /// Adds the block that follows the last block.
    pub(super) fn add(&mut self, block: &Block<T>) {
        let integrals = &block.integrals;
        for (row, block) in self.attitude.iter_mut().zip(&integrals.attitude_s) {
            add_each(row, block);
        }
        let since_s = seconds::<T>(self.all.duration_us);
        self.late_cos_inner_s.add(integrals.late_cos_inner_s + integrals.outer_cos_inner * since_s);
        self.late_sin_inner_s.add(integrals.late_sin_inner_s + integrals.outer_sin_inner * since_s);
        self.harmonics.merge(&integrals.harmonics);
        let (turned_rad, duration_s) = block.turned_g();
        self.gyro_path.add(turned_rad, duration_s);
        self.all.add(block);
    }

    pub(super) fn segment(&self) -> Segment<T> {
        let single = |sum: CompensatedSum<T>| sum.total().widened() as f32;
        let integrals = AngleIntegrals {
            attitude_s: self.attitude.map(|row| row.map(single)),
            late_cos_inner_s: self.late_cos_inner_s.total(),
            late_sin_inner_s: self.late_sin_inner_s.total(),
            harmonics: self.harmonics,
            gyro_path: self.gyro_path,
        };
        self.all.segment([self.all.outer.last, self.all.inner.last], Course::Move(integrals))
    }
}

pub(super) fn add_each<T: Real>(sums: &mut [CompensatedSum<T>; 3], terms: &[T]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        sum.add(*term);
    }
}

pub(super) fn totals<T: Real>(sums: &[CompensatedSum<T>; 3]) -> Vector3<T> {
    Vector3::from(sums.map(|sum| sum.total()))
}
