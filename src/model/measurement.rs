//! The predicted measurement of a segment, and its derivatives by all parameters.
//!
//! A stop measures the mean specific force. A stop or a move measures the integral of the angular rate:
//! ```text
//! (M6) f_a      = (I + diag ka) rot_sa^-1 rot_sr R f_b + ba,                R = rot_rr0(outer, inner)
//! (M7) int w_g  = (I + diag kg) rot_sg^-1 rot_sr [ V + A w_b ] + bg T,      A = int R
//!                 V = int R_inner [outer rate, 0, 0]^T + e_inner inner rate
//!      f_b = rot_bn (0, 0, g),   w_b = rot_bn w_ie,   b = r0
//! ```
//! (M6) and (M7) are (B10) and (B12) of Bai et al., Sensors 2019, 19, 4005, exact, integrated, and with (M4) and (M5).
//! Q is the tilt of the inner axis by d, and R_inner = Q R_z Q^T. So both integrals follow from the sums of the
//! segment for any d.
//!
//! [`super::effects`] has the effects of real hardware. They act in small ways: through the attitude error phi of the
//! rotation frame, in r. A force changes by f x phi, and V changes by
//! ```text
//! int (d phi / dt - phi x w) dt,   w the rate of r
//! ```
//!
//! The encoder error of a stop is the reading minus the true angle. Over a move the encoder error goes linearly from
//! that of one stop to that of the next stop. Harmonics e(angle) of the encoder error are known along the move and are
//! integrated:
//! ```text
//! V changes by - int R_z e_x de_outer + int e_z x R_z e_x e_inner(inner) d outer - e_inner de_inner
//! ```

use super::error_model::{InstrumentErrors, PARAMETERS, block};
use crate::base::angle::Angle;
use crate::base::linear::{
    Matrix, Matrix3, Real, Vector3, columns_mut, exp_so3, inverse3, left_jacobian_so3, real, skew,
};
use crate::base::site::Site;

/// Encoder errors that a measurement may depend on: outer and inner at the stop before, then outer and inner at this
/// stop. For a move, the two stops are those at its ends.
pub const ENCODER_ERRORS: usize = 4;

/// Effects of encoders and axes: harmonics 1 to 4 of the encoder errors (cosine and sine of the outer angle, then of
/// the inner angle, each), backlash (2), wobble of the outer axis about y and z and of the inner axis about x and y
/// (cosine and sine each), sag of the inner axis (cosine and sine), and wobble twice a turn in the order of the wobble.
pub const GEOMETRY: usize = 36;

/// The harmonics 1 and 2 of the encoder errors, the first of [`GEOMETRY`].
pub(super) const HARMONICS: usize = 8;

/// Place of the backlash of the outer encoder among the effects of encoders and axes.
pub(super) const BACKLASH: usize = 16;

/// A predicted measurement and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Prediction<T: Real> {
    /// Predicted value, three channels.
    pub value: Vector3<T>,
    /// Derivative by the parameter vector, (3 x 28), SI.
    pub by_parameters: Matrix<T, 3, PARAMETERS>,
    /// Derivative by the encoder errors (3 x 4), per rad.
    pub by_encoder_errors: Matrix<T, 3, ENCODER_ERRORS>,
    /// Derivative by the effects of encoders and axes (3 x 36), per rad. For a move, the columns of the backlash are the
    /// axes at its start, to be multiplied by the change of the sense of arrival. For a stop they are zero.
    pub by_geometry: Matrix<T, 3, GEOMETRY>,
    /// Specific force in the sensors' axes, in g. For gyros, its integral over the segment, s.
    pub in_g: Vector3<T>,
    /// Derivative by the rates of roll, pitch and heading of the base, s; zero for accelerometers.
    pub by_attitude_rate: Matrix3<T>,
    /// Derivative by the north and the up component of the Earth rate, s; zero for accelerometers.
    pub by_earth_rate: Matrix<T, 3, 2>,
}

/// Predicts the measurements of segments, linearized about one set of errors.
#[derive(Clone, Debug)]
pub struct MeasurementModel<T: Real> {
    pub(super) errors: InstrumentErrors<T>,
    pub(super) force_b: Vector3<T>,
    pub(super) earth_rate_b: Vector3<T>,
    /// Column k is the axis about which a change of roll, pitch or heading turns a vector that is fixed in n, seen in
    /// b.
    pub(super) attitude_axes_b: Matrix3<T>,
    /// North and up as unit vectors in b.
    pub(super) earth_axes_b: Matrix<T, 3, 2>,
    pub(super) rot_sr: Matrix3<T>,
    pub(super) mounting_jacobian: Matrix3<T>,
    pub(super) rot_inner_axis: Matrix3<T>,
    pub(super) rot_as: Matrix3<T>,
    pub(super) rot_gs: Matrix3<T>,
}

