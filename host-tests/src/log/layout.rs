//! A mapping with every number checked: which columns are read, and how they are converted.

use super::columns::{FIELDS, TEMPERATURE};
use super::error::LogError;
use super::mapping::{Column, EncoderTable, Format, Mapping, Moment, TriadTable, WrongKey};
use super::unit_names::{ACCEL_UNITS, ANGLE_UNITS, GYRO_UNITS, TEMPERATURE_UNITS, TIME_UNITS, Unit, named};
use crate::files::toml_file::TomlFile;
use rins_selfcal::gimbal::fault::AXIS_NAMES;
use std::f64::consts::TAU;
use std::path::Path;

/// 0 deg C, K.
const ZERO_C_K: f64 = 273.15;
/// Most columns of a matrix.
const MOST_COLUMNS: usize = 4096;

/// A field's column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The column.
    pub column: Column,
    /// Whether the column must exist and be finite in every row.
    pub required: bool,
}

/// Three axes of a sensor: the factor to SI, and for each axis of the IMU the axis of the columns with its sign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Triad {
    pub factor: f64,
    pub is_increment: bool,
    pub axes: [(usize, f64); 3],
}

/// An encoder: the signed factor to radians, and the reading at angle zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Encoder {
    pub factor: f64,
    pub zero: f64,
}

/// A checked mapping.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Kind of the file.
    pub format: Format,
    pub(super) delimiter: u8,
    pub(super) decimal_comma: bool,
    pub(super) skip_rows: u64,
    pub(super) has_header: bool,
    pub(super) matrix_columns: usize,
    pub(super) wanted: [Option<Wanted>; FIELDS],
    pub(super) time_factor_s: f64,
    pub(super) rate_hz: Option<f64>,
    pub(super) stamp: Moment,
    pub(super) angles: Moment,
    pub(super) gyro: Triad,
    pub(super) accel: Triad,
    pub(super) encoders: [Encoder; 2],
    pub(super) temperature_offset_c: f64,
}

impl Layout {
    /// The layout of a log without a mapping: the standard log, or the standard matrix.
    pub fn standard(log: &Path) -> Self {
        Mapping::default().layout(log).expect("the default mapping is right")
    }

    /// The layout of the file that a mapping describes, with these columns (at most ten) in place of its fields.
    ///
    /// # Errors
    /// What is wrong in the mapping.
    pub fn of_columns(mapping: &Mapping, log: &Path, columns: &[Column]) -> Result<Self, WrongKey> {
        let wanted = |field: usize| columns.get(field).map(|column| Wanted { column: column.clone(), required: false });
        Ok(Self {
            delimiter: mapping.delimiter()?,
            decimal_comma: mapping.text.decimal_comma,
            skip_rows: mapping.text.skip_rows,
            has_header: mapping.text.header,
            matrix_columns: mapping.matrix.columns,
            wanted: std::array::from_fn(wanted),
            ..Self::standard(log)
        })
    }

    /// Whether every row must have a finite number in a field.
    pub(super) fn must_be_finite(&self, field: usize) -> bool {
        field != TEMPERATURE && self.wanted[field].as_ref().is_some_and(|wanted| wanted.required)
    }

    /// The sample rate that the mapping gives, Hz.
    pub fn rate_hz(&self) -> Option<f64> {
        self.rate_hz
    }

    /// Name or number of a field's column.
    pub(super) fn column_name(&self, field: usize) -> String {
        self.wanted[field].as_ref().map_or_else(|| "of the time".into(), |wanted| wanted.column.to_string())
    }
}

impl Mapping {
    /// Reads a mapping file for a log of this name.
    ///
    /// # Errors
    /// One line that names file, line and key.
    pub fn read(path: &Path, log: &Path) -> Result<Layout, LogError> {
        let file = TomlFile::read(path)?;
        let mapping: Self = file.parse()?;
        let layout = mapping.layout(log);
        layout.map_err(|(table, key, what)| file.wrong_value(table, key, &what).into())
    }

