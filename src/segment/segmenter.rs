//! The segmenter finds stops and moves and sums up their samples.
//!
//! The parameters are constant, so only sums are kept while samples arrive. Stops and moves are found from the encoder
//! angles alone. The segmenter does not know the scheme:
//!
//! ```text
//! angle  ________                       ____________
//!                \_____________________/
//!        ...b b b|m m m ... m m m|s s s|b b ...|b b b|m m
//!          stop  |g|     move      |settle|  stop   |guard, part of the next move
//! ```
//! Samples are summed over blocks of 0.1 s. A block is at rest if both angles stay within `still_rad` over the block. A
//! move ends with three successive blocks at rest (settling). A stop ends three blocks before the first block that is
//! not at rest (guard). So the window of a move reaches from inside one stop to inside the next stop, and no ramp is
//! part of a stop.

use super::block::{AngleSums, Block, Carried};
use super::scatter::ScatterSums;
use super::sums::{MoveSums, Sums};
use super::types::Segment;
use crate::base::angle::{Angle, rad_to_ticks};
use crate::base::linear::Real;
use crate::base::sample::RawSample;
use crate::base::units::ARCSEC;
use core::mem;
use serde::{Deserialize, Serialize};

/// Length of a block, us.
const BLOCK_US: u64 = 100_000;
/// Number of settling blocks after a move, and of guard blocks before the next move.
const GUARD_BLOCKS: u8 = 3;
/// Duration of the settling after a move, and of the guard before the next move, s.
pub const GUARD_S: f64 = GUARD_BLOCKS as f64 * BLOCK_US as f64 * 1e-6;

/// Criterion for an axis at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stillness {
    /// Limit for an axis at rest, rad. The limit applies to the range of the encoder angle over 0.1 s and to the
    /// distance from the angle where the stop began. The limit is at most 1 deg and must exceed the encoder's noise
    /// and resolution. A ramp of 20 deg/s^2 exceeds 20 arcsec within 25 ms.
    pub still_rad: f64,
}

impl Default for Stillness {
    fn default() -> Self {
        Self { still_rad: 20.0 * ARCSEC }
    }
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// No block has ended yet.
    Start,
    /// The axes turn, or have been at rest for `still_blocks` blocks.
    Moving { still_blocks: u8 },
    /// The axes are at rest. The angles are the readings when the stop began.
    Still { outer: Angle, inner: Angle },
}

/// Finds stops and moves and sums up their samples.
///
/// A move is reported when the next stop is certain, which is 0.7 s after the axes came to rest. A stop is reported
/// when the axes start to move.
#[derive(Clone, Debug)]
pub struct Segmenter<T: Real> {
    still_ticks: i32,
    previous: Option<RawSample<T>>,
    carried: Carried<T>,
    block: Option<Block<T>>,
    phase: Phase,
    stopped_before: bool,
    /// Blocks at rest that may become the guard of the next move. The oldest block is first.
    guard: heapless::Deque<Block<T>, { GUARD_BLOCKS as usize + 1 }>,
    stop: Sums<T>,
    scatter: ScatterSums<T>,
    moved: MoveSums<T>,
}

impl<T: Real> Default for Segmenter<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Segmenter<T> {
    /// A segmenter without samples. Motion before the first stop is not reported.
    pub const fn new() -> Self {
        Self {
            still_ticks: 0,
            previous: None,
            carried: Carried::NONE,
            block: None,
            phase: Phase::Start,
            stopped_before: false,
            guard: heapless::Deque::new(),
            stop: Sums::ZERO,
            scatter: ScatterSums::ZERO,
            moved: MoveSums::ZERO,
        }
    }

    /// Discards all samples. From now on `stillness` decides whether an axis is at rest.
    pub fn restart(&mut self, stillness: &Stillness) {
        (self.previous, self.block, self.phase, self.stopped_before) = (None, None, Phase::Start, false);
        self.guard.clear();
        (self.stop, self.moved) = (Sums::ZERO, MoveSums::ZERO);
        self.scatter = ScatterSums::ZERO;
        self.carried = Carried::NONE;
        self.still_ticks = i32::try_from(rad_to_ticks(stillness.still_rad)).unwrap_or(i32::MAX);
    }

