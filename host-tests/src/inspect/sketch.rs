//! A sketch of a log: every column reduced to some thousand points, however long the log is.

use super::shape::Shape;
use crate::log::{Column, FIELDS, Layout, LogError, WrongKey};
use std::path::Path;

/// Fewest points that are kept. When a column has twice as many, neighbours are averaged in pairs.
const POINTS: usize = 2048;
/// First rows that are kept without averaging.
const HEAD_ROWS: usize = 4096;

/// The sketch of a column.
#[derive(Clone, Debug)]
pub struct ColumnSketch {
    /// The column.
    pub column: Column,
    /// Means of neighbouring rows, [`Sketch::rows_to_a_point`] rows to each.
    pub means: Vec<f64>,
    /// Last value of the rows of each mean.
    pub lasts: Vec<f64>,
    /// The first rows.
    pub head: Vec<f64>,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// Rows in which the value is lower than in the previous row.
    pub falls: u64,
    /// Whether all values are whole numbers.
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

    /// Largest value less the smallest.
    pub fn span(&self) -> f64 {
        self.range[1] - self.range[0]
    }
}

/// All columns of a log.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// The columns.
    pub series: Vec<ColumnSketch>,
    /// Rows of the log.
    pub rows: u64,
    /// Rows averaged in a point.
    pub rows_to_a_point: u32,
}

/// Why a log cannot be sketched.
#[derive(Debug, thiserror::Error)]
pub enum SketchError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The shape of the file is not a valid mapping.
    #[error("[{}] {}: {}", .0.0, .0.1, .0.2)]
    Shape(WrongKey),
}

impl Sketch {
    /// Reads a log, once for every ten columns. `on_rows` is called from time to time with the number of rows so far.
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
