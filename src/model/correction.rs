//! The correction of a sample: the specific force and the angular rate of the IMU frame, from the sensor outputs.
//!
//! The correction is the inverse of (M4) and (M5) of [`super::error_model`].

use super::error_model::InstrumentErrors;
use crate::base::angle::Angle;
use crate::base::linear::{Matrix3, Real, Vector3};
use crate::base::sample::{CorrectedSample, RawSample};

/// The inverse of (M4) and (M5), with its matrices computed once. It is applied to every sample.
///
/// ```
/// use rins_selfcal::model::correction::Calibration;
/// use rins_selfcal::model::error_model::InstrumentErrors;
/// use rins_selfcal::base::linear::Vector3;
/// use rins_selfcal::base::sample::RawSample;
/// use rins_selfcal::base::units::{ARCSEC, MICRO_G};
///
/// // An accelerometer bias, and a mounting angle of 100 arcsec about z.
/// let errors = InstrumentErrors {
///     accel_bias_a: [30.0 * MICRO_G, 0.0, 0.0],
///     mounting: [0.0, 0.0, 100.0 * ARCSEC],
///     ..InstrumentErrors::default()
/// };
/// let (force_s, omega_is_s) = (Vector3::new(0.0, 0.0, 9.79), Vector3::new(0.0, 0.3, 0.0));
/// let (force_a, omega_g) = errors.corrupt(&force_s, &omega_is_s);
/// let corrected = Calibration::new(&errors).correct(&RawSample { force_a, omega_g, ..RawSample::default() });
/// assert!((corrected.force_s - force_s).norm() < 1e-12);
/// // At gimbal angles (0, 0) the IMU differs from the vehicle by the mounting angle only.
/// assert!((corrected.rot_sb[(0, 1)] - 100.0 * ARCSEC).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Calibration<T: Real> {
    /// `rot_sa (I + diag ka)^-1`
    force_matrix_sa: Matrix3<T>,
    accel_bias_a: Vector3<T>,
    /// `rot_sg (I + diag kg)^-1`
    rate_matrix_sg: Matrix3<T>,
    gyro_bias_g: Vector3<T>,
    rot_sr: Matrix3<T>,
    errors: InstrumentErrors<T>,
}

impl<T: Real> Calibration<T> {
    /// Prepares the correction for an instrument with these errors.
    pub fn new(errors: &InstrumentErrors<T>) -> Self {
        let inverse_scale =
            |scale: [T; 3]| Matrix3::from_diagonal(&Vector3::from(scale.map(|k| (T::one() + k).recip())));
        Self {
            force_matrix_sa: errors.rot_sa() * inverse_scale(errors.accel_scale),
            accel_bias_a: Vector3::from(errors.accel_bias_a),
            rate_matrix_sg: errors.rot_sg() * inverse_scale(errors.gyro_scale),
            gyro_bias_g: Vector3::from(errors.gyro_bias_g),
            rot_sr: errors.rot_sr(),
            errors: *errors,
        }
    }

    /// Corrects one sample: `f_s = rot_sa (I + diag ka)^-1 (f_a - ba)` in m/s^2, and
    /// `w_s = rot_sg (I + diag kg)^-1 (w_g - bg)` in rad/s.
    pub fn correct(&self, sample: &RawSample<T>) -> CorrectedSample<T> {
        CorrectedSample {
            time_us: sample.time_us,
            force_s: self.force_matrix_sa * (sample.force_a - self.accel_bias_a),
            omega_is_s: self.rate_matrix_sg * (sample.omega_g - self.gyro_bias_g),
            rot_sb: self.rot_sb(sample.outer, sample.inner),
        }
    }

    /// Rotation from b (= r0) to s: the attitude of the IMU in the vehicle. It follows from the gimbal angles, the
    /// mounting angles (M2) and the non-perpendicularity (M3).
    pub fn rot_sb(&self, outer: Angle, inner: Angle) -> Matrix3<T> {
        self.rot_sr * self.errors.rot_rr0(outer, inner)
    }

    /// `rot_sa (I + diag ka)^-1`: takes the accelerometer outputs minus `ba` to the IMU frame.
    pub fn force_matrix_sa(&self) -> &Matrix3<T> {
        &self.force_matrix_sa
    }

    /// `rot_sg (I + diag kg)^-1`: takes the gyro outputs minus `bg` to the IMU frame.
    pub fn rate_matrix_sg(&self) -> &Matrix3<T> {
        &self.rate_matrix_sg
    }

    /// (M2): rotation frame to IMU frame.
    pub fn rot_sr(&self) -> &Matrix3<T> {
        &self.rot_sr
    }

    /// The errors that this calibration corrects.
    pub fn errors(&self) -> &InstrumentErrors<T> {
        &self.errors
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::{Vector, real};

    fn example<T: Real>() -> InstrumentErrors<T> {
        InstrumentErrors::from_vector(&Vector::from_fn(|row, _| {
            let sign = if row % 2 == 0 { 1.0 } else { -1.0 };
            real(sign * (1.0 + row as f64) * 2e-4)
        }))
    }

    fn round_trip<T: Real>() -> f64 {
        let errors = example::<T>();
        let force_s = Vector3::new(3.0, -4.0, 8.5).map(real);
        let omega_is_s = Vector3::new(0.3, -0.2, 0.1).map(real);
        let (force_a, omega_g) = errors.corrupt(&force_s, &omega_is_s);
        let sample = RawSample { force_a, omega_g, ..RawSample::default() };
        let back = Calibration::new(&errors).correct(&sample);
        ((back.force_s - force_s).norm() / force_s.norm())
            .widened()
            .max((back.omega_is_s - omega_is_s).norm().widened())
    }

    #[test]
    fn equations_m4_and_m5_round_trip_to_rounding() {
        assert!(round_trip::<f64>() < 8.0 * f64::EPSILON, "{}", round_trip::<f64>());
        assert!(round_trip::<f32>() < 8.0 * f64::from(f32::EPSILON), "{}", round_trip::<f32>());
    }
}
