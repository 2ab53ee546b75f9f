//! The correction of the IMU that \[11\] estimates.

use rins_selfcal::base::linear::{Matrix3, Vector3, inverse3};
use rins_selfcal::model::error_model::InstrumentErrors;

/// Correction of an IMU: `f_s = force_matrix_sa f_a - force_bias_s` and `w_s = rate_matrix_sg w_g - rate_bias_s`.
///
/// It is the inverse of (M4) and (M5): `force_matrix_sa = rot_sa (I + diag ka)^-1`, which is lower triangular, and
/// `rate_matrix_sg = rot_sg (I + diag kg)^-1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuCorrection {
    /// Accelerometer axes to IMU axes, with the scale factors. Lower triangular.
    pub force_matrix_sa: Matrix3<f64>,
    /// Accelerometer bias in the IMU frame, m/s^2.
    pub force_bias_s: Vector3<f64>,
    /// Gyro axes to IMU axes, with the scale factors.
    pub rate_matrix_sg: Matrix3<f64>,
    /// Gyro bias in the IMU frame, rad/s.
    pub rate_bias_s: Vector3<f64>,
}

impl Default for ImuCorrection {
    /// The correction of an IMU without errors.
    fn default() -> Self {
        Self {
            force_matrix_sa: Matrix3::identity(),
            force_bias_s: Vector3::zeros(),
            rate_matrix_sg: Matrix3::identity(),
            rate_bias_s: Vector3::zeros(),
        }
    }
}

impl ImuCorrection {
    /// Specific force in the IMU frame, m/s^2.
    pub fn force_s(&self, force_a: &Vector3<f64>) -> Vector3<f64> {
        self.force_matrix_sa * force_a - self.force_bias_s
    }

    /// Angular rate of the IMU frame in the IMU frame, rad/s.
    pub fn omega_is_s(&self, omega_g: &Vector3<f64>) -> Vector3<f64> {
        self.rate_matrix_sg * omega_g - self.rate_bias_s
    }

    /// The nine non-orthogonality angles, the scale-factor errors and the biases of (M1), (M4) and (M5). All other
    /// errors are zero.
    ///
    /// The columns of rot_sa and rot_sg in (M1) have the diagonal 1. So each column of a matrix here, divided by its
    /// diagonal element, is that column of (M1), and the diagonal element is `1 / (1 + k)`.
    pub fn errors(&self) -> InstrumentErrors<f64> {
        let unit_diagonal = |m: &Matrix3<f64>| m * Matrix3::from_diagonal(&m.diagonal().map(f64::recip));
        let scale = |m: &Matrix3<f64>| m.diagonal().map(|element| element.recip() - 1.0).into();
        let (rot_sa, rot_sg) = (unit_diagonal(&self.force_matrix_sa), unit_diagonal(&self.rate_matrix_sg));
        InstrumentErrors {
            gyro_non_orthogonality: [
                rot_sg[(0, 2)],
                -rot_sg[(0, 1)],
                -rot_sg[(1, 2)],
                rot_sg[(1, 0)],
                rot_sg[(2, 1)],
                -rot_sg[(2, 0)],
            ],
            accel_non_orthogonality: [rot_sa[(1, 0)], rot_sa[(2, 1)], -rot_sa[(2, 0)]],
            accel_bias_a: (inverse3(&self.force_matrix_sa) * self.force_bias_s).into(),
            accel_scale: scale(&self.force_matrix_sa),
            gyro_bias_g: (inverse3(&self.rate_matrix_sg) * self.rate_bias_s).into(),
            gyro_scale: scale(&self.rate_matrix_sg),
            ..InstrumentErrors::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_unit::presets;
    use rins_selfcal::model::correction::Calibration;

    /// The angles, scale factors and biases of the correction are those of the project's own error model.
    #[test]
    fn the_correction_has_the_errors_of_the_error_model() {
        let errors = presets::real(1);
        let calibration = Calibration::new(&errors);
        let scaled = |k: [f64; 3]| Matrix3::from_diagonal(&Vector3::from(k.map(|k| (1.0 + k).recip())));
        let force_matrix_sa = *calibration.force_matrix_sa();
        let rate_matrix_sg = errors.rot_sg() * scaled(errors.gyro_scale);
        let correction = ImuCorrection {
            force_matrix_sa,
            force_bias_s: force_matrix_sa * Vector3::from(errors.accel_bias_a),
            rate_matrix_sg,
            rate_bias_s: rate_matrix_sg * Vector3::from(errors.gyro_bias_g),
        };
        let (force_s, omega_is_s) = (Vector3::new(1.0, -2.0, 9.0), Vector3::new(0.1, 0.3, -0.2));
        let (force_a, omega_g) = errors.corrupt(&force_s, &omega_is_s);
        assert!((correction.force_s(&force_a) - force_s).norm() < 1e-14);
        assert!((correction.omega_is_s(&omega_g) - omega_is_s).norm() < 1e-15);
        let found = correction.errors();
        let known = InstrumentErrors {
            mounting: [0.0; 3],
            axis_non_perpendicularity: 0.0,
            base_roll: 0.0,
            base_pitch: 0.0,
            heading: 0.0,
            ..errors
        };
        assert!((found.to_vector() - known.to_vector()).norm() < 1e-14);
    }
}
