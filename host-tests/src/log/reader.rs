//! Streams the readings of a log.

use super::columns::{FIELDS, Fields, TEMPERATURE};
use super::convert::Conversion;
use super::error::{LogError, LogFault};
use super::layout::Layout;
use super::mapping::Format;
use super::matrix::MatrixRows;
use super::parquet::ParquetRows;
use super::rows::RawRows;
use super::text::TextRows;
use crate::virtual_unit::plant::Reading;
use std::collections::VecDeque;
use std::path::Path;

/// Rows from which the sample interval is estimated.
const HEAD_ROWS: usize = 4096;

impl Layout {
    /// The rows of a log as they are in the file.
    ///
    /// # Errors
    /// The file cannot be read, or lacks a column.
    pub fn open_raw(&self, path: &Path) -> Result<Box<dyn RawRows>, LogError> {
        Ok(match self.format {
            Format::Text => Box::new(TextRows::open(path, self)?),
            Format::F64 | Format::F32 => Box::new(MatrixRows::open(path, self)?),
            Format::Parquet => Box::new(ParquetRows::open(path, self)?),
        })
    }
}

/// A reading and its place in the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow {
    /// Line of a text file or row of a binary file, counted from 1.
    pub line: u64,
    /// The reading.
    pub reading: Reading,
}

/// Streams the rows of a log.
pub struct LogReader {
    rows: Box<dyn RawRows>,
    head: VecDeque<(u64, Fields)>,
    conversion: Conversion,
    /// The row that has been read and waits for the angles of the next row.
    waiting: Option<LogRow>,
    before: Option<Reading>,
    ended: bool,
}

impl LogReader {
    /// Opens a standard log and reads its first rows.
    ///
    /// # Errors
    /// The file cannot be read, is not a log, or has a wrong row among the first few thousand rows.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        Self::open_as(path, &Layout::standard(path))
    }

    /// Opens a log that a mapping describes.
    ///
    /// # Errors
    /// As [`LogReader::open`].
    pub fn open_as(path: &Path, layout: &Layout) -> Result<Self, LogError> {
        let mut rows = layout.open_raw(path)?;
        let mut head = VecDeque::with_capacity(HEAD_ROWS);
        let mut fields = [f64::NAN; FIELDS];
        while head.len() < HEAD_ROWS {
            match rows.next_row(&mut fields)? {
                Some(line) => head.push_back((line, fields)),
                None => break,
            }
        }
        if head.is_empty() {
            let line = rows.header_lines() + 1;
            let fault = if line == 1 { LogFault::NoSamples } else { LogFault::HeaderOnly };
            return Err(LogError::at(path, line, fault));
        }
        let conversion = Conversion::new(path, layout, head.make_contiguous())?;
        Ok(Self { rows, head, conversion, waiting: None, before: None, ended: false })
    }

    /// Sample interval, us: the median step over the first few thousand rows, repeated time stamps left out. `None` if
    /// these rows have fewer than two different times.
    pub fn interval_us(&self) -> Option<u64> {
        self.conversion.interval_us()
    }

    /// Whether the first few thousand rows have a temperature.
    pub fn has_temperature(&self) -> bool {
        self.head.iter().any(|(_, fields)| !fields[TEMPERATURE].is_nan())
    }

    /// The next row, with the angles not yet interpolated.
    fn next_read(&mut self) -> Result<Option<LogRow>, LogError> {
        let (line, fields) = match self.head.pop_front() {
            Some(row) => row,
            None => {
                let mut fields = [f64::NAN; FIELDS];
                let Some(line) = self.rows.next_row(&mut fields)? else { return Ok(None) };
                (line, fields)
            }
        };
        let reading = self.conversion.reading(line, &fields)?;
        Ok(Some(LogRow { line, reading }))
    }

    /// The next row, with the angles interpolated to its time.
    fn next_aligned(&mut self) -> Result<Option<LogRow>, LogError> {
        let late_us = self.conversion.angles_late_us();
        let next = if self.ended { None } else { self.next_read()? };
        self.ended = next.is_none();
        if late_us >= 0.0 {
            let Some(mut row) = next else { return Ok(None) };
            let before = self.before.replace(row.reading);
            if let Some(before) = before.filter(|_| late_us > 0.0) {
                row.reading.turn_towards(&before, late_us);
            }
            return Ok(Some(row));
        }
        let row = match (self.waiting.take(), next) {
            // The first row is aligned by means of the second row.
            (None, Some(first)) => {
                self.waiting = self.next_read()?;
                Some((first, self.waiting))
            }
            (Some(row), next) => {
                self.waiting = next;
                Some((row, next))
            }
            (None, None) => None,
        };
        Ok(row.map(|(mut row, after)| {
            if let Some(after) = after {
                row.reading.turn_towards(&after.reading, -late_us);
            }
            row
        }))
    }
}

impl Iterator for LogReader {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_aligned().transpose()
    }
}
