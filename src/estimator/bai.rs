//! The method of the paper to the letter: Bai et al., Sensors 2019, 19(18), 4005, section 3. Twelve states, random
//! constants, two Kalman filters one after the other:
//! ```text
//! (B6)  X_k = X_k-1 + W                                                     X: the installation errors (12)
//! (B2)  rot_sr = I - [theta x]                                              first order, as in the paper
//! (B11) z1 = f_a0 - R^T f_a = H1 X                                          at the stops of period one
//!       H1 = [0(3x6) | R^T F(f_a) - F(f_a0) | [(R^T f_a) x](I - R^T)]
//! (B12) w_s = rot_sn w_ie + rot_sr w_r
//! (B13) z2 = w_g - rot_sn w_ie - rot_sr w_r = H2 X,   H2 = [-G(w_g) | 0(3x6)]    in the moves of period two
//! ```
//! R is `rot_rr0` of (M3), and f_a0 is the mean force at the first stop. The paper takes the angles as zero there, and R
//! as the unit matrix. The readings of the encoders at the first stop are used only if the scheme begins elsewhere. A
//! segment gives the sum of its samples in one measurement. That is exact: at a stop R is constant and (B11) is linear in
//! f_a, and over a move (B13) is linear in w_g, so its integral is
//! ```text
//! int z2 dt = int w_g dt - (I - [theta x]) [A w_b + V] = -G(int w_g dt) s_g         A, V as in (M7), with d = 0
//! ```
//! Stage 2 takes theta and the attitude from stage 1: f_a0 is corrected by the accelerometers' non-orthogonality,
//! turned to the rotation frame by theta, and levelled. The paper names no source of the heading. Here the heading
//! comes from gyrocompassing at the first stop, or from the configuration.
//!
//! With one period only, stops and moves are taken from this period. The sweeps of [`super::passes`] then go over the
//! segments again, so that stage 2 has the theta of all stops.
//!
//! # P0, Q and R
//! The numbers of the paper are lost in its published text. Here they are:
//! ```text
//! P0  sigma^2 I, sigma = 3 deg                                                    [`BaiTuning`](super::BaiTuning)
//! Q   0: the states are constants                                                 [`BaiTuning`](super::BaiTuning)
//! R   (B11): psd_a (1 / T + 1 / T0) + (|f_a0| sigma_e)^2 in each channel          [`Noise`](crate::segment::white_noise::Noise)
//!     (B13): psd_g T + 2 sigma_e^2 in each channel, for the integral
//! ```
//! T and T0 are the durations of the segment and of the first stop, psd the density of the sensors' white noise, and
//! sigma_e the encoder error of a stop. R is the same in all channels. The encoder errors of a stop tilt the force about
//! two axes that are at right angles, so that (|f_a0| sigma_e)^2 is the largest variance in any direction. A move has the
//! encoder errors of the stops at its two ends.
//!
//! As in the paper, the noise counts as white from measurement to measurement. In truth all (B11) share the first stop,
//! whose encoder error tilts f_a0 where a servo holds the reading at zero. Two successive (B13) share a stop, and theta is
//! not exact. So the sigmas of this method are not those of its errors.
//! The paper also takes biases, scale factors and the non-perpendicularity of the axes as zero.

use super::configuration::{BEFORE_PARAMETERS, STATES};
use super::filter::Measurement;
use super::joint::{Estimator, level_attitude, rounding_variance};
use crate::base::angle::{Angle, ticks_to_rad};
use crate::base::linear::{Matrix, Matrix3, Real, Vector, Vector3, real, skew};
use crate::base::units::{ARCSEC, DEG};
use crate::model::error_model::{INSTALLATION_STATES, InstrumentErrors, block};
use crate::model::rotation::{attitude_integral, gyro_non_orthogonality_matrix};
use crate::model::stop_force::accel_non_orthogonality_matrix;
use crate::segment::{Segment, SegmentKind, Standing};

/// The equation that a segment is used in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// (B11), with the force at a stop.
    One,
    /// (B13), with the rotation over a move.
    Two,
}

/// The equation for a segment after `moves_before` moves. `period_moves` is `None` if there is only one period.
fn stage(kind: SegmentKind, moves_before: u16, period_moves: Option<u16>) -> Option<Stage> {
    match kind {
        SegmentKind::Stop => period_moves.is_none_or(|period| moves_before <= period).then_some(Stage::One),
        SegmentKind::Move => period_moves.is_none_or(|period| moves_before >= period).then_some(Stage::Two),
    }
}

