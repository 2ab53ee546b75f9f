//! Segments: a stop or a move with its sufficient sums, the unit of information from sampling to report.
//!
//! The parameters are constant, so while samples arrive only sums are kept. Stops and moves are found from the encoder
//! angles alone, with no knowledge of the scheme:
//!
//! ```text
//! angle  ________                       ____________
//!                \_____________________/
//!        ...b b b|m m m ... m m m|s s s|b b ...|b b b|m m
//!          stop  |g|     move      |settle|  stop   |guard, part of the next move
//! ```
//! Samples are summed over blocks of 0.1 s. A block is still if both angles keep within `still_rad` over it. A move ends
//! with three still blocks in a row (settling); a stop ends three blocks before the first that is not still (guard). So
//! a move's window reaches from inside one stop to inside the next, and no ramp touches a stop.

use crate::angle::{Angle, RAD_PER_TICK, rad_to_ticks, ticks_to_rad};
use crate::linear::{CompensatedSum, Real, Vector3, real};
use crate::reading::{Readings, Steps};
use crate::sample::{CHANNELS, RawSample};
use crate::scatter::{BlockMeans, Scatter, ScatterSums};
use crate::units::{ARCSEC, seconds};
use core::mem;
use serde::{Deserialize, Serialize};

/// Length of a block, us.
const BLOCK_US: u64 = 100_000;
/// Blocks of settling after a move, and of guard before the next.
const GUARD_BLOCKS: u8 = 3;
/// The same, s.
pub const GUARD_S: f64 = GUARD_BLOCKS as f64 * BLOCK_US as f64 * 1e-6;
/// A stop with a longer gap between two samples may hide a move and back; a move with one has lost rotation.
pub const LONGEST_GAP_US: u64 = 100_000;

/// How motion of the axes is recognized.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stillness {
    /// Range of an encoder angle over 0.1 s, and distance from where the stop began, up to which an axis stands, rad.
    /// Must exceed the encoder's noise and resolution; 20 arcsec are passed within 25 ms of a 20 deg/s^2 ramp.
    pub still_rad: f64,
}

impl Default for Stillness {
    fn default() -> Self {
        Self { still_rad: 20.0 * ARCSEC }
    }
}

/// Stop or move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SegmentKind {
    /// Both axes stand.
    Stop,
    /// One or both axes turn, with the settling before and after.
    Move,
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

    fn merge(&mut self, other: &Self) {
        let others = other.outer.iter().flatten().chain(&other.inner);
        self.outer.iter_mut().flatten().chain(&mut self.inner).zip(others).for_each(|(sum, other)| *sum += other);
    }
}

/// Sums over the gimbal angles of a segment, from which the integrals of (3) follow for any non-perpendicularity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GimbalSums<T> {
    /// Integral of (1, cos, sin)(inner) x (1, cos, sin)(outer) over time, s: row inner, column outer. They weight Earth
    /// rate, so `f32` is good for 0.0002" of a stop of 200 s, and saves memory where many segments are kept.
    pub attitude_s: [[f32; 3]; 3],
    /// Integral of cos(inner) over the outer angle, rad.
    pub outer_cos_inner: T,
    /// Integral of sin(inner) over the outer angle, rad.
    pub outer_sin_inner: T,
    /// The same two, each weighted with the time since the segment's start, rad s.
    pub late_cos_inner_s: T,
    /// See [`Self::late_cos_inner_s`].
    pub late_sin_inner_s: T,
    /// Outer increment, rad.
    pub outer: T,
    /// Inner increment, rad.
    pub inner: T,
    /// For harmonics of the encoder errors.
    pub harmonics: HarmonicSums,
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

    fn merge(&mut self, other: Self) {
        if other.samples > self.samples {
            (self.samples, self.channel) = (other.samples, other.channel);
        }
        self.stale = self.stale.saturating_add(other.stale);
    }
}

/// For how many samples each channel has stayed the same.
#[derive(Clone, Copy, Debug)]
struct Runs([u16; CHANNELS]);

