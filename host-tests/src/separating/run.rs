//! A run of the gimballed IMU as the separating methods need it: single samples while an axis turns, and means over
//! about a second while both axes are at rest.

use super::error::SeparatingError;
use crate::calibration::raw_sample;
use crate::virtual_unit::plant::Reading;
use rins_selfcal::base::linear::{Matrix3, Vector3};
use rins_selfcal::segment::{LONGEST_GAP_US, Segment, SegmentKind, Segmenter, Stillness};
use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

/// Duration of an interval at rest, s. A stop is divided into intervals of about this duration.
const REST_INTERVAL_S: f64 = 1.0;

/// Mean outputs of the IMU over an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Duration, s.
    pub duration_s: f64,
    /// Mean outputs of the gyros, rad/s.
    pub omega_g: Vector3<f64>,
    /// Mean outputs of the accelerometers, m/s^2.
    pub force_a: Vector3<f64>,
    /// Readings of the outer and the inner encoder in the middle of the interval, rad, continuous.
    pub angles_rad: [f64; 2],
    /// The stop to which the interval belongs, counted from zero; `None` while an axis turns, and in the guard before
    /// and the settling after.
    pub stop: Option<usize>,
}

impl Interval {
    /// Ideal (M3), without non-perpendicularity: rotation frame at gimbal angles (0, 0) to rotation frame.
    pub fn rot_rr0(&self) -> Matrix3<f64> {
        let [(so, co), (si, ci)] = self.angles_rad.map(f64::sin_cos);
        let outer = Matrix3::new(1.0, 0.0, 0.0, 0.0, co, so, 0.0, -so, co);
        let inner = Matrix3::new(ci, si, 0.0, -si, ci, 0.0, 0.0, 0.0, 1.0);
        inner * outer
    }
}

/// A run from its first stop to its last stop.
#[derive(Clone, Debug)]
pub struct GimballedRun {
    /// All intervals in the order of time.
    pub intervals: Vec<Interval>,
}

impl GimballedRun {
    /// The run of these readings.
    ///
    /// # Errors
    /// There is no move between two stops, or there is a gap.
    pub fn new(readings: impl IntoIterator<Item = Reading>) -> Result<Self, SeparatingError> {
        let mut builder = RunBuilder::default();
        readings.into_iter().for_each(|reading| builder.note(&reading));
        builder.build()
    }

    /// Means over each stop.
    pub fn stops(&self) -> Vec<Interval> {
        let mut stops: Vec<Interval> = Vec::new();
        for interval in self.intervals.iter().filter(|interval| interval.stop.is_some()) {
            match stops.last_mut() {
                Some(last) if last.stop == interval.stop => *last = mean(&[*last, *interval]),
                _ => stops.push(*interval),
            }
        }
        stops
    }
}

/// A reading and the interval that it stands for.
#[derive(Clone, Copy, Debug)]
struct Timed {
    time_us: u64,
    interval: Interval,
}

/// Collects readings one by one. Readings at a stop are averaged as soon as the stop has ended, so a run with long
/// stops needs little memory.
#[derive(Clone, Debug)]
pub struct RunBuilder {
    segmenter: Box<Segmenter<f64>>,
    before: Option<Reading>,
    /// Continuous encoder angles of the reading before, rad.
    angles_rad: Option<[f64; 2]>,
    /// Readings that do not belong to a finished stop or move yet.
    pending: VecDeque<Timed>,
    intervals: Vec<Interval>,
    stops: usize,
    /// The first gap: time before the gap and duration, s.
    gap: Option<[f64; 2]>,
}

impl Default for RunBuilder {
    fn default() -> Self {
        let mut segmenter = Box::new(Segmenter::new());
        segmenter.restart(&Stillness::default());
        Self {
            segmenter,
            before: None,
            angles_rad: None,
            pending: VecDeque::new(),
            intervals: Vec::new(),
            stops: 0,
            gap: None,
        }
    }
}

