//! One pass over the readings of a log: counts of samples, stops and moves, rates of the axes, and the moment at which
//! the encoders are read.

use crate::calibration::{HOST_SEGMENTS, raw_sample};
use crate::log::{LogError, LogReader, Moment};
use crate::virtual_unit::plant::Reading;
use rins_selfcal::base::angle::{Angle, ticks_to_rad};
use rins_selfcal::base::sample::RawSample;
use rins_selfcal::segment::intake::{Admission, Intake, IntakeCounts};
use rins_selfcal::segment::{Segment, Segmenter, Stillness};
use serde::Serialize;
use std::collections::VecDeque;

/// Time over which the rates of the axes are averaged, s.
const WINDOW_S: f64 = 0.1;
/// Least change of the turn per interval, rad, as a root of summed squares, that shows when the encoders are read:
/// 10 arcsec.
const TELLING_RAD: f64 = 5e-5;

/// A gap in a log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Line of the first sample after the gap.
    pub line: u64,
    /// Start of the gap, s.
    pub time_s: f64,
    /// Length of the gap, s.
    pub length_s: f64,
}

/// The findings of a pass over a log.
pub struct Passage {
    /// Rows.
    pub rows: u64,
    /// First and last time, s.
    pub times_s: [f64; 2],
    /// Sample rate by the median interval, Hz.
    pub rate_hz: f64,
    /// Samples, gaps and repeats as the core counts them.
    pub counts: IntakeCounts,
    /// The longest gap.
    pub longest_gap: Option<Gap>,
    /// Stops and moves, as the core finds them.
    pub segments: Vec<Segment<f64>>,
    /// Highest rate, rad/s, and acceleration, rad/s^2, of an axis.
    pub pace: [f64; 2],
    /// Moment at which the encoders are read, as a fraction of the gyros' interval before its end: 0 end, 1/2 middle, 1
    /// start. `None` if the motion does not show it.
    pub lag: Option<f64>,
    /// Lowest and highest temperature, deg C.
    pub temperature_c: Option<[f32; 2]>,
}

/// A pass that is not finished.
struct Passing {
    passage: Passage,
    intake: Intake,
    segmenter: Segmenter<f64>,
    turning: Turning,
    last_us: Option<u64>,
}

impl Passage {
    /// Reads a log to its end or to its first wrong row. `on_rows` is called from time to time with the number of rows.
    /// Returns the findings up to there, and the error of the wrong row if one ended the pass.
    pub fn over(reader: LogReader, mut on_rows: impl FnMut(u64)) -> (Self, Option<LogError>) {
        let interval_us = reader.interval_us().unwrap_or(0) as f64;
        let mut passing = Passing::new(1e6 / interval_us);
        let mut error = None;
        for row in reader {
            match row {
                Ok(row) => passing.step(row.line, &row.reading),
                Err(found) => {
                    error = Some(found);
                    break;
                }
            }
            if passing.passage.rows.is_multiple_of(10_000) {
                on_rows(passing.passage.rows);
            }
        }
        (passing.finish(), error)
    }

    /// The moment of the interval at which the encoders are read, if the readings show it.
    pub fn moment(&self) -> Option<Moment> {
        self.lag.map(|lag| match lag {
            lag if lag < 0.25 => Moment::End,
            lag if lag > 0.75 => Moment::Start,
            _ => Moment::Middle,
        })
    }
}

impl Passing {
    fn new(rate_hz: f64) -> Self {
        let mut segmenter = Segmenter::new();
        segmenter.restart(&Stillness::default());
        let passage = Passage {
            rows: 0,
            times_s: [0.0; 2],
            rate_hz,
            counts: IntakeCounts::NONE,
            longest_gap: None,
            segments: Vec::new(),
            pace: [0.0; 2],
            lag: None,
            temperature_c: None,
        };
        Self { passage, intake: Intake::new(rate_hz), segmenter, turning: Turning::new(rate_hz), last_us: None }
    }

    fn step(&mut self, line: u64, reading: &Reading) {
        let passage = &mut self.passage;
        let time_s = reading.time_us as f64 * 1e-6;
        if passage.rows == 0 {
            passage.times_s[0] = time_s;
        }
        passage.rows += 1;
        passage.times_s[1] = time_s;
        let temperature = reading.temperature_c;
        if temperature.is_finite() {
            let [low, high] = passage.temperature_c.unwrap_or([temperature; 2]);
            passage.temperature_c = Some([low.min(temperature), high.max(temperature)]);
        }
        let sample = raw_sample(reading);
        let before = self.intake.counts();
        if !matches!(self.intake.admit(&sample), Admission::Admitted { .. }) {
            return;
        }
        if self.intake.counts().gaps > before.gaps {
            self.turning.restart();
            self.note_gap(line, reading.time_us);
        }
        self.last_us = Some(reading.time_us);
        self.turning.step(&sample);
        let segment = self.segmenter.step(&sample);
        self.keep(segment);
    }

