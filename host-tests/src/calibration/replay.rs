//! Runs the core's chain on a log.

use super::{HostMethod, Outcome, Precision, Setup};
use crate::base::quantity::significant;
use crate::files::unit_file::UnitConfig;
use crate::log::{Layout, LogError, LogReader};
use crate::virtual_unit::plant::Reading;
use std::f64::consts::PI;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Number of rows between two calls of the progress function.
const ROWS_PER_TICK: u64 = 10_000;

/// Range of sample rates, Hz: 10 Hz to 10 kHz, with a margin of 1 % for rounded time stamps.
const RATES_HZ: RangeInclusive<f64> = 9.9..=10_100.0;
/// Relative difference that is allowed between the configured rate and the rate of the time stamps.
const RATE_TOLERANCE: f64 = 0.05;
/// Lowest encoder rate of a turning axis, in rad/s, or in deg/s if the angles are in degrees.
const LEAST_RATE: f64 = 0.1;

/// Reasons why a log gives no calibration.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log has a single time, so the sample rate is unknown.
    #[error("{}:2: column time_s: only one time, so the sample rate is unknown", path.display())]
    SingleTime {
        /// The file.
        path: PathBuf,
    },
    /// The rate of the time stamps is outside the range of IMUs.
    #[error("{}: time_s: the time stamps give {} Hz; are they in ms or us in place of s?", path.display(), significant(*rate_hz))]
    Rate {
        /// The file.
        path: PathBuf,
        /// Rate of the time stamps, Hz.
        rate_hz: f64,
    },
    /// The encoders turn much faster than the gyros.
    #[error("{}: outer_rad and inner_rad turn {ratio:.0} times as fast as the gyros; are they in degrees in place of radians?",
            path.display())]
    Degrees {
        /// The file.
        path: PathBuf,
        /// Largest rate of the encoders, divided by the largest rate of the gyros.
        ratio: f64,
    },
    /// The axes are never at rest.
    #[error("{}:{line}: columns outer_rad and inner_rad: no stop, in which both keep within 20 arcsec, up to the last line",
            path.display())]
    NoStop {
        /// The file.
        path: PathBuf,
        /// The last line.
        line: u64,
    },
    /// The axes never move.
    #[error("{}:{line}: columns outer_rad and inner_rad: no move between two stops up to the last line", path.display())]
    NoMove {
        /// The file.
        path: PathBuf,
        /// The last line.
        line: u64,
    },
}

/// Largest rates of a log, in rad/s as the names of the columns say.
#[derive(Default)]
struct Fastest {
    encoder: f64,
    gyro: f64,
    before: Option<Reading>,
}

impl Fastest {
    fn note(&mut self, reading: &Reading) {
        self.gyro = self.gyro.max(reading.omega_g.iter().map(|omega| omega * omega).sum::<f64>().sqrt());
        if let Some(before) = self.before.replace(*reading) {
            let time_s = (reading.time_us - before.time_us) as f64 * 1e-6;
            let steps = [reading.outer_rad - before.outer_rad, reading.inner_rad - before.inner_rad].map(f64::abs);
            // A step of half a turn or more is a wrap of the angle.
            for step in steps.into_iter().filter(|step| time_s > 0.0 && *step < PI) {
                self.encoder = self.encoder.max(step / time_s);
            }
        }
    }

    /// Ratio of both rates, if the ratio fits angles in degrees (57.3). The ratio is smaller if both axes turn at once,
    /// or if the gyros are noisy.
    fn of_degrees(&self) -> Option<f64> {
        let ratio = self.encoder / self.gyro;
        (self.encoder > LEAST_RATE && (40.0..75.0).contains(&ratio)).then_some(ratio)
    }
}