impl Runs {
    const NONE: Self = Self([0; CHANNELS]);

    fn step<T: Real>(&mut self, previous: &RawSample<T>, sample: &RawSample<T>) -> Held {
        let before = previous.force_a.as_slice().iter().chain(previous.omega_g.as_slice());
        let now = sample.force_a.as_slice().iter().chain(sample.omega_g.as_slice());
        let mut held = Held { stale: 1, ..Held::default() };
        for ((channel, run), (before, now)) in (0_u8..).zip(&mut self.0).zip(before.zip(now)) {
            if before == now {
                *run = run.saturating_add(1);
                held.merge(Held { samples: *run, channel, stale: 0 });
            } else {
                *run = 0;
                held.stale = 0;
            }
        }
        held
    }
}

/// A finished stop or move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<T: Real> {
    /// Stop or move.
    pub kind: SegmentKind,
    /// Time of the sample before the first, us.
    pub start_us: u64,
    /// Duration, us.
    pub duration_us: u64,
    /// Number of samples.
    pub samples: u32,
    /// Longest interval between two samples, us.
    pub longest_interval_us: u64,
    /// Readings that repeat.
    pub held: Held,
    /// Mean IMU temperature, deg C.
    pub temperature_c: f32,
    /// Integral of the gyro outputs over time, rad.
    pub rotation_g: Vector3<T>,
    /// Mean of the accelerometer outputs, m/s^2.
    pub force_a: Vector3<T>,
    /// Outer angle: mean of a stop, last of a move.
    pub outer: Angle,
    /// Inner angle: mean of a stop, last of a move.
    pub inner: Angle,
    /// Gimbal sums.
    pub gimbals: GimbalSums<T>,
    /// Scatter of a stop's block means.
    pub scatter: Scatter,
    /// Readings of outer and inner encoder.
    pub readings: [Readings; 2],
}

impl<T: Real> Segment<T> {
    /// Duration, s.
    pub fn duration_s(&self) -> T {
        seconds(self.duration_us)
    }

    /// Notes the resolutions of the encoders, ticks, which later segments may show better.
    pub fn know_resolution(&mut self, resolution_ticks: [u32; 2]) {
        for (readings, resolution_ticks) in self.readings.iter_mut().zip(resolution_ticks) {
            readings.resolution_ticks = resolution_ticks;
        }
    }

    /// Whether samples are missing for so long that the sums are not those of a stop or a move.
    pub fn is_broken(&self) -> bool {
        self.longest_interval_us > LONGEST_GAP_US
    }
}

/// Mean of an angle as offset from the first.
#[derive(Clone, Copy, Debug)]
struct AngleMean {
    first: Angle,
    last: Angle,
    count: i64,
    offset_ticks: i64,
}

impl AngleMean {
    const ZERO: Self = Self { first: Angle::from_ticks(0), last: Angle::from_ticks(0), count: 0, offset_ticks: 0 };

    fn add(&mut self, angle: Angle) {
        if self.count == 0 {
            self.first = angle;
        }
        self.last = angle;
        self.count += 1;
        self.offset_ticks += i64::from(angle.since(self.first));
    }

    fn merge(&mut self, other: &Self) {
        if self.count == 0 {
            *self = *other;
        } else {
            self.offset_ticks += other.offset_ticks + other.count * i64::from(other.first.since(self.first));
            self.count += other.count;
            self.last = other.last;
        }
    }

    fn mean(&self) -> Angle {
        // A mean of 32-bit offsets fits 32 bits.
        self.first.turned(self.offset_ticks.checked_div(self.count).unwrap_or(0) as i32)
    }
}