    /// Processes one admitted sample. Returns the segment that the sample completes, if any.
    pub fn step(&mut self, sample: &RawSample<T>) -> Option<Segment<T>> {
        let Some(previous) = &mut self.previous else {
            self.previous = Some(*sample);
            return None;
        };
        let block = self.block.get_or_insert_with(|| Block::after(previous));
        block.add(previous, sample, self.still_ticks, &mut self.carried);
        *previous = *sample;
        if block.duration_us < BLOCK_US {
            return None;
        }
        block.close(&mut self.carried);
        self.block.take().and_then(|block| self.close_block(&block))
    }

    /// Ends the last stop at the last sample. `None` if the axes are not at rest, or were at rest for too short a time.
    pub fn finish(&mut self) -> Option<Segment<T>> {
        if self.stop.is_empty() {
            return None;
        }
        while let Some(block) = self.guard.pop_front() {
            self.add_to_stop(&block);
        }
        self.phase = Phase::Moving { still_blocks: 0 };
        self.take_stop()
    }

    /// The present stop up to now, without the guard. `None` if the axes are not at rest, or have been at rest for too
    /// short a time.
    pub fn stop_so_far(&self) -> Option<Segment<T>> {
        let mut segment = self.stop.stop(self.scatter.scatter());
        segment.know_resolution(self.carried.resolution_ticks());
        segment.know_increments(self.carried.increments());
        (!self.stop.is_empty()).then_some(segment)
    }

    /// Longest interval between two samples of this stop so far, us. The guard and the open block are included.
    pub fn longest_interval_us(&self) -> u64 {
        let blocks = self.guard.iter().chain(&self.block);
        blocks.fold(self.stop.longest_interval_us, |longest, block| longest.max(block.longest_interval_us))
    }

    /// Discards the samples of this stop. The stop begins again with the next sample.
    pub fn restart_stop(&mut self) {
        self.stop = Sums::ZERO;
        self.scatter = ScatterSums::ZERO;
        self.guard.clear();
        self.block = None;
    }

    fn close_block(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        let still = block.is_still();
        let standing = Phase::Still { outer: block.outer.mean(), inner: block.inner.mean() };
        match self.phase {
            Phase::Start if still => {
                self.phase = standing;
                self.stay(block)
            }
            Phase::Start => self.leave(block),
            Phase::Moving { still_blocks } => {
                self.moved.add(block);
                let still_blocks = if still { still_blocks + 1 } else { 0 };
                self.phase = if still_blocks < GUARD_BLOCKS { Phase::Moving { still_blocks } } else { standing };
                None
            }
            Phase::Still { outer, inner } => {
                let departed = |from: Angle, angles: &AngleSums| angles.mean().since(from).saturating_abs();
                let there = departed(outer, &block.outer) <= self.still_ticks
                    && departed(inner, &block.inner) <= self.still_ticks;
                if still && there { self.stay(block) } else { self.leave(block) }
            }
        }
    }

    /// Processes a block on which the axes are still at rest. The oldest block of the guard is now part of the stop.
    fn stay(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        // The guard cannot be full: its oldest block is taken out below.
        let _ = self.guard.push_back(*block);
        if self.guard.len() <= usize::from(GUARD_BLOCKS) {
            return None;
        }
        let arrived = self.stop.is_empty();
        if let Some(sure) = self.guard.pop_front() {
            self.add_to_stop(&sure);
        }
        if !arrived {
            return None;
        }
        let moved = mem::replace(&mut self.moved, MoveSums::ZERO);
        let reported = mem::replace(&mut self.stopped_before, true) && !moved.all.is_empty();
        reported.then(|| moved.segment())
    }

