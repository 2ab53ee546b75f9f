//! A block holds the sums over 0.1 s of samples.
//!
//! Rates and forces are summed as deviations from the sample before the block. The deviations are small while the axes
//! are at rest. In `f32` the difference of two nearly equal numbers is exact, so plain sums are as accurate as
//! compensated sums.
//!
//! While both axes are at rest, the angles o (outer) and i (inner) are summed as whole ticks. The integrals for (M3)
//! are computed once, at the end of the block, from the mean angles and from the area A that the angles enclose:
//! ```text
//! integral of cos i do = cos(mean i) o - sin(mean i) A,   A = integral of (i - mean i) do
//! integral of sin i do = sin(mean i) o + cos(mean i) A
//! ```
//! The neglected terms are of third order, 1e-12 rad for 20 arcsec. From the first sample outside the range `still_rad`
//! on, sines and cosines are computed for the angles of every sample.

use super::increments::Increments;
use super::readings::{Readings, Steps};
use super::scatter::BlockMeans;
use super::types::{HarmonicSums, Held};
use crate::base::angle::{Angle, RAD_PER_TICK, ticks_to_rad};
use crate::base::linear::{Real, Vector3, real};
use crate::base::sample::{CHANNELS, RawSample};
use crate::base::units::seconds;
use core::mem;

/// Number of samples for which each channel has kept the same value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Runs([u16; CHANNELS]);

impl Runs {
    pub(super) const NONE: Self = Self([0; CHANNELS]);

    /// Counts a sample. Pulse outputs do repeat, so they are not reported as held once they are known.
    fn step<T: Real>(
        &mut self,
        previous: &RawSample<T>,
        sample: &RawSample<T>,
        increments: &Increments,
        held: &mut Held,
    ) {
        let before = previous.force_a.as_slice().iter().chain(previous.omega_g.as_slice());
        let now = sample.force_a.as_slice().iter().chain(sample.omega_g.as_slice());
        let mut stale = true;
        for ((channel, run), (before, now)) in (0_u8..).zip(&mut self.0).zip(before.zip(now)) {
            if before == now {
                *run = run.saturating_add(1);
                if !increments.are_known(channel) {
                    held.merge(Held { samples: *run, channel, stale: 0 });
                }
            } else {
                (*run, stale) = (0, false);
            }
        }
        held.stale = held.stale.saturating_add(stale.into());
    }
}

/// Sine and cosine of the last angle. The cache saves time because often one axis is at rest while the other axis
/// turns.
#[derive(Clone, Copy, Debug)]
struct CachedSinCos<T>(Option<(Angle, T, T)>);

impl<T: Real> CachedSinCos<T> {
    fn at(&mut self, angle: Angle) -> (T, T) {
        match self.0 {
            Some((last, sin, cos)) if last == angle => (sin, cos),
            _ => {
                let (sin, cos) = angle.sin_cos();
                self.0 = Some((angle, sin, cos));
                (sin, cos)
            }
        }
    }
}

/// State that one block passes on to the next block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried<T> {
    runs: Runs,
    /// Increments of the outer and the inner angle over the previous interval, ticks.
    turned: [i32; 2],
    steps: [Steps; 2],
    increments: Increments,
    outer: CachedSinCos<T>,
    inner: CachedSinCos<T>,
}

impl<T: Real> Carried<T> {
    pub(super) const NONE: Self = Self {
        runs: Runs::NONE,
        turned: [0; 2],
        steps: [Steps::UNKNOWN; 2],
        increments: Increments::UNKNOWN,
        outer: CachedSinCos(None),
        inner: CachedSinCos(None),
    };

    /// Resolutions of the outer and the inner encoder, ticks; 0 for a resolution that is not known yet.
    pub(super) fn resolution_ticks(&self) -> [u32; 2] {
        self.steps.map(|steps| steps.resolution_ticks())
    }

    /// Increments of the outputs per channel, m/s^2 and rad/s; 0 for a channel whose output is not known to be pulses.
    pub(super) fn increments(&self) -> [f32; CHANNELS] {
        self.increments.known()
    }

