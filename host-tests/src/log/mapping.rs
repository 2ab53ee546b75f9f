//! What a log has in place of the standard columns: MAP.toml.
//!
//! Every key is optional; what is left out is as in a standard log, or, in raw matrices, as PSINS writes them.
//!
//! ```toml
//! format = "text"                 # text, f64, f32, parquet; default: by the file's name (.f64, .f32, .parquet)
//! [text]
//! delimiter = ";"                 # ",", ";" or "tab"
//! decimal_comma = true
//! skip_rows = 2                   # before the header
//! header = true                   # false: columns by number, from 1
//! [matrix]
//! columns = 9                     # of a raw matrix; a row is so many numbers
//! [time]
//! column = "t"                    # name, or number from 1
//! unit = "ms"                     # s, ms, us, ns
//! scale = 1.0                     # the unit is so many times a step of the column: counts
//! stamp = "end"                   # what the stamp denotes of the sample interval: start, middle, end
//! angles = "end"                  # when the encoders are read; default: as the stamp
//! rate_hz = 200.0                 # without a column: there is none; else: the interval of increments
//! [gyro]
//! columns = ["wx", "wy", "wz"]
//! unit = "deg/h"                  # rad/s, deg/s, deg/h, arcsec/s; increments: rad, deg, arcsec
//! scale = 1.0                     # what one count is in that unit
//! axes = ["y", "-x", "z"]         # which of the columns' axes the IMU's x, y, z are
//! [accel]
//! columns = ["fx", "fy", "fz"]
//! unit = "g"                      # m/s^2, g, mg, ug; increments: m/s, g*s
//! [outer]
//! column = "roll"
//! unit = "deg"                    # rad, deg, arcsec, turns, counts
//! counts_per_turn = 1048576.0     # with counts
//! zero = 0.0                      # reading at angle zero, in this unit
//! reversed = false                # counts against the right-handed angle
//! [inner]
//! column = "yaw"
//! [temperature]
//! column = "temp"
//! unit = "C"                      # C, K
//! ```

use super::columns::{COLUMNS, TEMPERATURE_COLUMN};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::path::Path;

/// Kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Lines of numbers.
    Text,
    /// Raw little-endian double precision numbers, row by row.
    F64,
    /// Raw little-endian single precision numbers, row by row.
    F32,
    /// Apache Parquet.
    Parquet,
}

impl Format {
    /// By the name of a file, without `.gz`.
    pub fn of(path: &Path) -> Self {
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        match name.strip_suffix(".gz").unwrap_or(&name).rsplit_once('.').map(|(_, ending)| ending) {
            Some("f64") => Self::F64,
            Some("f32") => Self::F32,
            Some("parquet" | "pq") => Self::Parquet,
            _ => Self::Text,
        }
    }

    /// Whether it is a raw matrix.
    pub fn is_matrix(self) -> bool {
        matches!(self, Self::F64 | Self::F32)
    }
}

/// A column by name, or by number from 1.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Column {
    /// By name.
    Name(String),
    /// By number, from 1.
    Number(usize),
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => f.write_str(name),
            Self::Number(number) => write!(f, "{number}"),
        }
    }
}

impl<'de> Deserialize<'de> for Column {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColumnVisitor)
    }
}

struct ColumnVisitor;

impl Visitor<'_> for ColumnVisitor {
    type Value = Column;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("the name of a column, or its number from 1")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Column, E> {
        Ok(Column::Name(name.into()))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Column, E> {
        let counted = usize::try_from(number).ok().filter(|number| *number > 0);
        counted.map(Column::Number).ok_or_else(|| E::custom("columns are counted from 1"))
    }
}

/// A moment of the sample interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Moment {
    /// Its start.
    Start,
    /// Its middle.
    #[default]
    Middle,
    /// Its end.
    End,
}

/// `[text]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TextTable {
    /// ",", ";" or "tab".
    pub delimiter: String,
    /// Whether decimals follow a comma.
    pub decimal_comma: bool,
    /// Lines before the header, or the first row.
    pub skip_rows: u64,
    /// Whether there is a header.
    pub header: bool,
}

impl Default for TextTable {
    fn default() -> Self {
        Self { delimiter: ",".into(), decimal_comma: false, skip_rows: 0, header: true }
    }
}

/// `[matrix]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatrixTable {
    /// Numbers in a row.
    pub columns: usize,
}

impl Default for MatrixTable {
    fn default() -> Self {
        Self { columns: 9 }
    }
}

