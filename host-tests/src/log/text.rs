//! Lines of numbers, separated by commas, semicolons or tabs.

use super::columns::{FIELDS, Fields};
use super::error::{LogError, LogFault};
use super::layout::{Layout, Wanted};
use super::mapping::Column;
use super::rows::{RawRows, open_input};
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// Longest number with a decimal comma.
const LONGEST_NUMBER: usize = 64;

/// Rows of a text file.
pub(super) struct TextRows {
    path: PathBuf,
    input: Box<dyn BufRead>,
    layout: Layout,
    /// Names of the columns; empty if the file has no header.
    header: Vec<String>,
    columns: usize,
    /// Position of every field in a row; `None` for a field that the file lacks.
    positions: [Option<usize>; FIELDS],
    line: Vec<u8>,
    number: u64,
    /// Whether the line is a row that has not been taken yet.
    waiting: bool,
    /// Position in the line at which each field ends.
    ends: Vec<usize>,
    unquoted: csv::ByteRecord,
    /// Whether a quote begins in the line and does not end in it.
    quote_is_open: bool,
}

impl TextRows {
    pub(super) fn open(path: &Path, layout: &Layout) -> Result<Self, LogError> {
        let mut rows = Self {
            path: path.into(),
            input: open_input(path, true)?,
            layout: layout.clone(),
            header: Vec::new(),
            columns: 0,
            positions: [None; FIELDS],
            line: Vec::with_capacity(512),
            number: 0,
            waiting: false,
            ends: Vec::new(),
            unquoted: csv::ByteRecord::new(),
            quote_is_open: false,
        };
        for _ in 0..layout.skip_rows {
            rows.read_line()?;
        }
        rows.read_head()?;
        for field in 0..FIELDS {
            rows.positions[field] = rows.position(layout.wanted[field].as_ref())?;
        }
        Ok(rows)
    }

    /// Reads the header, or the first row if the file has no header. Both give the number of columns.
    fn read_head(&mut self) -> Result<(), LogError> {
        if !self.read_line()? {
            return Err(self.at(1, if self.layout.has_header { LogFault::Empty } else { LogFault::NoSamples }));
        }
        if self.layout.has_header {
            self.header =
                split_header(&self.line, self.layout.delimiter).map_err(|fault| self.at(self.number, fault))?;
            self.columns = self.header.len();
        } else {
            self.split();
            self.columns = self.ends.len();
            self.waiting = true;
        }
        self.check_delimiter()
    }

    /// A single column that contains another delimiter shows that the file uses that delimiter.
    fn check_delimiter(&self) -> Result<(), LogError> {
        let kinds = [(b',', "','"), (b';', "';'"), (b'\t', "tabs")];
        let name = |delimiter: u8| kinds.iter().find(|kind| kind.0 == delimiter).map_or("", |kind| kind.1);
        let other = kinds.iter().find(|kind| kind.0 != self.layout.delimiter && self.line.contains(&kind.0));
        match other {
            Some((_, found)) if self.columns == 1 => {
                Err(self.at(self.number, LogFault::Delimiter { found, expected: name(self.layout.delimiter) }))
            }
            _ => Ok(()),
        }
    }

    fn position(&self, wanted: Option<&Wanted>) -> Result<Option<usize>, LogError> {
        let Some(Wanted { column, required }) = wanted else { return Ok(None) };
        let found = match column {
            Column::Number(number) => Some(number - 1).filter(|position| *position < self.columns),
            Column::Name(name) => find_column(&self.header, name).map_err(|fault| self.at(self.number, fault))?,
        };
        match found {
            None if *required => Err(self.at(self.number, LogFault::MissingColumn(column.to_string()))),
            found => Ok(found),
        }
    }

    /// Reads a line. Returns false at the end of the file.
    fn read_line(&mut self) -> Result<bool, LogError> {
        self.line.clear();
        let read = self.input.read_until(b'\n', &mut self.line);
        self.number += 1;
        read.map(|length| length > 0).map_err(|cause| self.at(self.number, LogFault::Read(cause)))
    }

    /// Finds the fields of the line. Quotes, which are rare, are removed first.
    fn split(&mut self) {
        self.ends.clear();
        self.quote_is_open = false;
        if memchr::memchr(b'"', &self.line).is_some() {
            self.unquote();
        }
        self.ends.extend(memchr::memchr_iter(self.layout.delimiter, &self.line));
        self.ends.push(self.line.len());
    }

    /// Removes the quotes from the line, and the delimiters within the quotes.
    fn unquote(&mut self) {
        let delimiter = self.layout.delimiter;
        self.quote_is_open = memchr::memchr_iter(b'"', &self.line).count() % 2 == 1;
        let mut csv = csv::ReaderBuilder::new().has_headers(false).delimiter(delimiter).from_reader(&self.line[..]);
        if csv.read_byte_record(&mut self.unquoted).is_ok() {
            let fields = self.unquoted.iter().map(|field| {
                let kept = field.iter().map(|byte| if *byte == delimiter { b' ' } else { *byte });
                kept.collect::<Vec<u8>>()
            });
            self.line = fields.collect::<Vec<_>>().join(&delimiter);
        }
    }

    fn field(&self, position: usize) -> &[u8] {
        let start = if position == 0 { 0 } else { self.ends[position - 1] + 1 };
        self.line[start..self.ends[position]].trim_ascii()
    }