    /// Stores the increments, ticks, that end at these angles. Returns the increments of the previous interval.
    fn turn(&mut self, increments: [i32; 2], angles: [Angle; 2]) -> [i32; 2] {
        for ((steps, angle), increment) in self.steps.iter_mut().zip(angles).zip(increments) {
            if increment == 0 {
                steps.hold(angle);
            }
        }
        mem::replace(&mut self.turned, increments)
    }

    /// Sines and cosines of the outer and the inner angle.
    fn trigonometry(&mut self, [outer, inner]: [Angle; 2]) -> [(T, T); 2] {
        [self.outer.at(outer), self.inner.at(inner)]
    }
}

/// Sums of the readings of one encoder, as offsets from the first angle of the block, the stop or the move.
#[derive(Clone, Copy, Debug)]
pub(super) struct AngleSums {
    pub(super) begun: Angle,
    pub(super) last: Angle,
    pub(super) count: u32,
    offset_ticks: i64,
    /// Sum of the increments from sample to sample. Each increment is taken the shorter way round.
    pub(super) turned_ticks: i64,
    /// Sum of the squares of the second differences, ticks^2.
    jumps_ticks2: f32,
}

impl AngleSums {
    pub(super) const NONE: Self = Self::at(Angle::from_ticks(0));

    const fn at(begun: Angle) -> Self {
        Self { begun, last: begun, count: 0, offset_ticks: 0, turned_ticks: 0, jumps_ticks2: 0.0 }
    }

    fn add(&mut self, angle: Angle, offset_ticks: i32, increment_ticks: i32, before_ticks: i32) {
        let jump_ticks = increment_ticks.wrapping_sub(before_ticks) as f32;
        self.last = angle;
        self.count += 1;
        self.offset_ticks += i64::from(offset_ticks);
        self.turned_ticks += i64::from(increment_ticks);
        self.jumps_ticks2 += jump_ticks * jump_ticks;
    }

    pub(super) fn merge(&mut self, later: &Self) {
        if self.count == 0 {
            *self = *later;
        } else {
            self.offset_ticks += later.offset_ticks + i64::from(later.count) * i64::from(later.begun.since(self.begun));
            self.count += later.count;
            self.last = later.last;
            self.turned_ticks += later.turned_ticks;
            self.jumps_ticks2 += later.jumps_ticks2;
        }
    }

    /// Mean offset from the first angle. The mean of 32-bit offsets fits into 32 bits.
    fn mean_ticks(&self) -> i32 {
        self.offset_ticks.checked_div(self.count.into()).unwrap_or(0) as i32
    }

    pub(super) fn mean(&self) -> Angle {
        self.begun.turned(self.mean_ticks())
    }

    /// Quality of single readings. The resolution is not known here and is left at 0.
    pub(super) fn readings(&self) -> Readings {
        Readings { jumps_ticks2: self.jumps_ticks2, count: self.count, resolution_ticks: 0 }
    }
}

/// Integrals over the gimbal angles of a block, as in [`super::Turned`] and [`super::AngleIntegrals`]. While
/// both axes are at rest, the integrals stay zero until the block ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Integrals<T> {
    pub(super) attitude_s: [[T; 3]; 3],
    pub(super) outer_cos_inner: T,
    pub(super) outer_sin_inner: T,
    pub(super) late_cos_inner_s: T,
    pub(super) late_sin_inner_s: T,
    pub(super) harmonics: HarmonicSums,
}

/// An interval between two samples over which an axis turns.
struct Turn<T> {
    duration_s: T,
    /// Time from the start of the block to the middle of the interval, s.
    since_s: T,
    /// Increments of the outer and the inner angle, rad.
    turned: [T; 2],
    /// One twelfth of: outer rate times inner acceleration, minus inner rate times outer acceleration, rad^2.
    swerve: T,
}

impl<T: Real> Integrals<T> {
    const ZERO: Self = Self {
        attitude_s: [[T::ZERO; 3]; 3],
        outer_cos_inner: T::ZERO,
        outer_sin_inner: T::ZERO,
        late_cos_inner_s: T::ZERO,
        late_sin_inner_s: T::ZERO,
        harmonics: HarmonicSums::ZERO,
    };

