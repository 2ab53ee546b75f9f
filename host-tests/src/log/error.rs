//! What is wrong with a log, and where.

use crate::files::toml_file::TomlFileError;
use std::io;
use std::path::{Path, PathBuf};

/// Latest time stamp, s: about a century. Up to this time an `f64` resolves a thousandth of a microsecond.
pub(super) const LATEST_S: f64 = 3.2e9;

/// Why a log cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file cannot be opened, created or written.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// The path is a directory.
    #[error("{}: is a directory", path.display())]
    Directory {
        /// The path.
        path: PathBuf,
    },
    /// The mapping is wrong or does not fit the log.
    #[error(transparent)]
    Mapping(#[from] TomlFileError),
    /// The format can be read but not written.
    #[error("{}: raw matrices are not written; give a name that ends in .csv, .csv.gz or .parquet", path.display())]
    ReadOnly {
        /// The file.
        path: PathBuf,
    },
    /// A fault at a place in the log.
    #[error("{}:{line}: {fault}", path.display())]
    At {
        /// The file.
        path: PathBuf,
        /// Line of a text file or row of a binary file, counted from 1.
        line: u64,
        /// The fault.
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
    /// Reading or decompressing fails before the end of the file.
    #[error("{0}")]
    Read(io::Error),
    /// The file is empty.
    #[error("the file is empty; a header row is required")]
    Empty,
    /// The log has a header row and no samples.
    #[error("no samples after the header row")]
    HeaderOnly,
    /// A log without a header row has no samples.
    #[error("no samples")]
    NoSamples,
    /// The columns are separated by another delimiter than the mapping says.
    #[error("the columns are separated by {found}, not {expected}")]
    Delimiter {
        /// The delimiter in the file.
        found: &'static str,
        /// The delimiter of the mapping.
        expected: &'static str,
    },
    /// The log lacks a column.
    #[error("column {0} is missing")]
    MissingColumn(String),
    /// The header has a column twice.
    #[error("column {column} appears twice, as columns {} and {}", numbers[0], numbers[1])]
    DuplicateColumn {
        /// The column.
        column: String,
        /// Its two positions, counted from 1.
        numbers: [usize; 2],
    },
    /// A row has fewer or more fields than the header. In a log without a header the first row takes its place.
    #[error("the row has {found} fields, the {} {expected}; the first {} column is {column}",
    if *header { "header has" } else { "first row has" }, if found < expected { "missing" } else { "extra" })]
    RowLength {
        /// Fields of the row.
        found: usize,
        /// Fields of the header.
        expected: usize,
        /// Name of the first missing column, or number (from 1) of the first field without a column.
        column: String,
        /// Whether there is a header.
        header: bool,
    },
    /// Not UTF-8.
    #[error("column {column}: the text is not UTF-8")]
    NotUtf8 {
        /// Name of the column, or its number from 1.
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
    /// The number is infinite or "nan".
    #[error("column {column}: {text} is not finite")]
    NotFinite {
        /// The column.
        column: String,
        /// What is there.
        text: String,
    },
    /// A quote begins in a line and does not end in the same line.
    #[error("a quote (\") is not closed")]
    OpenQuote,
    /// A number larger than any sensor can measure. It would overflow in the sums.
    #[error("column {column}: {value:e} {unit} is outside the range of any sensor")]
    Immense {
        /// The column.
        column: String,
        /// The number.
        value: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// A column that does not hold numbers.
    #[error("column {column} holds {found}, not numbers")]
    NotNumbers {
        /// The column.
        column: String,
        /// What the column holds.
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
    #[error("column {column} has no value")]
    Null {
        /// The column.
        column: String,
    },
    /// A time stamp before zero, or too late to be counted in microseconds.
    #[error("column {column}: the time {time_s} is not between 0 and {LATEST_S}{}", if *scaled { " s" } else { "" })]
    TimeRange {
        /// The column.
        column: String,
        /// The time stamp, s.
        time_s: f64,
        /// Whether the column has another unit than seconds.
        scaled: bool,
    },
    /// A time stamp earlier than the previous time stamp.
    #[error("column {column}: time goes back from {previous_us} to {time_us} us")]
    TimeBack {
        /// The column.
        column: String,
        /// The time stamp, us.
        time_us: u64,
        /// The previous time stamp, us.
        previous_us: u64,
    },
    /// The file ends within a row.
    #[error("column {column}: the file ends within the row; do its rows have {columns} columns?")]
    Cut {
        /// The first column that is not complete.
        column: usize,
        /// Columns that a row should have.
        columns: usize,
    },
    /// The sample interval is needed, for increments or for time stamps at the start or end of the interval, but it is
    /// not known.
    #[error(
        "column {0}: the log has no two different times, so the sample interval is unknown; give rate_hz in the mapping"
    )]
    NoInterval(String),
    /// A file of this format cannot be read.
    #[error("{0}")]
    Format(String),
}
