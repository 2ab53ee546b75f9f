//! Writes a standard log: CSV, plain or compressed, or Parquet.

use super::columns::{COLUMNS, TEMPERATURE_COLUMN};
use super::error::LogError;
use super::mapping::Format;
use super::parquet_writer::ParquetOutput;
use crate::virtual_unit::plant::Reading;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a log.
pub struct LogWriter {
    path: PathBuf,
    output: Output,
    temperature: bool,
    line: String,
}

enum Output {
    Plain(BufWriter<File>),
    Gzip(Box<BufWriter<GzEncoder<File>>>),
    Parquet(Box<ParquetOutput>),
}

impl LogWriter {
    /// Creates a log, with or without the temperature column. The format is Parquet if the name ends in `.parquet` or
    /// `.pq`, else CSV. The CSV is compressed if the name ends in `.gz`.
    ///
    /// # Errors
    /// The file cannot be created or written, or its name is the name of a raw matrix.
    pub fn create(path: &Path, temperature: bool) -> Result<Self, LogError> {
        if Format::of(path).is_matrix() {
            return Err(LogError::ReadOnly { path: path.into() });
        }
        let file = File::create(path).map_err(LogError::io(path))?;
        let output = match Format::of(path) {
            Format::Parquet => Output::Parquet(Box::new(ParquetOutput::create(path, file, temperature)?)),
            _ if path.extension().is_some_and(|extension| extension == "gz") => {
                let encoder = GzEncoder::new(file, Compression::fast());
                Output::Gzip(Box::new(BufWriter::with_capacity(1 << 16, encoder)))
            }
            _ => Output::Plain(BufWriter::with_capacity(1 << 16, file)),
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
        if let Output::Parquet(output) = &mut self.output {
            return output.write(reading);
        }
        self.format(reading).expect("a string takes all");
        self.write_line()
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self) -> Result<(), LogError> {
        let io = LogError::io(&self.path);
        match self.output {
            Output::Plain(mut output) => output.flush().map_err(io),
            Output::Gzip(output) => {
                let encoder = output.into_inner().map_err(|error| io(error.into_error()))?;
                encoder.finish().map(drop).map_err(io)
            }
            Output::Parquet(output) => output.finish(),
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
        let bytes = self.line.as_bytes();
        let written = match &mut self.output {
            Output::Plain(output) => output.write_all(bytes),
            Output::Gzip(output) => output.write_all(bytes),
            // The columns' names are in the schema.
            Output::Parquet(_) => Ok(()),
        };
        written.map_err(LogError::io(&self.path))
    }
}