/// Sums of one block, or of many.
#[derive(Clone, Copy, Debug)]
struct Sums<T> {
    start_us: u64,
    duration_us: u64,
    samples: u32,
    longest_interval_us: u64,
    held: Held,
    temperature_c: f32,
    rotation: [CompensatedSum<T>; 3],
    force: [CompensatedSum<T>; 3],
    attitude: [[CompensatedSum<T>; 3]; 3],
    outer_cos_inner: CompensatedSum<T>,
    outer_sin_inner: CompensatedSum<T>,
    late_cos_inner_s: CompensatedSum<T>,
    late_sin_inner_s: CompensatedSum<T>,
    harmonics: HarmonicSums,
    outer_ticks: i64,
    inner_ticks: i64,
    outer: AngleMean,
    inner: AngleMean,
    /// Squares of the second differences of the readings, ticks^2.
    jumps_ticks2: [f32; 2],
}

/// Sine and cosine of the last angle asked for: most samples come at rest.
#[derive(Clone, Copy, Debug)]
struct CachedSinCos<T>(Option<(Angle, T, T)>);

impl<T: Real> CachedSinCos<T> {
    const EMPTY: Self = Self(None);

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

/// One interval between two samples: what a block adds up.
struct Interval<T> {
    duration_us: u64,
    held: Held,
    rotation: Vector3<T>,
    outer_ticks: i32,
    inner_ticks: i32,
    sin_cos_outer: (T, T),
    sin_cos_inner: (T, T),
    /// Rate of the outer axis times the inner one's acceleration, less the other way round, ticks^2.
    swerve_ticks2: i64,
    /// How much farther outer and inner axis turned than in the interval before, ticks.
    jumps_ticks: [i32; 2],
}

impl<T: Real> Sums<T> {
    const ZERO: Self = Self {
        start_us: 0,
        duration_us: 0,
        samples: 0,
        longest_interval_us: 0,
        held: Held::NONE,
        temperature_c: 0.0,
        rotation: [CompensatedSum::ZERO; 3],
        force: [CompensatedSum::ZERO; 3],
        attitude: [[CompensatedSum::ZERO; 3]; 3],
        outer_cos_inner: CompensatedSum::ZERO,
        outer_sin_inner: CompensatedSum::ZERO,
        late_cos_inner_s: CompensatedSum::ZERO,
        late_sin_inner_s: CompensatedSum::ZERO,
        harmonics: HarmonicSums::ZERO,
        outer_ticks: 0,
        inner_ticks: 0,
        outer: AngleMean::ZERO,
        inner: AngleMean::ZERO,
        jumps_ticks2: [0.0; 2],
    };

    fn add(&mut self, sample: &RawSample<T>, interval: &Interval<T>) {
        if self.samples == 0 {
            self.start_us = sample.time_us.saturating_sub(interval.duration_us);
        }
        self.samples += 1;
        self.duration_us += interval.duration_us;
        self.longest_interval_us = self.longest_interval_us.max(interval.duration_us);
        self.held.merge(interval.held);
        self.temperature_c += sample.temperature_c;
        add_each(&mut self.rotation, &interval.rotation);
        add_each(&mut self.force, &sample.force_a);
        self.add_gimbals(interval);
        self.outer.add(sample.outer);
        self.inner.add(sample.inner);
        for (sum, jump) in self.jumps_ticks2.iter_mut().zip(interval.jumps_ticks) {
            *sum += jump as f32 * jump as f32;
        }
    }

