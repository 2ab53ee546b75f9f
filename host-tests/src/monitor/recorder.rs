//! Records the corrected samples of an instrument in a file.

use anyhow::{Context, Result};
use rins_selfcal::link::CorrectedReport;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Columns: those of a log, with corrected values, then the status word and the running number of the sample.
const HEADER: &str = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,\
                      outer_rad,inner_rad,status,number\n";
/// Bytes that are collected before they are written, about one second of samples. Only whole rows are written, so that
/// an interrupted recording ends with a whole row.
const BUFFER_BYTES: usize = 32 * 1024;

/// A recording of corrected samples as CSV. Numbers have all their digits, so that reading them back gives the same
/// bits.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    file: File,
    rows: String,
    recorded: u64,
    missing: u64,
    restarts: u64,
    next: u32,
}

impl Recorder {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).with_context(|| format!("{}: cannot create", path.display()))?;
        Ok(Self { path: path.into(), file, rows: HEADER.into(), recorded: 0, missing: 0, restarts: 0, next: 0 })
    }

    /// Appends a sample. A gap in the running numbers is counted. A number that goes back is an instrument that has begun to
    /// count anew.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn record(&mut self, report: &CorrectedReport) -> Result<()> {
        match report.number.checked_sub(self.next) {
            Some(gap) => self.missing += u64::from(gap),
            None => self.restarts += 1,
        }
        self.next = report.number.saturating_add(1);
        self.recorded += 1;
        let _ = write!(self.rows, "{}.{:06}", report.time_us / 1_000_000, report.time_us % 1_000_000);
        for number in report.omega_is_s.iter().chain(&report.force_s) {
            let _ = write!(self.rows, ",{number:?}");
        }
        for angle in report.angles {
            let _ = write!(self.rows, ",{:?}", angle.rad::<f64>());
        }
        let _ = writeln!(self.rows, ",{},{}", report.status.bits(), report.number);
        if self.rows.len() < BUFFER_BYTES { Ok(()) } else { self.flush() }
    }

    /// What the recording holds, in one line.
    pub fn summary(&self) -> String {
        let Self { recorded, missing, restarts, .. } = self;
        let again = match restarts {
            0 => String::new(),
            times => format!("; the instrument began to count anew, restarts: {times}"),
        };
        format!("corrected samples: {recorded} recorded, {missing} missing{again}")
    }

    /// Writes the collected rows.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        self.file.write_all(self.rows.as_bytes()).with_context(|| format!("{}: cannot write", self.path.display()))?;
        self.rows.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::angle::Angle;
    use rins_selfcal::base::sample::SampleStatus;

    #[test]
    fn a_recording_keeps_every_bit_and_counts_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("corrected.csv");
        let mut recorder = Recorder::create(&path).unwrap();
        let report = |number| CorrectedReport {
            number,
            time_us: 5_002_500,
            force_s: [0.1, -1e-12, 9.79],
            omega_is_s: [1.0 / 3.0, 0.0, -7.292e-5],
            angles: [Angle::from_ticks(1 << 30), Angle::from_ticks(3 << 30)],
            status: SampleStatus::AT_REST,
        };
        for number in [0, 1, 4, 0, 1] {
            recorder.record(&report(number)).unwrap();
        }
        recorder.flush().unwrap();
        assert_eq!(
            recorder.summary(),
            "corrected samples: 5 recorded, 2 missing; the instrument began to count anew, restarts: 1"
        );
        let text = std::fs::read_to_string(&path).unwrap();
        let rows: Vec<_> = text.lines().collect();
        assert_eq!(rows.len(), 6);
        let fields: Vec<_> = rows[3].split(',').collect();
        assert_eq!((fields[0], fields[9], fields[10]), ("5.002500", "4", "4"));
        let number = |field: &str| field.parse::<f64>().unwrap().to_bits();
        let expected = [1.0 / 3.0, 0.0, -7.292e-5, 0.1, -1e-12, 9.79].map(f64::to_bits);
        assert_eq!(fields[1..7].iter().map(|field| number(field)).collect::<Vec<_>>(), expected);
    }
}
