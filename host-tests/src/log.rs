//! Logs: CSV with one header row, plain or compressed with gzip, SI units and radians.
//!
//! Columns are found by name, in any order; others are ignored. The reader streams, and refuses what it cannot read with
//! one line that names file, line and column. Repeated time stamps and gaps pass: the core judges and counts them.

use crate::plant::{Plant, Reading};
use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

/// Columns that every log has.
pub const COLUMNS: [&str; 9] = [
    "time_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "outer_rad",
    "inner_rad",
];
/// Column that a log may have; an empty field or `nan` in it means that the sensor was silent.
pub const TEMPERATURE_COLUMN: &str = "temperature_c";

/// Rows from which the sample interval is estimated.
const HEAD_ROWS: usize = 4096;
/// Latest time stamp, s; a century, and microseconds still fit an `f64` to a thousandth.
const LATEST_S: f64 = 3.2e9;

/// Why a log cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file cannot be opened, created or written.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// The path is a directory.
    #[error("{}: is a directory", path.display())]
    Directory {
        /// The path.
        path: PathBuf,
    },
    /// Reading, or decompressing, fails on the way.
    #[error("{}:{line}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What the system or the decompressor says.
        cause: std::io::Error,
    },
    /// Nothing in the file.
    #[error("{}:1: the file is empty, expected a header row", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A header, and no samples.
    #[error("{}:2: no samples after the header row", path.display())]
    HeaderOnly {
        /// The file.
        path: PathBuf,
    },
    /// Columns separated by something else.
    #[error("{}:1: the columns are separated by ';', not ','", path.display())]
    Semicolons {
        /// The file.
        path: PathBuf,
    },
    /// The header lacks a column.
    #[error("{}:1: column {column} is missing", path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: &'static str,
    },
    /// The header has a column twice.
    #[error("{}:1: column {column} is there twice, as columns {} and {}", path.display(), numbers[0], numbers[1])]
    DuplicateColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: &'static str,
        /// Where it is, from 1.
        numbers: [usize; 2],
    },
    /// A row has fewer or more fields than the header.
    #[error("{}:{line}: {found} fields, the header has {expected}; column {column} is the first {}",
            path.display(), if found < expected { "missing" } else { "too many" })]
    RowLength {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Fields of the row.
        found: usize,
        /// Fields of the header.
        expected: usize,
        /// Name of the first missing column, or number, from 1, of the first field without a column.
        column: String,
    },
    /// Not UTF-8.
    #[error("{}:{line}: column {column}: not UTF-8", path.display())]
    NotUtf8 {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Name of the column, or its number, from 1, in the header.
        column: String,
    },
    /// Not a number.
    #[error("{}:{line}: column {column}: \"{text}\" is not a number", path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What is there.
        text: String,
    },
    /// Infinite, or "nan".
    #[error("{}:{line}: column {column}: {text} is not finite", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What is there.
        text: String,
    },
    /// A time stamp before zero or too late to count in microseconds.
    #[error("{}:{line}: column time_s: {time_s} is not between 0 and {LATEST_S}", path.display())]
    TimeRange {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The time stamp, s.
        time_s: f64,
    },
    /// A time stamp earlier than the one before.
    #[error("{}:{line}: column time_s: time goes back from {previous_us} to {time_us} us", path.display())]
    TimeBack {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The time stamp, us.
        time_us: u64,
        /// The one before, us.
        previous_us: u64,
    },
}

/// A reading and where it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow {
    /// Line in the file, from 1.
    pub line: u64,
    /// The reading.
    pub reading: Reading,
}

/// Streams the rows of a log.
pub struct LogReader {
    rows: Rows,
    head: VecDeque<LogRow>,
    interval_us: Option<u64>,
}

