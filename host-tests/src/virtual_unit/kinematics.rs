//! Rigid truth: the noise-free input of a unit's sensors while its axes turn.
//!
//! The code is written from the equations, not from the core's code, so that it can check the core:
//! ```text
//! (M2) rot_s0r0 = exp(-[theta x]);   b = r0
//! (M3) rot_rr0 = R_e(inner) R_x(outer),  e = (sin d, 0, cos d)
//!      x_r = R_e(inner) e_x                                           outer axis in r
//!      omega_br_r = x_r outer' + e inner'
//!      d/dt omega_br_r = x_r outer'' + e inner'' - (e x x_r) outer' inner'
//!      f_r = rot_rr0 up_r0 + omega' x l + omega x (omega x l)         l: lever arm; up: reaction to gravity
//! (M4) f_a = (I + diag ka) rot_sa^-1 rot_sr f_r + ba
//! (M5) w_g = (I + diag kg) rot_sg^-1 rot_sr (omega_br_r + rot_rr0 earth_r0) + bg
//! ```
//! Roll, pitch and heading of the base are the attitude of b = r0, whose axes are the rotation axes at (0, 0). With b =
//! s0 they would differ by the mounting angles. The base tilts and the biases ramp in proportion to time. The tilt is
//! computed to first order.

use super::imperfections::Imperfections;
use super::unit::VirtualUnit;
use super::vec3::{
    Mat3, Vec3, add, add_scaled, apply, apply_transposed, cross, frame_rotation, inverse, multiply, scale, transpose,
    turn_frame,
};
use rins_selfcal::base::units::{ARCSEC, DEG_H, HOUR_S, MICRO_G};

/// A vector that is linear in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Value at time zero.
    pub start: Vec3,
    /// Slope, per second.
    pub per_s: Vec3,
}

impl Drift {
    /// Value at a time, s.
    pub fn at(&self, time_s: f64) -> Vec3 {
        add_scaled(self.start, self.per_s, time_s)
    }

    fn mapped(&self, linear: impl Fn(Vec3) -> Vec3) -> Self {
        Self { start: linear(self.start), per_s: linear(self.per_s) }
    }

    fn plus(&self, other: &Self) -> Self {
        Self { start: add(self.start, other.start), per_s: add(self.per_s, other.per_s) }
    }
}

/// Motion of (outer, inner) over one interval. The rates are linear in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Angles at the start, rad.
    pub angles_rad: [f64; 2],
    /// Rates at the start, rad/s.
    pub from_rad_s: [f64; 2],
    /// Rates at the end, rad/s.
    pub to_rad_s: [f64; 2],
    /// Length of the interval, s.
    pub duration_s: f64,
}

impl Motion {
    /// Angles at the fraction `part` of the interval, rad.
    pub fn angles_at(&self, part: f64) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let change = self.to_rad_s[axis] - self.from_rad_s[axis];
            self.angles_rad[axis] + (self.from_rad_s[axis] + 0.5 * change * part) * part * self.duration_s
        })
    }

    fn rates_at(&self, part: f64) -> [f64; 2] {
        std::array::from_fn(|axis| self.from_rad_s[axis] + (self.to_rad_s[axis] - self.from_rad_s[axis]) * part)
    }

    fn accelerations(&self) -> [f64; 2] {
        std::array::from_fn(|axis| (self.to_rad_s[axis] - self.from_rad_s[axis]) / self.duration_s)
    }
}

/// Noise-free readings of accelerometers, m/s^2, and gyros, rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed<V> {
    /// Accelerometers.
    pub force_a: V,
    /// Gyros.
    pub omega_g: V,
}

/// The rigid truth of one unit.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidTruth {
    inner_axis_r: Vec3,
    lever_r: Vec3,
    /// Reaction to gravity in r at gimbal angles (0, 0).
    up_r0: Drift,
    /// Earth rate, and the rate at which the base tilts, in r at gimbal angles (0, 0).
    earth_r0: Drift,
    /// Linear part of (M4) on r-components.
    force_matrix_ar: Mat3,
    /// Linear part of (M5) on r-components.
    rate_matrix_gr: Mat3,
    accel_bias_a: Drift,
    gyro_bias_g: Drift,
    /// Effects on the attitude, if there are any.
    bent: Option<Imperfections>,
    /// Effects on the outputs, if there are any.
    distorted: Option<Imperfections>,
}

/// Nodes of two-point Gauss-Legendre quadrature, as fractions of an interval. Both weights are one half.
const GAUSS_POINTS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

