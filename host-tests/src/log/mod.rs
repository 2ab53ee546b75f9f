//! Logs: rows of time, rates, forces and angles, whatever the file.
//!
//! ```text
//! mapping, unit_names -> layout -> text | matrix | parquet -> rows of numbers -> convert -> reader -> readings
//! readings -> writer: text, or parquet_writer
//! ```
//! Without a mapping a log is CSV with one header row, plain or compressed with gzip, SI units and radians; columns are
//! found by name, in any order, and others are ignored. A [`Mapping`] says what another log has in their place. The reader
//! streams, and refuses what it cannot read with one line that names file, line (of binary files: row) and column.
//! Repeated time stamps and gaps pass: the core judges and counts them.

mod columns;
mod convert;
mod error;
mod layout;
mod mapping;
mod matrix;
mod parquet;
mod parquet_writer;
mod player;
mod reader;
mod rows;
mod text;
mod unit_names;
mod writer;

pub use columns::{COLUMNS, FIELDS, Fields, TEMPERATURE_COLUMN};
pub use error::{LogError, LogFault};
pub use layout::Layout;
pub use mapping::{
    Column, EncoderTable, Format, Mapping, Moment, TemperatureTable, TextTable, TimeTable, TriadTable, WrongKey,
};
pub use parquet::parquet_columns;
pub use player::LogPlayer;
pub use reader::{LogReader, LogRow};
pub use rows::RawRows;
pub use text::{header, lines};
pub use unit_names::{ACCEL_UNITS, ANGLE_UNITS, GYRO_UNITS, TIME_UNITS, Unit};
pub use writer::LogWriter;