    fn add_attitude(&mut self, duration_s: T, [(so, co), (si, ci)]: [(T, T); 2]) {
        let columns = [duration_s, duration_s * co, duration_s * so];
        for (row, inner) in self.attitude_s.iter_mut().zip([T::one(), ci, si]) {
            for (sum, column) in row.iter_mut().zip(columns) {
                *sum += inner * column;
            }
        }
    }

    fn add_harmonics(&mut self, [outer, inner]: [(T, T); 2], turned: T) {
        let single = |(sin, cos): (T, T)| (sin.widened() as f32, cos.widened() as f32);
        self.harmonics.add(single(outer), single(inner), turned.widened() as f32);
    }

    fn add_turn(&mut self, turn: &Turn<T>, trigonometry: [(T, T); 2]) {
        self.add_attitude(turn.duration_s, trigonometry);
        let ([outer, inner], [_, (si, ci)]) = (turn.turned, trigonometry);
        // The mean of cosine and sine over an interval with constant rate, from their values in the middle of the
        // interval.
        let outer = outer * (T::one() - inner * inner / real(24.0));
        // The effect of the accelerations to the same order, at the sample between the previous interval and this
        // interval.
        let half = inner * real(0.5);
        let (cos, sin) = (ci * outer, si * outer);
        self.outer_cos_inner += cos + (si - ci * half) * turn.swerve;
        self.outer_sin_inner += sin - (ci + si * half) * turn.swerve;
        self.late_cos_inner_s += cos * turn.since_s;
        self.late_sin_inner_s += sin * turn.since_s;
        if outer != T::zero() {
            self.add_harmonics(trigonometry, outer);
        }
    }
}

/// Plain sums over 0.1 s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<T: Real> {
    /// Time of the last sample before the block, us.
    pub(super) start_us: u64,
    pub(super) duration_us: u64,
    pub(super) longest_interval_us: u64,
    pub(super) held: Held,
    pub(super) temperature_c: f32,
    before: [Vector3<T>; 2],
    /// Deviations from `before`: the sum over the forces, and the integral of the rates over time.
    deviations: [Vector3<T>; 2],
    pub(super) outer: AngleSums,
    pub(super) inner: AngleSums,
    ranges_ticks: [(i32, i32); 2],
    still: bool,
    /// Twelve times the area that the angles enclose about their first values, ticks^2.
    area12_ticks2: i64,
    pub(super) integrals: Integrals<T>,
}

impl<T: Real> Block<T> {
    /// A block that begins after this sample. The sample is not part of the block.
    pub(super) fn after(before: &RawSample<T>) -> Self {
        Self {
            start_us: before.time_us,
            duration_us: 0,
            longest_interval_us: 0,
            held: Held::NONE,
            temperature_c: 0.0,
            before: [before.force_a, before.omega_g],
            deviations: [Vector3::zeros(); 2],
            outer: AngleSums::at(before.outer),
            inner: AngleSums::at(before.inner),
            ranges_ticks: [(0, 0); 2],
            still: true,
            area12_ticks2: 0,
            integrals: Integrals::ZERO,
        }
    }

    pub(super) fn add(
        &mut self,
        previous: &RawSample<T>,
        sample: &RawSample<T>,
        still_ticks: i32,
        carried: &mut Carried<T>,
    ) {
        let interval_us = sample.time_us.saturating_sub(previous.time_us);
        let interval_s = seconds::<T>(interval_us);
        carried.runs.step(previous, sample, &carried.increments, &mut self.held);
        self.temperature_c += sample.temperature_c;
        self.add_deviations(previous, sample, interval_s);
        self.add_angles(previous, sample, interval_us, still_ticks, carried);
        self.duration_us += interval_us;
        self.longest_interval_us = self.longest_interval_us.max(interval_us);
    }