impl LogReader {
    /// Opens a log, plain or gzip (told by its contents), and reads its first rows.
    ///
    /// # Errors
    /// The file cannot be read, is no log, or has a wrong row among the first few thousand.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let mut rows = Rows::open(path)?;
        let mut head = VecDeque::with_capacity(HEAD_ROWS);
        while head.len() < HEAD_ROWS {
            match rows.next_row()? {
                Some(row) => head.push_back(row),
                None => break,
            }
        }
        if head.is_empty() {
            return Err(LogError::HeaderOnly { path: path.into() });
        }
        let interval_us = median_interval_us(head.make_contiguous());
        Ok(Self { rows, head, interval_us })
    }

    /// Sample interval, us: the median over the first few thousand rows, repeated stamps left out; `None` where there
    /// are fewer than two times.
    pub fn interval_us(&self) -> Option<u64> {
        self.interval_us
    }
}

impl Iterator for LogReader {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.head.pop_front() {
            Some(row) => Some(Ok(row)),
            None => self.rows.next_row().transpose(),
        }
    }
}

fn median_interval_us(rows: &[LogRow]) -> Option<u64> {
    let steps = rows.windows(2).map(|pair| pair[1].reading.time_us - pair[0].reading.time_us);
    let mut steps: Vec<u64> = steps.filter(|&step| step > 0).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied()
}

/// The rows below the header.
struct Rows {
    path: PathBuf,
    csv: csv::Reader<Box<dyn Read>>,
    columns: [usize; COLUMNS.len()],
    temperature: Option<usize>,
    header: Vec<String>,
    record: csv::ByteRecord,
    previous_us: u64,
}

impl Rows {
    fn open(path: &Path) -> Result<Self, LogError> {
        // Rows end at a line feed, the last one too; carriage returns are trimmed with other blanks. So lines count right.
        let input: Box<dyn Read> = Box::new(open_input(path)?.chain(&b"\n"[..]));
        let mut csv = csv::ReaderBuilder::new()
            .flexible(true)
            .terminator(csv::Terminator::Any(b'\n'))
            .buffer_capacity(1 << 16)
            .from_reader(input);
        let header = read_header(path, &mut csv)?;
        let mut columns = [0; COLUMNS.len()];
        for (position, column) in columns.iter_mut().zip(COLUMNS) {
            *position = find_column(path, &header, column)?
                .ok_or_else(|| LogError::MissingColumn { path: path.into(), column })?;
        }
        let temperature = find_column(path, &header, TEMPERATURE_COLUMN)?;
        let record = csv::ByteRecord::new();
        Ok(Self { path: path.into(), csv, columns, temperature, header, record, previous_us: 0 })
    }

    fn next_row(&mut self) -> Result<Option<LogRow>, LogError> {
        let Some(line) = self.read_record()? else { return Ok(None) };
        self.check_length(line)?;
        let mut values = [0.0; COLUMNS.len()];
        for (value, (position, column)) in values.iter_mut().zip(self.columns.iter().zip(COLUMNS)) {
            *value = self.finite(line, *position, column)?;
        }
        let [time_s, gx, gy, gz, ax, ay, az, outer_rad, inner_rad] = values;
        let reading = Reading {
            time_us: self.time_us(line, time_s)?,
            omega_g: [gx, gy, gz],
            force_a: [ax, ay, az],
            outer_rad,
            inner_rad,
            temperature_c: self.temperature(line)?,
        };
        Ok(Some(LogRow { line, reading }))
    }

    /// Reads the next row that is not blank; its line.
    fn read_record(&mut self) -> Result<Option<u64>, LogError> {
        loop {
            let read = self.csv.read_byte_record(&mut self.record);
            if !read.map_err(|error| read_error(&self.path, error, &self.csv))? {
                return Ok(None);
            }
            if self.record.len() > 1 || !self.record[0].trim_ascii().is_empty() {
                // The reader stands behind the row's end.
                return Ok(Some(self.csv.position().line() - 1));
            }
        }
    }

