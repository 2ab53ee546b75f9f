//! IMU samples. Raw and corrected samples have different types, so that they cannot be confused.

use crate::base::angle::Angle;
use crate::base::linear::{Matrix3, Real, Vector3};
use serde::{Deserialize, Serialize};

/// Number of channels of the IMU: accelerometers x, y, z, then gyros x, y, z.
pub const CHANNELS: usize = 6;

/// One IMU measurement with both gimbal angles.
///
/// Rate and force are means over one sample interval. `time_us` is the middle of that interval, and the angles belong
/// to `time_us`. If an instrument took the angles and the stamp at the end of the interval instead, each move would
/// lose up to half an interval of Earth rotation: 0.04 arcsec at 200 Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

/// Status of a corrected sample, as a word of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SampleStatus(u16);

impl SampleStatus {
    /// No bit is set.
    pub const NONE: Self = Self(0);
    /// A run since power-up found the calibration of this sample. Otherwise the calibration comes from the store.
    pub const CALIBRATED_NOW: Self = Self(1);
    /// A calibration run is in progress: the gimbal turns the IMU through the scheme.
    pub const RUN_UNDER_WAY: Self = Self(1 << 1);
    /// Both axes are at rest.
    pub const AT_REST: Self = Self(1 << 2);
    /// An axis has a fault, and both axes are brought to rest.
    pub const GIMBAL_FAULT: Self = Self(1 << 3);
    /// At least one sample is missing between the sample before and this sample: its time stamp is more than 1.5 nominal
    /// intervals later.
    pub const SAMPLES_MISSED: Self = Self(1 << 4);

    /// This word, and also the bits of `other` if `set` is true.
    #[must_use]
    pub const fn with(self, other: Self, set: bool) -> Self {
        if set { Self(self.0 | other.0) } else { self }
    }

    /// Whether all bits of `other` are set.
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The bits.
    pub const fn bits(self) -> u16 {
        self.0
    }
}
