//! Rows of numbers, whatever the file, and how a file is opened for them.

use super::columns::Fields;
use super::error::LogError;
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Rows of numbers, whatever the file.
pub trait RawRows {
    /// Takes the next row; its line, or, of a binary file, its number, from 1. `None` at the end.
    ///
    /// # Errors
    /// Where and what.
    fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, LogError>;

    /// Lines before the first row.
    fn header_lines(&self) -> u64 {
        0
    }
}

/// Opens a file, and, where it may be, decompresses it: told by its contents.
pub(super) fn open_input(path: &Path, may_be_compressed: bool) -> Result<Box<dyn BufRead>, LogError> {
    let mut input = BufReader::with_capacity(1 << 16, open_file(path)?);
    let magic = input.fill_buf().map_err(LogError::io(path))?.starts_with(&[0x1f, 0x8b]);
    if may_be_compressed && magic {
        return Ok(Box::new(BufReader::with_capacity(1 << 16, MultiGzDecoder::new(input))));
    }
    Ok(Box::new(input))
}

pub(super) fn open_file(path: &Path) -> Result<File, LogError> {
    let file = File::open(path).map_err(LogError::io(path))?;
    if file.metadata().map_err(LogError::io(path))?.is_dir() {
        return Err(LogError::Directory { path: path.into() });
    }
    Ok(file)
}
