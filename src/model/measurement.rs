//! What a segment should have measured, and how that depends on every parameter.
//!
//! A stop measures the mean specific force; a stop or a move measures the integral of angular rate:
//! ```text
//! f_a      = (I + diag ka) rot_sa^-1 rot_sr R f_b + ba,             R = rot_rr0(outer, inner)
//! int w_g  = (I + diag kg) rot_sg^-1 rot_sr [ V + A w_b ] + bg T,
//!            V = int R_inner [outer rate, 0, 0]^T + e_inner inner rate,   A = int R
//! f_b = rot_bn (0, 0, g),   w_b = rot_bn w_ie,   b = r0
//! ```
//! which is (4), (5), (10) and (12) of Bai et al., Sensors 2019, 19, 4005, exact and integrated. With R_inner = Q R_z Q^T,
//! Q the tilt of the inner axis by d, both integrals follow from the segment's sums for any d.
//!
//! The encoder error of a stop is the reading minus the true angle; over a move it passes linearly from the one stop's
//! to the next one's. Harmonics e(angle) are known along the move, and integrated:
//! ```text
//! V changes by - int R_z e_x de_outer + int e_z x R_z e_x e_inner(inner) d outer - e_inner de_inner
//! ```

use crate::base::angle::Angle;
use crate::base::linear::{Matrix, Matrix3, Real, Vector3, exp_so3, inverse3, left_jacobian_so3, real, skew};
use crate::base::site::Site;
use crate::model::error_model::{InstrumentErrors, PARAMETERS, block, frame_rotation_x, frame_rotation_z};
use crate::segment::{AngleIntegrals, GUARD_S, Segment, SegmentKind, Turned};

/// Encoder errors that a measurement may depend on: outer and inner at the stop before, outer and inner at this stop.
pub const ENCODER_ERRORS: usize = 4;

/// Harmonics of the encoder errors: cosine and sine of the outer, then of the inner angle, and the same of their doubles.
pub const HARMONICS: usize = 8;

/// A predicted measurement and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction<T: Real> {
    /// Predicted value, (3).
    pub value: Vector3<T>,
    /// Derivative by the parameter vector, (3 x 28), SI.
    pub by_parameters: Matrix<T, 3, PARAMETERS>,
    /// Derivative by the encoder errors (3 x 4), per rad.
    pub by_encoder_errors: Matrix<T, 3, ENCODER_ERRORS>,
    /// Derivative by the harmonics of the encoder errors (3 x 8), per rad.
    pub by_harmonics: Matrix<T, 3, HARMONICS>,
    /// Derivative by the rates of roll, pitch and heading at which the base turns, s; nothing for accelerometers.
    pub by_attitude_rate: Matrix3<T>,
    /// Derivative by the Earth rate, north and up, s; nothing for accelerometers.
    pub by_earth_rate: Matrix<T, 3, 2>,
}

/// Predicts what segments measure, linearized about one set of errors.
#[derive(Clone, Debug)]
pub struct MeasurementModel<T: Real> {
    errors: InstrumentErrors<T>,
    force_b: Vector3<T>,
    earth_rate_b: Vector3<T>,
    /// Column k: axis about which parameter k of roll, pitch, heading turns a fixed vector as seen in b.
    attitude_axes_b: Matrix3<T>,
    /// North and up in b.
    earth_axes_b: Matrix<T, 3, 2>,
    rot_sr: Matrix3<T>,
    mounting_jacobian: Matrix3<T>,
    rot_inner_axis: Matrix3<T>,
    rot_as: Matrix3<T>,
    rot_gs: Matrix3<T>,
}

impl<T: Real> MeasurementModel<T> {
    /// Linearizes about `errors`.
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

