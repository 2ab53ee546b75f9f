//! All columns of a log in some thousand points each, however long it is, whatever they are.

use super::shape::Shape;
use crate::log::{Column, FIELDS, Layout, LogError, WrongKey};
use std::path::Path;

/// Points kept: when there are twice as many, neighbours are put together.
const POINTS: usize = 2048;
/// Rows of the beginning that are kept as they are.
const HEAD_ROWS: usize = 4096;

/// A column.
#[derive(Clone, Debug)]
pub struct ColumnSketch {
    /// The column.
    pub column: Column,
    /// Means of neighbouring rows, so many to each.
    pub means: Vec<f64>,
    /// The last of each.
    pub lasts: Vec<f64>,
    /// The first rows.
    pub head: Vec<f64>,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// Rows in which it is lower than in the one before.
    pub falls: u64,
    /// Whether it has nothing but whole numbers.
    pub whole: bool,
    sum: (f64, u32),
}

impl ColumnSketch {
    fn new(column: &Column) -> Self {
        Self {
            column: column.clone(),
            means: Vec::new(),
            lasts: Vec::new(),
            head: Vec::new(),
            range: [f64::INFINITY, f64::NEG_INFINITY],
            falls: 0,
            whole: true,
            sum: (0.0, 0),
        }
    }

    fn note(&mut self, value: f64, previous: Option<f64>, rows_to_a_point: u32) {
        if self.head.len() < HEAD_ROWS {
            self.head.push(value);
        }
        self.range = [self.range[0].min(value), self.range[1].max(value)];
        self.whole &= value.fract() == 0.0;
        self.falls += u64::from(previous.is_some_and(|previous| value < previous));
        self.sum = (self.sum.0 + value, self.sum.1 + 1);
        if self.sum.1 == rows_to_a_point {
            self.means.push(self.sum.0 / f64::from(rows_to_a_point));
            self.lasts.push(value);
            self.sum = (0.0, 0);
        }
    }

    fn halve(&mut self) {
        self.means = self.means.chunks_exact(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        self.lasts = self.lasts.chunks_exact(2).map(|pair| pair[1]).collect();
    }

    /// From the smallest value to the largest.
    pub fn span(&self) -> f64 {
        self.range[1] - self.range[0]
    }
}

/// All columns of a log.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// The columns.
    pub series: Vec<ColumnSketch>,
    /// Rows.
    pub rows: u64,
    /// Rows to a point.
    pub rows_to_a_point: u32,
}

/// Why there is none.
#[derive(Debug, thiserror::Error)]
pub enum SketchError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// What is known of the file contradicts itself.
    #[error("[{}] {}: {}", .0.0, .0.1, .0.2)]
    Shape(WrongKey),
}

impl Sketch {
    /// Reads a log, as often as it has tens of columns. `on_rows` is called now and then with the rows so far.
    ///
    /// # Errors
    /// The first row that cannot be read.
    pub fn of(path: &Path, shape: &Shape, mut on_rows: impl FnMut(u64)) -> Result<Self, SketchError> {
        let mut sketch = Self { series: Vec::new(), rows: 0, rows_to_a_point: 1 };
        for columns in shape.columns.chunks(FIELDS) {
            let layout = Layout::of_columns(&shape.mapping, path, columns).map_err(SketchError::Shape)?;
            let (series, rows, rows_to_a_point) = of_columns(path, &layout, columns, &mut on_rows)?;
            sketch.series.extend(series);
            (sketch.rows, sketch.rows_to_a_point) = (rows, rows_to_a_point);
        }
        Ok(sketch)
    }
}

fn of_columns(
    path: &Path,
    layout: &Layout,
    columns: &[Column],
    on_rows: &mut impl FnMut(u64),
) -> Result<(Vec<ColumnSketch>, u64, u32), LogError> {
    let mut series: Vec<ColumnSketch> = columns.iter().map(ColumnSketch::new).collect();
    let mut rows = layout.open_raw(path)?;
    let (mut fields, mut before) = ([f64::NAN; FIELDS], None);
    let (mut count, mut rows_to_a_point) = (0, 1);
    while rows.next_row(&mut fields)?.is_some() {
        for (index, series) in series.iter_mut().enumerate() {
            series.note(fields[index], before.map(|before: [f64; FIELDS]| before[index]), rows_to_a_point);
        }
        before = Some(fields);
        count += 1;
        if count % 10_000 == 0 {
            on_rows(count);
        }
        if series.first().is_some_and(|series| series.means.len() >= 2 * POINTS) {
            series.iter_mut().for_each(ColumnSketch::halve);
            rows_to_a_point *= 2;
        }
    }
    Ok((series, count, rows_to_a_point))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_column_keeps_its_mean_its_range_and_its_end() {
        let mut series = ColumnSketch::new(&Column::Number(1));
        let mut rows_to_a_point = 1;
        for row in 0..50_000_u32 {
            series.note(f64::from(row), row.checked_sub(1).map(f64::from), rows_to_a_point);
            if series.means.len() >= 2 * POINTS {
                series.halve();
                rows_to_a_point *= 2;
            }
        }
        // 50000 rows make 3125 points of 16.
        assert_eq!((series.means.len(), rows_to_a_point), (3125, 16));
        assert_eq!((series.means[0], series.lasts[0], series.lasts[3124]), (7.5, 15.0, 49_999.0));
        assert_eq!((series.span(), series.falls, series.whole, series.head.len()), (49_999.0, 0, true, 4096));
    }
}
