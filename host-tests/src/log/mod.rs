//! Logs: rows of time, rates, forces and angles in several file formats.
//!
//! ```text
//! mapping, unit_names -> layout -> text | matrix | parquet -> rows of numbers -> convert -> reader -> readings
//! readings -> writer: text, or parquet_writer
//! ```
//! Without a mapping a log is CSV with one header row, plain or compressed with gzip, in SI units and radians. Columns
//! are found by name, in any order. Other columns are ignored. A [`Mapping`] describes every other kind of log. The
//! reader streams. It refuses a row that it cannot read with one line that names file, line (row in a binary file) and
//! column. The reader does not refuse repeated time stamps and gaps, because the core judges and counts them.

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
