//! How a file is cut into columns: separator, header, decimal comma; of a raw matrix, how many numbers a row has.

use crate::log::{Column, Format, Layout, LogError, Mapping, TextTable, header, lines, parquet_columns};
use std::path::Path;

/// Lines that are looked at.
const LINES: usize = 200;
/// Least columns of a log: nine, or eight without a time.
const LEAST_COLUMNS: usize = 8;
/// Rows of a matrix that are looked at, and most numbers that a row is thought to have.
const ROWS: usize = 2000;
const MOST_COLUMNS: usize = 32;
/// Part of all steps that may differ in a column of times.
const IRREGULAR: f64 = 0.05;

/// A file cut into columns.
#[derive(Clone, Debug)]
pub struct Shape {
    /// How to read it, without saying what the columns are.
    pub mapping: Mapping,
    /// Columns that hold numbers.
    pub columns: Vec<Column>,
}

impl Shape {
    /// Of a file, by its name and its first lines or rows.
    ///
    /// # Errors
    /// The file cannot be read, or is nothing that a mapping could describe.
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
    /// It cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// No line of the first ones has enough numbers.
    #[error(
        "{path}: no line of {LEAST_COLUMNS} numbers or more, separated by commas, semicolons or tabs, in the first {LINES}"
    )]
    NoNumbers {
        /// The file.
        path: String,
    },
}

/// Separators, and whether decimals follow a comma.
const DIALECTS: [(&str, char, bool); 5] =
    [(",", ',', false), (";", ';', false), ("tab", '\t', false), (";", ';', true), ("tab", '\t', true)];

fn of_text(path: &Path) -> Result<Shape, ShapeError> {
    let lines = lines(path, LINES)?;
    let numbers = |line: &str, dialect: &(&str, char, bool)| {
        line.split(dialect.1).filter(|field| number(field, dialect.2).is_some()).count()
    };
    let most = |dialect: &(&str, char, bool)| lines.iter().map(|line| numbers(line, dialect)).max().unwrap_or(0);
    // The first of the best: a decimal comma only where it makes more numbers.
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
    // A field that is not a number in some line is no column of numbers; an empty one is a sensor that is silent.
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

/// So many columns that one of them is a time, which grows by equal steps.
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

/// Whether almost all steps are the median one, which is positive.
pub fn grows_evenly(values: &[f64]) -> bool {
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let Some(median) = steps.get(steps.len() / 2).copied().filter(|median| *median > 0.0) else { return false };
    let even = steps.iter().filter(|step| (*step / median - 1.0).abs() < 0.5).count();
    values.len() >= 16 && even as f64 > (1.0 - IRREGULAR) * steps.len() as f64
}