    fn add_gimbals(&mut self, interval: &Interval<T>) {
        let duration_s = seconds::<T>(interval.duration_us);
        let (so, co) = interval.sin_cos_outer;
        let (si, ci) = interval.sin_cos_inner;
        let columns = [duration_s, duration_s * co, duration_s * so];
        for (row, inner) in self.attitude.iter_mut().zip([T::one(), ci, si]) {
            for (sum, column) in row.iter_mut().zip(columns) {
                sum.add(inner * column);
            }
        }
        if interval.outer_ticks != 0 || interval.swerve_ticks2 != 0 {
            let inner: T = ticks_to_rad(interval.inner_ticks.into());
            // Mean of cosine and sine over an interval that they pass at constant rate, from their value in its middle.
            let mean = T::one() - inner * inner / real(24.0);
            let outer = ticks_to_rad::<T>(interval.outer_ticks.into()) * mean;
            // What the axes' accelerations add, to the same order; at the sample where this interval and the last meet.
            let swerve = ticks_to_rad::<T>(interval.swerve_ticks2) * real(RAD_PER_TICK / 12.0);
            let half = inner * real(0.5);
            self.outer_cos_inner.add(ci * outer + (si - ci * half) * swerve);
            self.outer_sin_inner.add(si * outer - (ci + si * half) * swerve);
            let since_s = seconds::<T>(self.duration_us.saturating_sub(interval.duration_us / 2));
            self.late_cos_inner_s.add(ci * outer * since_s);
            self.late_sin_inner_s.add(si * outer * since_s);
            let single = |(sin, cos): (T, T)| (sin.widened() as f32, cos.widened() as f32);
            self.harmonics.add(single((so, co)), single((si, ci)), outer.widened() as f32);
        }
        self.outer_ticks += i64::from(interval.outer_ticks);
        self.inner_ticks += i64::from(interval.inner_ticks);
    }

    fn merge(&mut self, other: &Self) {
        if self.samples == 0 {
            *self = *other;
            return;
        }
        // The other begins where this one ends.
        let since_s = seconds::<T>(self.duration_us);
        let late = |sum: &CompensatedSum<T>, late_s: &CompensatedSum<T>| late_s.total() + sum.total() * since_s;
        self.late_cos_inner_s.add(late(&other.outer_cos_inner, &other.late_cos_inner_s));
        self.late_sin_inner_s.add(late(&other.outer_sin_inner, &other.late_sin_inner_s));
        self.samples += other.samples;
        self.duration_us += other.duration_us;
        self.longest_interval_us = self.longest_interval_us.max(other.longest_interval_us);
        self.held.merge(other.held);
        self.temperature_c += other.temperature_c;
        merge_each(&mut self.rotation, &other.rotation);
        merge_each(&mut self.force, &other.force);
        for (row, other) in self.attitude.iter_mut().zip(&other.attitude) {
            merge_each(row, other);
        }
        self.outer_cos_inner.merge(&other.outer_cos_inner);
        self.outer_sin_inner.merge(&other.outer_sin_inner);
        self.harmonics.merge(&other.harmonics);
        self.outer_ticks += other.outer_ticks;
        self.inner_ticks += other.inner_ticks;
        self.outer.merge(&other.outer);
        self.inner.merge(&other.inner);
        for (sum, other) in self.jumps_ticks2.iter_mut().zip(other.jumps_ticks2) {
            *sum += other;
        }
    }

    /// Of a block of a stop that began at these angles.
    fn means(&self, outer: Angle, inner: Angle) -> BlockMeans<T> {
        let count: T = real(f64::from(self.samples.max(1)));
        let duration_s = seconds::<T>(self.duration_us.max(1));
        let since = |mean: &AngleMean, begun| ticks_to_rad(mean.mean().since(begun).into());
        BlockMeans {
            force: self.force.map(|sum| sum.total() / count),
            rate: self.rotation.map(|sum| sum.total() / duration_s),
            angles: [since(&self.outer, outer), since(&self.inner, inner)],
            axis_rates: [self.outer_ticks, self.inner_ticks].map(|ticks| ticks_to_rad::<T>(ticks) / duration_s),
        }
    }

