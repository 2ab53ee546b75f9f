//! The gyros over a move or a stop: the predicted integral of their outputs (M7), and its derivatives by all
//! parameters.

use super::error_model::{block, frame_rotation_z};
use super::measurement::{
    BACKLASH, ENCODER_ERRORS, GEOMETRY, HARMONICS, MeasurementModel, Motion, Prediction, add_bias, harmonics, sensed,
    unit,
};
use crate::base::angle::{Angle, rad_to_ticks};
use crate::base::linear::{Matrix, Matrix3, Real, Vector3, columns_mut, real, skew};
use crate::segment::{AngleIntegrals, GUARD_S, Segment, SegmentKind, Turned};

impl<T: Real> MeasurementModel<T> {
    /// Integral of the gyro outputs over a segment, rad. (M7)
    // Not inlined, so that its stack is free again before the filter runs.
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
            by_geometry: axes.by_geometry(tilt, segment, &integrals),
        };
        let mut prediction = self.felt(&motion, &self.earth_rate_b);
        sensed(&mut prediction, &self.rot_gs, &self.errors.gyro_scale, block::GYRO_SCALE, |omega_g| {
            (block::GYRO_NON_ORTHOGONALITY, gyro_non_orthogonality_matrix(omega_g))
        });
        add_bias(&mut prediction, &self.errors.gyro_bias_g, block::GYRO_BIAS, segment.duration_s());
        // When the base turns, a vector fixed in n turns the opposite way in b.
        let scaled = Matrix3::from_diagonal(&Vector3::from(self.errors.gyro_scale.map(|k| T::one() + k)));
        let by_rate = scaled * self.rot_gs * self.rot_sr * attitude;
        prediction.in_g = by_rate * self.force_b / self.force_b.norm();
        prediction.by_attitude_rate = by_rate * -self.attitude_axes_b;
        prediction.by_earth_rate = by_rate * self.earth_axes_b;
        prediction
    }

    /// The outer and the inner axis in the IMU frame at this inner angle.
    pub fn axes_at(&self, inner: Angle) -> [Vector3<T>; 2] {
        let tilt = &self.rot_inner_axis;
        let outer = tilt * frame_rotation_z(inner) * tilt.transpose().column(0);
        [outer, self.inner_axis()].map(|axis| self.rot_sr * axis)
    }
}

/// Time at rest at either end of a move, s: the guard time plus the mean excess of its last block.
const AT_REST_S: f64 = GUARD_S + 0.025;

/// The gimbal axes in the rotation frame over one segment.
struct GimbalAxes<T: Real> {
    /// Integral of `R_z` over the outer angle, rad.
    outer_sums: Matrix3<T>,
    /// Integral of the outer axis over the outer angle, rad.
    outer_integral: Vector3<T>,
    /// Integral of the outer axis over the outer angle, weighted with the elapsed fraction of the move's time, rad.
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
        // Remove the time at rest at both ends from the time of the move.
        let duration_s = segment.duration_s();
        let at_rest_s: T = if segment.kind() == SegmentKind::Move { real(AT_REST_S) } else { T::zero() };
        let move_s = (duration_s - at_rest_s - at_rest_s).max(at_rest_s);
        let (sin_to, cos_to): (T, T) = segment.inner.sin_cos();
        let (sin_from, cos_from): (T, T) = segment.inner_from().sin_cos();
        let ends = rotation_z_integral(cos_from + cos_to, sin_from + sin_to, T::one() + T::one()) * at_rest_s;
        let mean = (rotation_z_integral(cos_s, sin_s, duration_s) - ends) / move_s;
        let late = |late_s: T, sum: T| (late_s - sum * at_rest_s) / move_s;
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

    /// Derivatives by the encoder errors. Over the move an encoder error goes from that of one stop to that of the
    /// next stop in proportion to time. The change of an error acts along the encoder's own axis. An error of the
    /// inner encoder also acts across, because it changes the direction of the outer axis while the outer axis turns.
    fn by_encoder_errors(&self) -> Matrix<T, 3, ENCODER_ERRORS> {
        let late = self.inner.cross(&self.outer_late);
        let early = self.inner.cross(&self.outer_integral) - late;
        Matrix::from_columns(&[self.outer_mean, self.inner + early, -self.outer_mean, late - self.inner])
    }

