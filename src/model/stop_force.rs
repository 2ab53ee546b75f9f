//! The accelerometers at a stop: the predicted mean output (M6), and its derivatives by all parameters.

use super::error_model::{block, frame_rotation_x, frame_rotation_z};
use super::measurement::{GEOMETRY, MeasurementModel, Motion, Prediction, add_bias, harmonics, sensed, unit};
use crate::base::linear::{Matrix, Matrix3, Real, Vector3, columns_mut};
use crate::segment::Segment;

impl<T: Real> MeasurementModel<T> {
    /// Mean accelerometer output at a stop, m/s^2. (M6)
    // Not inlined, so that its stack is free again before the filter runs.
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
            by_geometry: self.geometry_at_stop(stop, [&by_outer, &by_inner], [&rot_inner, &rot_outer]),
        };
        let mut prediction = self.felt(&motion, &self.force_b);
        sensed(&mut prediction, &self.rot_as, &self.errors.accel_scale, block::ACCEL_SCALE, |force_a| {
            (block::ACCEL_NON_ORTHOGONALITY, accel_non_orthogonality_matrix(force_a))
        });
        prediction.in_g = prediction.value / self.force_b.norm();
        add_bias(&mut prediction, &self.errors.accel_bias_a, block::ACCEL_BIAS, T::one());
        prediction
    }

    /// Derivatives of the force in r by the effects of encoders and axes.
    // Not inlined, so that its stack is free again before the sensors' axes are taken into account.
    #[inline(never)]
    fn geometry_at_stop(
        &self,
        stop: &Segment<T>,
        by_angles: [&Vector3<T>; 2],
        [rot_inner, rot_outer]: [&Matrix3<T>; 2],
    ) -> Matrix<T, 3, GEOMETRY> {
        let both = [harmonics::<T>(stop.outer), harmonics::<T>(stop.inner)];
        let force_r = rot_inner * rot_outer * self.force_b;
        let tilts = |axis: Vector3<T>, [cos, sin]: [T; 2]| {
            let by_tilt = force_r.cross(&axis);
            [by_tilt * cos, by_tilt * sin]
        };
        let rot = rot_inner * rot_outer;
        let [[o1, o2, o3, o4], [i1, i2, i3, i4]] = both;
        let wobble = |outer: [T; 2], inner: [T; 2]| {
            [
                tilts(rot * unit::<T>(1), outer),
                tilts(rot * unit::<T>(2), outer),
                tilts(rot_inner * unit::<T>(0), inner),
                tilts(rot_inner * unit::<T>(1), inner),
            ]
        };
        let sag = tilts(rot_inner * unit::<T>(1), o1);
        let tilted = wobble(o1, i1).into_iter().chain([sag]).chain(wobble(o2, i2));
        let by_outer = |[cos, sin]: [T; 2]| [by_angles[0] * cos, by_angles[0] * sin];
        let by_inner = |[cos, sin]: [T; 2]| [by_angles[1] * cos, by_angles[1] * sin];
        let encoders = [
            by_outer(o1),
            by_inner(i1),
            by_outer(o2),
            by_inner(i2),
            by_outer(o3),
            by_inner(i3),
            by_outer(o4),
            by_inner(i4),
            // The backlash.
            [Vector3::zeros(); 2],
        ];
        let mut geometry = Matrix::<T, 3, GEOMETRY>::zeros();
        let derivatives = encoders.into_iter().chain(tilted).flatten();
        for (to, column) in columns_mut(&mut geometry).iter_mut().zip(derivatives) {
            *to = column.into();
        }
        geometry
    }
}

/// `F(f)` of (B11): `(rot_sa - I) f = F(f) (Sayz, Sazx, Sazy)`.
pub fn accel_non_orthogonality_matrix<T: Real>(f: &Vector3<T>) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(zero, zero, zero, f.x, zero, zero, zero, f.y, -f.x)
}

#[cfg(test)]
mod tests {
    use super::super::error_model::InstrumentErrors;
    use super::super::measurement::example::{differences, errors, segments};
    use super::*;
    use crate::base::angle::Angle;
    use crate::base::site::Site;

    #[test]
    fn force_derivatives_match_differences() {
        let [stop, ..] = segments();
        let site = Site::default();
        let predict = |errors: &InstrumentErrors<f64>| MeasurementModel::new(errors, &site).force_at_stop(&stop);
        let found = (predict(&errors()).by_parameters - differences(|e| predict(e).value)).abs().max();
        assert!(found < 1e-7, "{found}");
    }

    #[test]
    fn encoder_errors_of_a_stop_match_differences() {
        let [stop, ..] = segments();
        let model = MeasurementModel::new(&errors(), &Site::default());
        let by = model.force_at_stop(&stop).by_encoder_errors;
        // With an encoder error e, the true angle is the reading minus e.
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
