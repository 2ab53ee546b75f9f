//! Columns of a standard log, and the fields of a row.

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

/// Fields of a row: time, gyros x y z, accelerometers x y z, outer, inner, temperature.
pub const FIELDS: usize = 10;

/// A row as it is in the file; NaN where there is no such column.
pub type Fields = [f64; FIELDS];

/// Position of the temperature in [`Fields`].
pub(super) const TEMPERATURE: usize = 9;
