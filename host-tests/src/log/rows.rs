//! Rows of numbers, common to all file formats, and how a file is opened.

use super::columns::Fields;
use super::error::LogError;
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Rows of numbers of a log in any file format.
pub trait RawRows {
    /// Takes the next row. Returns its line (row number in a binary file), counted from 1, and `None` at the end.
    ///
    /// # Errors
    /// The place and the fault.
    fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, LogError>;

    /// Lines before the first row.
    fn header_lines(&self) -> u64 {
        0
    }
}

/// Opens a file. If it may be compressed, its first bytes decide whether it is decompressed.
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