    /// Mean accelerometer output at a stop. (4), (10) Not inlined, as the next: what it needs on the stack is free again
    /// for the filter.
    #[inline(never)]
    pub fn force_at_stop(&self, stop: &Segment<T>) -> Prediction<T> {
        let rot_inner = self.rot_inner_axis * frame_rotation_z(stop.inner) * self.rot_inner_axis.transpose();
        let rot_outer = frame_rotation_x(stop.outer);
        let after_outer = rot_outer * self.force_b;
        let force_r = rot_inner * after_outer;
        let y = unit::<T>(1);
        let by_outer = rot_inner * unit::<T>(0).cross(&after_outer);
        let by_inner = self.inner_axis().cross(&force_r);
        let motion = Motion {
            in_r: force_r,
            by_b: rot_inner * rot_outer,
            by_non_perpendicularity: y.cross(&force_r) - rot_inner * y.cross(&after_outer),
            by_encoder_errors: Matrix::from_columns(&[Vector3::zeros(), Vector3::zeros(), by_outer, by_inner]),
            by_harmonics: in_order(
                harmonics::<T>(stop.outer).map(|harmonic| by_outer * harmonic),
                harmonics::<T>(stop.inner).map(|harmonic| by_inner * harmonic),
            ),
        };
        let mut prediction = self.felt(&motion, &self.force_b);
        sensed(&mut prediction, &self.rot_as, &self.errors.accel_scale, block::ACCEL_SCALE, |force_a| {
            (block::ACCEL_NON_ORTHOGONALITY, accel_non_orthogonality_matrix(force_a))
        });
        add_bias(&mut prediction, &self.errors.accel_bias_a, block::ACCEL_BIAS, T::one());
        prediction
    }

    /// Integral of the gyro outputs over a segment. (5), (12)
    #[inline(never)]
    pub fn rotation(&self, segment: &Segment<T>) -> Prediction<T> {
        let integrals = segment.integrals();
        let tilt = &self.rot_inner_axis;
        let untilt = tilt.transpose();
        let axes = GimbalAxes::new(tilt, segment, &integrals);
        let y = skew(&unit::<T>(1));
        let attitude = tilt * attitude_integral(&integrals, &untilt);
        let attitude_by_tilt = y * attitude - tilt * attitude_integral(&integrals, &(untilt * y));
        let turned = axes.outer_integral + axes.inner * segment.turned.inner;
        let turned_by_tilt = y * turned + tilt * axes.outer_sums * untilt.column(2);
        let motion = Motion {
            in_r: turned + attitude * self.earth_rate_b,
            by_b: attitude,
            by_non_perpendicularity: turned_by_tilt + attitude_by_tilt * self.earth_rate_b,
            by_encoder_errors: axes.by_encoder_errors(),
            by_harmonics: axes.by_harmonics(tilt, segment, &integrals),
        };
        let mut prediction = self.felt(&motion, &self.earth_rate_b);
        sensed(&mut prediction, &self.rot_gs, &self.errors.gyro_scale, block::GYRO_SCALE, |omega_g| {
            (block::GYRO_NON_ORTHOGONALITY, gyro_non_orthogonality_matrix(omega_g))
        });
        add_bias(&mut prediction, &self.errors.gyro_bias_g, block::GYRO_BIAS, segment.duration_s());
        // The base turns against what a fixed vector seems to do in b.
        let scaled = Matrix3::from_diagonal(&Vector3::from(self.errors.gyro_scale.map(|k| T::one() + k)));
        let by_rate = scaled * self.rot_gs * self.rot_sr * attitude;
        prediction.by_attitude_rate = by_rate * -self.attitude_axes_b;
        prediction.by_earth_rate = by_rate * self.earth_axes_b;
        prediction
    }

    /// The outer and the inner axis in the IMU frame, where the inner angle is this.
    pub fn axes_at(&self, inner: Angle) -> [Vector3<T>; 2] {
        let tilt = &self.rot_inner_axis;
        let outer = tilt * frame_rotation_z(inner) * tilt.transpose().column(0);
        [outer, self.inner_axis()].map(|axis| self.rot_sr * axis)
    }

    fn inner_axis(&self) -> Vector3<T> {
        self.rot_inner_axis.column(2).into_owned()
    }