    /// Derivatives by the effects of encoders and axes. Those by the first two harmonics follow from the integrals of
    /// the harmonics; along the inner axis they follow from the inner angles at both ends. The others follow from the
    /// way of the axes.
    // Not inlined, so that its stack is free again before the sensors' axes are taken into account.
    #[inline(never)]
    fn by_geometry(
        &self,
        tilt: &Matrix3<T>,
        segment: &Segment<T>,
        integrals: &AngleIntegrals<T>,
    ) -> Matrix<T, 3, GEOMETRY> {
        let along_outer = |[cos, sin]: [f64; 2]| tilt * Vector3::new(real(cos), real(-sin), T::zero());
        let across = |[cos, sin]: [f64; 2]| tilt * Vector3::new(real(sin), real(cos), T::zero());
        let (before, after) = (harmonics::<T>(segment.inner_from()), harmonics::<T>(segment.inner));
        let mut changes =
            before.into_iter().flatten().zip(after.into_iter().flatten()).map(|(from, to)| self.inner * (from - to));
        let mut along_inner = || changes.next().unwrap_or_else(Vector3::zeros);
        let [a, b, e, f] = outer_harmonics(integrals).map(along_outer);
        let [c, d, g, h] =
            inner_harmonics(&segment.turned, integrals).map(|along_way| across(along_way) + along_inner());
        let mut geometry = Matrix::<T, 3, GEOMETRY>::zeros();
        for (to, column) in columns_mut(&mut geometry).iter_mut().zip([a, b, c, d, e, f, g, h]) {
            *to = column.into();
        }
        add_along_way(&mut geometry, segment);
        geometry
    }
}

/// Number of steps along the way of a move. The error of the midpoint rule is 1 % over three quarters of a turn, of
/// effects of some tenths of an arcsec.
const STEPS: u32 = 12;