/// Number of moves in period one, if the angles of the stops repeat exactly once. `None` if they do not repeat.
pub(super) fn find_period<T: Real>(segments: &[Segment<T>]) -> Option<u16> {
    const SAME_RAD: f64 = DEG;
    let stops = || segments.iter().filter(|segment| segment.kind() == SegmentKind::Stop);
    let moves = stops().count().checked_sub(1)?;
    let half = moves / 2;
    let near = |a: &Segment<T>, b: &Segment<T>| {
        let apart = |ticks: i32| ticks_to_rad::<f64>(ticks.into()).abs();
        apart(a.outer.since(b.outer)) < SAME_RAD && apart(a.inner.since(b.inner)) < SAME_RAD
    };
    let repeats = moves > 0 && moves % 2 == 0 && stops().zip(stops().skip(half)).all(|(a, b)| near(a, b));
    repeats.then_some(half as u16)
}

/// A measurement that is linear in the twelve states: `z = h X + v`, with the variance `r` of v in each channel.
#[derive(Clone, Copy, Debug)]
struct Linear<T: Real> {
    z: Vector3<T>,
    h: Matrix<T, 3, INSTALLATION_STATES>,
    r: T,
}

/// z1 and H1 of (B11). `rot_rr_first` is R, the rotation frame at the first stop to the rotation frame at this stop.
fn equation_b11<T: Real>(
    force_a0: &Vector3<T>,
    force_a: &Vector3<T>,
    rot_rr_first: &Matrix3<T>,
) -> (Vector3<T>, Matrix<T, 3, INSTALLATION_STATES>) {
    let back = rot_rr_first.transpose();
    let returned = back * force_a;
    let by_accels = back * accel_non_orthogonality_matrix(force_a) - accel_non_orthogonality_matrix(force_a0);
    let by_mounting = skew(&returned) * (Matrix3::identity() - back);
    let mut h = Matrix::<T, 3, INSTALLATION_STATES>::zeros();
    h.fixed_columns_mut::<3>(block::ACCEL_NON_ORTHOGONALITY).copy_from(&by_accels);
    h.fixed_columns_mut::<3>(block::MOUNTING).copy_from(&by_mounting);
    (force_a0 - returned, h)
}

/// z2 and H2 of (B13), integrated over a move, rad. `reference_r` is the integral of the Earth rate and of the rate of
/// the gimbals, in the rotation frame; `theta` are the mounting angles of stage 1.
fn equation_b13<T: Real>(
    rotation_g: &Vector3<T>,
    reference_r: &Vector3<T>,
    theta: &Vector3<T>,
) -> (Vector3<T>, Matrix<T, 3, INSTALLATION_STATES>) {
    let mut h = Matrix::<T, 3, INSTALLATION_STATES>::zeros();
    h.fixed_columns_mut::<6>(block::GYRO_NON_ORTHOGONALITY).copy_from(&-gyro_non_orthogonality_matrix(rotation_g));
    (rotation_g - (reference_r - theta.cross(reference_r)), h)
}

/// An axis that reads less than this at the first stop is taken as at zero there, rad.
const AT_ZERO_RAD: f64 = 20.0 * ARCSEC;

/// The rotation frame at (0, 0) to the rotation frame at the angles of a stop, for perpendicular axes.
fn rot_rr0<T: Real>(outer: Angle, inner: Angle) -> Matrix3<T> {
    InstrumentErrors::<T>::default().rot_rr0(outer, inner)
}

/// As [`rot_rr0`], at the first stop.
fn rot_rr0_at_first<T: Real>(first: &Segment<T>) -> Matrix3<T> {
    let start = |angle: Angle| if angle.rad::<f64>().abs() < AT_ZERO_RAD { Angle::default() } else { angle };
    rot_rr0(start(first.outer), start(first.inner))
}

impl<T: Real, const SEGMENTS: usize> Estimator<T, SEGMENTS> {
    /// Processes segment `number` by the paper's method. Returns whether the segment is used.
    // Not inlined, so that the joint method does not need its stack.
    #[inline(never)]
    pub(super) fn process_by_bai(
        &mut self,
        number: usize,
        segment: &Segment<T>,
        moves_before: u16,
        period_moves: Option<u16>,
    ) -> bool {
        self.let_constants_walk(segment);
        let Some(stage) = stage(segment.kind(), moves_before, period_moves).filter(|_| !segment.is_broken()) else {
            return false;
        };
        let Some((first, at_first)) = self.first_stop() else { return false };
        let linear = match (stage, segment.standing()) {
            // The first stop is what the others are compared with.
            (Stage::One, Some(_)) if first.start_us == segment.start_us => return true,
            (Stage::One, Some(standing)) => self.stage_one((first, at_first), (segment, standing)),
            _ => self.stage_two(segment),
        };
        let measured = if stage == Stage::One { at_first.force_a } else { segment.rotation_g };
        self.take_in_linear(&linear, measured.norm(), number, if stage == Stage::One { 0 } else { 3 });
        true
    }