impl RigidTruth {
    /// Computes the constant parts of a unit's truth.
    pub fn new(unit: &VirtualUnit) -> Self {
        let (errors, effects) = (&unit.errors, &unit.effects);
        let rot_sr = frame_rotation(errors.mounting);
        let tilt = effects.base_tilt_drift_arcsec_h.map(|drift| drift * ARCSEC / HOUR_S);
        let in_b = |v_n: Vec3| {
            let start_b = base_from_level(unit, v_n);
            // In a frame that has turned by phi, v becomes v + v x phi.
            let per_s_b = cross(start_b, [tilt[0], tilt[1], 0.0]);
            Drift { start: start_b, per_s: per_s_b }
        };
        let site = effects.hardware.true_site(&unit.site);
        let earth = in_b(site.earth_rate_n());
        let (sin, cos) = errors.axis_non_perpendicularity.sin_cos();
        Self {
            inner_axis_r: [sin, 0.0, cos],
            lever_r: apply_transposed(&rot_sr, effects.lever_arm_m),
            up_r0: in_b([0.0, 0.0, site.gravity_m_s2()]),
            // The gyros feel the rate at which the base tilts beside the Earth rate.
            earth_r0: Drift { start: add(earth.start, [tilt[0], tilt[1], 0.0]), ..earth },
            bent: effects.hardware.bends().then_some(effects.hardware),
            distorted: effects.hardware.distorts().then_some(effects.hardware),
            force_matrix_ar: sensor_matrix(&accel_axes(&errors.accel_non_orthogonality), errors.accel_scale, &rot_sr),
            rate_matrix_gr: sensor_matrix(&gyro_axes(&errors.gyro_non_orthogonality), errors.gyro_scale, &rot_sr),
            accel_bias_a: Drift {
                start: errors.accel_bias_a,
                per_s: scale(effects.accel_bias_ramp_ug_h, MICRO_G / HOUR_S),
            },
            gyro_bias_g: Drift {
                start: errors.gyro_bias_g,
                per_s: scale(effects.gyro_bias_ramp_deg_h_h, DEG_H / HOUR_S),
            },
        }
    }

    /// Readings of the sensors against time while the axes are at rest at these angles, rad.
    pub fn at_rest(&self, angles_rad: [f64; 2]) -> Sensed<Drift> {
        let turn = Turn::new(angles_rad);
        let rotated =
            |line: &Drift, matrix: &Mat3| line.mapped(|v| apply(matrix, self.rotate_bent(v, angles_rad, &turn)));
        Sensed {
            force_a: rotated(&self.up_r0, &self.force_matrix_ar).plus(&self.accel_bias_a),
            omega_g: rotated(&self.earth_r0, &self.rate_matrix_gr).plus(&self.gyro_bias_g),
        }
    }

    /// Mean readings of the sensors over an interval whose middle is at `middle_s`.
    pub fn mean_over(&self, motion: &Motion, middle_s: f64) -> Sensed<Vec3> {
        let (up_r0, earth_r0) = (self.up_r0.at(middle_s), self.earth_r0.at(middle_s));
        let [first, second] = GAUSS_POINTS.map(|part| self.felt_r(motion, part, up_r0, earth_r0));
        let mean = |a: Vec3, b: Vec3| scale(add(a, b), 0.5);
        Sensed {
            force_a: add(apply(&self.force_matrix_ar, mean(first.0, second.0)), self.accel_bias_a.at(middle_s)),
            omega_g: add(apply(&self.rate_matrix_gr, mean(first.1, second.1)), self.gyro_bias_g.at(middle_s)),
        }
    }

    /// Adds what the sensors distort, from their linear outputs at this time.
    pub fn distorted(&self, sensed: Sensed<Vec3>, middle_s: f64) -> Sensed<Vec3> {
        let Some(imperfections) = &self.distorted else { return sensed };
        let linear = |value: Vec3, bias: &Drift| add_scaled(value, bias.at(middle_s), -1.0);
        let (force_a, omega_g) =
            (linear(sensed.force_a, &self.accel_bias_a), linear(sensed.omega_g, &self.gyro_bias_g));
        let [force, omega] = imperfections.distortion(force_a, omega_g, middle_s);
        Sensed { force_a: add(sensed.force_a, force), omega_g: add(sensed.omega_g, omega) }
    }

    /// Change of the readings when the base has turned by the rotation vector `turned_b`, rad, and turns at `rate_b`,
    /// rad/s. `middle_s` is the time and `angles_rad` are the gimbal angles at the middle of the interval.
    pub fn by_base_motion(&self, turned_b: Vec3, rate_b: Vec3, angles_rad: [f64; 2], middle_s: f64) -> Sensed<Vec3> {
        let turn = Turn::new(angles_rad);
        let rot = frame_rotation(turned_b);
        let change = |v_r0: Vec3| add_scaled(apply(&rot, v_r0), v_r0, -1.0);
        let force_r = self.rotate_rr0(change(self.up_r0.at(middle_s)), &turn);
        let omega_r = self.rotate_rr0(add(change(self.earth_r0.at(middle_s)), rate_b), &turn);
        Sensed { force_a: apply(&self.force_matrix_ar, force_r), omega_g: apply(&self.rate_matrix_gr, omega_r) }
    }