    /// What the IMU frame feels of a motion given in the rotation frame, with the derivatives by mounting angles,
    /// non-perpendicularity, attitude and encoder errors. `fixed_b` is the vector in b that does not turn.
    fn felt(&self, motion: &Motion<T>, fixed_b: &Vector3<T>) -> Prediction<T> {
        let value = self.rot_sr * motion.in_r;
        let by_mounting = skew(&value) * self.mounting_jacobian;
        let mut by_parameters = Matrix::<T, 3, PARAMETERS>::zeros();
        by_parameters.fixed_columns_mut::<3>(block::MOUNTING).copy_from(&by_mounting);
        by_parameters.set_column(block::NON_PERPENDICULARITY, &(self.rot_sr * motion.by_non_perpendicularity));
        let by_attitude = self.rot_sr * motion.by_b * -skew(fixed_b) * self.attitude_axes_b;
        by_parameters.fixed_columns_mut::<3>(block::ATTITUDE).copy_from(&by_attitude);
        Prediction {
            value,
            by_parameters,
            by_encoder_errors: self.rot_sr * motion.by_encoder_errors,
            by_harmonics: self.rot_sr * motion.by_harmonics,
            by_attitude_rate: Matrix3::zeros(),
            by_earth_rate: Matrix::zeros(),
        }
    }
}

/// Time that the axes stand at either end of a move, s: the guard, and what its blocks are longer on average.
const STANDING_S: f64 = GUARD_S + 0.025;

/// A vector or an integral of one, in the rotation frame.
struct Motion<T: Real> {
    in_r: Vector3<T>,
    /// It depends by this matrix on the vector in b that does not turn.
    by_b: Matrix3<T>,
    by_non_perpendicularity: Vector3<T>,
    by_encoder_errors: Matrix<T, 3, ENCODER_ERRORS>,
    by_harmonics: Matrix<T, 3, HARMONICS>,
}

/// The gimbal axes in the rotation frame over one segment.
struct GimbalAxes<T: Real> {
    /// Integral of R_z over the outer angle, rad.
    outer_sums: Matrix3<T>,
    /// Integral of the outer axis over the outer angle, rad.
    outer_integral: Vector3<T>,
    /// The same, weighted with the part of the move's time that has passed.
    outer_late: Vector3<T>,
    /// Mean of the outer axis over the time of the move.
    outer_mean: Vector3<T>,
    inner: Vector3<T>,
}

impl<T: Real> GimbalAxes<T> {
    fn new(tilt: &Matrix3<T>, segment: &Segment<T>, integrals: &AngleIntegrals<T>) -> Self {
        let turned = &segment.turned;
        let [_, [cos_s, _, _], [sin_s, _, _]] = integrals.attitude_s.map(|row| row.map(|sum_s| real(sum_s.into())));
        let outer_sums = rotation_z_integral(turned.outer_cos_inner, turned.outer_sin_inner, turned.outer);
        let outer_untilted = tilt.transpose().column(0).into_owned();
        // What stands still at both ends of a move is no part of it.
        let duration_s = segment.duration_s();
        let standing_s: T = if segment.kind() == SegmentKind::Move { real(STANDING_S) } else { T::zero() };
        let move_s = (duration_s - standing_s - standing_s).max(standing_s);
        let (sin_to, cos_to): (T, T) = segment.inner.sin_cos();
        let (sin_from, cos_from): (T, T) = segment.inner_from().sin_cos();
        let ends = rotation_z_integral(cos_from + cos_to, sin_from + sin_to, T::one() + T::one()) * standing_s;
        let mean = (rotation_z_integral(cos_s, sin_s, duration_s) - ends) / move_s;
        let late = |late_s: T, sum: T| (late_s - sum * standing_s) / move_s;
        let outer_late = rotation_z_integral(
            late(integrals.late_cos_inner_s, turned.outer_cos_inner),
            late(integrals.late_sin_inner_s, turned.outer_sin_inner),
            turned.outer * real(0.5),
        );
        Self {
            outer_sums,
            outer_integral: tilt * outer_sums * outer_untilted,
            outer_late: tilt * outer_late * outer_untilted,
            outer_mean: tilt * mean * outer_untilted,
            inner: tilt.column(2).into_owned(),
        }
    }