/// Adds the derivatives by the effects whose integrals are not measured, in r: harmonics 3 and 4, backlash, wobble and
/// sag, the columns behind the first [`HARMONICS`]. The teeth change sides at the start of the move, so the derivatives
/// by the backlash are the axes at the start. While both axes turn, they are taken to turn equally far until the shorter
/// way ends, as they do at one rate.
fn add_along_way<T: Real>(geometry: &mut Matrix<T, 3, GEOMETRY>, segment: &Segment<T>) {
    let ways = [segment.turned.outer, segment.turned.inner];
    if segment.kind() == SegmentKind::Stop {
        return;
    }
    let longest = ways[0].abs().max(ways[1].abs());
    let starts = [segment.outer_from(), segment.inner_from()];
    let at = |part: T| {
        let gone = |way: T| way.abs().min(longest * part) * way.signum();
        [gone(ways[0]), gone(ways[1])]
    };
    let angles = |gone: [T; 2]| {
        let mut both = starts.iter().zip(gone).map(|(from, gone)| from.turned(rad_to_ticks(gone.widened()) as i32));
        [both.next().unwrap_or_default(), both.next().unwrap_or_default()]
    };
    let step = real::<T>(f64::from(STEPS)).recip();
    let mut before = at(T::zero());
    let mut harmonics_before = angles(before).map(harmonics::<T>);
    for number in 0..STEPS {
        let after = at(real::<T>(f64::from(number) + 1.0) * step);
        let harmonics_after = angles(after).map(harmonics::<T>);
        let [outer, inner] = angles(at(real::<T>(f64::from(number) + 0.5) * step));
        let [turned_outer, turned_inner] = [after[0] - before[0], after[1] - before[1]];
        let ((so, co), (si, ci)): ((T, T), (T, T)) = (outer.sin_cos(), inner.sin_cos());
        let outer_axis = Vector3::new(ci, -si, T::zero());
        let across = Vector3::new(si, ci, T::zero());
        let along = Vector3::new(T::zero(), T::zero(), T::one());
        // R_z (0, y, z), for vectors of the outer gimbal.
        let rotated = |y: T, z: T| across * y + along * z;
        let inner_now = harmonics::<T>(inner);
        let [outer_before, inner_before] = &harmonics_before;
        let [outer_after, inner_after] = &harmonics_after;
        let mut places = columns_mut(geometry).iter_mut().skip(HARMONICS);
        let mut add = |value: Vector3<T>| {
            if let Some(place) = places.next() {
                *place = (Vector3::from(*place) + value).into();
            }
        };
        for n in [2, 3] {
            let change = |before: &[[T; 2]; 4], after: &[[T; 2]; 4]| {
                let of = |all: &[[T; 2]; 4]| all.get(n).copied().unwrap_or([T::zero(); 2]);
                let ([c, s], [to_c, to_s]) = (of(before), of(after));
                [to_c - c, to_s - s]
            };
            change(outer_before, outer_after).into_iter().for_each(|change| add(outer_axis * -change));
            let now = inner_now.get(n).copied().unwrap_or([T::zero(); 2]);
            let along_inner = change(inner_before, inner_after);
            for (now, change) in now.into_iter().zip(along_inner) {
                add(across * (now * turned_outer) - along * change);
            }
        }
        // The places of the backlash, which does not build up along the way.
        add(Vector3::zeros());
        add(Vector3::zeros());
        // What a tilt by a wave of the n-fold angle changes over the step, and the wave.
        let wave = |n: f64, turned: T, [cos_less_one, sin]: [T; 2]| {
            let by = real::<T>(n) * turned;
            ([-sin * by, (cos_less_one + T::one()) * by], [cos_less_one, sin])
        };
        let [once_outer, twice_outer, ..] = harmonics::<T>(outer);
        let [once_inner, twice_inner, ..] = inner_now;
        let once = [wave(1.0, turned_outer, once_outer), wave(1.0, turned_inner, once_inner)];
        let twice = [wave(2.0, turned_outer, twice_outer), wave(2.0, turned_inner, twice_inner)];
        // Of the outer axis about y, then about z: R_x e is (0, cos, -sin), then (0, sin, cos). Of the inner axis about x,
        // then about y, which also tilts the turning outer axis.
        let [about_y, about_z] = [rotated(co, -so), rotated(so, co)];
        let tilting = |by: T, now: T| across * by + along * (now * turned_outer);
        let wobble = |[([c, s], _), ([inner_c, inner_s], [now_c, now_s])]: [([T; 2], [T; 2]); 2]| {
            let of_outer = [about_y * c, about_y * s, about_z * c, about_z * s];
            let about_x = [outer_axis * inner_c, outer_axis * inner_s];
            of_outer.into_iter().chain(about_x).chain([tilting(inner_c, now_c), tilting(inner_s, now_s)])
        };
        // Sag of the inner axis about y, which also tilts it against the outer axis.
        let [([sag_c, sag_s], [now_c, now_s]), _] = once;
        let sag = [tilting(sag_c, now_c), tilting(sag_s, now_s)];
        wobble(once).chain(sag).chain(wobble(twice)).for_each(&mut add);
        (before, harmonics_before) = (after, harmonics_after);
    }
    let (sin, cos): (T, T) = segment.inner_from().sin_cos();
    let axes_at_start = [Vector3::new(cos, -sin, T::zero()), Vector3::new(T::zero(), T::zero(), T::one())];
    for (place, axis) in columns_mut(geometry).iter_mut().skip(BACKLASH).zip(axes_at_start) {
        *place = axis.into();
    }
}

/// Negative integrals of (cos, sin)(inner) over the error of each outer harmonic.
fn outer_harmonics<T>(integrals: &AngleIntegrals<T>) -> [[f64; 2]; HARMONICS / 2] {
    let [by_cos, by_sin] = integrals.harmonics.outer.map(|row| row.map(f64::from));
    let of = |[cos, sin, cos_double, sin_double]: [f64; 4]| [sin, -cos, 2.0 * sin_double, -2.0 * cos_double];
    let [a, b, c, d] = of(by_cos);
    let [e, f, g, h] = of(by_sin);
    [[a, e], [b, f], [c, g], [d, h]]
}

/// Integrals of (cos, sin)(inner) times each inner harmonic over the outer angle.
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

