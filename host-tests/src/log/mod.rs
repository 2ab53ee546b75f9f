//! Logs: rows of time, rates, forces and angles, whatever the file.
//!
//! ```text
//! mapping, unit_names -> layout -> text | matrix | parquet -> rows of numbers -> convert -> reader -> readings
//! ```
//! Without a mapping a log is CSV with one header row, plain or compressed with gzip, SI units and radians; columns are
//! found by name, in any order, and others are ignored. A [`Mapping`] says what another log has in their place. The reader
//! streams, and refuses what it cannot read with one line that names file, line (of binary files: row) and column.
//! Repeated time stamps and gaps pass: the core judges and counts them.

mod convert;
mod error;
mod layout;
mod mapping;
mod matrix;
mod parquet;
mod parquet_writer;
mod player;
mod reader;
mod text;
mod unit_names;
mod writer;

pub use error::{Fault, LogError};
pub use layout::{FIELDS, Fields, Format, Layout};
pub use mapping::{Column, EncoderTable, Mapping, Moment, TemperatureTable, TextTable, TimeTable, TriadTable, Wrong};
pub use parquet::parquet_columns;
pub use player::LogPlayer;
pub use reader::{LogReader, LogRow, RawRows};
pub use text::{header, lines};
pub use unit_names::{ACCEL_UNITS, ANGLE_UNITS, GYRO_UNITS, TIME_UNITS, Unit};
pub use writer::LogWriter;

/// Columns that every log has.
pub const COLUMNS: [&str; 9] = [
    "time_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "outer_rad",
    "inner_rad",
];
/// Column that a log may have; an empty field or `nan` in it means that the sensor was silent.
pub const TEMPERATURE_COLUMN: &str = "temperature_c";