    /// The checked mapping for a log of this name.
    ///
    /// # Errors
    /// What is wrong.
    pub fn layout(&self, log: &Path) -> Result<Layout, WrongKey> {
        let format = self.format.unwrap_or_else(|| Format::of(log));
        self.clone().or(if format.is_matrix() { Self::psins() } else { Self::standard() }).check(format)
    }

    fn check(self, format: Format) -> Result<Layout, WrongKey> {
        let stamp = self.time.stamp.unwrap_or_default();
        let time = self.unit("time", &TIME_UNITS, self.time.unit.as_deref())?;
        let temperature = self.unit("temperature", &TEMPERATURE_UNITS, self.temperature.unit.as_deref())?;
        let layout = Layout {
            format,
            delimiter: self.delimiter()?,
            decimal_comma: self.text.decimal_comma,
            skip_rows: self.text.skip_rows,
            has_header: self.text.header,
            matrix_columns: self.matrix.columns,
            wanted: self.wanted(),
            time_factor_s: time.si * positive("time", "scale", self.time.scale)?,
            rate_hz: rate("time", self.time.rate_hz)?,
            stamp,
            angles: self.time.angles.unwrap_or(stamp),
            gyro: triad("gyro", &self.gyro, &GYRO_UNITS)?,
            accel: triad("accel", &self.accel, &ACCEL_UNITS)?,
            encoders: [encoder(AXIS_NAMES[0], &self.outer)?, encoder(AXIS_NAMES[1], &self.inner)?],
            temperature_offset_c: if temperature.name == "K" { -ZERO_C_K } else { 0.0 },
        };
        self.check_columns(&layout)?;
        Ok(layout)
    }

    fn unit(&self, table: &'static str, units: &[Unit], name: Option<&str>) -> Result<Unit, WrongKey> {
        name.map_or(Ok(units[0]), |name| named(units, name)).map_err(|what| (table, "unit", what))
    }

    fn delimiter(&self) -> Result<u8, WrongKey> {
        let wrong = |what: &str| Err(("text", "delimiter", what.to_string()));
        match self.text.delimiter.as_str() {
            "," if self.text.decimal_comma => wrong("must not be \",\" while decimal_comma = true"),
            "," => Ok(b','),
            ";" => Ok(b';'),
            "tab" | "\t" => Ok(b'\t'),
            _ => wrong("must be \",\", \";\" or \"tab\""),
        }
    }

    fn wanted(&self) -> [Option<Wanted>; FIELDS] {
        let required = |column: &Column| Wanted { column: column.clone(), required: true };
        let triad = |table: &TriadTable, axis: usize| table.columns.as_ref().map(|columns| required(&columns[axis]));
        std::array::from_fn(|field| match field {
            0 => self.time.column.as_ref().map(required),
            1..=3 => triad(&self.gyro, field - 1),
            4..=6 => triad(&self.accel, field - 4),
            7 => self.outer.column.as_ref().map(required),
            8 => self.inner.column.as_ref().map(required),
            _ => {
                let (column, required) = self.temperature_column();
                Some(Wanted { column, required })
            }
        })
    }

    /// A column by name needs a log with names, and no column may be used for two fields.
    fn check_columns(&self, layout: &Layout) -> Result<(), WrongKey> {
        let matrix = layout.format.is_matrix();
        if matrix && !(1..=MOST_COLUMNS).contains(&layout.matrix_columns) {
            return Err(("matrix", "columns", format!("must be between 1 and {MOST_COLUMNS}")));
        }
        let nameless = matrix || (layout.format == Format::Text && !layout.has_header);
        let mut seen: Vec<&Column> = Vec::new();
        for (field, wanted) in layout.wanted.iter().enumerate() {
            let Some(Wanted { column, required: true }) = wanted else { continue };
            let (table, key) = place(field);
            match column {
                Column::Name(name) if nameless => {
                    return Err((
                        table,
                        key,
                        format!("\"{name}\": the log has no column names; give the number of the column, from 1"),
                    ));
                }
                Column::Number(number) if matrix && *number > layout.matrix_columns => {
                    return Err((
                        table,
                        key,
                        format!("{number} is too large: the matrix has {} columns", layout.matrix_columns),
                    ));
                }
                _ if seen.contains(&column) => return Err((table, key, format!("column {column} is used twice"))),
                _ => seen.push(column),
            }
        }
        Ok(())
    }
}

