//! Raw little-endian matrices, row by row.

use super::columns::{FIELDS, Fields};
use super::error::{LogError, LogFault};
use super::layout::Layout;
use super::mapping::{Column, Format};
use super::rows::{RawRows, open_input};
use std::io::{BufRead, ErrorKind};
use std::path::{Path, PathBuf};

/// Rows of a raw matrix.
pub(super) struct MatrixRows {
    path: PathBuf,
    input: Box<dyn BufRead>,
    layout: Layout,
    width: usize,
    positions: [Option<usize>; FIELDS],
    row: Vec<u8>,
    number: u64,
}

impl MatrixRows {
    pub(super) fn open(path: &Path, layout: &Layout) -> Result<Self, LogError> {
        let width = if layout.format == Format::F64 { 8 } else { 4 };
        let position = |field: usize| match layout.wanted[field].as_ref()?.column {
            Column::Number(number) => Some(number - 1),
            Column::Name(_) => None,
        };
        // The first number may have the same bytes as the head of a compressed file, so the name decides.
        let compressed = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("gz"));
        Ok(Self {
            path: path.into(),
            input: open_input(path, compressed)?,
            layout: layout.clone(),
            width,
            positions: std::array::from_fn(position),
            row: vec![0; width * layout.matrix_columns],
            number: 0,
        })
    }

    /// Reads a row. Returns false at the end of the file.
    fn read_row(&mut self) -> Result<bool, LogFault> {
        let mut filled = 0;
        while filled < self.row.len() {
            match self.input.read(&mut self.row[filled..]) {
                Ok(0) if filled == 0 => return Ok(false),
                Ok(0) => {
                    return Err(LogFault::Cut { column: filled / self.width + 1, columns: self.layout.matrix_columns });
                }
                Ok(length) => filled += length,
                Err(cause) if cause.kind() == ErrorKind::Interrupted => {}
                Err(cause) => return Err(LogFault::Read(cause)),
            }
        }
        Ok(true)
    }

    fn number(&self, position: usize) -> f64 {
        let bytes = &self.row[position * self.width..];
        match bytes.first_chunk::<8>() {
            Some(bytes) if self.width == 8 => f64::from_le_bytes(*bytes),
            _ => bytes.first_chunk::<4>().map_or(f64::NAN, |bytes| f32::from_le_bytes(*bytes).into()),
        }
    }

    fn parse(&self, fields: &mut Fields) -> Result<(), LogFault> {
        for (field, (value, position)) in fields.iter_mut().zip(&self.positions).enumerate() {
            *value = position.map_or(f64::NAN, |position| self.number(position));
            if self.layout.must_be_finite(field) && !value.is_finite() {
                return Err(LogFault::NotFinite { column: self.layout.column_name(field), text: value.to_string() });
            }
        }
        Ok(())
    }
}

impl RawRows for MatrixRows {
    fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, LogError> {
        self.number += 1;
        let read = self.read_row().and_then(|read| if read { self.parse(fields).map(|()| true) } else { Ok(false) });
        let there = read.map_err(|fault| LogError::at(&self.path, self.number, fault))?;
        Ok(there.then_some(self.number))
    }
}
