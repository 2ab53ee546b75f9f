//! The rows of a unit description that the stops of a log support, each with its number.
//!
//! | in the Allan curves | row |
//! |---|---|
//! | white noise | `accel_vrw_ug_sqrt_hz`, `gyro_arw_deg_sqrt_h` |
//! | floor, walk | `accel_floor_ug`, `accel_walk_ug_sqrt_h` and those of the gyros |
//! | a grid of values, or noise of the angle without one | `gyro_pulse_arcsec`, `accel_pulse_mm_s` |
//! | rocking | `base_rocking_arcsec` |
//! | ramp | none: a warm-up, which has its size |
//!
//! A row that the stops do not tell stays as configured. Noise of the angle that has no grid, and rocking, change their
//! rows only if they are larger than configured. They are not told apart from errors of single readings of the
//! encoders, by which hunting is removed, and stay as configured unless they are clearly larger than these.

use super::allan::AllanPoint;
use super::noise::ChannelNoise;
use super::shapes::{Process, Processes};
use crate::base::quantity::significant;
use crate::files::unit_file::UnitConfig;
use rins_selfcal::base::hardware::HardwareSize;
use rins_selfcal::base::sample::CHANNELS;
use rins_selfcal::base::units::{DEG_SQRT_H, MICRO_G};
use rins_selfcal::segment::Segment;
use rins_selfcal::segment::readings::Readings;
use serde::Serialize;

/// A channel whose white noise is larger than the triad's mean by more than this factor sets that of the triad.
const ALIKE: f64 = 1.15;

/// Noise of the angle is told apart from errors of single readings if it is larger than these by this factor.
const CLEARLY: f64 = 2.0;

/// What the core knows of the outputs and of the encoders after all stops.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steps {
    /// Increments of the channels that are known to have pulses, m/s and rad; 0 for the others.
    pub pulses: [f64; CHANNELS],
    /// Standard deviation of single readings of the encoders, rad.
    pub reading_rad: f64,
}

impl Steps {
    /// By the segments of a log with this interval.
    pub fn of(segments: &[Segment<f64>], interval_s: f64) -> Self {
        let stops = || segments.iter().filter_map(Segment::standing);
        let increments = stops().next_back().map_or([0.0; CHANNELS], |last| last.increments);
        let readings = stops().flat_map(|stop| stop.readings.iter().map(Readings::variance));
        Self {
            pulses: increments.map(|increment| f64::from(increment) * interval_s),
            reading_rad: readings.fold(0.0, f64::max).sqrt(),
        }
    }
}

/// A row of a unit description.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Its key.
    pub key: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The number that the log shows, in its unit. `None` if the row stays as configured.
    pub seen: Option<f64>,
    /// Standard deviation of this number. `None` if it is exact, as the grid of pulses, or not known.
    pub sigma: Option<f64>,
    /// The configured number, in its unit.
    pub configured: f64,
}

impl Row {
    /// A row of `[hardware]`, or an Allan floor or a walk of `[noise]`, with what a log shows of it, SI.
    fn of(unit: &UnitConfig, key: &'static str, seen: Option<Seen>) -> Self {
        let size = size(key);
        let configured = size.get(&unit.hardware()) / size.unit_si;
        let row = Self { key, unit: size.unit, seen: None, sigma: None, configured };
        row.with(seen.map(|seen| Seen { value: seen.value.min(size.largest * size.unit_si), ..seen }), size.unit_si)
    }

    fn with(self, seen: Option<Seen>, unit_si: f64) -> Self {
        let of = |number: f64| three_digits(number / unit_si);
        Self { seen: seen.map(|seen| of(seen.value)), sigma: seen.and_then(|seen| seen.sigma).map(of), ..self }
    }

    /// The number of the row.
    pub fn value(&self) -> f64 {
        self.seen.unwrap_or(self.configured)
    }

    /// The number in words.
    pub fn described(&self) -> [String; 2] {
        let from = if self.seen.is_some() { "seen" } else { "not told by the log: stays as configured" };
        let sigma = self.sigma.map_or_else(String::new, |sigma| format!(" +- {}", significant(sigma)));
        [significant(self.value()) + &sigma, from.into()]
    }

    /// Writes the row into a unit description, if the log shows it.
    pub fn write(&self, unit: &mut UnitConfig) {
        let Some(seen) = self.seen else { return };
        let noise = &mut unit.noise;
        match self.key {
            "accel_vrw_ug_sqrt_hz" => noise.accel_vrw_ug_sqrt_hz = seen,
            "gyro_arw_deg_sqrt_h" => noise.gyro_arw_deg_sqrt_h = seen,
            "encoder_repeatability_arcsec" => noise.encoder_repeatability_arcsec = seen,
            "accel_floor_ug" => noise.accel_floor_ug = Some(seen),
            "accel_walk_ug_sqrt_h" => noise.accel_walk_ug_sqrt_h = Some(seen),
            "gyro_floor_deg_h" => noise.gyro_floor_deg_h = Some(seen),
            "gyro_walk_deg_h_sqrt_h" => noise.gyro_walk_deg_h_sqrt_h = Some(seen),
            key => size(key).set(&mut unit.hardware.0, seen * size(key).unit_si),
        }
    }
}

