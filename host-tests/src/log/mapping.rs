//! The mapping of a log that is not a standard log: the file MAP.toml.
//!
//! Every key is optional. Keys that are left out are as in a standard log, or, for a raw matrix, as PSINS writes it.
//!
//! ```toml
//! format = "text"                 # text, f64, f32, parquet; default: by the file's name (.f64, .f32, .parquet)
//! [text]
//! delimiter = ";"                 # ",", ";" or "tab"
//! decimal_comma = true
//! skip_rows = 2                   # lines before the header
//! header = true                   # false: columns are given by number, from 1
//! [matrix]
//! columns = 9                     # numbers in a row of a raw matrix
//! [time]
//! column = "t"                    # name, or number from 1
//! unit = "ms"                     # s, ms, us, ns
//! scale = 1.0                     # one count of the column, in that unit
//! stamp = "end"                   # moment of the sample interval that the time stamp denotes: start, middle, end
//! angles = "end"                  # moment at which the encoders are read; default: as the stamp
//! rate_hz = 200.0                 # without `column`: the log has no time; with it: gives the interval of increments
//! [gyro]
//! columns = ["wx", "wy", "wz"]
//! unit = "deg/h"                  # rad/s, deg/s, deg/h, arcsec/s; increments: rad, deg, arcsec
//! scale = 1.0                     # one count of the columns, in that unit
//! axes = ["y", "-x", "z"]         # the columns' axes along the IMU's x, y, z
//! [accel]
//! columns = ["fx", "fy", "fz"]
//! unit = "g"                      # m/s^2, g, mg, ug; increments: m/s, g*s
//! [outer]
//! column = "roll"
//! unit = "deg"                    # rad, deg, arcsec, turns, counts
//! counts_per_turn = 1048576.0     # for the unit counts
//! zero = 0.0                      # reading at angle zero, in this unit
//! reversed = false                # true: the encoder counts left-handed
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
    /// The format by the name of a file, `.gz` left aside.
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
    /// Whether the decimal mark is a comma.
    pub decimal_comma: bool,
    /// Lines before the header, or before the first row if the file has no header.
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
    /// One count, in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// The moment of the sample interval that a time stamp denotes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stamp: Option<Moment>,
    /// The moment at which the encoders are read. Default: the moment of the time stamp.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angles: Option<Moment>,
    /// Sample rate, Hz. In a log without a time column the time is counted by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
}

/// `[gyro]` and `[accel]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TriadTable {
    /// The columns of the axes x, y, z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<[Column; 3]>,
    /// Name of the unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// One count, in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// The columns' axes along the IMU's x, y, z: "x", "-x" and so on.
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
    /// Counts in a turn, for the unit counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counts_per_turn: Option<f64>,
    /// Reading at angle zero, in this unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zero: Option<f64>,
    /// Whether the encoder counts left-handed.
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
    /// Format of the file. Default: by the file's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub format: Option<Format>,
    /// How text files are read.
    #[serde(skip_serializing_if = "is_default")]
    pub text: TextTable,
    /// How raw matrices are read.
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

/// What is wrong in a mapping: table, key, and the fault in words.
pub type WrongKey = (&'static str, &'static str, String);

impl Mapping {
    /// The mapping of a standard log.
    pub(super) fn standard() -> Self {
        let [time, gx, gy, gz, ax, ay, az, outer, inner] = COLUMNS.map(|name| Column::Name(name.into()));
        Self::of([time, outer, inner], [gx, gy, gz], [ax, ay, az], ["rad/s", "m/s^2"], Moment::Middle)
    }

    /// The mapping of a PSINS matrix: increments of angle and velocity over the interval that ends at the time stamp
    /// (`wm vm t`), and the encoders.
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

    /// Takes the keys that are left out from another mapping. The time column is not taken if `rate_hz` is given.
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

    /// Name of the temperature column, and whether the column must exist.
    pub(super) fn temperature_column(&self) -> (Column, bool) {
        let given = self.temperature.column.clone();
        let required = given.is_some();
        (given.unwrap_or_else(|| Column::Name(TEMPERATURE_COLUMN.into())), required)
    }
}