    /// The error for a row that cannot be read. If compressed data are damaged, the decompressor reports it at the end
    /// of the file, so the rest is read first and the damage is reported in place of the row's fault.
    fn wrong_row(&mut self, fault: LogFault) -> LogError {
        let rest = std::io::copy(&mut self.input, &mut std::io::sink());
        self.at(self.number, rest.map_or_else(LogFault::Read, |_| fault))
    }

    fn check_length(&self) -> Result<(), LogFault> {
        if self.quote_is_open {
            return Err(LogFault::OpenQuote);
        }
        let (found, expected) = (self.ends.len(), self.columns);
        if found == expected {
            return Ok(());
        }
        let number = if found < expected { found } else { expected } + 1;
        let column = self.header.get(found).cloned().unwrap_or_else(|| number.to_string());
        Err(LogFault::RowLength { found, expected, column, header: self.layout.has_header })
    }

    fn parse(&self, fields: &mut Fields) -> Result<(), LogFault> {
        self.check_length()?;
        for (number, (value, position)) in fields.iter_mut().zip(&self.positions).enumerate() {
            *value = match position {
                Some(position) => self.value(number, self.field(*position))?,
                None => f64::NAN,
            };
        }
        Ok(())
    }

    fn value(&self, field: usize, text: &[u8]) -> Result<f64, LogFault> {
        let required = self.layout.must_be_finite(field);
        if text.is_empty() && !required {
            return Ok(f64::NAN);
        }
        let column = || self.layout.column_name(field);
        let number = self.number(text).ok_or_else(|| match std::str::from_utf8(text) {
            Ok(text) => LogFault::NotANumber { column: column(), text: text.into() },
            Err(_) => LogFault::NotUtf8 { column: column() },
        })?;
        if required && !number.is_finite() {
            return Err(LogFault::NotFinite { column: column(), text: String::from_utf8_lossy(text).into() });
        }
        Ok(number)
    }

    fn number(&self, text: &[u8]) -> Option<f64> {
        if self.layout.decimal_comma {
            let mut buffer = [0; LONGEST_NUMBER];
            let buffer = buffer.get_mut(..text.len())?;
            buffer.copy_from_slice(text);
            buffer.iter_mut().filter(|byte| **byte == b',').for_each(|byte| *byte = b'.');
            return parsed(buffer);
        }
        parsed(text)
    }

    fn at(&self, line: u64, fault: LogFault) -> LogError {
        LogError::at(&self.path, line, fault)
    }
}

/// Parses with the fast parser. The standard library's parser is tried when the fast one refuses, because it accepts a
/// sign before any value.
fn parsed(text: &[u8]) -> Option<f64> {
    fast_float2::parse(text).ok().or_else(|| std::str::from_utf8(text).ok()?.parse().ok())
}

impl RawRows for TextRows {
    fn next_row(&mut self, fields: &mut Fields) -> Result<Option<u64>, LogError> {
        while std::mem::take(&mut self.waiting) || self.read_line()? {
            if self.line.trim_ascii().is_empty() {
                continue;
            }
            self.split();
            return match self.parse(fields) {
                Ok(()) => Ok(Some(self.number)),
                Err(fault) => Err(self.wrong_row(fault)),
            };
        }
        Ok(None)
    }

    fn header_lines(&self) -> u64 {
        self.layout.skip_rows + u64::from(self.layout.has_header)
    }
}

fn split_header(line: &[u8], delimiter: u8) -> Result<Vec<String>, LogFault> {
    let mut csv = csv::ReaderBuilder::new().has_headers(false).delimiter(delimiter).from_reader(line);
    let mut record = csv::ByteRecord::new();
    let read = csv.read_byte_record(&mut record);
    read.map_err(|error| LogFault::Read(std::io::Error::other(error)))?;
    let name = |(number, field): (usize, &[u8])| match std::str::from_utf8(field) {
        // Some programs begin a file with a byte order mark.
        Ok(name) => Ok(name.trim_start_matches('\u{feff}').trim().to_string()),
        Err(_) => Err(LogFault::NotUtf8 { column: number.to_string() }),
    };
    (1..).zip(record.iter()).map(name).collect()
}

fn find_column(header: &[String], column: &str) -> Result<Option<usize>, LogFault> {
    let mut places = header.iter().enumerate().filter(|(_, name)| *name == column).map(|(position, _)| position);
    match (places.next(), places.next()) {
        (Some(first), Some(second)) => {
            Err(LogFault::DuplicateColumn { column: column.into(), numbers: [first + 1, second + 1] })
        }
        (place, _) => Ok(place),
    }
}

/// The first lines of a text file, plain or compressed.
///
/// # Errors
/// The file cannot be read.
pub fn lines(path: &Path, count: usize) -> Result<Vec<String>, LogError> {
    let mut input = open_input(path, true)?;
    let mut lines = Vec::new();
    let mut line = Vec::new();
    while lines.len() < count {
        line.clear();
        let read = input.read_until(b'\n', &mut line);
        if read.map_err(|cause| LogError::at(path, lines.len() as u64 + 1, LogFault::Read(cause)))? == 0 {
            break;
        }
        lines.push(String::from_utf8_lossy(&line).trim_end_matches(['\r', '\n']).to_string());
    }
    Ok(lines)
}

/// The names of the columns in a header row.
pub fn header(line: &str, delimiter: u8) -> Vec<String> {
    split_header(line.as_bytes(), delimiter).unwrap_or_default()
}