    /// Processes the block on which the axes start to move. The block and the guard begin the next move. If the axes
    /// were at rest for too short a time for a stop, the block and the guard continue the last move.
    fn leave(&mut self, block: &Block<T>) -> Option<Segment<T>> {
        self.phase = Phase::Moving { still_blocks: 0 };
        while let Some(guard) = self.guard.pop_front() {
            self.moved.add(&guard);
        }
        self.moved.add(block);
        self.take_stop()
    }

    fn add_to_stop(&mut self, block: &Block<T>) {
        self.stop.add(block);
        self.scatter.add(&block.means(self.stop.outer.begun, self.stop.inner.begun));
    }

    fn take_stop(&mut self) -> Option<Segment<T>> {
        let stop = self.stop_so_far();
        self.stop = Sums::ZERO;
        self.scatter = ScatterSums::ZERO;
        stop
    }
}

#[cfg(test)]
mod tests {
    use super::super::scatter::Scatter;
    use super::super::types::SegmentKind;
    use super::*;
    use crate::base::linear::{Vector3, real};
    use std::vec::Vec;

    const INTERVAL_US: u64 = 5000;

    /// A segmenter with samples at 200 Hz, and all segments that it has reported.
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
        let kinds: Vec<_> = stream.segments.iter().map(|segment| segment.kind()).collect();
        assert_eq!(kinds, [SegmentKind::Stop, SegmentKind::Move, SegmentKind::Stop]);
        let [first, moved, last] = &stream.segments[..] else { unreachable!() };
        // 0.3 s of guard before the move, and 0.3 s of settling after it.
        let durations_us = [first, moved, last].map(|segment| segment.duration_us);
        assert_eq!(durations_us, [1_700_000, 2_100_000, 1_700_000]);
        assert_eq!(moved.start_us, first.start_us + first.duration_us);
        assert_eq!(last.start_us, moved.start_us + moved.duration_us);
        assert!((moved.turned.outer + 1.5).abs() < 1e-8);
        assert_eq!([first.force_a().x, last.force_a().x], [1.0, 2.0]);
    }

    #[test]
    fn a_restarted_stop_keeps_no_earlier_samples() {
        let mut stream = Stream::new();
        // The samples end in the middle of a block.
        stream.stand(413, 1.0);
        assert!(stream.segmenter.stop_so_far().is_some());
        stream.segmenter.restart_stop();
        assert!(stream.segmenter.stop_so_far().is_none());
        stream.stand(400, 2.0);
        let mut stop = stream.segmenter.finish().expect("a stop");
        assert_eq!(stop.force_a().x, 2.0);
        assert_eq!((stop.duration_us, stop.standing_mut().scatter.blocks), (2_000_000, 20));
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

    /// Reproducible pseudo-random numbers in (-1, 1).
    fn scattered(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// A stop of one hour at 200 Hz with noise and hunting axes. `f32` represents the readings exactly.
    fn hour<T: Real>() -> Segment<T> {
        let mut segmenter = Segmenter::<T>::new();
        segmenter.restart(&Stillness::default());
        let mut seed = 4;
        let mut noisy = |mean: f64, noise: f64| real::<T>(f64::from((mean + noise * scattered(&mut seed)) as f32));
        for sample in 0..720_000_u64 {
            let force_a = Vector3::new(noisy(0.3, 1e-3), noisy(-6.9, 1e-3), noisy(6.9, 1e-3));
            let omega_g = Vector3::new(noisy(4e-5, 1e-5), noisy(-5e-5, 1e-5), noisy(3e-5, 1e-5));
            let hunting = Angle::from_rad(1.0 + 5.0 * ARCSEC * (sample as f64 * 0.3).sin());
            let time_us = sample * INTERVAL_US;
            let still = RawSample { time_us, force_a, omega_g, outer: hunting, inner: hunting, temperature_c: 25.0 };
            assert!(segmenter.step(&still).is_none());
        }
        segmenter.finish().expect("a stop")
    }

    /// A move of one minute at 200 Hz in which both axes turn, with a stop before the move and a stop after it.
    fn minute<T: Real>() -> Segment<T> {
        let mut segmenter = Segmenter::<T>::new();
        segmenter.restart(&Stillness::default());
        let mut segments = Vec::new();
        for sample in 0..12_800_u64 {
            let part = (sample.saturating_sub(400) as f64 / 12_000.0).min(1.0);
            let (outer, inner) = (Angle::from_rad(0.3 + 3.0 * part), Angle::from_rad(-1.0 + 4.0 * part * part));
            let still = RawSample { time_us: sample * INTERVAL_US, outer, inner, ..RawSample::default() };
            segments.extend(segmenter.step(&still));
        }
        segments.into_iter().find(|segment| segment.kind() == SegmentKind::Move).expect("a move")
    }

    #[test]
    fn a_move_of_a_minute_is_as_good_in_single_precision() {
        let (single, double) = (minute::<f32>(), minute::<f64>());
        assert_eq!((single.duration_us, single.outer, single.inner), (double.duration_us, double.outer, double.inner));
        // A block sums 20 rounded products. Parts of an integral may cancel, so the error is relative to their scale.
        let close = |single: f64, double: f64, scale: f64| {
            assert!((single - double).abs() < 20.0 * f64::from(f32::EPSILON) * scale, "{single} for {double}");
        };
        let (duration_s, way) = (double.duration_s(), double.turned.outer);
        let (of_single, of_double) = (single.integrals(), double.integrals());
        let attitudes = of_single.attitude_s.iter().flatten().zip(of_double.attitude_s.iter().flatten());
        attitudes.for_each(|(single, double)| close((*single).into(), (*double).into(), duration_s));
        close(single.turned.outer_cos_inner.into(), double.turned.outer_cos_inner, way);
        close(single.turned.outer_sin_inner.into(), double.turned.outer_sin_inner, way);
        close(of_single.late_cos_inner_s.into(), of_double.late_cos_inner_s, way * duration_s);
        close(of_single.late_sin_inner_s.into(), of_double.late_sin_inner_s, way * duration_s);
    }

    #[test]
    fn integrals_of_a_stop_are_those_of_its_samples() {
        let stop = hour::<f64>();
        let (outer_rad, inner_rad, duration_s) = (1.0_f64, 1.0_f64, stop.duration_s());
        for (row, inner) in stop.integrals().attitude_s.iter().zip([1.0, inner_rad.cos(), inner_rad.sin()]) {
            for (sum, outer) in row.iter().zip([1.0, outer_rad.cos(), outer_rad.sin()]) {
                // The axis hunts by 5 arcsec about its mean, which has an effect of second order. The rest is rounding.
                assert!((f64::from(*sum) / (inner * outer * duration_s) - 1.0).abs() < 2e-7, "{sum}");
            }
        }
    }

    #[test]
    fn a_stop_of_an_hour_is_as_good_in_single_precision() {
        let (single, double) = (hour::<f32>(), hour::<f64>());
        assert_eq!((single.samples, single.outer, single.inner), (double.samples, double.outer, double.inner));
        let close = |single: f32, double: f64| {
            // The sum, the interval and the mean are rounded once each.
            let error = (f64::from(single) / double - 1.0).abs();
            assert!(error < 1.5 * f64::from(f32::EPSILON), "{single} is {error} from {double}");
        };
        for axis in 0..3 {
            close(single.standing().expect("a stop").force_a[axis], double.force_a()[axis]);
            close(single.rotation_g[axis], double.rotation_g[axis]);
        }
        let variances = |standing: &Scatter| standing.variance;
        let single = variances(&single.standing().expect("a stop").scatter);
        for (single, double) in single.into_iter().zip(double.standing().expect("a stop").scatter.variance) {
            assert!((single / double - 1.0).abs() < 1e-3, "{single} for {double}");
        }
    }
}