    fn check_length(&self, line: u64) -> Result<(), LogError> {
        let (found, expected) = (self.record.len(), self.header.len());
        if found == expected {
            return Ok(());
        }
        let column = self.header.get(found).cloned().unwrap_or_else(|| (expected + 1).to_string());
        Err(LogError::RowLength { path: self.path.clone(), line, found, expected, column })
    }

    fn text(&self, line: u64, position: usize, column: &'static str) -> Result<&str, LogError> {
        match std::str::from_utf8(&self.record[position]) {
            Ok(text) => Ok(text.trim()),
            Err(_) => Err(LogError::NotUtf8 { path: self.path.clone(), line, column: column.into() }),
        }
    }

    fn number(&self, line: u64, position: usize, column: &'static str) -> Result<f64, LogError> {
        let text = self.text(line, position, column)?;
        text.parse().map_err(|_| LogError::NotANumber { path: self.path.clone(), line, column, text: text.into() })
    }

    fn finite(&self, line: u64, position: usize, column: &'static str) -> Result<f64, LogError> {
        let value = self.number(line, position, column)?;
        if value.is_finite() {
            return Ok(value);
        }
        let text = self.text(line, position, column)?.into();
        Err(LogError::NotFinite { path: self.path.clone(), line, column, text })
    }

    fn time_us(&mut self, line: u64, time_s: f64) -> Result<u64, LogError> {
        if !(0.0..=LATEST_S).contains(&time_s) {
            return Err(LogError::TimeRange { path: self.path.clone(), line, time_s });
        }
        let time_us = (time_s * 1e6).round() as u64;
        let previous_us = std::mem::replace(&mut self.previous_us, time_us);
        if time_us < previous_us {
            return Err(LogError::TimeBack { path: self.path.clone(), line, time_us, previous_us });
        }
        Ok(time_us)
    }

    fn temperature(&self, line: u64) -> Result<f32, LogError> {
        match self.temperature {
            Some(position) if !self.record[position].trim_ascii().is_empty() => {
                Ok(self.number(line, position, TEMPERATURE_COLUMN)? as f32)
            }
            _ => Ok(f32::NAN),
        }
    }
}

fn open_input(path: &Path) -> Result<Box<dyn Read>, LogError> {
    let io = |cause| LogError::Io { path: path.into(), cause };
    let file = File::open(path).map_err(io)?;
    if file.metadata().map_err(io)?.is_dir() {
        return Err(LogError::Directory { path: path.into() });
    }
    let mut input = BufReader::with_capacity(1 << 16, file);
    let gzip = input.fill_buf().map_err(io)?.starts_with(&[0x1f, 0x8b]);
    Ok(if gzip { Box::new(MultiGzDecoder::new(input)) } else { Box::new(input) })
}

fn read_header(path: &Path, csv: &mut csv::Reader<Box<dyn Read>>) -> Result<Vec<String>, LogError> {
    let header = match csv.byte_headers() {
        Ok(header) => header.clone(),
        Err(error) => return Err(read_error(path, error, csv)),
    };
    if header.is_empty() {
        return Err(LogError::Empty { path: path.into() });
    }
    if header.len() == 1 && header[0].contains(&b';') {
        return Err(LogError::Semicolons { path: path.into() });
    }
    let name = |(number, field): (usize, &[u8])| match std::str::from_utf8(field) {
        Ok(name) => Ok(name.trim().to_string()),
        Err(_) => Err(LogError::NotUtf8 { path: path.into(), line: 1, column: number.to_string() }),
    };
    (1..).zip(header.iter()).map(name).collect()
}

fn find_column(path: &Path, header: &[String], column: &'static str) -> Result<Option<usize>, LogError> {
    let mut places = header.iter().enumerate().filter(|(_, name)| *name == column).map(|(position, _)| position);
    match (places.next(), places.next()) {
        (Some(first), Some(second)) => {
            Err(LogError::DuplicateColumn { path: path.into(), column, numbers: [first + 1, second + 1] })
        }
        (place, _) => Ok(place),
    }
}