impl RunBuilder {
    /// Adds a reading. Readings with a number that is not finite, and readings that are not later than the reading
    /// before, are ignored.
    pub fn note(&mut self, reading: &Reading) {
        let numbers = [reading.omega_g, reading.force_a].concat();
        let finite = numbers.iter().chain([&reading.outer_rad, &reading.inner_rad]).all(|number| number.is_finite());
        if !finite || self.before.is_some_and(|before| reading.time_us <= before.time_us) {
            return;
        }
        if let Some(before) = self.before {
            self.note_after(&before, reading);
        }
        self.before = Some(*reading);
        let ended = self.segmenter.step(&raw_sample(reading));
        ended.iter().for_each(|segment| self.end(segment));
    }

    /// Adds the interval of a reading, which reaches back to the reading before.
    fn note_after(&mut self, before: &Reading, reading: &Reading) {
        let duration_us = reading.time_us - before.time_us;
        let duration_s = duration_us as f64 * 1e-6;
        if duration_us > LONGEST_GAP_US {
            self.gap.get_or_insert([before.time_us as f64 * 1e-6, duration_s]);
        }
        let last_rad = self.angles_rad.unwrap_or([before.outer_rad, before.inner_rad]);
        let read_rad = [reading.outer_rad, reading.inner_rad];
        let angles_rad = [0, 1].map(|axis: usize| last_rad[axis] + within_half_turn(read_rad[axis] - last_rad[axis]));
        self.angles_rad = Some(angles_rad);
        let (omega_g, force_a) = (reading.omega_g.into(), reading.force_a.into());
        let interval = Interval { duration_s, omega_g, force_a, angles_rad, stop: None };
        self.pending.push_back(Timed { time_us: reading.time_us, interval });
    }

    /// Moves the readings of a finished segment from the pending ones to the intervals.
    fn end(&mut self, segment: &Segment<f64>) {
        let end_us = segment.start_us + segment.duration_us;
        let is_stop = segment.kind() == SegmentKind::Stop;
        let count = self.pending.iter().take_while(|timed| timed.time_us <= end_us).count();
        // Readings before the first stop belong to no segment.
        let of_segment = self.pending.drain(..count).filter(|timed| timed.time_us > segment.start_us);
        let readings: Vec<Interval> = of_segment.map(|timed| timed.interval).collect();
        if !is_stop {
            self.intervals.extend(readings);
            return;
        }
        let parts = (segment.duration_us as f64 * 1e-6 / REST_INTERVAL_S).round().max(1.0) as usize;
        for part in readings.chunks(readings.len().div_ceil(parts).max(1)) {
            self.intervals.push(Interval { stop: Some(self.stops), ..mean(part) });
        }
        self.stops += 1;
    }

    /// Ends the run.
    ///
    /// # Errors
    /// There is no move between two stops, or there is a gap.
    pub fn build(mut self) -> Result<GimballedRun, SeparatingError> {
        let last = self.segmenter.finish();
        last.iter().for_each(|segment| self.end(segment));
        if let Some([time_s, duration_s]) = self.gap {
            return Err(SeparatingError::Gap { time_s, duration_s });
        }
        let last = self.intervals.iter().rposition(|interval| interval.stop.is_some()).map_or(0, |last| last + 1);
        self.intervals.truncate(last);
        if self.stops < 2 {
            return Err(SeparatingError::Stops { stops: self.stops });
        }
        Ok(GimballedRun { intervals: self.intervals })
    }
}

/// The same angle within half a turn either way, rad.
fn within_half_turn(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

/// Mean over the time of intervals of one stop.
fn mean(intervals: &[Interval]) -> Interval {
    let duration_s: f64 = intervals.iter().map(|interval| interval.duration_s).sum();
    let of = |value: &dyn Fn(&Interval) -> Vector3<f64>| {
        intervals.iter().map(|interval| value(interval) * interval.duration_s).sum::<Vector3<f64>>() / duration_s
    };
    let angle = |axis: usize| {
        intervals.iter().map(|interval| interval.angles_rad[axis] * interval.duration_s).sum::<f64>() / duration_s
    };
    Interval {
        duration_s,
        omega_g: of(&|interval| interval.omega_g),
        force_a: of(&|interval| interval.force_a),
        angles_rad: [0, 1].map(angle),
        stop: intervals.first().and_then(|interval| interval.stop),
    }
}
