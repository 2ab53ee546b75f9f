//! The interface of an instrument to the bench: it advances by control periods and is driven by two windings.

use rins_selfcal::gimbal::servo::{Drive, PERIOD_US};
use std::cell::RefCell;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// What the IMU and the encoders report after one data-ready edge, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Middle of the interval over which rates and forces are averaged, us. The angles belong to the same time.
    pub time_us: u64,
    /// Gyro outputs, rad/s.
    pub omega_g: [f64; 3],
    /// Accelerometer outputs, m/s^2.
    pub force_a: [f64; 3],
    /// Outer encoder, rad, continuous or wrapped.
    pub outer_rad: f64,
    /// Inner encoder, rad, continuous or wrapped.
    pub inner_rad: f64,
    /// IMU temperature, deg C. NaN without a sensor.
    pub temperature_c: f32,
}

/// Measurements at the end of a control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// Readings of the outer and the inner encoder, rad.
    pub encoders_rad: [f64; 2],
    /// Measurement of the IMU, if an interval of the IMU ended in this period.
    pub reading: Option<Reading>,
}

/// State of the bridge's output to the winding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// Mean voltage as a fraction of the supply, -1 to 1.
    Driven(f64),
    /// Shorted.
    Shorted,
    /// Open.
    Open,
}

impl From<Output> for Drive<f64> {
    fn from(output: Output) -> Self {
        match output {
            Output::Driven(part) => Self::Duty(part),
            Output::Shorted => Self::Brake,
            Output::Open => Self::Off,
        }
    }
}

/// An instrument, virtual or recorded.
pub trait Plant {
    /// Advances by a control period in which the windings of the outer and the inner motor have these outputs. Returns
    /// `None` when the instrument is switched off. A recording ignores the windings.
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick>;
}

/// An instrument that runs in real time.
pub struct Paced<P> {
    plant: P,
    interval: Duration,
    next: Instant,
}

impl<P> Paced<P> {
    /// The instrument `plant` with this time from one period to the next.
    pub fn new(plant: P, interval: Duration) -> Self {
        Self { plant, interval, next: Instant::now() }
    }
}

impl<P: Plant> Plant for Paced<P> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        let now = Instant::now();
        std::thread::sleep(self.next.saturating_duration_since(now));
        // After a delay the later periods keep their length, so lost time is not caught up.
        self.next = self.next.max(now) + self.interval;
        self.plant.advance(outputs)
    }
}

/// An instrument that others can observe while it is on the bench.
impl<P: Plant> Plant for Rc<RefCell<P>> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        self.borrow_mut().advance(outputs)
    }
}

/// Control periods in an interval of the IMU at 200 Hz.
const PERIODS: u64 = 5000 / PERIOD_US;

/// Readings at 200 Hz in place of an instrument. The encoder angles are constant over each interval.
#[derive(Clone, Debug)]
pub struct Recording<I> {
    readings: I,
    under_way: Option<Reading>,
    periods: u64,
}

impl<I: Iterator<Item = Reading>> Recording<I> {
    /// Plays the readings. Their times are ignored.
    pub fn new(readings: I) -> Self {
        Self { readings, under_way: None, periods: 0 }
    }

    /// The readings that have not been played.
    pub fn into_readings(self) -> I {
        self.readings
    }
}

impl<I: Iterator<Item = Reading>> Plant for Recording<I> {
    fn advance(&mut self, _outputs: [Output; 2]) -> Option<Tick> {
        let reading = match self.under_way.take() {
            Some(reading) => reading,
            None => self.readings.next()?,
        };
        self.periods += 1;
        let ends = self.periods.is_multiple_of(PERIODS);
        self.under_way = (!ends).then_some(reading);
        Some(Tick { encoders_rad: [reading.outer_rad, reading.inner_rad], reading: ends.then_some(reading) })
    }
}

/// An instrument at rest for a number of samples at 200 Hz, level, on an Earth that does not turn.
pub fn at_rest(samples: u32) -> Recording<impl Iterator<Item = Reading>> {
    Recording::new((0..samples).map(|sample| Reading {
        time_us: u64::from(sample) * 5000,
        omega_g: [0.0; 3],
        force_a: [0.0, 0.0, 9.8],
        outer_rad: 0.0,
        inner_rad: 0.0,
        temperature_c: 20.0,
    }))
}