fn read_error(path: &Path, error: csv::Error, csv: &csv::Reader<Box<dyn Read>>) -> LogError {
    let line = csv.position().line();
    let cause = match error.into_kind() {
        csv::ErrorKind::Io(cause) => cause,
        other => std::io::Error::other(format!("{other:?}")),
    };
    LogError::Read { path: path.into(), line, cause }
}

/// Writes a log.
pub struct LogWriter {
    path: PathBuf,
    output: Output,
    temperature: bool,
    line: String,
}

enum Output {
    Plain(BufWriter<File>),
    Gzip(BufWriter<GzEncoder<File>>),
}

impl Output {
    fn writer(&mut self) -> &mut dyn Write {
        match self {
            Self::Plain(output) => output,
            Self::Gzip(output) => output,
        }
    }
}

impl LogWriter {
    /// Creates a log, compressed if the name ends in `.gz`, with or without the temperature column.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, temperature: bool) -> Result<Self, LogError> {
        let file = File::create(path).map_err(|cause| LogError::Io { path: path.into(), cause })?;
        let output = if path.extension().is_some_and(|extension| extension == "gz") {
            Output::Gzip(BufWriter::with_capacity(1 << 16, GzEncoder::new(file, Compression::fast())))
        } else {
            Output::Plain(BufWriter::with_capacity(1 << 16, file))
        };
        let mut line = COLUMNS.join(",");
        if temperature {
            line = line + "," + TEMPERATURE_COLUMN;
        }
        let mut writer = Self { path: path.into(), output, temperature, line };
        writer.write_line()?;
        Ok(writer)
    }

    /// Appends a reading.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, reading: &Reading) -> Result<(), LogError> {
        self.format(reading).expect("a string takes all");
        self.write_line()
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self) -> Result<(), LogError> {
        let io = |cause| LogError::Io { path: self.path.clone(), cause };
        match self.output {
            Output::Plain(mut output) => output.flush().map_err(io),
            Output::Gzip(output) => {
                let encoder = output.into_inner().map_err(|error| io(error.into_error()))?;
                encoder.finish().map(drop).map_err(io)
            }
        }
    }

    fn format(&mut self, reading: &Reading) -> std::fmt::Result {
        let line = &mut self.line;
        line.clear();
        write!(line, "{}.{:06}", reading.time_us / 1_000_000, reading.time_us % 1_000_000)?;
        for value in reading.omega_g.iter().chain(&reading.force_a) {
            write!(line, ",{value:.9e}")?;
        }
        write!(line, ",{:.12e},{:.12e}", reading.outer_rad, reading.inner_rad)?;
        if self.temperature {
            write!(line, ",{}", reading.temperature_c)?;
        }
        Ok(())
    }

    fn write_line(&mut self) -> Result<(), LogError> {
        self.line.push('\n');
        let written = self.output.writer().write_all(self.line.as_bytes());
        written.map_err(|cause| LogError::Io { path: self.path.clone(), cause })
    }
}

/// A log in place of an instrument. It ignores commands, and ends at the log's end or at its first wrong row.
pub struct LogPlayer {
    reader: LogReader,
    rows: u64,
    error: Option<LogError>,
}

impl LogPlayer {
    /// Plays a log from its first row.
    pub fn new(reader: LogReader) -> Self {
        Self { reader, rows: 0, error: None }
    }

    /// Ends the play: how many rows were played, or what ended it.
    ///
    /// # Errors
    /// The first wrong row.
    pub fn finish(self) -> Result<u64, LogError> {
        self.error.map_or(Ok(self.rows), Err)
    }
}

impl Plant for LogPlayer {
    fn next_reading(&mut self) -> Option<Reading> {
        if self.error.is_some() {
            return None;
        }
        match self.reader.next()? {
            Ok(row) => {
                self.rows += 1;
                Some(row.reading)
            }
            Err(error) => {
                self.error = Some(error);
                None
            }
        }
    }

    fn command_rates(&mut self, _rates_rad_s: [f64; 2]) {}
}