    fn add_deviations(&mut self, previous: &RawSample<T>, sample: &RawSample<T>, interval_s: T) {
        let ([force_before, rate_before], [force, rotation]) = (&self.before, &mut self.deviations);
        *force += sample.force_a - force_before;
        // Trapezoidal rule. The axes are at rest at both ends of a segment, so the rule is exact for mean rates. It
        // does not matter whether the time stamp is the start, the middle or the end of the averaging interval.
        let twice = (previous.omega_g - rate_before) + (sample.omega_g - rate_before);
        *rotation += twice * (interval_s * real(0.5));
    }

    fn add_angles(
        &mut self,
        previous: &RawSample<T>,
        sample: &RawSample<T>,
        interval_us: u64,
        still_ticks: i32,
        carried: &mut Carried<T>,
    ) {
        let increments = [sample.outer.since(previous.outer), sample.inner.since(previous.inner)];
        let offsets = [sample.outer.since(self.outer.begun), sample.inner.since(self.inner.begun)];
        let [outer_ticks, inner_ticks] = increments.map(i64::from);
        let before = carried.turn(increments, [sample.outer, sample.inner]);
        let [outer_before, inner_before] = before.map(i64::from);
        let swerve_ticks2 = (inner_ticks * outer_before).saturating_sub(inner_before * outer_ticks);
        if self.still && !self.keep_still(offsets, still_ticks) {
            self.set_integrals_at_rest(carried);
            self.still = false;
            carried.increments.end_rest();
        }
        if self.still {
            carried.increments.step(previous, sample);
            let [_, offset] = offsets.map(i64::from);
            self.area12_ticks2 += (2 * offset - inner_ticks) * outer_ticks * 6 - swerve_ticks2;
        } else {
            let middles = [previous.outer.turned(increments[0] / 2), previous.inner.turned(increments[1] / 2)];
            let turn = Turn {
                duration_s: seconds(interval_us),
                since_s: seconds(self.duration_us + interval_us / 2),
                turned: increments.map(|ticks| ticks_to_rad(ticks.into())),
                swerve: swerve_rad2(swerve_ticks2),
            };
            self.integrals.add_turn(&turn, carried.trigonometry(middles));
        }
        self.outer.add(sample.outer, offsets[0], increments[0], before[0]);
        self.inner.add(sample.inner, offsets[1], increments[1], before[1]);
    }

    /// Widens the ranges of the angles. Returns whether both ranges are still within `still_ticks`.
    fn keep_still(&mut self, offsets: [i32; 2], still_ticks: i32) -> bool {
        let mut still = true;
        for ((low, high), offset) in self.ranges_ticks.iter_mut().zip(offsets) {
            (*low, *high) = ((*low).min(offset), (*high).max(offset));
            still &= high.saturating_sub(*low) <= still_ticks;
        }
        still
    }

    /// Sets the integrals over the samples so far. Both axes were at rest over these samples.
    fn set_integrals_at_rest(&mut self, carried: &mut Carried<T>) {
        let trigonometry = carried.trigonometry([self.outer.mean(), self.inner.mean()]);
        let [_, (si, ci)] = trigonometry;
        let duration_s = seconds::<T>(self.duration_us);
        let outer: T = ticks_to_rad(self.outer.turned_ticks);
        let about_mean = self.area12_ticks2 - 12 * i64::from(self.inner.mean_ticks()) * self.outer.turned_ticks;
        let area = swerve_rad2(about_mean);
        let integrals = &mut self.integrals;
        integrals.add_attitude(duration_s, trigonometry);
        (integrals.outer_cos_inner, integrals.outer_sin_inner) = (ci * outer - si * area, si * outer + ci * area);
        let since_s = duration_s * real(0.5);
        (integrals.late_cos_inner_s, integrals.late_sin_inner_s) = (ci * outer * since_s, si * outer * since_s);
        integrals.add_harmonics(trigonometry, outer);
    }

    /// Completes the integrals when the last sample has been added.
    pub(super) fn close(&mut self, carried: &mut Carried<T>) {
        if self.still {
            self.set_integrals_at_rest(carried);
        }
    }

    /// Whether both angles stayed within `still_ticks`.
    pub(super) fn is_still(&self) -> bool {
        self.still
    }

