//! Writes a standard log as Parquet.

use super::columns::{COLUMNS, TEMPERATURE_COLUMN};
use super::error::{LogError, LogFault};
use crate::virtual_unit::plant::Reading;
use parquet::basic::Compression;
use parquet::data_type::DoubleType;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows of a group.
const GROUP_ROWS: usize = 1 << 16;

/// Collects a group of rows at a time.
pub(super) struct ParquetOutput {
    path: PathBuf,
    writer: SerializedFileWriter<File>,
    columns: Vec<Vec<f64>>,
}

impl ParquetOutput {
    pub(super) fn create(path: &Path, file: File, temperature: bool) -> Result<Self, LogError> {
        let names = COLUMNS.into_iter().chain(temperature.then_some(TEMPERATURE_COLUMN));
        let fields: String = names.clone().map(|name| format!("required double {name}; ")).collect();
        let schema = parse_message_type(&format!("message log {{ {fields}}}")).map_err(|error| of(path, &error))?;
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
        let columns = names.map(|_| Vec::with_capacity(GROUP_ROWS)).collect();
        Ok(Self { path: path.into(), writer: writer.map_err(|error| of(path, &error))?, columns })
    }

    pub(super) fn write(&mut self, reading: &Reading) -> Result<(), LogError> {
        let [gx, gy, gz] = reading.omega_g;
        let [ax, ay, az] = reading.force_a;
        let time_s = reading.time_us as f64 * 1e-6;
        let row = [time_s, gx, gy, gz, ax, ay, az, reading.outer_rad, reading.inner_rad, reading.temperature_c.into()];
        for (column, value) in self.columns.iter_mut().zip(row) {
            column.push(value);
        }
        if self.columns[0].len() == GROUP_ROWS { self.write_group() } else { Ok(()) }
    }

    fn write_group(&mut self) -> Result<(), LogError> {
        let written = write_columns(&mut self.writer, &self.columns);
        self.columns.iter_mut().for_each(Vec::clear);
        written.map_err(|error| of(&self.path, &error))
    }

    pub(super) fn finish(mut self) -> Result<(), LogError> {
        self.write_group()?;
        self.writer.finish().map(drop).map_err(|error| of(&self.path, &error))
    }
}

fn write_columns(writer: &mut SerializedFileWriter<File>, columns: &[Vec<f64>]) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    for values in columns {
        if let Some(mut column) = group.next_column()? {
            column.typed::<DoubleType>().write_batch(values, None, None)?;
            column.close()?;
        }
    }
    group.close().map(drop)
}

fn of(path: &Path, error: &ParquetError) -> LogError {
    LogError::Io { path: path.into(), cause: std::io::Error::other(LogFault::Format(error.to_string())) }
}