    /// The first stop that no gap breaks.
    fn first_stop(&self) -> Option<(&Segment<T>, &Standing<T>)> {
        self.segments
            .iter()
            .filter(|segment| !segment.is_broken())
            .find_map(|segment| Some((segment, segment.standing()?)))
    }

    fn stage_one(
        &self,
        (first, at_first): (&Segment<T>, &Standing<T>),
        (stop, standing): (&Segment<T>, &Standing<T>),
    ) -> Linear<T> {
        let (z, h) = equation_b11(
            &at_first.force_a,
            &standing.force_a,
            &(rot_rr0::<T>(stop.outer, stop.inner) * rot_rr0_at_first::<T>(first).transpose()),
        );
        let noise = &self.config.noise;
        let psd_sqrt = real::<T>(noise.accel_psd_sqrt);
        let tilted = at_first.force_a.norm() * real(noise.encoder_sigma_rad);
        let white = psd_sqrt * psd_sqrt * (stop.duration_s().recip() + first.duration_s().recip());
        Linear { z, h, r: white + tilted * tilted }
    }

    fn stage_two(&self, turn: &Segment<T>) -> Linear<T> {
        let errors = InstrumentErrors::from_vector(&self.nominal);
        let earth_rate_b = errors.rot_nb().transpose() * Vector3::from(self.site.earth_rate_n().map(real));
        let turned = &turn.turned;
        let gimbals_r = Vector3::new(turned.outer_cos_inner, -turned.outer_sin_inner, turned.inner);
        let reference_r = gimbals_r + attitude_integral(&turn.integrals(), &Matrix3::identity()) * earth_rate_b;
        let (z, h) = equation_b13(&turn.rotation_g, &reference_r, &Vector3::from(errors.mounting));
        let noise = &self.config.noise;
        let (psd_sqrt, encoder) = (real::<T>(noise.gyro_psd_sqrt), real::<T>(noise.encoder_sigma_rad));
        Linear { z, h, r: psd_sqrt * psd_sqrt * turn.duration_s() + encoder * encoder * real(2.0) }
    }

    /// Updates the filter with the three channels one by one. `size` is the magnitude of the vector that was measured,
    /// whose rounding error adds to the noise. Rounding matters in `f32` only.
    fn take_in_linear(&mut self, linear: &Linear<T>, size: T, segment: usize, first_channel: u8) {
        let nominal = self.nominal.fixed_rows::<INSTALLATION_STATES>(0).into_owned();
        // The state of the filter is the deviation from the nominal value.
        let z = linear.z - linear.h * nominal;
        let r = linear.r + rounding_variance(size);
        for (row, channel) in (0..3).zip(first_channel..) {
            let mut h = Vector::<T, STATES>::zeros();
            let of_row = linear.h.row_iter().nth(row);
            let places = h.iter_mut().skip(BEFORE_PARAMETERS);
            places.zip(of_row.iter().flat_map(|row| row.iter())).for_each(|(place, value)| *place = *value);
            let z = z.iter().nth(row).copied().unwrap_or(T::zero());
            let (update, _) = self.filter.update(&Measurement { z, h, r });
            self.note(&update, r, segment, channel);
        }
    }

    /// (B6): W over the time of a segment.
    fn let_constants_walk(&mut self, segment: &Segment<T>) {
        let walk = real::<T>(self.config.tuning.walk_rad_sqrt_s);
        if walk > T::zero() {
            for state in BEFORE_PARAMETERS..BEFORE_PARAMETERS + INSTALLATION_STATES {
                self.filter.inflate_state(state, walk * walk * segment.duration_s());
            }
        }
    }

