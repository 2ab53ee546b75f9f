//! Converts a row of the file to a reading: units, axes, time.
//!
//! A sample belongs to an interval, and its time is the middle of the interval. If the time stamp denotes the start or
//! the end of the interval, half an interval is added or subtracted. If the encoders are read at the start or the end,
//! the angles at the middle are interpolated between two rows. The first or last row keeps its own angles.

use super::columns::Fields;
use super::error::{LATEST_S, LogError, LogFault};
use super::layout::{Encoder, Layout, Triad};
use super::mapping::Moment;
use crate::virtual_unit::plant::Reading;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

/// The mean interval is taken over the steps that differ from the median by less than this fraction of the median.
const REGULAR: f64 = 0.5;
/// Rates, forces and angles above this, SI, are refused. Data in a wrong unit stay far below it.
const IMMENSE: f64 = 1e15;

/// Converts rows to readings.
pub(super) struct Conversion {
    path: PathBuf,
    layout: Layout,
    /// Median step of the time stamps, us.
    interval_us: Option<u64>,
    gyro: Triad,
    accel: Triad,
    /// Added to a time stamp, s.
    shift_s: f64,
    /// Time of the angles after the middle of the interval, us.
    angles_late_us: f64,
    rows: u64,
    previous_us: u64,
}

impl Conversion {
    /// Takes the sample interval from the first rows.
    pub(super) fn new(path: &Path, layout: &Layout, head: &[(u64, Fields)]) -> Result<Self, LogError> {
        let stamps: Vec<f64> = match layout.rate_hz {
            Some(rate_hz) if layout.wanted[0].is_none() => (0..head.len()).map(|row| row as f64 / rate_hz).collect(),
            _ => head.iter().map(|(_, fields)| fields[0] * layout.time_factor_s).collect(),
        };
        let interval_s = layout.rate_hz.map(f64::recip).or_else(|| mean_interval_s(&stamps));
        let needed = layout.gyro.is_increment || layout.accel.is_increment || layout.stamp != Moment::Middle;
        if needed && interval_s.is_none() {
            return Err(LogError::at(path, head[0].0, LogFault::NoInterval(layout.column_name(0))));
        }
        let interval_s = interval_s.unwrap_or(0.0);
        let per_interval = |triad: Triad| Triad {
            factor: if triad.is_increment { triad.factor / interval_s } else { triad.factor },
            ..triad
        };
        // A time is never negative, so a log that begins at zero keeps its time stamps.
        let shift_s = (-half(layout.stamp) * interval_s).max(-stamps[0].max(0.0));
        Ok(Self {
            path: path.into(),
            layout: layout.clone(),
            interval_us: median_interval_us(&stamps),
            gyro: per_interval(layout.gyro),
            accel: per_interval(layout.accel),
            shift_s,
            angles_late_us: half(layout.angles) * interval_s * 1e6,
            rows: 0,
            previous_us: 0,
        })
    }

    pub(super) fn interval_us(&self) -> Option<u64> {
        self.interval_us
    }

    pub(super) fn angles_late_us(&self) -> f64 {
        self.angles_late_us
    }

    /// The reading of a row. Its angles are not yet interpolated to the middle of the interval.
    pub(super) fn reading(&mut self, line: u64, fields: &Fields) -> Result<Reading, LogError> {
        let time_us = self.time_us(fields[0]).map_err(|fault| LogError::at(&self.path, line, fault))?;
        let [_, gx, gy, gz, ax, ay, az, outer, inner, temperature] = *fields;
        let reading = Reading {
            time_us,
            omega_g: self.gyro.apply([gx, gy, gz]),
            force_a: self.accel.apply([ax, ay, az]),
            outer_rad: self.layout.encoders[0].apply(outer),
            inner_rad: self.layout.encoders[1].apply(inner),
            temperature_c: (temperature + self.layout.temperature_offset_c) as f32,
        };
        self.check(&reading).map_err(|fault| LogError::at(&self.path, line, fault))?;
        Ok(reading)
    }