    fn segment(&self, kind: SegmentKind) -> Segment<T> {
        let samples = self.samples.max(1);
        let count: T = real(f64::from(samples));
        let angle = |mean: &AngleMean| match kind {
            SegmentKind::Stop => mean.mean(),
            SegmentKind::Move => mean.last,
        };
        Segment {
            kind,
            start_us: self.start_us,
            duration_us: self.duration_us,
            samples: self.samples,
            longest_interval_us: self.longest_interval_us,
            held: self.held,
            temperature_c: self.temperature_c / samples as f32,
            rotation_g: totals(&self.rotation),
            force_a: totals(&self.force) / count,
            outer: angle(&self.outer),
            inner: angle(&self.inner),
            gimbals: GimbalSums {
                attitude_s: self.attitude.map(|row| row.map(|sum| sum.total().widened() as f32)),
                outer_cos_inner: self.outer_cos_inner.total(),
                outer_sin_inner: self.outer_sin_inner.total(),
                late_cos_inner_s: self.late_cos_inner_s.total(),
                late_sin_inner_s: self.late_sin_inner_s.total(),
                outer: ticks_to_rad(self.outer_ticks),
                inner: ticks_to_rad(self.inner_ticks),
                harmonics: self.harmonics,
            },
            scatter: Scatter::default(),
            readings: self.jumps_ticks2.map(|jumps_ticks2| Readings {
                jumps_ticks2,
                count: self.samples,
                resolution_ticks: 0,
            }),
        }
    }
}

fn add_each<T: Real>(sums: &mut [CompensatedSum<T>; 3], terms: &Vector3<T>) {
    for (sum, term) in sums.iter_mut().zip(terms.as_slice()) {
        sum.add(*term);
    }
}

fn merge_each<T: Real>(sums: &mut [CompensatedSum<T>; 3], others: &[CompensatedSum<T>; 3]) {
    for (sum, other) in sums.iter_mut().zip(others) {
        sum.merge(other);
    }
}

fn totals<T: Real>(sums: &[CompensatedSum<T>; 3]) -> Vector3<T> {
    Vector3::from(sums.map(|sum| sum.total()))
}

/// Range that an angle has passed, ticks from a reference.
#[derive(Clone, Copy, Debug)]
struct AngleRange {
    reference: Angle,
    low: i32,
    high: i32,
}

impl AngleRange {
    fn at(reference: Angle) -> Self {
        Self { reference, low: 0, high: 0 }
    }

    fn add(&mut self, angle: Angle) {
        let offset = angle.since(self.reference);
        self.low = self.low.min(offset);
        self.high = self.high.max(offset);
    }

    fn ticks(&self) -> i64 {
        i64::from(self.high) - i64::from(self.low)
    }
}

/// The block being filled.
#[derive(Clone, Copy, Debug)]
struct Block<T> {
    sums: Sums<T>,
    outer: AngleRange,
    inner: AngleRange,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// No block yet.
    Start,
    /// Axes turn, or have stood for this many blocks.
    Moving { still_blocks: u8 },
    /// Axes stand where these angles were read when the stop began.
    Still { outer: Angle, inner: Angle },
}

/// Finds stops and moves and sums them up.
///
/// A move is reported once the stop after it is sure (0.7 s after the axes came to rest), a stop when the axes leave it.
#[derive(Clone, Debug)]
pub struct Segmenter<T: Real> {
    still_ticks: i64,
    previous: Option<RawSample<T>>,
    /// How far outer and inner axis turned in the interval before, ticks.
    turned: [i32; 2],
    steps: [Steps; 2],
    trig_outer: CachedSinCos<T>,
    trig_inner: CachedSinCos<T>,
    runs: Runs,
    block: Option<Block<T>>,
    phase: Phase,
    stopped_before: bool,
    /// Still blocks that may turn out to be the guard of the next move; the oldest first.
    guard: heapless::Deque<Sums<T>, { GUARD_BLOCKS as usize + 1 }>,
    stop: Sums<T>,
    scatter: ScatterSums<T>,
    moved: Sums<T>,
}

impl<T: Real> Default for Segmenter<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Segmenter<T> {
    /// Before the first sample. Motion before the first stop is not reported.
    pub const fn new() -> Self {
        Self {
            still_ticks: 0,
            previous: None,
            turned: [0; 2],
            steps: [Steps::UNKNOWN; 2],
            trig_outer: CachedSinCos::EMPTY,
            trig_inner: CachedSinCos::EMPTY,
            runs: Runs::NONE,
            block: None,
            phase: Phase::Start,
            stopped_before: false,
            guard: heapless::Deque::new(),
            stop: Sums::ZERO,
            scatter: ScatterSums::ZERO,
            moved: Sums::ZERO,
        }
    }

