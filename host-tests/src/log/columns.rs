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
/// Optional column. An empty field or `nan` in this column means that the temperature sensor gave no value.
pub const TEMPERATURE_COLUMN: &str = "temperature_c";

/// Fields of a row: time, gyros x y z, accelerometers x y z, outer, inner, temperature.
pub const FIELDS: usize = 10;

/// The numbers of a row, not yet converted. NaN where the log has no such column.
pub type Fields = [f64; FIELDS];

/// Position of the temperature in [`Fields`].
pub(super) const TEMPERATURE: usize = 9;