    /// An encoder's error goes from that of one stop to that of the next in proportion to time. Along its axis it counts
    /// where it changes; across, an inner error turns the outer axis, while that turns.
    fn by_encoder_errors(&self) -> Matrix<T, 3, ENCODER_ERRORS> {
        let late = self.inner.cross(&self.outer_late);
        let early = self.inner.cross(&self.outer_integral) - late;
        Matrix::from_columns(&[self.outer_mean, self.inner + early, -self.outer_mean, late - self.inner])
    }

    /// Of the harmonics, from their integrals and, along the inner axis, from its angles at the ends.
    fn by_harmonics(
        &self,
        tilt: &Matrix3<T>,
        segment: &Segment<T>,
        integrals: &AngleIntegrals<T>,
    ) -> Matrix<T, 3, HARMONICS> {
        let along_outer = |[cos, sin]: [f64; 2]| tilt * Vector3::new(real(cos), real(-sin), T::zero());
        let across = |[cos, sin]: [f64; 2]| tilt * Vector3::new(real(sin), real(cos), T::zero());
        let (before, after) = (harmonics::<T>(segment.inner_from()), harmonics::<T>(segment.inner));
        let mut changes = before.into_iter().zip(after).map(|(before, after)| self.inner * (before - after));
        let mut along_inner = || changes.next().unwrap_or_else(Vector3::zeros);
        in_order(
            outer_harmonics(integrals).map(along_outer),
            inner_harmonics(&segment.turned, integrals).map(|along_way| across(along_way) + along_inner()),
        )
    }
}

/// Integrals of (cos, sin)(inner) over the error of an outer harmonic, of each, negative.
fn outer_harmonics<T>(integrals: &AngleIntegrals<T>) -> [[f64; 2]; HARMONICS / 2] {
    let [by_cos, by_sin] = integrals.harmonics.outer.map(|row| row.map(f64::from));
    let of = |[cos, sin, cos_double, sin_double]: [f64; 4]| [sin, -cos, 2.0 * sin_double, -2.0 * cos_double];
    let [a, b, c, d] = of(by_cos);
    let [e, f, g, h] = of(by_sin);
    [[a, e], [b, f], [c, g], [d, h]]
}

/// Integrals of (cos, sin)(inner) times an inner harmonic over the outer angle, of each.
fn inner_harmonics<T: Real>(turned: &Turned<T>, integrals: &AngleIntegrals<T>) -> [[f64; 2]; HARMONICS / 2] {
    let [one, cos, sin] = [turned.outer, turned.outer_cos_inner, turned.outer_sin_inner].map(Real::widened);
    let [cos_2, sin_2, cos_3, sin_3] = integrals.harmonics.inner.map(f64::from);
    [
        [0.5 * (one + cos_2) - cos, 0.5 * sin_2 - sin],
        [0.5 * sin_2, 0.5 * (one - cos_2)],
        [0.5 * (cos_3 + cos) - cos, 0.5 * (sin_3 - sin) - sin],
        [0.5 * (sin_3 + sin), 0.5 * (cos - cos_3)],
    ]
}

/// cos - 1 and sin of the angle and of its double: an encoder's error vanishes at its zero.
fn harmonics<T: Real>(angle: Angle) -> [T; HARMONICS / 2] {
    let (sin, cos) = angle.sin_cos::<T>();
    let two: T = real(2.0);
    [cos - T::one(), sin, -(two * sin * sin), two * sin * cos]
}

/// Derivatives by the harmonics of the outer and of the inner encoder, in the order of all.
fn in_order<T: Real>(outer: [Vector3<T>; 4], inner: [Vector3<T>; 4]) -> Matrix<T, 3, HARMONICS> {
    let [[a, b, c, d], [e, f, g, h]] = [outer, inner];
    Matrix::from_columns(&[a, b, e, f, c, d, g, h])
}