    /// Levels the first stop with the estimate of stage 1. The attitude is no state of the filter.
    #[inline(never)]
    pub(super) fn level(&mut self) {
        let errors = InstrumentErrors::from_vector(&self.nominal);
        let Some((first, at_first)) = self.first_stop() else { return };
        let theta = Vector3::from(errors.mounting);
        let rot_br = rot_rr0_at_first::<T>(first).transpose();
        // (B4), then (B2) from the IMU frame to the rotation frame.
        let in_b = |v_s: &Vector3<T>| rot_br * (v_s + theta.cross(v_s));
        let force_b = in_b(&(errors.rot_sa() * at_first.force_a));
        let (attitude, _) = level_attitude(&force_b, &in_b(&first.rotation_g), &self.config.heading);
        for vector in [&mut self.start, &mut self.nominal] {
            vector.fixed_rows_mut::<3>(block::ATTITUDE).copy_from(&attitude);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::exp_so3;
    use crate::model::error_model::PARAMETERS;

    /// Gimbal angles of a stop that both axes have turned to, and the rotation to it from (0, 0).
    fn turned() -> Matrix3<f64> {
        rot_rr0(Angle::from_rad(-1.1), Angle::from_rad(0.7))
    }

    fn with(x: &Vector<f64, INSTALLATION_STATES>) -> InstrumentErrors<f64> {
        let mut all = Vector::<f64, PARAMETERS>::zeros();
        all.fixed_rows_mut::<INSTALLATION_STATES>(0).copy_from(x);
        InstrumentErrors::from_vector(&all)
    }

    /// Derivative of a vector by the twelve states at zero, from central differences.
    fn differences(of: impl Fn(&InstrumentErrors<f64>) -> Vector3<f64>) -> Matrix<f64, 3, INSTALLATION_STATES> {
        const STEP: f64 = 1e-5;
        let at = |state: usize, step: f64| of(&with(&Vector::from_fn(|row, _| if row == state { step } else { 0.0 })));
        Matrix::from_columns(&core::array::from_fn::<_, INSTALLATION_STATES, _>(|state| {
            (at(state, STEP) - at(state, -STEP)) / (2.0 * STEP)
        }))
    }

    #[test]
    fn equation_b11_matches_differences() {
        let (force_a0, force_a) = (Vector3::new(0.4, -0.9, 9.7), Vector3::new(5.5, 7.0, -3.9));
        let (z, h) = equation_b11(&force_a0, &force_a, &turned());
        // (B10): f_s0 = rot_s0r0 R^T rot_rs f_s, exact. With X the force at the first stop and the returned force agree.
        let disagreement = |errors: &InstrumentErrors<f64>| {
            let rot_sa = errors.rot_sa();
            let rot_sr = errors.rot_sr();
            rot_sr * turned().transpose() * rot_sr.transpose() * rot_sa * force_a - rot_sa * force_a0
        };
        assert_eq!(disagreement(&InstrumentErrors::default()), -z);
        let found = (differences(disagreement) - h).abs().max();
        // The third derivative of the two rotations by theta is at most 2^3 |f_a|, and a sixth of it times the square of
        // the step of 1e-5 is left.
        assert!(found < 8.0 * force_a.norm() * 1e-10 / 6.0, "{found}");
        assert_eq!(h.fixed_columns::<6>(block::GYRO_NON_ORTHOGONALITY).norm(), 0.0);
        assert!((0..INSTALLATION_STATES).skip(6).all(|state| h.column(state).norm() > 1.0), "every state is seen: {h}");
    }

    #[test]
    fn equation_b13_matches_differences() {
        let (omega_g, omega_r) = (Vector3::new(0.21, -0.13, 0.24), Vector3::new(0.2, -0.14, 0.26));
        let theta = Vector3::new(3e-4, -2e-4, 5e-4);
        let (z, h) = equation_b13(&omega_g, &omega_r, &theta);
        // (B5) and (B12): the rate that the gyros sense, without that of gimbals and Earth.
        let left = |errors: &InstrumentErrors<f64>| errors.rot_sg() * omega_g - (omega_r - theta.cross(&omega_r));
        assert_eq!(left(&InstrumentErrors::default()), z);
        let found = (differences(left) + h).abs().max();
        // The equation is linear, so that only rounding is left.
        assert!(found < 1e-10, "{found}");
        // (B2) is the first order of the rotation.
        let exact = omega_g - exp_so3(&-theta) * omega_r;
        assert!((exact - z).norm() < theta.norm_squared() * omega_r.norm(), "{exact} {z}");
        assert_eq!(h.fixed_columns::<6>(block::ACCEL_NON_ORTHOGONALITY).norm(), 0.0);
    }

    #[test]
    fn the_reading_of_the_first_stop_counts_only_away_from_zero() {
        let at = |outer: f64, inner: f64| {
            let stop = Segment {
                outer: Angle::from_rad(outer),
                inner: Angle::from_rad(inner),
                ..Segment::quiet_stop(6_000_000)
            };
            rot_rr0_at_first(&stop)
        };
        assert_eq!(at(5.0 * ARCSEC, -5.0 * ARCSEC), Matrix3::identity());
        assert_eq!(at(-5.0 * ARCSEC, 0.3), rot_rr0(Angle::default(), Angle::from_rad(0.3)));
    }

    #[test]
    fn stops_are_of_the_first_period_and_moves_of_the_second() {
        use SegmentKind::{Move, Stop};
        let stages = |period| {
            [(Stop, 0), (Move, 0), (Stop, 1), (Move, 1), (Stop, 2)].map(|(kind, moves)| stage(kind, moves, period))
        };
        let (one, two) = (Some(Stage::One), Some(Stage::Two));
        assert_eq!(stages(None), [one, two, one, two, one]);
        assert_eq!(stages(Some(1)), [one, None, one, two, None]);
    }
}