    /// Forgets all samples; motion is recognized as `stillness` says from here on.
    pub fn restart(&mut self, stillness: &Stillness) {
        (self.previous, self.block, self.phase, self.stopped_before) = (None, None, Phase::Start, false);
        (self.turned, self.steps) = ([0; 2], [Steps::UNKNOWN; 2]);
        self.guard.clear();
        (self.stop, self.moved) = (Sums::ZERO, Sums::ZERO);
        self.scatter = ScatterSums::ZERO;
        self.runs = Runs::NONE;
        self.still_ticks = rad_to_ticks(stillness.still_rad);
    }

    /// Takes one admitted sample; returns the segment that it completes.
    pub fn step(&mut self, sample: &RawSample<T>) -> Option<Segment<T>> {
        let previous = self.previous.replace(*sample)?;
        let interval = self.interval(&previous, sample);
        let block = self.block.get_or_insert_with(|| Block {
            sums: Sums::ZERO,
            outer: AngleRange::at(previous.outer),
            inner: AngleRange::at(previous.inner),
        });
        block.outer.add(sample.outer);
        block.inner.add(sample.inner);
        block.sums.add(sample, &interval);
        if block.sums.duration_us < BLOCK_US {
            return None;
        }
        self.block.take().and_then(|block| self.close_block(&block))
    }

    /// Ends the last stop where the samples end. `None` if the axes do not stand, or stood too briefly.
    pub fn finish(&mut self) -> Option<Segment<T>> {
        if self.stop.samples == 0 {
            return None;
        }
        while let Some(block) = self.guard.pop_front() {
            self.add_to_stop(&block);
        }
        self.phase = Phase::Moving { still_blocks: 0 };
        self.take_stop()
    }

    /// The stop as it is now, without the guard. `None` if the axes do not stand, or not for long enough.
    pub fn stop_so_far(&self) -> Option<Segment<T>> {
        let mut segment = Segment { scatter: self.scatter.scatter(), ..self.stop.segment(SegmentKind::Stop) };
        segment.know_resolution(self.steps.map(|steps| steps.resolution_ticks()));
        (self.stop.samples > 0).then_some(segment)
    }

    /// Longest interval between two samples of this stop so far, us; the guard and the open block are part of it.
    pub fn longest_interval_us(&self) -> u64 {
        let blocks = self.guard.iter().chain(self.block.as_ref().map(|block| &block.sums));
        blocks.fold(self.stop.longest_interval_us, |longest, block| longest.max(block.longest_interval_us))
    }

    /// Forgets this stop so far; it begins anew with the next sample.
    pub fn restart_stop(&mut self) {
        self.stop = Sums::ZERO;
        self.scatter = ScatterSums::ZERO;
        self.guard.clear();
        self.block = None;
    }

    fn interval(&mut self, previous: &RawSample<T>, sample: &RawSample<T>) -> Interval<T> {
        let duration_us = sample.time_us.saturating_sub(previous.time_us);
        let outer_ticks = sample.outer.since(previous.outer);
        let inner_ticks = sample.inner.since(previous.inner);
        let half = real::<T>(0.5);
        let before = mem::replace(&mut self.turned, [outer_ticks, inner_ticks]);
        let jumps_ticks = [outer_ticks.wrapping_sub(before[0]), inner_ticks.wrapping_sub(before[1])];
        for (steps, (angle, ticks)) in
            self.steps.iter_mut().zip([(sample.outer, outer_ticks), (sample.inner, inner_ticks)])
        {
            if ticks == 0 {
                steps.hold(angle);
            }
        }
        let [outer_before, inner_before] = before.map(i64::from);
        let gained = i64::from(inner_ticks) * outer_before;
        Interval {
            duration_us,
            held: self.runs.step(previous, sample),
            // The trapezoidal rule: axes stand at both ends of a segment, so it is exact for mean rates however the
            // means are centred on their time stamps.
            rotation: (previous.omega_g + sample.omega_g) * (half * seconds(duration_us)),
            outer_ticks,
            inner_ticks,
            sin_cos_outer: self.trig_outer.at(previous.outer.turned(outer_ticks / 2)),
            sin_cos_inner: self.trig_inner.at(previous.inner.turned(inner_ticks / 2)),
            swerve_ticks2: gained.saturating_sub(inner_before * i64::from(outer_ticks)),
            jumps_ticks,
        }
    }

