//! IMU samples. Raw and corrected samples have different types, so that they cannot be confused.

use crate::base::angle::Angle;
use crate::base::linear::{Matrix3, Real, Vector3};

/// Number of channels of the IMU: accelerometers x, y, z, then gyros x, y, z.
pub const CHANNELS: usize = 6;

/// One IMU measurement with both gimbal angles.
///
/// Rate and force are means over one sample interval. `time_us` is the middle of that interval, and the angles belong
/// to `time_us`. If an instrument took the angles and the stamp at the end of the interval instead, each move would
/// lose up to half an interval of Earth rotation: 0.04 arcsec at 200 Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSample<T: Real> {
    /// Middle of the sample interval, us, monotonic.
    pub time_us: u64,
    /// Gyro outputs along the gyro axes, rad/s.
    pub omega_g: Vector3<T>,
    /// Accelerometer outputs along the accelerometer axes, m/s^2.
    pub force_a: Vector3<T>,
    /// Outer gimbal angle.
    pub outer: Angle,
    /// Inner gimbal angle.
    pub inner: Angle,
    /// IMU temperature, deg C. NaN if the IMU has no temperature sensor.
    pub temperature_c: f32,
}

impl<T: Real> Default for RawSample<T> {
    fn default() -> Self {
        Self {
            time_us: 0,
            omega_g: Vector3::zeros(),
            force_a: Vector3::zeros(),
            outer: Angle::default(),
            inner: Angle::default(),
            temperature_c: f32::NAN,
        }
    }
}

/// A sample from which the calibrated errors have been removed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectedSample<T: Real> {
    /// Time stamp of the raw sample, us.
    pub time_us: u64,
    /// Specific force in the IMU frame, m/s^2.
    pub force_s: Vector3<T>,
    /// Angular rate of the IMU frame relative to inertial space, in the IMU frame, rad/s.
    pub omega_is_s: Vector3<T>,
    /// Rotation from the vehicle frame b to the IMU frame s.
    pub rot_sb: Matrix3<T>,
}