fn unit<T: Real>(axis: usize) -> Vector3<T> {
    Vector3::from_fn(|row, _| if row == axis { T::one() } else { T::zero() })
}

/// Integral of `R_z` from those of cosine, sine and 1.
fn rotation_z_integral<T: Real>(cos: T, sin: T, one: T) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(cos, sin, zero, -sin, cos, zero, zero, zero, one)
}

/// Integral of `R_z(inner) middle R_x(outer)` over time, s.
fn attitude_integral<T: Real>(integrals: &AngleIntegrals<T>, middle: &Matrix3<T>) -> Matrix3<T> {
    let (zero, one) = (T::zero(), T::one());
    // R_z = [1, cos, sin] . inner parts, R_x = [1, cos, sin] . outer parts
    let inner_parts = [
        rotation_z_integral(zero, zero, one),
        rotation_z_integral(one, zero, zero),
        rotation_z_integral(zero, one, zero),
    ];
    let outer_parts = [
        Matrix3::from_diagonal(&Vector3::new(one, zero, zero)),
        Matrix3::from_diagonal(&Vector3::new(zero, one, one)),
        Matrix3::new(zero, zero, zero, zero, zero, one, zero, -one, zero),
    ];
    let mut integral = Matrix3::zeros();
    for (inner, row) in inner_parts.iter().zip(&integrals.attitude_s) {
        let mut weighted = Matrix3::zeros();
        for (outer, weight) in outer_parts.iter().zip(row) {
            weighted += outer * real::<T>((*weight).into());
        }
        integral += inner * middle * weighted;
    }
    integral
}

/// `F(f)` of (11): `(rot_sa - I) f = F(f) (Sayz, Sazx, Sazy)`.
pub fn accel_non_orthogonality_matrix<T: Real>(f: &Vector3<T>) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(zero, zero, zero, f.x, zero, zero, zero, f.y, -f.x)
}

/// `G(w)` of (13): `(rot_sg - I) w = G(w) (Sgxy, Sgxz, Sgyx, Sgyz, Sgzx, Sgzy)`.
pub fn gyro_non_orthogonality_matrix<T: Real>(w: &Vector3<T>) -> Matrix<T, 3, 6> {
    let zero = T::zero();
    Matrix::from_columns(&[
        Vector3::new(w.z, zero, zero),
        Vector3::new(-w.y, zero, zero),
        Vector3::new(zero, -w.z, zero),
        Vector3::new(zero, w.x, zero),
        Vector3::new(zero, zero, w.y),
        Vector3::new(zero, zero, -w.x),
    ])
}

/// From what the IMU frame feels to what the sensors read, without bias: non-orthogonality and scale factor.
fn sensed<T: Real, const S: usize>(
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
    prediction.by_parameters = to_output * prediction.by_parameters;
    prediction.by_encoder_errors = to_output * prediction.by_encoder_errors;
    prediction.by_harmonics = to_output * prediction.by_harmonics;
    prediction.by_parameters.fixed_columns_mut::<S>(first).copy_from(&(-to_output * matrix));
    prediction.by_parameters.fixed_columns_mut::<3>(scale_block).copy_from(&Matrix3::from_diagonal(&along));
}

