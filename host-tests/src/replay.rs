//! A log through the core's chain.

use crate::calibration::{Outcome, Precision, Setup};
use crate::log::{LogError, LogReader};
use crate::unit::UnitConfig;
use rins_selfcal::calibrator::Progress;
use rins_selfcal::method::Method;
use rins_selfcal::options::Options;
use std::path::{Path, PathBuf};

/// Rows between two calls of the progress function.
const ROWS_PER_TICK: u64 = 10_000;

/// Why a log gives no calibration.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The sample rate cannot be told.
    #[error("{}:2: column time_s: a single time, so no sample rate", path.display())]
    SingleTime {
        /// The file.
        path: PathBuf,
    },
    /// The axes never stand.
    #[error("{}:{line}: columns outer_rad and inner_rad: no stop up to the last line, where both keep within 20 arcsec",
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

/// What to do with a log.
#[derive(Clone, Debug)]
pub struct Replay {
    /// The log.
    pub path: PathBuf,
    /// Unit and site.
    pub unit: UnitConfig,
    /// Joint or two-stage.
    pub method: Method,
    /// Scalar of the core.
    pub precision: Precision,
    /// Optional states and noise of the joint method.
    pub options: Options,
}

impl Replay {
    /// Streams the log through the chain. `on_rows` is called now and then with the number of rows so far, `on_segment`
    /// with every live estimate.
    ///
    /// # Errors
    /// The log is no log, has a wrong row, or shows no stop or no move.
    pub fn run(
        &self,
        mut on_rows: impl FnMut(u64),
        mut on_segment: impl FnMut(&Progress),
    ) -> Result<Outcome, ReplayError> {
        let reader = LogReader::open(&self.path)?;
        let rate_hz = self.rate_hz(&reader)?;
        let setup = Setup::new(&self.unit, rate_hz, self.method, self.precision);
        let mut chain = Setup { options: self.options, ..setup }.chain();
        let (mut rows, mut line) = (0, 1);
        for row in reader {
            let row = row?;
            (rows, line) = (rows + 1, row.line);
            if rows % ROWS_PER_TICK == 0 {
                on_rows(rows);
            }
            chain.step(&row.reading).iter().for_each(&mut on_segment);
        }
        self.with_moves(chain.conclude(&mut on_segment), line)
    }

    fn rate_hz(&self, reader: &LogReader) -> Result<f64, ReplayError> {
        let measured = reader.interval_us().map(|interval_us| 1e6 / interval_us as f64);
        let rate_hz = self.unit.sampling.rate_hz.or(measured);
        rate_hz.ok_or_else(|| ReplayError::SingleTime { path: self.path.clone() })
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

/// The unit description that lies beside a log, by its name: `LOG.toml` beside `LOG.csv` or `LOG.csv.gz`.
pub fn config_beside(log: &Path) -> Option<PathBuf> {
    let name = log.file_name()?.to_str()?;
    let stem = name.strip_suffix(".gz").unwrap_or(name);
    let config = log.with_file_name(stem.strip_suffix(".csv").unwrap_or(stem).to_string() + ".toml");
    config.is_file().then_some(config)
}
