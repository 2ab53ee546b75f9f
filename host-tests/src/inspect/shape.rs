//! How a file is cut into columns: separator, header and decimal comma of a text, numbers in a row of a raw matrix.

use crate::log::{Column, Format, Layout, LogError, Mapping, TextTable, header, lines, parquet_columns};
use std::path::Path;

/// Lines at the start of a text file that are examined.
const LINES: usize = 200;
/// Fewest columns of a log: nine, or eight without a time.
const LEAST_COLUMNS: usize = 8;
/// Rows of a matrix that are examined.
const ROWS: usize = 2000;
/// Most numbers in a row of a matrix that are tried.
const MOST_COLUMNS: usize = 32;
/// Largest fraction of steps in a time column that may differ from the median step.
const IRREGULAR: f64 = 0.05;

/// A file cut into columns.
#[derive(Clone, Debug)]
pub struct Shape {
    /// How to read the file. The roles of the columns are left out.
    pub mapping: Mapping,
    /// Columns that hold numbers.
    pub columns: Vec<Column>,
}

impl Shape {
    /// The shape of a file, by its name and its first lines or rows.
    ///
    /// # Errors
    /// The file cannot be read, or no mapping can describe it.
    pub fn of(path: &Path) -> Result<Self, ShapeError> {
        match Format::of(path) {
            Format::Text => of_text(path),
            Format::Parquet => {
                let columns = parquet_columns(path)?.into_iter().map(Column::Name).collect();
                Ok(Self { mapping: Mapping::default(), columns })
            }
            Format::F64 | Format::F32 => of_matrix(path),
        }
    }
}

/// Why a file cannot be cut into columns.
#[derive(Debug, thiserror::Error)]
pub enum ShapeError {
    /// The file cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// None of the first lines has enough numbers.
    #[error(
        "{path}: none of the first {LINES} lines has {LEAST_COLUMNS} or more numbers between commas, semicolons or tabs"
    )]
    NoNumbers {
        /// The file.
        path: String,
    },
}

/// Names of separators, the separators, and whether the decimal mark is a comma.
const DIALECTS: [(&str, char, bool); 5] =
    [(",", ',', false), (";", ';', false), ("tab", '\t', false), (";", ';', true), ("tab", '\t', true)];

fn of_text(path: &Path) -> Result<Shape, ShapeError> {
    let lines = lines(path, LINES)?;
    let numbers = |line: &str, dialect: &(&str, char, bool)| {
        line.split(dialect.1).filter(|field| number(field, dialect.2).is_some()).count()
    };
    let most = |dialect: &(&str, char, bool)| lines.iter().map(|line| numbers(line, dialect)).max().unwrap_or(0);
    // Among equals the first wins, so a decimal comma is assumed only if it gives more numbers.
    let best = DIALECTS.iter().rev().max_by_key(|dialect| most(dialect)).filter(|best| most(best) >= LEAST_COLUMNS);
    let no_numbers = || ShapeError::NoNumbers { path: path.display().to_string() };
    let dialect @ (delimiter, separator, decimal_comma) = best.ok_or_else(no_numbers)?;
    let enough = most(dialect).div_ceil(2).max(LEAST_COLUMNS);
    let first = lines.iter().position(|line| numbers(line, dialect) >= enough).ok_or_else(no_numbers)?;
    let width = |line: &str| line.split(*separator).count();
    let names =
        first.checked_sub(1).and_then(|above| lines.get(above)).filter(|above| width(above) == width(&lines[first]));
    let text = TextTable {
        delimiter: (*delimiter).into(),
        decimal_comma: *decimal_comma,
        skip_rows: (first - usize::from(names.is_some())) as u64,
        header: names.is_some(),
    };
    let all: Vec<Column> = match names {
        Some(names) => self::header(names, *separator as u8).into_iter().map(Column::Name).collect(),
        None => (1..=width(&lines[first])).map(Column::Number).collect(),
    };
    // A column with a field that is not a number is left out. An empty field is allowed: a sensor without a value.
    let rows = &lines[first..];
    let numeric = |position: usize| {
        let mut fields = rows.iter().filter_map(|line| line.split(*separator).nth(position)).peekable();
        fields.peek().is_some()
            && fields.all(|field| field.trim().is_empty() || number(field, *decimal_comma).is_some())
    };
    let columns = all.into_iter().enumerate().filter(|(position, _)| numeric(*position)).map(|(_, column)| column);
    Ok(Shape { columns: columns.collect(), mapping: Mapping { text, ..Mapping::default() } })
}

fn number(field: &str, decimal_comma: bool) -> Option<f64> {
    let field = field.trim().trim_matches('"');
    if decimal_comma { field.replace(',', ".").parse().ok() } else { field.parse().ok() }
}

/// The number of columns with which one of the columns is a time, that is, grows by equal steps.
fn of_matrix(path: &Path) -> Result<Shape, ShapeError> {
    let of_width = |width: usize| {
        let mut mapping = Mapping::default();
        mapping.matrix.columns = width;
        Shape { mapping, columns: (1..=width).map(Column::Number).collect() }
    };
    let usual = Mapping::default().matrix.columns;
    let widths = std::iter::once(usual).chain(LEAST_COLUMNS..=MOST_COLUMNS);
    let timed = widths.map(of_width).find(|shape| {
        let layout = |column: &Column| Layout::of_columns(&shape.mapping, path, std::slice::from_ref(column)).ok();
        shape.columns.iter().any(|column| layout(column).is_some_and(|layout| is_time(path, &layout)))
    });
    Ok(timed.unwrap_or_else(|| of_width(usual)))
}

fn is_time(path: &Path, layout: &Layout) -> bool {
    let Ok(mut rows) = layout.open_raw(path) else { return false };
    let mut fields = [f64::NAN; crate::log::FIELDS];
    let mut values = Vec::with_capacity(ROWS);
    while values.len() < ROWS && matches!(rows.next_row(&mut fields), Ok(Some(_))) {
        values.push(fields[0]);
    }
    grows_evenly(&values)
}

/// Whether the median step is positive and almost all steps are near it.
pub fn grows_evenly(values: &[f64]) -> bool {
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let Some(median) = steps.get(steps.len() / 2).copied().filter(|median| *median > 0.0) else { return false };
    let even = steps.iter().filter(|step| (*step / median - 1.0).abs() < 0.5).count();
    values.len() >= 16 && even as f64 > (1.0 - IRREGULAR) * steps.len() as f64
}