    /// Number of samples.
    pub(super) fn samples(&self) -> u32 {
        self.outer.count
    }

    /// Sum of the forces in two parts: the part common to all samples, and the deviations from the common part.
    pub(super) fn force_parts(&self) -> [Vector3<T>; 2] {
        let ([common, _], [deviations, _]) = (self.before, self.deviations);
        [common * real::<T>(self.samples().into()), deviations]
    }

    /// Integral of the rates over time, in the same two parts.
    pub(super) fn rotation_parts(&self) -> [Vector3<T>; 2] {
        let ([_, common], [_, deviations]) = (self.before, self.deviations);
        [common * seconds::<T>(self.duration_us), deviations]
    }

    /// What each gyro has turned, rad, and the time of it, s.
    pub(super) fn turned_g(&self) -> ([f32; 3], f32) {
        let [common, deviations] = self.rotation_parts();
        let single = |value: T| value.widened() as f32;
        ((common + deviations).map(single).into(), single(seconds(self.duration_us)))
    }

    /// Means of the block. Angles are relative to `outer` and `inner`, the angles where the stop began.
    pub(super) fn means(&self, outer: Angle, inner: Angle) -> BlockMeans<T> {
        let ([force, rate], [force_sum, rotation]) = (self.before, self.deviations);
        let count: T = real(self.samples().max(1).into());
        let duration_s = seconds::<T>(self.duration_us.max(1));
        let since = |angles: &AngleSums, begun| ticks_to_rad(angles.mean().since(begun).into());
        BlockMeans {
            force: (force + force_sum / count).into(),
            rate: (rate + rotation / duration_s).into(),
            angles: [since(&self.outer, outer), since(&self.inner, inner)],
            axis_rates: [self.outer, self.inner].map(|angles| ticks_to_rad::<T>(angles.turned_ticks) / duration_s),
        }
    }
}

/// Converts twelve times an area, ticks^2, to the area, rad^2.
fn swerve_rad2<T: Real>(ticks2: i64) -> T {
    ticks_to_rad::<T>(ticks2) * real(RAD_PER_TICK / 12.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::ARCSEC;
    use core::f64::consts::TAU;

    /// A block of 20 samples in which the two angles pass twice round a circle.
    fn circling(still_ticks: i32) -> Block<f64> {
        let at = |sample: u32| {
            let phase = TAU * f64::from(sample) / 10.0;
            let radius = 8.0 * ARCSEC;
            let (outer, inner) = (0.7 + radius * phase.cos(), -0.4 + radius * phase.sin());
            let time_us = u64::from(sample) * 5000;
            RawSample { time_us, outer: Angle::from_rad(outer), inner: Angle::from_rad(inner), ..RawSample::default() }
        };
        let (mut block, mut carried) = (Block::after(&at(0)), Carried::NONE);
        for sample in 1..=20 {
            block.add(&at(sample - 1), &at(sample), still_ticks, &mut carried);
        }
        block.close(&mut carried);
        block
    }

    #[test]
    fn integrals_at_rest_equal_integrals_of_turning_axes() {
        let (standing, turning) = (circling(i32::MAX), circling(0));
        assert!(standing.is_still() && !turning.is_still());
        let (standing, turning) = (standing.integrals, turning.integrals);
        // The area, including the swerve terms: 20 steps of one tenth of a circle.
        let area = 20.0 * 0.5 * (8.0 * ARCSEC).powi(2) * (TAU / 10.0).sin();
        assert!(turning.outer_cos_inner.abs() > 0.3 * area);
        for (standing, turning) in
            [(standing.outer_cos_inner, turning.outer_cos_inner), (standing.outer_sin_inner, turning.outer_sin_inner)]
        {
            assert!((standing - turning).abs() < 1e-5 * area, "{standing} {turning}");
        }
        let attitudes = standing.attitude_s.iter().flatten().zip(turning.attitude_s.iter().flatten());
        for (standing, turning) in attitudes {
            // The second-order difference is 0.1 s (8 arcsec)^2 / 2.
            assert!((standing - turning).abs() < 1e-10, "{standing} {turning}");
        }
    }
}