impl<T: Real> MeasurementModel<T> {
    /// A model that is linearized about `errors`.
    pub fn new(errors: &InstrumentErrors<T>, site: &Site) -> Self {
        let rot_bn = errors.rot_nb().transpose();
        let rot_br = exp_so3(&Vector3::new(-errors.base_roll, T::zero(), T::zero()));
        let up_n = Vector3::new(T::zero(), T::zero(), T::one());
        Self {
            errors: *errors,
            force_b: rot_bn * (up_n * real::<T>(site.gravity_m_s2())),
            earth_rate_b: rot_bn * Vector3::from(site.earth_rate_n().map(real)),
            attitude_axes_b: Matrix3::from_columns(&[
                Vector3::new(-T::one(), T::zero(), T::zero()),
                -rot_br.column(1).into_owned(),
                rot_bn * up_n,
            ]),
            earth_axes_b: rot_bn.fixed_columns::<2>(1).into_owned(),
            rot_sr: errors.rot_sr(),
            mounting_jacobian: left_jacobian_so3(&-Vector3::from(errors.mounting)),
            rot_inner_axis: errors.rot_inner_axis(),
            rot_as: inverse3(&errors.rot_sa()),
            rot_gs: inverse3(&errors.rot_sg()),
        }
    }

    pub(super) fn inner_axis(&self) -> Vector3<T> {
        self.rot_inner_axis.column(2).into_owned()
    }

    /// Transforms a motion from the rotation frame to the IMU frame, with its derivatives by mounting angles,
    /// non-perpendicularity, attitude and encoder errors. `fixed_b` is the vector fixed in n, specific force or Earth
    /// rate, in b.
    pub(super) fn felt(&self, motion: &Motion<T>, fixed_b: &Vector3<T>) -> Prediction<T> {
        let value = self.rot_sr * motion.in_r;
        let by_mounting = skew(&value) * self.mounting_jacobian;
        let mut by_parameters = Matrix::<T, 3, PARAMETERS>::zeros();
        by_parameters.fixed_columns_mut::<3>(block::MOUNTING).copy_from(&by_mounting);
        by_parameters.set_column(block::NON_PERPENDICULARITY, &(self.rot_sr * motion.by_non_perpendicularity));
        let by_attitude = self.rot_sr * motion.by_b * -skew(fixed_b) * self.attitude_axes_b;
        by_parameters.fixed_columns_mut::<3>(block::ATTITUDE).copy_from(&by_attitude);
        let mut prediction = Prediction {
            value,
            by_parameters,
            by_encoder_errors: motion.by_encoder_errors,
            by_geometry: motion.by_geometry,
            in_g: Vector3::zeros(),
            by_attitude_rate: Matrix3::zeros(),
            by_earth_rate: Matrix::zeros(),
        };
        transform(&mut prediction.by_encoder_errors, &self.rot_sr);
        transform(&mut prediction.by_geometry, &self.rot_sr);
        prediction
    }
}

/// Specific force, or the integral of the angular rate, in the rotation frame, with its derivatives.
pub(super) struct Motion<T: Real> {
    pub(super) in_r: Vector3<T>,
    /// Derivative by the vector fixed in n, specific force or Earth rate, in b.
    pub(super) by_b: Matrix3<T>,
    pub(super) by_non_perpendicularity: Vector3<T>,
    pub(super) by_encoder_errors: Matrix<T, 3, ENCODER_ERRORS>,
    pub(super) by_geometry: Matrix<T, 3, GEOMETRY>,
}

/// cos - 1 and sin of the angle and of its multiples 2, 3 and 4. With cos - 1 the harmonics of an encoder vanish at its
/// zero.
pub(super) fn harmonics<T: Real>(angle: Angle) -> [[T; 2]; 4] {
    let (sin, cos) = angle.sin_cos::<T>();
    multiples(sin, cos).map(|[cos, sin]| [cos - T::one(), sin])
}

/// Cosine and sine of an angle and of its multiples 2, 3 and 4.
pub(super) fn multiples<T: Real>(sin: T, cos: T) -> [[T; 2]; 4] {
    let mut last = [T::one(), T::zero()];
    [(); 4].map(|()| {
        let [c, s] = last;
        last = [c * cos - s * sin, s * cos + c * sin];
        last
    })
}

/// Multiplies every column by a matrix, in place: a second matrix of this size would need much stack.
fn transform<T: Real, const C: usize>(matrix: &mut Matrix<T, 3, C>, by: &Matrix3<T>) {
    for column in columns_mut(matrix) {
        *column = (by * Vector3::from(*column)).into();
    }
}

pub(super) fn unit<T: Real>(axis: usize) -> Vector3<T> {
    Vector3::from_fn(|row, _| if row == axis { T::one() } else { T::zero() })
}