/// Integral of `R_z` from the integrals of cosine, sine and 1.
fn rotation_z_integral<T: Real>(cos: T, sin: T, one: T) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(cos, sin, zero, -sin, cos, zero, zero, zero, one)
}

/// Integral of `R_z(inner) middle R_x(outer)` over time, s.
pub fn attitude_integral<T: Real>(integrals: &AngleIntegrals<T>, middle: &Matrix3<T>) -> Matrix3<T> {
    let (zero, one) = (T::zero(), T::one());
    // R_z = [1, cos, sin](inner) . inner_parts,  R_x = [1, cos, sin](outer) . outer_parts
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

/// `G(w)` of (B13): `(rot_sg - I) w = G(w) (Sgxy, Sgxz, Sgyx, Sgyz, Sgzx, Sgzy)`.
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

#[cfg(test)]
mod tests {
    use super::super::error_model::InstrumentErrors;
    use super::super::measurement::example::{angles, differences, errors, segments, segments_along, smooth};
    use super::*;
    use crate::base::linear::exp_so3;
    use crate::base::profile::Profile;
    use crate::base::site::Site;

    #[test]
    fn rotation_derivatives_match_differences() {
        let [_, turn, _] = segments();
        let site = Site::default();
        let predict = |errors: &InstrumentErrors<f64>| MeasurementModel::new(errors, &site).rotation(&turn);
        let found = (predict(&errors()).by_parameters - differences(|e| predict(e).value)).abs().max();
        assert!(found < 1e-9, "{found}");
    }

    /// The integral of (M7), summed in small steps.
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
    fn equation_m7_integrates_exactly_with_both_axes_turning() {
        let [_, turn, _] = segments();
        let (errors, site) = (errors(), Site::default());
        let difference = MeasurementModel::new(&errors, &site).rotation(&turn).value
            - rotation_by_steps(&errors, &site, &turn, angles);
        // The change of rate within the segment's steps of 1 ms remains: acceleration * step^2 / 12 per radian.
        assert!(difference.norm() < 1e-8, "{difference}");
    }

    /// Both axes start together. The outer axis arrives long before the inner axis.
    fn early(time_s: f64) -> (f64, f64) {
        (-1.2 * smooth((time_s - 2.0) / 1.5), 0.9 * smooth((time_s - 2.0) / 4.0))
    }

    #[test]
    fn axes_may_turn_at_unequal_rates_between_few_samples() {
        let [_, turn, _] = segments_along(early, 10_000);
        let (errors, site) = (errors(), Site::default());
        let difference = MeasurementModel::new(&errors, &site).rotation(&turn).value
            - rotation_by_steps(&errors, &site, &turn, early);
        // 86 deg/s at 100 Hz. Without the terms of the accelerations the error would be 6e-6 rad, 1.2 arcsec.
        assert!(difference.norm() < 5e-8, "{difference}");
    }

    #[test]
    fn encoder_errors_of_a_move_match_differences() {
        let [_, turn, _] = segments_along(early, 1000);
        let (errors, site) = (errors(), Site::default());
        let by = MeasurementModel::new(&errors, &site).rotation(&turn).by_encoder_errors;
        let exact = rotation_by_steps(&errors, &site, &turn, early);
        for column in 0..ENCODER_ERRORS {
            // Over the move the error goes from that of one stop to that of the other. The true angle is the reading
            // minus the error.
            let with = rotation_by_steps(&errors, &site, &turn, |time_s| {
                let (outer, inner) = early(time_s);
                let part = ((time_s - 2.0) / 4.0).clamp(0.0, 1.0);
                let error = 1e-5 * if column < 2 { 1.0 - part } else { part };
                if column % 2 == 0 { (outer - error, inner) } else { (outer, inner - error) }
            });
            // The times of the ends of the move are known to half a block of 0.1 s.
            let found = ((with - exact) / 1e-5 - by.column(column)).norm();
            assert!(found < 0.05, "{column}: {found}");
        }
    }

    #[test]
    fn harmonics_of_a_move_match_differences() {
        let [stop, turn, _] = segments_along(early, 1000);
        let (errors, site) = (errors(), Site::default());
        let by = MeasurementModel::new(&errors, &site).rotation(&turn).by_geometry;
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
            // The tilt of the inner axis, 3e-3 rad here, is included in part only. The error with the double angle
            // changes twice as fast.
            assert!(found < 1e-2, "{column}: {found}");
        }
    }

    /// Attitude of the rotation frame at these angles with a small effect of encoders or axes, in the order of
    /// [`GEOMETRY`]: built from rotations, not from the derivatives.
    fn attitude_with(effect: usize, size: f64, [outer, inner]: [f64; 2]) -> Matrix3<f64> {
        let wave =
            |n: f64, is_sine: bool, angle: f64| if is_sine { (n * angle).sin() } else { (n * angle).cos() - 1.0 };
        let is_sine = effect % 2 == 1;
        let tilted = |axis: usize, by: f64| exp_so3(&(unit::<f64>(axis) * (-size * by)));
        let (mut read, mut base, mut gimbal) = ([outer, inner], Matrix3::identity(), Matrix3::identity());
        match effect {
            0..16 => {
                let axis = effect / 2 % 2;
                read[axis] -= size * wave((effect / 4 + 1) as f64, is_sine, read[axis]);
            }
            18..22 => base = tilted(1 + (effect - 18) / 2, wave(1.0, is_sine, outer)),
            22..26 => gimbal = tilted((effect - 22) / 2, wave(1.0, is_sine, inner)),
            26..28 => gimbal = tilted(1, wave(1.0, is_sine, outer)),
            28..32 => base = tilted(1 + (effect - 28) / 2, wave(2.0, is_sine, outer)),
            32.. => gimbal = tilted((effect - 32) / 2, wave(2.0, is_sine, inner)),
            _ => {}
        }
        exp_so3(&(unit::<f64>(2) * -read[1])) * gimbal * exp_so3(&(unit::<f64>(0) * -read[0])) * base
    }

    #[test]
    fn effects_of_encoders_and_axes_match_differences() {
        let ways = [2.1, -1.3];
        let path = |time_s: f64| {
            let at = |way| Profile::trapezoid(way, 0.7, 1.4).at((time_s - 2.0).max(0.0)).angle_rad;
            (0.4 + at(2.1), -0.7 + at(-1.3))
        };
        let segments = segments_along(path, 1000);
        let [first, turn, last] = &segments;
        let errors = InstrumentErrors::<f64> { base_roll: 0.1, base_pitch: -0.2, ..Default::default() };
        let model = MeasurementModel::new(&errors, &Site::default());
        let (by_rotation, by_force) = (model.rotation(turn).by_geometry, model.force_at_stop(last).by_geometry);
        // The rotation of the frame against the base, summed up in r over many steps.
        let turned = |effect, size| {
            let at = |step: u32| {
                let part = f64::from(step) / 40_000.0;
                let longest = ways[0] * part;
                let angles = [0.4 + longest, -0.7 - longest.min(-ways[1])];
                attitude_with(effect, size, angles)
            };
            (0..40_000).fold(Vector3::<f64>::zeros(), |sum, step| {
                let change = at(step + 1) * at(step).transpose();
                let odd = (change - change.transpose()) * -0.5;
                sum + Vector3::new(odd[(2, 1)], odd[(0, 2)], odd[(1, 0)])
            })
        };
        let force = |effect, size| attitude_with(effect, size, [last.outer.rad(), last.inner.rad()]) * model.force_b;
        const SIZE: f64 = 1e-4;
        for effect in (0..GEOMETRY).filter(|effect| !(16..18).contains(effect)) {
            let of_force = (force(effect, SIZE) - force(effect, -SIZE)) / (2.0 * SIZE);
            let found = by_force.column(effect);
            assert!((found - of_force).norm() < 1e-5, "force, {effect}: {found} for {of_force}");
            let of_turn = (turned(effect, SIZE) - turned(effect, -SIZE)) / (2.0 * SIZE);
            let found = by_rotation.column(effect);
            assert!((found - of_turn).norm() < 0.02, "rotation, {effect}: {found} for {of_turn}");
        }
        assert_eq!(by_force.columns(16, 2).norm() + model.rotation(first).by_geometry.columns(8, 28).norm(), 0.0);
    }
}