fn add_bias<T: Real>(prediction: &mut Prediction<T>, bias: &[T; 3], bias_block: usize, weight: T) {
    prediction.value += Vector3::from(*bias) * weight;
    prediction.by_parameters.fixed_columns_mut::<3>(bias_block).copy_from(&(Matrix3::identity() * weight));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::Vector;
    use crate::base::sample::RawSample;
    use crate::segment::{SegmentKind, Segmenter, Stillness};

    fn errors() -> InstrumentErrors<f64> {
        let mut x = Vector::<f64, PARAMETERS>::from_fn(|row, _| if row % 2 == 0 { 3e-3 } else { -2e-3 });
        x[block::GYRO_BIAS] = 1e-5;
        x[block::ATTITUDE] = 0.1;
        x[block::ATTITUDE + 1] = -0.07;
        x[block::ATTITUDE + 2] = 2.0;
        InstrumentErrors::from_vector(&x)
    }

    fn smooth(t: f64) -> f64 {
        let t = t.clamp(0.0, 1.0);
        t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
    }

    /// Angles of both axes turning at once, with stops at both ends, s after the start.
    fn angles(time_s: f64) -> (f64, f64) {
        (0.3 - 1.2 * smooth((time_s - 2.0) / 4.0), -0.5 + 0.9 * smooth((time_s - 2.5) / 3.0))
    }

    fn segments() -> [Segment<f64>; 3] {
        segments_along(angles, 1000)
    }

    /// A stop, a move of both axes and a stop, without noise.
    fn segments_along(angles: fn(f64) -> (f64, f64), step_us: u64) -> [Segment<f64>; 3] {
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

    /// Derivative of `predict` by each parameter through central differences.
    fn differences(predict: impl Fn(&InstrumentErrors<f64>) -> Vector3<f64>) -> Matrix<f64, 3, PARAMETERS> {
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

    #[test]
    fn force_derivatives_match_differences() {
        let [stop, ..] = segments();
        let site = Site::default();
        let predict = |errors: &InstrumentErrors<f64>| MeasurementModel::new(errors, &site).force_at_stop(&stop);
        let found = (predict(&errors()).by_parameters - differences(|e| predict(e).value)).abs().max();
        assert!(found < 1e-7, "{found}");
    }

    #[test]
    fn rotation_derivatives_match_differences() {
        let [_, turn, _] = segments();
        let site = Site::default();
        let predict = |errors: &InstrumentErrors<f64>| MeasurementModel::new(errors, &site).rotation(&turn);
        let found = (predict(&errors()).by_parameters - differences(|e| predict(e).value)).abs().max();
        assert!(found < 1e-9, "{found}");
    }

    /// The integral of (12), summed sample by sample.
    fn rotation_by_steps(
        errors: &InstrumentErrors<f64>,
        site: &Site,
        turn: &Segment<f64>,
        angles: impl Fn(f64) -> (f64, f64),
    ) -> Vector3<f64> {
        const STEPS: u32 = 200_000;
        let (start_s, duration_s) = (turn.start_us as f64 * 1e-6, turn.duration_us as f64 * 1e-6);
        let step_s = duration_s / f64::from(STEPS);
        let axis_r = errors.rot_inner_axis() * Vector3::z();
        let earth_rate_b = errors.rot_nb().transpose() * Vector3::from(site.earth_rate_n());
        let mut sum_s = Vector3::zeros();
        for step in 0..STEPS {
            let time_s = start_s + f64::from(step) * step_s;
            let (from, to) = (angles(time_s), angles(time_s + step_s));
            let (outer, inner) = (0.5 * (from.0 + to.0), 0.5 * (from.1 + to.1));
            let rot_inner = exp_so3(&(axis_r * -inner));
            let rot_rr0 = rot_inner * exp_so3(&(Vector3::x() * -outer));
            let earth = rot_rr0 * earth_rate_b * step_s;
            sum_s += errors.rot_sr() * (rot_inner * Vector3::x() * (to.0 - from.0) + axis_r * (to.1 - from.1) + earth);
        }
        let rate_s = sum_s / duration_s;
        errors.corrupt(&Vector3::zeros(), &rate_s).1 * duration_s
    }

    #[test]
    fn equation_12_integrates_exactly_with_both_axes_turning() {
        let [_, turn, _] = segments();
        let (errors, site) = (errors(), Site::default());
        let difference = MeasurementModel::new(&errors, &site).rotation(&turn).value
            - rotation_by_steps(&errors, &site, &turn, angles);
        // What is left is the change of rate within the segment's steps of 1 ms: acceleration * step^2 / 12 per radian.
        assert!(difference.norm() < 1e-8, "{difference}");
    }

    /// The outer axis is there long before the inner one, which starts with it.
    fn early(time_s: f64) -> (f64, f64) {
        (-1.2 * smooth((time_s - 2.0) / 1.5), 0.9 * smooth((time_s - 2.0) / 4.0))
    }

    #[test]
    fn axes_may_turn_at_unequal_rates_between_few_samples() {
        let [_, turn, _] = segments_along(early, 10_000);
        let (errors, site) = (errors(), Site::default());
        let difference = MeasurementModel::new(&errors, &site).rotation(&turn).value
            - rotation_by_steps(&errors, &site, &turn, early);
        // 86 deg/s at 100 Hz. Without what the accelerations add it would be 6e-6, 1.2 arcsec.
        assert!(difference.norm() < 5e-8, "{difference}");
    }

    #[test]
    fn encoder_errors_of_a_move_match_differences() {
        let [_, turn, _] = segments_along(early, 1000);
        let (errors, site) = (errors(), Site::default());
        let by = MeasurementModel::new(&errors, &site).rotation(&turn).by_encoder_errors;
        let exact = rotation_by_steps(&errors, &site, &turn, early);
        for column in 0..ENCODER_ERRORS {
            // An error that goes, over the move, from one stop's to the other's; the true angle is the reading less it.
            let with = rotation_by_steps(&errors, &site, &turn, |time_s| {
                let (outer, inner) = early(time_s);
                let part = ((time_s - 2.0) / 4.0).clamp(0.0, 1.0);
                let error = 1e-5 * if column < 2 { 1.0 - part } else { part };
                if column % 2 == 0 { (outer - error, inner) } else { (outer, inner - error) }
            });
            // The ends of the move are known to half a block of 0.1 s.
            let found = ((with - exact) / 1e-5 - by.column(column)).norm();
            assert!(found < 0.05, "{column}: {found}");
        }
    }

    #[test]
    fn harmonics_of_a_move_match_differences() {
        let [stop, turn, _] = segments_along(early, 1000);
        let (errors, site) = (errors(), Site::default());
        let by = MeasurementModel::new(&errors, &site).rotation(&turn).by_harmonics;
        let exact = rotation_by_steps(&errors, &site, &turn, early);
        assert_eq!((stop.outer, stop.inner), (Angle::default(), Angle::default()));
        for column in 0..HARMONICS {
            let error = |angle: f64| {
                let multiple = if column < HARMONICS / 2 { angle } else { 2.0 * angle };
                1e-5 * if column % 2 == 0 { multiple.cos() - 1.0 } else { multiple.sin() }
            };
            let with = rotation_by_steps(&errors, &site, &turn, |time_s| {
                let (outer, inner) = early(time_s);
                if column % 4 < 2 { (outer - error(outer), inner) } else { (outer, inner - error(inner)) }
            });
            let found = ((with - exact) / 1e-5 - by.column(column)).norm();
            // The tilt of the inner axis, 3e-3 here, is carried in part only; the double angle's error changes twice as fast.
            assert!(found < 1e-2, "{column}: {found}");
        }
    }

    #[test]
    fn encoder_errors_of_a_stop_match_differences() {
        let [stop, ..] = segments();
        let model = MeasurementModel::new(&errors(), &Site::default());
        let by = model.force_at_stop(&stop).by_encoder_errors;
        // An encoder error e means a true angle of reading - e.
        let at = |outer: f64, inner: f64| {
            let turned = |angle: Angle, by: f64| Angle::from_rad(angle.rad::<f64>() - by);
            let stop = Segment { outer: turned(stop.outer, outer), inner: turned(stop.inner, inner), ..stop };
            model.force_at_stop(&stop).value
        };
        let outer = (at(1e-3, 0.0) - at(-1e-3, 0.0)) / 2e-3;
        let inner = (at(0.0, 1e-3) - at(0.0, -1e-3)) / 2e-3;
        assert!((by.column(2) - outer).norm() < 1e-4 && (by.column(3) - inner).norm() < 1e-4);
        assert_eq!(by.columns(0, 2).norm(), 0.0);
    }
}