/// A number that a log shows, with its standard deviation if it is known, SI.
#[derive(Clone, Copy)]
struct Seen {
    value: f64,
    sigma: Option<f64>,
}

impl Seen {
    fn of(processes: &Processes, process: Process) -> Option<Self> {
        processes.found(process).map(|found| Self { value: found.size, sigma: found.sigma })
    }

    fn scaled(self, factor: f64) -> Self {
        Self { value: factor * self.value, sigma: self.sigma.map(|sigma| factor * sigma) }
    }
}

fn size(key: &str) -> &'static HardwareSize {
    HardwareSize::named(key).expect("a key of the hardware")
}

/// The rows of the sensors and the base.
pub fn of_stops(channels: &[ChannelNoise], steps: &Steps, unit: &UnitConfig) -> Vec<Row> {
    let (accels, gyros) = channels.split_at(channels.len() / 2);
    let (accel_pulses, gyro_pulses) = steps.pulses.split_at(CHANNELS / 2);
    let [of_accels, of_gyros] = [(accels, &Process::OF_ACCELEROMETER[..]), (gyros, &Process::OF_GYRO)]
        .map(|(triad, known)| together(triad, known));
    // The error of a pulse is distributed evenly, and the three gyros share the rocking about two axes.
    let [like_pulses, like_rocking] = [12.0_f64, 1.5].map(f64::sqrt);
    let pulse = |key: &'static str, pulses: &[f64], processes: &Processes, least: f64| {
        let known = Some(pulses.iter().copied().fold(0.0, f64::max)).filter(|pulse| *pulse > 0.0);
        let known = known.map(|value| Seen { value, sigma: None });
        let alike = Seen::of(processes, Process::Angle).filter(|rms| rms.value > least);
        Row::of(unit, key, known.or(larger(unit, key, alike.map(|rms| rms.scaled(like_pulses)))))
    };
    let least = CLEARLY * steps.reading_rad;
    let rocking = Seen::of(&of_gyros, Process::Rocking).filter(|rms| rms.value > least);
    let rocking = rocking.map(|rms| rms.scaled(like_rocking));
    let white = |key, symbol, unit_si: f64, triad: &[ChannelNoise], processes: &Processes, configured| {
        Row { key, unit: symbol, seen: None, sigma: None, configured }.with(white(triad, processes), unit_si)
    };
    let (vrw, arw) = (unit.noise.accel_vrw_ug_sqrt_hz, unit.noise.gyro_arw_deg_sqrt_h);
    vec![
        white("accel_vrw_ug_sqrt_hz", "ug/sqrt(Hz)", MICRO_G, accels, &of_accels, vrw),
        Row::of(unit, "accel_floor_ug", Seen::of(&of_accels, Process::Floor)),
        Row::of(unit, "accel_walk_ug_sqrt_h", Seen::of(&of_accels, Process::Walk)),
        pulse("accel_pulse_mm_s", accel_pulses, &of_accels, 0.0),
        white("gyro_arw_deg_sqrt_h", "deg/sqrt(h)", DEG_SQRT_H, gyros, &of_gyros, arw),
        Row::of(unit, "gyro_floor_deg_h", Seen::of(&of_gyros, Process::Floor)),
        Row::of(unit, "gyro_walk_deg_h_sqrt_h", Seen::of(&of_gyros, Process::Walk)),
        pulse("gyro_pulse_arcsec", gyro_pulses, &of_gyros, least),
        Row::of(unit, "base_rocking_arcsec", larger(unit, "base_rocking_arcsec", rocking)),
    ]
}

/// A size, SI, if it is larger than the configured size.
fn larger(unit: &UnitConfig, key: &str, seen: Option<Seen>) -> Option<Seen> {
    seen.filter(|seen| seen.value > size(key).get(&unit.hardware()))
}

/// The processes in the mean of the curves of a triad.
fn together(triad: &[ChannelNoise], known: &[Process]) -> Processes {
    let Some(first) = triad.first() else { return Processes::default() };
    let count = triad.len() as f64;
    let mean = |(place, point): (usize, &AllanPoint)| {
        let squares = triad.iter().filter_map(|channel| Some(channel.curve.get(place)?.deviation.powi(2)));
        let deviation = (squares.sum::<f64>() / count).sqrt();
        AllanPoint { deviation, scatter: point.scatter / count.sqrt(), ..*point }
    };
    let curve: Vec<AllanPoint> = first.curve.iter().enumerate().map(mean).collect();
    Processes::of(&curve, known)
}

/// White noise of a triad, which has one number for its three channels: that of their mean curve, or the noise of the
/// noisiest channel if it is clearly larger.
fn white(triad: &[ChannelNoise], together: &Processes) -> Option<Seen> {
    let mean = Seen::of(together, Process::White)?;
    let of_channel = triad.iter().filter_map(|channel| Seen::of(&channel.processes, Process::White));
    let most = of_channel.max_by(|a, b| a.value.total_cmp(&b.value));
    most.filter(|most| most.value > ALIKE * mean.value).or(Some(mean))
}

/// Rounds to three significant digits, which is all that the estimate is worth in a file.
pub fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