    fn close_block(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        let still = block.outer.ticks() <= self.still_ticks && block.inner.ticks() <= self.still_ticks;
        let standing = Phase::Still { outer: block.sums.outer.mean(), inner: block.sums.inner.mean() };
        match self.phase {
            Phase::Start if still => {
                self.phase = standing;
                self.stay(block)
            }
            Phase::Start => self.leave(block),
            Phase::Moving { still_blocks } => {
                self.moved.merge(&block.sums);
                let still_blocks = if still { still_blocks + 1 } else { 0 };
                self.phase = if still_blocks < GUARD_BLOCKS { Phase::Moving { still_blocks } } else { standing };
                None
            }
            Phase::Still { outer, inner } => {
                let departed = |from: Angle, mean: &AngleMean| i64::from(mean.mean().since(from)).abs();
                let there = departed(outer, &block.sums.outer) <= self.still_ticks
                    && departed(inner, &block.sums.inner) <= self.still_ticks;
                if still && there { self.stay(block) } else { self.leave(block) }
            }
        }
    }

    /// A block on which the axes still stand: the oldest one of the guard is now surely part of the stop.
    fn stay(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        // The guard is drained below before it can be full.
        let _ = self.guard.push_back(block.sums);
        if self.guard.len() <= usize::from(GUARD_BLOCKS) {
            return None;
        }
        let arrived = self.stop.samples == 0;
        if let Some(sure) = self.guard.pop_front() {
            self.add_to_stop(&sure);
        }
        if !arrived {
            return None;
        }
        let moved = mem::replace(&mut self.moved, Sums::ZERO);
        let reported = mem::replace(&mut self.stopped_before, true) && moved.samples > 0;
        reported.then(|| moved.segment(SegmentKind::Move))
    }

    /// The block on which the axes start: with the guard it begins the next move, or, if they had not stood long enough
    /// for a stop, goes on with the last one.
    fn leave(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        self.phase = Phase::Moving { still_blocks: 0 };
        while let Some(guard) = self.guard.pop_front() {
            self.moved.merge(&guard);
        }
        self.moved.merge(&block.sums);
        self.take_stop()
    }

    fn add_to_stop(&mut self, block: &Sums<T>) {
        let begun = [&self.stop, block].into_iter().find(|sums| sums.samples > 0).unwrap_or(block);
        self.scatter.add(&block.means(begun.outer.first, begun.inner.first));
        self.stop.merge(block);
    }