/// Transforms a prediction from the IMU frame to the sensor outputs: non-orthogonality and scale factor, without bias.
pub(super) fn sensed<T: Real, const S: usize>(
    prediction: &mut Prediction<T>,
    rot_sensor_s: &Matrix3<T>,
    scale: &[T; 3],
    scale_block: usize,
    non_orthogonality: impl Fn(&Vector3<T>) -> (usize, Matrix<T, 3, S>),
) {
    let along = rot_sensor_s * prediction.value;
    let scaled = Matrix3::from_diagonal(&Vector3::from(scale.map(|k| T::one() + k)));
    let to_output = scaled * rot_sensor_s;
    let (first, matrix) = non_orthogonality(&along);
    prediction.value = scaled * along;
    transform(&mut prediction.by_parameters, &to_output);
    transform(&mut prediction.by_encoder_errors, &to_output);
    transform(&mut prediction.by_geometry, &to_output);
    prediction.by_parameters.fixed_columns_mut::<S>(first).copy_from(&(-to_output * matrix));
    prediction.by_parameters.fixed_columns_mut::<3>(scale_block).copy_from(&Matrix3::from_diagonal(&along));
}

pub(super) fn add_bias<T: Real>(prediction: &mut Prediction<T>, bias: &[T; 3], bias_block: usize, weight: T) {
    prediction.value += Vector3::from(*bias) * weight;
    prediction.by_parameters.fixed_columns_mut::<3>(bias_block).copy_from(&(Matrix3::identity() * weight));
}

#[cfg(test)]
pub(super) mod example {
    use super::*;
    use crate::base::linear::Vector;
    use crate::base::sample::RawSample;
    use crate::segment::{Segment, SegmentKind, Segmenter, Stillness};

    pub(in crate::model) fn errors() -> InstrumentErrors<f64> {
        let mut x = Vector::<f64, PARAMETERS>::from_fn(|row, _| if row % 2 == 0 { 3e-3 } else { -2e-3 });
        x[block::GYRO_BIAS] = 1e-5;
        x[block::ATTITUDE] = 0.1;
        x[block::ATTITUDE + 1] = -0.07;
        x[block::HEADING] = 2.0;
        InstrumentErrors::from_vector(&x)
    }

    pub(in crate::model) fn smooth(t: f64) -> f64 {
        let t = t.clamp(0.0, 1.0);
        t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
    }

    /// Angles of both axes at `time_s` after the start, rad. The axes turn at the same time, with a stop before and
    /// after.
    pub(in crate::model) fn angles(time_s: f64) -> (f64, f64) {
        (0.3 - 1.2 * smooth((time_s - 2.0) / 4.0), -0.5 + 0.9 * smooth((time_s - 2.5) / 3.0))
    }

    pub(in crate::model) fn segments() -> [Segment<f64>; 3] {
        segments_along(angles, 1000)
    }

    /// A stop, a move of both axes and a second stop, without noise.
    pub(in crate::model) fn segments_along(angles: fn(f64) -> (f64, f64), step_us: u64) -> [Segment<f64>; 3] {
        let mut segmenter = Segmenter::new();
        segmenter.restart(&Stillness::default());
        let mut found = std::vec::Vec::new();
        for step in 0..9_000_000 / step_us {
            let time_us = step * step_us;
            let (outer, inner) = angles(time_us as f64 * 1e-6);
            let (outer, inner) = (Angle::from_rad(outer), Angle::from_rad(inner));
            let sample = RawSample { time_us, outer, inner, ..RawSample::default() };
            found.extend(segmenter.step(&sample));
        }
        found.extend(segmenter.finish());
        found.try_into().expect("stop, move, stop")
    }

    /// Derivative of `predict` by each parameter, from central differences.
    pub(in crate::model) fn differences(
        predict: impl Fn(&InstrumentErrors<f64>) -> Vector3<f64>,
    ) -> Matrix<f64, 3, PARAMETERS> {
        let x = errors().to_vector();
        Matrix::from_columns(&core::array::from_fn::<_, PARAMETERS, _>(|column| {
            let at = |step: f64| {
                let mut x = x;
                x[column] += step;
                predict(&InstrumentErrors::from_vector(&x))
            };
            (at(1e-5) - at(-1e-5)) / 2e-5
        }))
    }

    #[test]
    fn segment_kinds_and_windows() {
        let [first, turn, last] = segments();
        assert_eq!([first.kind(), turn.kind(), last.kind()], [SegmentKind::Stop, SegmentKind::Move, SegmentKind::Stop]);
        assert_eq!(turn.start_us, first.start_us + first.duration_us);
        assert_eq!(last.start_us, turn.start_us + turn.duration_us);
        assert!((turn.turned.outer + 1.2).abs() < 1e-8 && (turn.turned.inner - 0.9).abs() < 1e-8);
    }
}
