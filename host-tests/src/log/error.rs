//! What is wrong with a log, and where.

use crate::files::toml_file::TomlFileError;
use std::io;
use std::path::{Path, PathBuf};

/// Latest time stamp, s; a century, and microseconds still fit an `f64` to a thousandth.
pub(super) const LATEST_S: f64 = 3.2e9;

/// Why a log cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file cannot be opened, created or written.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// The path is a directory.
    #[error("{}: is a directory", path.display())]
    Directory {
        /// The path.
        path: PathBuf,
    },
    /// The mapping is wrong, or does not fit the log.
    #[error(transparent)]
    Mapping(#[from] TomlFileError),
    /// A format that can be read only.
    #[error("{}: raw matrices are not written; give a name that ends in .csv, .csv.gz or .parquet", path.display())]
    ReadOnly {
        /// The file.
        path: PathBuf,
    },
    /// Something in the log.
    #[error("{}:{line}: {fault}", path.display())]
    At {
        /// The file.
        path: PathBuf,
        /// Line of a text, row of a binary file, from 1.
        line: u64,
        /// What is wrong there.
        fault: LogFault,
    },
}

impl LogError {
    pub(super) fn io(path: &Path) -> impl Fn(io::Error) -> Self {
        move |cause| Self::Io { path: path.into(), cause }
    }

    pub(super) fn at(path: &Path, line: u64, fault: LogFault) -> Self {
        Self::At { path: path.into(), line, fault }
    }
}

/// What is wrong at a place in a log.
#[derive(Debug, thiserror::Error)]
pub enum LogFault {
    /// Reading, or decompressing, fails on the way.
    #[error("{0}")]
    Read(io::Error),
    /// Nothing in the file.
    #[error("the file is empty, expected a header row")]
    Empty,
    /// No samples.
    #[error("no samples after the header row")]
    HeaderOnly,
    /// No samples in a log without a header.
    #[error("no samples")]
    NoSamples,
    /// Columns separated by something else.
    #[error("the columns are separated by {found}, not {expected}")]
    Delimiter {
        /// What separates them.
        found: &'static str,
        /// What should.
        expected: &'static str,
    },
    /// The log lacks a column.
    #[error("column {0} is missing")]
    MissingColumn(String),
    /// The header has a column twice.
    #[error("column {column} is there twice, as columns {} and {}", numbers[0], numbers[1])]
    DuplicateColumn {
        /// The column.
        column: String,
        /// Where it is, from 1.
        numbers: [usize; 2],
    },
    /// A row has fewer or more fields than the header, or, without one, than the first row.
    #[error("{found} fields, the {} {expected}; column {column} is the first {}",
            if *header { "header has" } else { "first row has" }, if found < expected { "missing" } else { "too many" })]
    RowLength {
        /// Fields of the row.
        found: usize,
        /// Fields of the header.
        expected: usize,
        /// Name of the first missing column, or number, from 1, of the first field without a column.
        column: String,
        /// Whether there is a header.
        header: bool,
    },
    /// Not UTF-8.
    #[error("column {column}: not UTF-8")]
    NotUtf8 {
        /// Name of the column, or its number, from 1.
        column: String,
    },
    /// Not a number.
    #[error("column {column}: \"{text}\" is not a number")]
    NotANumber {
        /// The column.
        column: String,
        /// What is there.
        text: String,
    },
    /// Infinite, or "nan".
    #[error("column {column}: {text} is not finite")]
    NotFinite {
        /// The column.
        column: String,
        /// What is there.
        text: String,
    },
    /// A quote begins in a line and does not end in it.
    #[error("a quote (\") is not closed")]
    OpenQuote,
    /// A number that nothing measures.
    #[error("column {column}: {value:e} {unit} is beyond anything that can be measured")]
    Immense {
        /// The column.
        column: String,
        /// The number.
        value: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// A column of something else than numbers.
    #[error("column {column}: {found}, not numbers")]
    NotNumbers {
        /// The column.
        column: String,
        /// What it holds.
        found: String,
    },
    /// A column of a Parquet file has a compression that this program cannot read.
    #[error(
        "column {column}: compressed with {codec}, which is not supported; write the file again with snappy, gzip, \
             lz4 or no compression"
    )]
    Codec {
        /// The column.
        column: String,
        /// Name of the compression.
        codec: &'static str,
    },
    /// A field without a value.
    #[error("column {column}: no value")]
    Null {
        /// The column.
        column: String,
    },
    /// A time stamp before zero or too late to count in microseconds.
    #[error("column {column}: {time_s} is not between 0 and {LATEST_S}{}", if *scaled { " s" } else { "" })]
    TimeRange {
        /// The column.
        column: String,
        /// The time stamp, s.
        time_s: f64,
        /// Whether the column has another unit.
        scaled: bool,
    },
    /// A time stamp earlier than the one before.
    #[error("column {column}: time goes back from {previous_us} to {time_us} us")]
    TimeBack {
        /// The column.
        column: String,
        /// The time stamp, us.
        time_us: u64,
        /// The one before, us.
        previous_us: u64,
    },
    /// The file ends within a row.
    #[error("column {column}: the file ends within the row; do its rows have {columns} columns?")]
    Cut {
        /// The first column that is not whole.
        column: usize,
        /// Columns that a row should have.
        columns: usize,
    },
    /// Increments, and no rate to divide by.
    #[error("column {0}: a single time, so no sample interval to divide increments by; give rate_hz in the mapping")]
    NoInterval(String),
    /// A file of this format cannot be read.
    #[error("{0}")]
    Format(String),
}
