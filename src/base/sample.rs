//! IMU samples, raw and corrected: two types, so that neither passes for the other.

use crate::base::angle::Angle;
use crate::base::linear::{Matrix3, Real, Vector3};

/// Channels of the IMU: accelerometers x y z, gyros x y z.
pub const CHANNELS: usize = 6;

/// One reading of the IMU with both gimbal angles.
///
/// Rate and force are means over a sample interval. `time_us` is the middle of that interval, and the angles are those at
/// that time: if means and angles are half an interval apart, as where angles and stamp are of the interval's end, each
/// move loses up to half an interval of Earth rate, 0.04 arcsec at 200 Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSample<T: Real> {
    /// Middle of the interval over which rate and force are means, us, monotonic.
    pub time_us: u64,
    /// Gyro outputs on their own axes, rad/s.
    pub omega_g: Vector3<T>,
    /// Accelerometer outputs on their own axes, m/s^2.
    pub force_a: Vector3<T>,
    /// Outer gimbal angle.
    pub outer: Angle,
    /// Inner gimbal angle.
    pub inner: Angle,
    /// IMU temperature, deg C; not a number where there is no sensor.
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

/// A sample with the instrument's errors taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectedSample<T: Real> {
    /// Time of the raw sample, us.
    pub time_us: u64,
    /// Specific force in the IMU frame, m/s^2.
    pub force_s: Vector3<T>,
    /// Inertial angular rate of the IMU frame in the IMU frame, rad/s.
    pub omega_is_s: Vector3<T>,
    /// Attitude of the IMU frame relative to the vehicle: b to s.
    pub rot_sb: Matrix3<T>,
}