    fn note_gap(&mut self, line: u64, time_us: u64) {
        let Some(last_us) = self.last_us else { return };
        let gap = Gap { line, time_s: last_us as f64 * 1e-6, length_s: (time_us - last_us) as f64 * 1e-6 };
        if self.passage.longest_gap.is_none_or(|longest| gap.length_s > longest.length_s) {
            self.passage.longest_gap = Some(gap);
        }
    }

    fn keep(&mut self, segment: Option<Segment<f64>>) {
        if self.passage.segments.len() < HOST_SEGMENTS {
            self.passage.segments.extend(segment);
        }
    }

    fn finish(mut self) -> Passage {
        let last = self.segmenter.finish();
        self.keep(last);
        Passage { counts: self.intake.counts(), pace: self.turning.pace, lag: self.turning.lag(), ..self.passage }
    }
}

/// Compares the turns of the axes with the gyros, in consecutive windows.
///
/// Over a window the gyros measure the turn between the ends of its first and last interval. If the encoders are read
/// at the end of an interval, their angles show the same turn. If the encoders are read at the start, the angles of the
/// next samples show it. Least squares give the fraction between these two cases, which is how early the encoders are
/// read. Scale and installation errors cancel over a move, because a move begins and ends at rest.
struct Turning {
    samples: usize,
    window: VecDeque<RawSample<f64>>,
    last_rates: Option<[f64; 2]>,
    pace: [f64; 2],
    products: [f64; 2],
}

impl Turning {
    fn new(rate_hz: f64) -> Self {
        let samples = if rate_hz.is_finite() { (rate_hz * WINDOW_S).round().max(2.0) as usize } else { 2 };
        Self { samples, window: VecDeque::new(), last_rates: None, pace: [0.0; 2], products: [0.0; 2] }
    }

    fn restart(&mut self) {
        self.window.clear();
        self.last_rates = None;
    }

    fn step(&mut self, sample: &RawSample<f64>) {
        self.window.push_back(*sample);
        if self.window.len() == self.samples + 2 {
            self.note();
            self.window.drain(..self.samples);
        }
    }

    fn note(&mut self) {
        let last = self.samples;
        let [first, end] = [0, last].map(|at: usize| self.window[at]);
        let window_s = (end.time_us - first.time_us) as f64 * 1e-6;
        let turned = between(&first, &end);
        let rates = turned.map(|turn| turn / window_s);
        let fastest = |values: [f64; 2]| values[0].abs().max(values[1].abs());
        if let Some(before) = self.last_rates.replace(rates) {
            let accelerations = [0, 1].map(|axis: usize| (rates[axis] - before[axis]) / window_s);
            self.pace = [self.pace[0].max(fastest(rates)), self.pace[1].max(fastest(accelerations))];
        }
        let early = in_r(&first, turned);
        let late = in_r(&self.window[1], between(&self.window[1], &self.window[last + 1]));
        let pairs = (1..=last).map(|at| (&self.window[at - 1], &self.window[at]));
        let gyros = pairs.fold([0.0; 3], |sum, (before, now)| {
            let interval_s = (now.time_us - before.time_us) as f64 * 1e-6;
            std::array::from_fn(|axis| sum[axis] + now.omega_g[axis] * interval_s)
        });
        for axis in 0..3 {
            let way = late[axis] - early[axis];
            self.products[0] += (gyros[axis] - early[axis]) * way;
            self.products[1] += way * way;
        }
    }

    fn lag(&self) -> Option<f64> {
        let [shown, all] = self.products;
        (all > TELLING_RAD * TELLING_RAD).then(|| shown / all)
    }
}

pub(super) fn between(from: &RawSample<f64>, to: &RawSample<f64>) -> [f64; 2] {
    let turn = |from: Angle, to: Angle| ticks_to_rad(to.since(from).into());
    [turn(from.outer, to.outer), turn(from.inner, to.inner)]
}

/// A small turn of both axes in the rotation frame, as V of (M7).
pub(super) fn in_r(from: &RawSample<f64>, [outer, inner]: [f64; 2]) -> [f64; 3] {
    let (sin, cos) = (from.inner.rad::<f64>() + 0.5 * inner).sin_cos();
    [cos * outer, -sin * outer, inner]
}