    /// Refuses numbers that would overflow to infinity in the sums.
    fn check(&self, reading: &Reading) -> Result<(), LogFault> {
        let angles = [reading.outer_rad, reading.inner_rad];
        let values = [("rad/s", &reading.omega_g[..]), ("m/s^2", &reading.force_a), ("rad", &angles)];
        let all = values.into_iter().flat_map(|(unit, values)| values.iter().map(move |value| (unit, *value)));
        match all.enumerate().find(|(_, (_, value))| value.abs() > IMMENSE) {
            Some((number, (unit, value))) => Err(LogFault::Immense { column: self.column_of(number), value, unit }),
            None => Ok(()),
        }
    }

    /// The column of a number in a reading, counted through gyros, accelerometers and angles.
    fn column_of(&self, number: usize) -> String {
        let of = |triad: &Triad, axis: usize| triad.axes[axis].0;
        let field = match number {
            0..3 => 1 + of(&self.gyro, number),
            3..6 => 4 + of(&self.accel, number - 3),
            _ => number + 1,
        };
        self.layout.column_name(field)
    }

    fn time_us(&mut self, stamp: f64) -> Result<u64, LogFault> {
        let counted = self.rows as f64;
        self.rows += 1;
        let time_s = match self.layout.rate_hz {
            Some(rate_hz) if self.layout.wanted[0].is_none() => counted / rate_hz,
            _ => stamp * self.layout.time_factor_s,
        };
        let column = || self.layout.column_name(0);
        if !(0.0..=LATEST_S).contains(&time_s) {
            return Err(LogFault::TimeRange { column: column(), time_s, scaled: self.layout.time_factor_s != 1.0 });
        }
        let time_us = ((time_s + self.shift_s) * 1e6).round() as u64;
        if time_us < self.previous_us {
            return Err(LogFault::TimeBack { column: column(), time_us, previous_us: self.previous_us });
        }
        self.previous_us = time_us;
        Ok(time_us)
    }
}

impl Triad {
    fn apply(&self, columns: [f64; 3]) -> [f64; 3] {
        self.axes.map(|(axis, sign)| sign * self.factor * columns[axis])
    }
}

impl Encoder {
    fn apply(&self, reading: f64) -> f64 {
        (reading - self.zero) * self.factor
    }
}

impl Reading {
    /// Interpolates the angles towards those of another row, `by_us` of the time between both rows.
    pub(super) fn turn_towards(&mut self, other: &Self, by_us: f64) {
        let between_us = other.time_us.abs_diff(self.time_us) as f64;
        if between_us > 0.0 {
            let part = (by_us / between_us).min(1.0);
            self.outer_rad += part * shorter_way(self.outer_rad, other.outer_rad);
            self.inner_rad += part * shorter_way(self.inner_rad, other.inner_rad);
        }
    }
}

/// The shorter way from one angle to another, in -pi to pi rad.
fn shorter_way(from_rad: f64, to_rad: f64) -> f64 {
    (to_rad - from_rad + PI).rem_euclid(TAU) - PI
}

/// A moment of the interval, as a fraction of the interval after its middle.
fn half(moment: Moment) -> f64 {
    match moment {
        Moment::Start => -0.5,
        Moment::Middle => 0.0,
        Moment::End => 0.5,
    }
}

fn median_interval_us(stamps_s: &[f64]) -> Option<u64> {
    let us = |stamp: f64| (stamp * 1e6).round();
    let steps = stamps_s.windows(2).map(|pair| us(pair[1]) - us(pair[0]));
    let mut steps: Vec<u64> = steps.filter(|step| *step >= 1.0).map(|step| step as u64).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied()
}

/// The mean of the regular steps. Gaps and repeated time stamps are left out. The rounding of time stamps averages out.
fn mean_interval_s(stamps_s: &[f64]) -> Option<f64> {
    let median_s = median_interval_us(stamps_s)? as f64 * 1e-6;
    let steps = stamps_s.windows(2).map(|pair| pair[1] - pair[0]);
    let regular = steps.filter(|step| (step / median_s - 1.0).abs() < REGULAR);
    let (count, sum) = regular.fold((0_u32, 0.0), |(count, sum), step| (count + 1, sum + step));
    (count > 0).then(|| sum / f64::from(count))
}