    fn take_stop(&mut self) -> Option<Segment<T>> {
        let stop = self.stop_so_far();
        self.stop = Sums::ZERO;
        self.scatter = ScatterSums::ZERO;
        stop
    }
}

#[cfg(test)]
impl Segment<f64> {
    /// A level stop at (0, 0) without noise, of samples at 200 Hz.
    pub(crate) fn quiet_stop(duration_us: u64) -> Self {
        Self {
            kind: SegmentKind::Stop,
            start_us: 0,
            duration_us,
            samples: (duration_us / 5000) as u32,
            longest_interval_us: 5000,
            held: Held::NONE,
            temperature_c: 20.0,
            rotation_g: Vector3::zeros(),
            force_a: Vector3::new(0.0, 0.0, 9.8),
            outer: Angle::default(),
            inner: Angle::default(),
            gimbals: GimbalSums::default(),
            scatter: Scatter {
                blocks: (duration_us / BLOCK_US) as u16,
                freedom: (duration_us / BLOCK_US) as u16 - 1,
                ..Scatter::default()
            },
            readings: [Readings::NONE; 2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const INTERVAL_US: u64 = 5000;

    /// A segmenter fed at 200 Hz, and all that it has reported.
    struct Stream {
        segmenter: Segmenter<f64>,
        time_us: u64,
        outer_rad: f64,
        segments: Vec<Segment<f64>>,
    }

    impl Stream {
        fn new() -> Self {
            let mut segmenter = Segmenter::new();
            segmenter.restart(&Stillness::default());
            Self { segmenter, time_us: 0, outer_rad: 0.0, segments: Vec::new() }
        }

        fn sample(&mut self, force: f64) {
            let force_a = Vector3::new(force, 0.0, 0.0);
            let (time_us, outer) = (self.time_us, Angle::from_rad(self.outer_rad));
            self.segments.extend(self.segmenter.step(&RawSample { time_us, force_a, outer, ..RawSample::default() }));
            self.time_us += INTERVAL_US;
        }

        fn stand(&mut self, samples: u32, force: f64) {
            (0..samples).for_each(|_| self.sample(force));
        }

        fn turn(&mut self, samples: u32, by_rad: f64) {
            for _ in 0..samples {
                self.outer_rad += by_rad / f64::from(samples);
                self.sample(0.0);
            }
        }
    }

    #[test]
    fn stops_and_moves_are_found_and_leave_nothing_out() {
        let mut stream = Stream::new();
        stream.stand(401, 1.0);
        stream.turn(300, -1.5);
        stream.stand(400, 2.0);
        stream.segments.extend(stream.segmenter.finish());
        let kinds: Vec<_> = stream.segments.iter().map(|segment| segment.kind).collect();
        assert_eq!(kinds, [SegmentKind::Stop, SegmentKind::Move, SegmentKind::Stop]);
        let [first, moved, last] = &stream.segments[..] else { unreachable!() };
        // 0.3 s of guard before the move, and 0.3 s of settling after it.
        let durations_us = [first, moved, last].map(|segment| segment.duration_us);
        assert_eq!(durations_us, [1_700_000, 2_100_000, 1_700_000]);
        assert_eq!(moved.start_us, first.start_us + first.duration_us);
        assert_eq!(last.start_us, moved.start_us + moved.duration_us);
        assert!((moved.gimbals.outer + 1.5).abs() < 1e-8);
        assert_eq!([first.force_a.x, last.force_a.x], [1.0, 2.0]);
    }

    #[test]
    fn a_stop_begun_anew_keeps_nothing_of_what_was_before() {
        let mut stream = Stream::new();
        // Ends in the middle of a block.
        stream.stand(413, 1.0);
        assert!(stream.segmenter.stop_so_far().is_some());
        stream.segmenter.restart_stop();
        assert!(stream.segmenter.stop_so_far().is_none());
        stream.stand(400, 2.0);
        let stop = stream.segmenter.finish().expect("a stop");
        assert_eq!(stop.force_a.x, 2.0);
        assert_eq!((stop.duration_us, stop.scatter.blocks), (2_000_000, 20));
    }

    #[test]
    fn a_gap_is_seen_while_it_is_still_in_the_guard() {
        let mut stream = Stream::new();
        stream.stand(401, 1.0);
        assert_eq!(stream.segmenter.longest_interval_us(), INTERVAL_US);
        stream.time_us += 200_000;
        stream.sample(1.0);
        assert_eq!(stream.segmenter.longest_interval_us(), 205_000);
        assert!(stream.segmenter.stop_so_far().is_some_and(|stop| !stop.is_broken()));
        stream.stand(200, 1.0);
        assert!(stream.segmenter.stop_so_far().is_some_and(|stop| stop.is_broken()));
        stream.segmenter.restart_stop();
        stream.stand(200, 1.0);
        assert_eq!(stream.segmenter.longest_interval_us(), INTERVAL_US);
    }
}
