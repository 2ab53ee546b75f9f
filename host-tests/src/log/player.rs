//! A log in place of an instrument.

use super::error::LogError;
use super::reader::LogReader;
use crate::virtual_unit::plant::Reading;

/// Plays a log in place of an instrument. The player ignores commands. It ends at the log's end or at its first wrong
/// row.
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

    /// Ends the play. Returns the number of rows that were played.
    ///
    /// # Errors
    /// The first wrong row ended the play.
    pub fn finish(self) -> Result<u64, LogError> {
        self.error.map_or(Ok(self.rows), Err)
    }
}

impl Iterator for LogPlayer {
    type Item = Reading;

    fn next(&mut self) -> Option<Reading> {
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
}