    /// Specific force and inertial rate of the IMU in r.
    fn felt_r(&self, motion: &Motion, part: f64, up_r0: Vec3, earth_r0: Vec3) -> (Vec3, Vec3) {
        let turn = Turn::new(motion.angles_at(part));
        let ([outer_rate, inner_rate], [outer_acc, inner_acc]) = (motion.rates_at(part), motion.accelerations());
        let (axis_r, lever_r) = (self.inner_axis_r, self.lever_r);
        let x_r = turn_frame([1.0, 0.0, 0.0], axis_r, turn.inner);
        let omega_br_r = add_scaled(scale(x_r, outer_rate), axis_r, inner_rate);
        let acceleration_r = add_scaled(
            add_scaled(scale(x_r, outer_acc), axis_r, inner_acc),
            cross(axis_r, x_r),
            -outer_rate * inner_rate,
        );
        let lever_force_r = add(cross(acceleration_r, lever_r), cross(omega_br_r, cross(omega_br_r, lever_r)));
        let angles = motion.angles_at(part);
        let rate_r = match &self.bent {
            None => add(self.rotate_rr0(earth_r0, &turn), omega_br_r),
            Some(bent) => {
                // From the base outwards: each part leans, and the change of its lean is a rate of its own.
                let [base, base_by_outer] = bent.base_bent(angles[0]);
                let [gimbal, by_outer, by_inner] = bent.gimbal_bent(angles[0], angles[1]);
                let of_base = add_scaled(apply(&frame_rotation(base), earth_r0), base_by_outer, outer_rate);
                let of_gimbal = add(turn_frame(of_base, [1.0, 0.0, 0.0], turn.outer), [outer_rate, 0.0, 0.0]);
                let leaning = add(apply(&frame_rotation(gimbal), of_gimbal), scale(by_outer, outer_rate));
                let leaning = add_scaled(leaning, by_inner, inner_rate);
                add_scaled(turn_frame(leaning, axis_r, turn.inner), axis_r, inner_rate)
            }
        };
        (add(self.rotate_bent(up_r0, angles, &turn), lever_force_r), rate_r)
    }

    /// Applies (M3) with the effects on the attitude.
    fn rotate_bent(&self, v_r0: Vec3, angles_rad: [f64; 2], turn: &Turn) -> Vec3 {
        let Some(bent) = &self.bent else { return self.rotate_rr0(v_r0, turn) };
        let [base, _] = bent.base_bent(angles_rad[0]);
        let [gimbal, ..] = bent.gimbal_bent(angles_rad[0], angles_rad[1]);
        let of_base = apply(&frame_rotation(base), v_r0);
        let of_gimbal = apply(&frame_rotation(gimbal), turn_frame(of_base, [1.0, 0.0, 0.0], turn.outer));
        turn_frame(of_gimbal, self.inner_axis_r, turn.inner)
    }

    /// Applies (M3).
    fn rotate_rr0(&self, v_r0: Vec3, turn: &Turn) -> Vec3 {
        turn_frame(turn_frame(v_r0, [1.0, 0.0, 0.0], turn.outer), self.inner_axis_r, turn.inner)
    }
}

/// Sines and cosines of the gimbal angles.
struct Turn {
    outer: (f64, f64),
    inner: (f64, f64),
}

impl Turn {
    fn new([outer, inner]: [f64; 2]) -> Self {
        Self { outer: outer.sin_cos(), inner: inner.sin_cos() }
    }
}

/// Takes n-components to b-components. The base is rolled, then pitched, then turned to its heading.
fn base_from_level(unit: &VirtualUnit, v_n: Vec3) -> Vec3 {
    let errors = &unit.errors;
    let yawed = turn_frame(v_n, [0.0, 0.0, 1.0], (-errors.heading).sin_cos());
    let pitched = turn_frame(yawed, [0.0, 1.0, 0.0], errors.base_pitch.sin_cos());
    turn_frame(pitched, [1.0, 0.0, 0.0], errors.base_roll.sin_cos())
}

/// `(I + diag k) axes^-1 rot_sr`.
fn sensor_matrix(axes: &Mat3, scale_error: Vec3, rot_sr: &Mat3) -> Mat3 {
    let rows = multiply(&inverse(axes), rot_sr);
    std::array::from_fn(|row| scale(rows[row], 1.0 + scale_error[row]))
}

/// rot_sa of (M1). Its columns are the sensor axes.
fn accel_axes(&[yz, zx, zy]: &[f64; 3]) -> Mat3 {
    transpose(&[[1.0, yz, -zy], [0.0, 1.0, zx], [0.0, 0.0, 1.0]])
}

/// rot_sg of (M1). Its columns are the sensor axes.
fn gyro_axes(&[xy, xz, yx, yz, zx, zy]: &[f64; 6]) -> Mat3 {
    transpose(&[[1.0, yz, -zy], [-xz, 1.0, zx], [xy, -yx, 1.0]])
}