/// Replay of a log.
#[derive(Clone, Debug)]
pub struct Replay {
    /// The log.
    pub path: PathBuf,
    /// Columns and units of the log.
    pub layout: Layout,
    /// Unit and site.
    pub unit: UnitConfig,
    /// Method.
    pub method: HostMethod,
    /// Floating-point type of the core.
    pub precision: Precision,
    /// Whether to solve once more with the size of the hardware enlarged that the verdict names as too small.
    pub adapt: bool,
}

impl Replay {
    /// Runs the chain on the log. `on_rows` is called every 10 000 rows with the number of rows so far, `on_reading`
    /// with every reading.
    ///
    /// # Errors
    /// The file is not a log, has a wrong row, or shows no stop or no move.
    pub fn run(
        &self,
        mut on_rows: impl FnMut(u64),
        mut on_reading: impl FnMut(&Reading),
    ) -> Result<Outcome, ReplayError> {
        let reader = LogReader::open_as(&self.path, &self.layout)?;
        let rate_hz = self.rate_hz(&reader)?;
        let setup = Setup { adapt: self.adapt, ..Setup::new(&self.unit, rate_hz, self.method, self.precision) };
        let mut chain = setup.chain();
        let (mut rows, mut line) = (0, 1);
        let mut fastest = Fastest::default();
        for row in reader {
            let row = row?;
            (rows, line) = (rows + 1, row.line);
            if rows % ROWS_PER_TICK == 0 {
                on_rows(rows);
            }
            fastest.note(&row.reading);
            on_reading(&row.reading);
            // The live estimates are part of the outcome.
            let _ = chain.step(&row.reading);
        }
        if let Some(ratio) = fastest.of_degrees() {
            return Err(ReplayError::Degrees { path: self.path.clone(), ratio });
        }
        let _ = chain.finish();
        self.with_moves(chain.conclude(), line)
    }

    fn rate_hz(&self, reader: &LogReader) -> Result<f64, ReplayError> {
        let path = || self.path.clone();
        let interval_us = reader.interval_us().ok_or_else(|| ReplayError::SingleTime { path: path() })?;
        let rate_hz = 1e6 / interval_us as f64;
        if !RATES_HZ.contains(&rate_hz) {
            return Err(ReplayError::Rate { path: path(), rate_hz });
        }
        Ok(self.unit.sampling.rate_hz.unwrap_or(rate_hz))
    }

    /// The configured rate and the rate of the time stamps, Hz, if they differ. The configured rate is used: it
    /// determines how many samples are expected, and samples that are not in the log count as missing.
    ///
    /// # Errors
    /// The file is not a log, or has a wrong row among the first few thousand.
    pub fn other_rate_hz(&self) -> Result<Option<[f64; 2]>, ReplayError> {
        let Some(configured) = self.unit.sampling.rate_hz else { return Ok(None) };
        let interval_us = LogReader::open_as(&self.path, &self.layout)?.interval_us();
        let measured = interval_us.map(|interval_us| 1e6 / interval_us as f64);
        let differs = |measured: &f64| (measured / configured - 1.0).abs() > RATE_TOLERANCE;
        Ok(measured.filter(differs).map(|measured| [configured, measured]))
    }

    fn with_moves(&self, outcome: Outcome, line: u64) -> Result<Outcome, ReplayError> {
        let path = self.path.clone();
        match outcome {
            Outcome { stops: 0, .. } => Err(ReplayError::NoStop { path, line }),
            Outcome { moves: 0, .. } => Err(ReplayError::NoMove { path, line }),
            outcome => Ok(outcome),
        }
    }
}

/// The unit description in the folder of a log: `LOG.toml` for `LOG.csv` or `LOG.csv.gz`.
pub fn config_beside(log: &Path) -> Option<PathBuf> {
    let name = log.file_name()?.to_str()?;
    let stem = name.strip_suffix(".gz").unwrap_or(name);
    let config = log.with_file_name(stem.strip_suffix(".csv").unwrap_or(stem).to_string() + ".toml");
    config.is_file().then_some(config)
}
