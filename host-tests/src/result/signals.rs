//! Signals of the IMU and the encoders during a run, reduced to few points for a plot.

use crate::virtual_unit::plant::{Output, Plant, Reading, Tick};
use rins_selfcal::base::angle::{Angle, ticks_to_rad};
use std::cell::RefCell;
use std::rc::Rc;

/// Smallest number of points of a long run. When there are twice as many points, neighbouring points are averaged.
const POINTS: usize = 2048;

/// Means over several samples; time and angles are those of the last sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Time of the last sample, s.
    pub time_s: f64,
    /// Gyro outputs, rad/s.
    pub omega_g: [f64; 3],
    /// Accelerometer outputs, m/s^2.
    pub force_a: [f64; 3],
    /// Outer and inner angle, continuous over whole turns, rad.
    pub angles_rad: [f64; 2],
}

/// A run of any length in at most 4096 points.
#[derive(Clone, Debug, Default)]
pub struct Signals {
    points: Vec<Point>,
    /// Binary logarithm of the number of samples in a point.
    doublings: u32,
    /// Sums of the current point, and the number of its samples.
    sum: Option<(Point, u32)>,
    /// Last readings of both encoders, and their continuous angles, rad.
    turned: Option<[(Angle, f64); 2]>,
}

impl Signals {
    /// Adds a reading.
    pub fn note(&mut self, reading: &Reading) {
        let point = Point {
            time_s: reading.time_us as f64 * 1e-6,
            omega_g: reading.omega_g,
            force_a: reading.force_a,
            angles_rad: self.count_turns([reading.outer_rad, reading.inner_rad]),
        };
        let (sum, count) = match self.sum.take() {
            Some((sum, count)) => (combined(&sum, &point, 1.0), count + 1),
            None => (point, 1),
        };
        if count < 1 << self.doublings {
            self.sum = Some((sum, count));
            return;
        }
        self.points.push(scaled(&sum, 1.0 / f64::from(count)));
        if self.points.len() >= 2 * POINTS {
            self.points = self.points.chunks_exact(2).map(|pair| combined(&pair[0], &pair[1], 0.5)).collect();
            self.doublings += 1;
        }
    }

    /// The points so far.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    fn count_turns(&mut self, angles_rad: [f64; 2]) -> [f64; 2] {
        let read = angles_rad.map(Angle::from_rad);
        let turned = match self.turned {
            Some(before) => [0, 1].map(|axis: usize| {
                let (angle, total) = before[axis];
                (read[axis], total + ticks_to_rad::<f64>(read[axis].since(angle).into()))
            }),
            None => [0, 1].map(|axis| (read[axis], angles_rad[axis])),
        };
        self.turned = Some(turned);
        turned.map(|(_, total)| total)
    }
}

/// Sum of the signals of two points, times a factor; time and angles are those of the second point.
fn combined(first: &Point, second: &Point, factor: f64) -> Point {
    let sum = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| (a[axis] + b[axis]) * factor);
    Point { omega_g: sum(first.omega_g, second.omega_g), force_a: sum(first.force_a, second.force_a), ..*second }
}

fn scaled(point: &Point, factor: f64) -> Point {
    let by = |values: [f64; 3]| values.map(|value| value * factor);
    Point { omega_g: by(point.omega_g), force_a: by(point.force_a), ..*point }
}

/// Signals that a plant records and other code reads.
pub type SharedSignals = Rc<RefCell<Signals>>;

/// A plant whose readings are recorded.
pub struct Recorded<P> {
    plant: P,
    signals: SharedSignals,
}

impl<P> Recorded<P> {
    /// Records the readings of `plant` in `signals`.
    pub fn new(plant: P, signals: &SharedSignals) -> Self {
        Self { plant, signals: Rc::clone(signals) }
    }
}

impl<P: Plant> Plant for Recorded<P> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        let tick = self.plant.advance(outputs)?;
        tick.reading.iter().for_each(|reading| self.signals.borrow_mut().note(reading));
        Some(tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    fn reading(number: u32, outer_rad: f64) -> Reading {
        Reading {
            time_us: u64::from(number) * 5000,
            omega_g: [f64::from(number), 0.0, 0.0],
            force_a: [0.0, 0.0, 9.8],
            outer_rad,
            inner_rad: 0.0,
            temperature_c: f32::NAN,
        }
    }

    #[test]
    fn a_long_run_keeps_mean_and_turns_in_few_points() {
        let mut signals = Signals::default();
        let samples = 16 * POINTS as u32;
        for number in 0..samples {
            // Three turns in the negative direction; the encoder reads -pi to pi.
            let angle = -3.0 * TAU * f64::from(number + 1) / f64::from(samples);
            signals.note(&reading(number, (angle + PI).rem_euclid(TAU) - PI));
        }
        let points = signals.points();
        assert!((POINTS..2 * POINTS).contains(&points.len()), "{}", points.len());
        let mean = points.iter().map(|point| point.omega_g[0]).sum::<f64>() / points.len() as f64;
        assert!((mean - f64::from(samples - 1) / 2.0).abs() < 1e-6, "{mean}");
        assert!((points[points.len() - 1].angles_rad[0] + 3.0 * TAU).abs() < 1e-6);
    }
}