/// Table and key with which a mapping names the column of a field.
fn place(field: usize) -> (&'static str, &'static str) {
    match field {
        0 => ("time", "column"),
        1..=3 => ("gyro", "columns"),
        4..=6 => ("accel", "columns"),
        7 | 8 => (AXIS_NAMES[field - 7], "column"),
        _ => ("temperature", "column"),
    }
}

fn positive(table: &'static str, key: &'static str, value: Option<f64>) -> Result<f64, WrongKey> {
    let value = value.unwrap_or(1.0);
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err((table, key, "must be finite and positive".into())) }
}

fn rate(table: &'static str, rate_hz: Option<f64>) -> Result<Option<f64>, WrongKey> {
    match rate_hz {
        Some(rate) if !(1.0..=100_000.0).contains(&rate) => {
            Err((table, "rate_hz", "must be between 1 and 100000".into()))
        }
        rate => Ok(rate),
    }
}

fn triad(name: &'static str, table: &TriadTable, units: &[Unit]) -> Result<Triad, WrongKey> {
    let unit = table.unit.as_deref().map_or(Ok(units[0]), |unit| named(units, unit));
    let unit = unit.map_err(|what| (name, "unit", what))?;
    let scale = table.scale.unwrap_or(1.0);
    if !scale.is_finite() || scale == 0.0 {
        return Err((name, "scale", "must be finite and not zero".into()));
    }
    let wrong = || (name, "axes", "must be x, y and z in some order, each with or without \"-\"".to_string());
    let axes = table.axes.as_ref().map_or(Some([(0, 1.0), (1, 1.0), (2, 1.0)]), parsed_axes).ok_or_else(wrong)?;
    Ok(Triad { factor: unit.si * scale, is_increment: unit.is_increment, axes })
}

/// The axes with their signs, if each axis appears once.
fn parsed_axes(names: &[String; 3]) -> Option<[(usize, f64); 3]> {
    let mut axes = [(0, 0.0); 3];
    let mut seen = [false; 3];
    for (axis, name) in axes.iter_mut().zip(names) {
        let (sign, letter) = name.strip_prefix('-').map_or((1.0, name.as_str()), |rest| (-1.0, rest));
        let number = ["x", "y", "z"].iter().position(|other| *other == letter)?;
        if std::mem::replace(&mut seen[number], true) {
            return None;
        }
        *axis = (number, sign);
    }
    Some(axes)
}

fn encoder(name: &'static str, table: &EncoderTable) -> Result<Encoder, WrongKey> {
    let unit = table.unit.as_deref().map_or(Ok(ANGLE_UNITS[0]), |unit| named(&ANGLE_UNITS, unit));
    let unit = unit.map_err(|what| (name, "unit", what))?;
    let factor = match (unit.name, table.counts_per_turn) {
        ("counts", None) => return Err((name, "unit", "\"counts\" needs counts_per_turn".into())),
        ("counts", counts) => TAU / positive(name, "counts_per_turn", counts)?,
        (_, None) => unit.si,
        (other, Some(_)) => {
            return Err((name, "counts_per_turn", format!("is for the unit \"counts\" only, not for \"{other}\"")));
        }
    };
    let zero = table.zero.unwrap_or(0.0);
    if !zero.is_finite() {
        return Err((name, "zero", "must be finite".into()));
    }
    let sign = if table.reversed == Some(true) { -1.0 } else { 1.0 };
    Ok(Encoder { factor: factor * sign, zero })
}
