//! Writes corrected samples to a file.

use anyhow::{Context, Result};
use rins_selfcal::link::CorrectedReport;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::mem::take;
use std::path::{Path, PathBuf};

/// Columns: those of a log, with corrected values, then the status word and the running number of the sample.
const HEADER: &str = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,\
                      outer_rad,inner_rad,status,number\n";
/// Bytes that are collected before they are written, about one second of samples. Only whole rows are written, so that
/// an interrupted recording ends with a whole row.
const BUFFER_BYTES: usize = 32 * 1024;

/// A file of corrected samples as CSV. Numbers have all their digits, so that reading them back gives the same bits.
#[derive(Debug)]
pub(super) struct Recorder {
    path: PathBuf,
    file: File,
    /// Length of the file in whole rows, bytes.
    length: u64,
    /// The rows that are not written yet, and their number.
    rows: String,
    waiting: u64,
    /// Time of the instrument when its stream was off, us.
    off_us: u64,
    /// Whether the first sample of the stream has arrived.
    begun: bool,
    /// Whether the file could not be written. Further samples are dropped.
    failed: bool,
    /// Whether a reset was noted since the last sample.
    was_reset: bool,
    recorded: u64,
    missing: u64,
    restarts: u64,
    next: u32,
}

impl Recorder {
    /// Creates the file with its header. The stream was off at the time `off_us` of the instrument: earlier samples,
    /// which may still be on their way, belong to an earlier stream.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub(super) fn create(path: &Path, off_us: u64) -> Result<Self> {
        Self::of(File::create(path).with_context(|| format!("{}: cannot create", path.display()))?, path, off_us)
    }

    /// As [`Self::create`], in a file that is open.
    pub(super) fn of(file: File, path: &Path, off_us: u64) -> Result<Self> {
        let mut recorder = Self {
            path: path.into(),
            file,
            length: 0,
            rows: HEADER.into(),
            waiting: 0,
            off_us,
            begun: false,
            failed: false,
            was_reset: false,
            recorded: 0,
            missing: 0,
            restarts: 0,
            next: 0,
        };
        recorder.flush().map(|()| recorder)
    }

    /// Appends a sample. Samples of an earlier stream, and samples after a failure, are dropped. A gap in the running
    /// numbers is counted. A number that goes back is an instrument that has begun to count anew.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn record(&mut self, report: &CorrectedReport) -> Result<()> {
        // The time tells the stream where sample 0 was lost.
        self.begun |= report.number == 0 || report.time_us > self.off_us;
        if !self.begun || self.failed {
            return Ok(());
        }
        self.count(report.number);
        self.append(report);
        if self.rows.len() < BUFFER_BYTES { Ok(()) } else { self.flush() }
    }

    fn count(&mut self, number: u32) {
        let was_reset = take(&mut self.was_reset);
        let gap = number.checked_sub(self.next).unwrap_or_else(|| {
            self.restarts += u64::from(!was_reset);
            number
        });
        self.missing += u64::from(gap);
        self.next = number.saturating_add(1);
    }

    fn append(&mut self, report: &CorrectedReport) {
        let _ = write!(self.rows, "{}.{:06}", report.time_us / 1_000_000, report.time_us % 1_000_000);
        for number in report.omega_is_s.iter().chain(&report.force_s) {
            let _ = write!(self.rows, ",{number:?}");
        }
        for angle in report.angles {
            let _ = write!(self.rows, ",{:?}", angle.rad::<f64>());
        }
        let _ = writeln!(self.rows, ",{},{}", report.status.bits(), report.number);
        self.waiting += 1;
    }

    /// Notes that the instrument was reset. Its samples are counted from 0 again.
    pub(super) fn note_reset(&mut self) {
        self.restarts += 1;
        self.was_reset = true;
    }

    /// Whether a sample of the stream has arrived.
    pub(super) fn has_begun(&self) -> bool {
        self.begun
    }

    /// What the file holds, in one line.
    pub(super) fn summary(&self) -> String {
        let Self { recorded, missing, restarts, .. } = self;
        let again = match restarts {
            0 => String::new(),
            times => format!("; the instrument began to count anew, restarts: {times}"),
        };
        format!("corrected samples: {recorded} recorded, {missing} missing{again}")
    }

    /// Writes the collected rows. If that fails, the rows are dropped, and the file is cut after its last whole row.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn flush(&mut self) -> Result<()> {
        let (rows, count) = (take(&mut self.rows), take(&mut self.waiting));
        match self.file.write_all(rows.as_bytes()) {
            Ok(()) => {
                self.length += rows.len() as u64;
                self.recorded += count;
                Ok(())
            }
            Err(error) => {
                self.failed = true;
                // An error is ignored: a device or a pipe cannot be cut.
                let _ = self.file.set_len(self.length);
                Err(error).with_context(|| format!("{}: cannot write", self.path.display()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::angle::Angle;
    use rins_selfcal::base::sample::SampleStatus;

    const OFF_US: u64 = 5_000_000;

    fn report(number: u32) -> CorrectedReport {
        CorrectedReport {
            number,
            time_us: OFF_US + 2_500,
            force_s: [0.1, -1e-12, 9.79],
            omega_is_s: [1.0 / 3.0, 0.0, -7.292e-5],
            angles: [Angle::from_ticks(1 << 30), Angle::from_ticks(3 << 30)],
            status: SampleStatus::AT_REST,
        }
    }

    /// The summary after samples with these numbers, and the rows of the file.
    fn recorded(reports: &[CorrectedReport]) -> (String, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("corrected.csv");
        let mut recorder = Recorder::create(&path, OFF_US).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), HEADER);
        reports.iter().try_for_each(|report| recorder.record(report)).unwrap();
        recorder.flush().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        (recorder.summary(), text.lines().skip(1).map(String::from).collect())
    }

    #[test]
    fn a_recording_keeps_every_bit_and_counts_gaps() {
        let (summary, rows) = recorded(&[0, 1, 4, 0, 1].map(report));
        assert_eq!(
            summary,
            "corrected samples: 5 recorded, 2 missing; the instrument began to count anew, restarts: 1"
        );
        assert_eq!(rows.len(), 5);
        let fields: Vec<_> = rows[2].split(',').collect();
        assert_eq!((fields[0], fields[9], fields[10]), ("5.002500", "4", "4"));
        let number = |field: &str| field.parse::<f64>().unwrap().to_bits();
        let expected = [1.0 / 3.0, 0.0, -7.292e-5, 0.1, -1e-12, 9.79].map(f64::to_bits);
        assert_eq!(fields[1..7].iter().map(|field| number(field)).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_recording_begins_with_the_first_sample_of_its_own_stream() {
        let earlier = |number| CorrectedReport { time_us: OFF_US, ..report(number) };
        let (summary, rows) = recorded(&[earlier(70), earlier(71), report(0), report(1)]);
        assert_eq!((summary.as_str(), rows.len()), ("corrected samples: 2 recorded, 0 missing", 2));
        // Sample 0 may be older than the command that switched the stream on.
        let (summary, _) = recorded(&[earlier(71), earlier(0), earlier(1), report(2)]);
        assert_eq!(summary, "corrected samples: 3 recorded, 0 missing");
        // Sample 0 was lost.
        let (summary, _) = recorded(&[earlier(71), report(1), report(2)]);
        assert_eq!(summary, "corrected samples: 2 recorded, 1 missing");
    }

    #[test]
    fn a_noted_reset_is_counted_once() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(&folder.path().join("corrected.csv"), OFF_US).unwrap();
        [0, 1].iter().for_each(|number| recorder.record(&report(*number)).unwrap());
        recorder.note_reset();
        [1, 2].iter().for_each(|number| recorder.record(&report(*number)).unwrap());
        recorder.flush().unwrap();
        assert!(recorder.summary().ends_with("4 recorded, 1 missing; the instrument began to count anew, restarts: 1"));
    }

    #[test]
    fn after_a_failed_write_samples_are_dropped() {
        let (reader, writer) = std::io::pipe().unwrap();
        let mut recorder = Recorder::of(File::from(std::os::fd::OwnedFd::from(writer)), Path::new("pipe"), 0).unwrap();
        drop(reader);
        let failures = (0..1000).filter_map(|number| recorder.record(&report(number)).err());
        assert_eq!(failures.map(|error| error.to_string()).collect::<Vec<_>>(), ["pipe: cannot write"]);
        assert!(recorder.rows.is_empty() && recorder.flush().is_ok());
        assert_eq!(recorder.summary(), "corrected samples: 0 recorded, 0 missing");
    }
}