/// `[time]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimeTable {
    /// The column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<Column>,
    /// s, ms, us or ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// What one count is in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// What a stamp denotes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stamp: Option<Moment>,
    /// When the encoders are read; default: when the stamp is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angles: Option<Moment>,
    /// Sample rate, Hz; without a column, what time is counted by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
}

/// `[gyro]` and `[accel]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TriadTable {
    /// The columns of its axes x, y, z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<[Column; 3]>,
    /// Name of the unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// What one count is in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Which of these axes the IMU's x, y, z are: "x", "-x" and so on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<[String; 3]>,
}

/// `[outer]` and `[inner]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderTable {
    /// The column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<Column>,
    /// rad, deg, arcsec, turns or counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// With counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counts_per_turn: Option<f64>,
    /// Reading at angle zero, in this unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zero: Option<f64>,
    /// Whether it counts against the right-handed angle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reversed: Option<bool>,
}

/// `[temperature]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TemperatureTable {
    /// The column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<Column>,
    /// C or K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
}

/// Contents of MAP.toml.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mapping {
    /// Default: by the file's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub format: Option<Format>,
    /// Of text files.
    #[serde(skip_serializing_if = "is_default")]
    pub text: TextTable,
    /// Of raw matrices.
    #[serde(skip_serializing_if = "is_default")]
    pub matrix: MatrixTable,
    /// Time stamps.
    #[serde(skip_serializing_if = "is_default")]
    pub time: TimeTable,
    /// Gyros.
    #[serde(skip_serializing_if = "is_default")]
    pub gyro: TriadTable,
    /// Accelerometers.
    #[serde(skip_serializing_if = "is_default")]
    pub accel: TriadTable,
    /// Outer encoder.
    #[serde(skip_serializing_if = "is_default")]
    pub outer: EncoderTable,
    /// Inner encoder.
    #[serde(skip_serializing_if = "is_default")]
    pub inner: EncoderTable,
    /// IMU temperature.
    #[serde(skip_serializing_if = "is_default")]
    pub temperature: TemperatureTable,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// What is wrong in a mapping: table, key, and what of it.
pub type WrongKey = (&'static str, &'static str, String);

impl Mapping {
    /// Of a standard log.
    pub(super) fn standard() -> Self {
        let [time, gx, gy, gz, ax, ay, az, outer, inner] = COLUMNS.map(|name| Column::Name(name.into()));
        Self::of([time, outer, inner], [gx, gy, gz], [ax, ay, az], ["rad/s", "m/s^2"], Moment::Middle)
    }

    /// PSINS: increments of angle and velocity over the interval that ends at the stamp, `wm vm t`, and the encoders.
    pub(super) fn psins() -> Self {
        let triad = |first: usize| std::array::from_fn(|axis| Column::Number(first + axis));
        let others = [7, 8, 9].map(Column::Number);
        Self::of(others, triad(1), triad(4), ["rad", "m/s"], Moment::End)
    }

    fn of(others: [Column; 3], gyro: [Column; 3], accel: [Column; 3], units: [&str; 2], stamp: Moment) -> Self {
        let [time, outer, inner] = others.map(Some);
        let triad = |columns, unit: &str| TriadTable {
            columns: Some(columns),
            unit: Some(unit.into()),
            ..TriadTable::default()
        };
        let encoder = |column| EncoderTable { column, ..EncoderTable::default() };
        Self {
            time: TimeTable { column: time, stamp: Some(stamp), ..TimeTable::default() },
            gyro: triad(gyro, units[0]),
            accel: triad(accel, units[1]),
            outer: encoder(outer),
            inner: encoder(inner),
            ..Self::default()
        }
    }

    /// With what is left out taken from another one. Whether there is a time column, a given rate decides.
    pub(super) fn or(mut self, other: Self) -> Self {
        let column = if self.time.rate_hz.is_none() { other.time.column } else { None };
        self.time.column = self.time.column.or(column);
        self.time.stamp = self.time.stamp.or(other.time.stamp);
        for (mine, other) in [(&mut self.gyro, other.gyro), (&mut self.accel, other.accel)] {
            mine.columns = mine.columns.take().or(other.columns);
            mine.unit = mine.unit.take().or(other.unit);
        }
        self.outer.column = self.outer.column.or(other.outer.column);
        self.inner.column = self.inner.column.or(other.inner.column);
        self
    }

    /// Name of the temperature's column, and whether it must be there.
    pub(super) fn temperature_column(&self) -> (Column, bool) {
        let given = self.temperature.column.clone();
        let required = given.is_some();
        (given.unwrap_or_else(|| Column::Name(TEMPERATURE_COLUMN.into())), required)
    }
}
