//! The errors of the instrument, and their effect on a sample. [`super::correction`] has the inverse.
//!
//! ```text
//! (M1) rot_sa = [[1,0,0],[Sayz,1,0],[-Sazy,Sazx,1]]     rot_sg = [[1,-Sgxz,Sgxy],[Sgyz,1,-Sgyx],[-Sgzy,Sgzx,1]]
//! (M2) rot_sr = rot_s0r0 = exp(-[theta x]),  theta = (alpha, beta, gamma)
//! (M3) rot_rr0(outer, inner) = R_inner(inner) R_x(outer);  R_inner turns about the inner axis (sin d, 0, cos d)
//! (M4) f_a = (I + diag ka) rot_sa^-1 f_s + ba
//! (M5) w_g = (I + diag kg) rot_sg^-1 w_s + bg
//! ```
//! The source of (M1) to (M3) is Bai et al., Sensors 2019, 19, 4005. These equations are made exact here. The errors
//! d, k and b are additions of this project. `R_x(a)` is the frame rotation `[[1,0,0],[0,c,s],[0,-s,c]]`. The second
//! index of S is the rotation axis.

use crate::base::angle::Angle;
use crate::base::linear::{Matrix3, Real, Vector, Vector3, exp_so3, inverse3};
use crate::base::units::{ARCSEC, DEG, DEG_H, MICRO_G, PPM};
use core::slice::from_mut;
use serde::{Deserialize, Serialize};

/// Number of parameters.
pub const PARAMETERS: usize = 28;

/// The blocks of the parameter vector. Each constant is the index of the first parameter of a block.
pub mod block {
    /// Gyro non-orthogonality Sgxy Sgxz Sgyx Sgyz Sgzx Sgzy, rad.
    pub const GYRO_NON_ORTHOGONALITY: usize = 0;
    /// Accelerometer non-orthogonality Sayz Sazx Sazy, rad.
    pub const ACCEL_NON_ORTHOGONALITY: usize = 6;
    /// Mounting angles alpha beta gamma, rad.
    pub const MOUNTING: usize = 9;
    /// Accelerometer bias, a-frame, m/s^2.
    pub const ACCEL_BIAS: usize = 12;
    /// Accelerometer scale-factor error.
    pub const ACCEL_SCALE: usize = 15;
    /// Gyro bias, g-frame, rad/s.
    pub const GYRO_BIAS: usize = 18;
    /// Gyro scale-factor error.
    pub const GYRO_SCALE: usize = 21;
    /// Non-perpendicularity d of the axes, rad.
    pub const NON_PERPENDICULARITY: usize = 24;
    /// Roll, pitch, heading of the base, rad.
    pub const ATTITUDE: usize = 25;
    /// Heading of the base, rad. It is the last parameter of the attitude.
    pub const HEADING: usize = ATTITUDE + 2;
}

/// Number of installation errors: Sgxy Sgxz Sgyx Sgyz Sgzx Sgzy, Sayz Sazx Sazy, alpha beta gamma. They are the first
/// parameters, and the states of the paper's method.
pub const INSTALLATION_STATES: usize = block::ACCEL_BIAS;

/// Name and unit of a parameter, for reports.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterInfo {
    /// Name, as in the literature and in all files.
    pub name: &'static str,
    /// Unit in reports and files.
    pub unit: &'static str,
    /// `value_si = value_in_unit * unit_si`.
    pub unit_si: f64,
}

const fn info(name: &'static str, unit: &'static str, unit_si: f64) -> ParameterInfo {
    ParameterInfo { name, unit, unit_si }
}

/// Names and units in the order of the parameter vector.
pub const PARAMETER_INFO: [ParameterInfo; PARAMETERS] = [
    info("Sgxy", "arcsec", ARCSEC),
    info("Sgxz", "arcsec", ARCSEC),
    info("Sgyx", "arcsec", ARCSEC),
    info("Sgyz", "arcsec", ARCSEC),
    info("Sgzx", "arcsec", ARCSEC),
    info("Sgzy", "arcsec", ARCSEC),
    info("Sayz", "arcsec", ARCSEC),
    info("Sazx", "arcsec", ARCSEC),
    info("Sazy", "arcsec", ARCSEC),
    info("alpha", "arcsec", ARCSEC),
    info("beta", "arcsec", ARCSEC),
    info("gamma", "arcsec", ARCSEC),
    info("accel_bias_x", "ug", MICRO_G),
    info("accel_bias_y", "ug", MICRO_G),
    info("accel_bias_z", "ug", MICRO_G),
    info("accel_scale_x", "ppm", PPM),
    info("accel_scale_y", "ppm", PPM),
    info("accel_scale_z", "ppm", PPM),
    info("gyro_bias_x", "deg/h", DEG_H),
    info("gyro_bias_y", "deg/h", DEG_H),
    info("gyro_bias_z", "deg/h", DEG_H),
    info("gyro_scale_x", "ppm", PPM),
    info("gyro_scale_y", "ppm", PPM),
    info("gyro_scale_z", "ppm", PPM),
    info("axis_nonperpendicularity", "arcsec", ARCSEC),
    info("base_roll", "deg", DEG),
    info("base_pitch", "deg", DEG),
    info("heading", "deg", DEG),
];

/// The errors of one instrument and the attitude of its base: the 28 parameters by name.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InstrumentErrors<T> {
    /// Sgxy Sgxz Sgyx Sgyz Sgzx Sgzy of (M1), rad.
    pub gyro_non_orthogonality: [T; 6],
    /// Sayz Sazx Sazy of (M1), rad.
    pub accel_non_orthogonality: [T; 3],
    /// theta = (alpha, beta, gamma) of (M2), rad.
    pub mounting: [T; 3],
    /// ba of (M4), m/s^2.
    pub accel_bias_a: [T; 3],
    /// ka of (M4).
    pub accel_scale: [T; 3],
    /// bg of (M5), rad/s.
    pub gyro_bias_g: [T; 3],
    /// kg of (M5).
    pub gyro_scale: [T; 3],
    /// d of (M3), rad.
    pub axis_non_perpendicularity: T,
    /// Roll of the base, rad: `rot_nb = R_z(-heading) R_y(pitch) R_x(roll)` with active rotations.
    pub base_roll: T,
    /// Pitch of the base, rad; see `base_roll`.
    pub base_pitch: T,
    /// Bearing of the b-frame's y axis, clockwise from north, rad.
    pub heading: T,
}

impl<T: Real> InstrumentErrors<T> {
    /// Every parameter, in the order of the parameter vector. This is the only list of that order by name.
    fn in_order(&mut self) -> impl Iterator<Item = &mut T> {
        [
            self.gyro_non_orthogonality.as_mut_slice(),
            &mut self.accel_non_orthogonality,
            &mut self.mounting,
            &mut self.accel_bias_a,
            &mut self.accel_scale,
            &mut self.gyro_bias_g,
            &mut self.gyro_scale,
            from_mut(&mut self.axis_non_perpendicularity),
            from_mut(&mut self.base_roll),
            from_mut(&mut self.base_pitch),
            from_mut(&mut self.heading),
        ]
        .into_iter()
        .flatten()
    }

    /// The errors with the values of the parameter vector (28), SI.
    pub fn from_vector(x: &Vector<T, PARAMETERS>) -> Self {
        let mut errors = Self::default();
        errors.in_order().zip(x.iter()).for_each(|(parameter, value)| *parameter = *value);
        errors
    }

    /// The parameter vector (28), SI.
    pub fn to_vector(&self) -> Vector<T, PARAMETERS> {
        let (mut errors, mut x) = (*self, Vector::<T, PARAMETERS>::zeros());
        x.iter_mut().zip(errors.in_order()).for_each(|(value, parameter)| *value = *parameter);
        x
    }

    /// (M1): accelerometer axes to IMU axes.
    pub fn rot_sa(&self) -> Matrix3<T> {
        let [sayz, sazx, sazy] = self.accel_non_orthogonality;
        let (zero, one) = (T::zero(), T::one());
        Matrix3::new(one, zero, zero, sayz, one, zero, -sazy, sazx, one)
    }

    /// (M1): gyro axes to IMU axes.
    pub fn rot_sg(&self) -> Matrix3<T> {
        let [sgxy, sgxz, sgyx, sgyz, sgzx, sgzy] = self.gyro_non_orthogonality;
        let one = T::one();
        Matrix3::new(one, -sgxz, sgxy, sgyz, one, -sgyx, -sgzy, sgzx, one)
    }

    /// (M2): rotation frame to IMU frame. Both frames are fixed to the inner gimbal, so the rotation is the same at all
    /// gimbal angles.
    pub fn rot_sr(&self) -> Matrix3<T> {
        exp_so3(&-Vector3::from(self.mounting))
    }

    /// (M3): rotation frame at gimbal angles (0, 0) to rotation frame at gimbal angles (outer, inner).
    pub fn rot_rr0(&self, outer: Angle, inner: Angle) -> Matrix3<T> {
        let tilt = self.rot_inner_axis();
        tilt * frame_rotation_z(inner) * tilt.transpose() * frame_rotation_x(outer)
    }

    /// Active rotation about y that carries (0, 0, 1) to the inner axis (sin d, 0, cos d).
    pub fn rot_inner_axis(&self) -> Matrix3<T> {
        exp_so3(&Vector3::new(T::zero(), self.axis_non_perpendicularity, T::zero()))
    }

    /// Base to local level: `R_z(-heading) R_y(pitch) R_x(roll)`. The base frame b is the rotation frame at gimbal
    /// angles (0, 0). The encoder zeros and the gimbal axes define this frame; the mounting of the IMU does not matter.
    pub fn rot_nb(&self) -> Matrix3<T> {
        let zero = T::zero();
        exp_so3(&Vector3::new(zero, zero, -self.heading))
            * exp_so3(&Vector3::new(zero, self.base_pitch, zero))
            * exp_so3(&Vector3::new(self.base_roll, zero, zero))
    }

    /// (M4) and (M5): sensor outputs (`f_a`, `w_g`) for the specific force `force_s` (m/s^2) and the angular rate
    /// `omega_is_s` (rad/s) of the IMU frame.
    pub fn corrupt(&self, force_s: &Vector3<T>, omega_is_s: &Vector3<T>) -> (Vector3<T>, Vector3<T>) {
        let force_a = inverse3(&self.rot_sa()) * force_s;
        let omega_g = inverse3(&self.rot_sg()) * omega_is_s;
        let one = Vector3::repeat(T::one());
        (
            force_a.component_mul(&(one + Vector3::from(self.accel_scale))) + Vector3::from(self.accel_bias_a),
            omega_g.component_mul(&(one + Vector3::from(self.gyro_scale))) + Vector3::from(self.gyro_bias_g),
        )
    }
}

/// Frame rotation about z: `[[c,s,0],[-s,c,0],[0,0,1]]`.
pub fn frame_rotation_z<T: Real>(angle: Angle) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    let (zero, one) = (T::zero(), T::one());
    Matrix3::new(c, s, zero, -s, c, zero, zero, zero, one)
}

/// Frame rotation about x: `[[1,0,0],[0,c,s],[0,-s,c]]`.
pub fn frame_rotation_x<T: Real>(angle: Angle) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    let (zero, one) = (T::zero(), T::one());
    Matrix3::new(one, zero, zero, zero, c, s, zero, -s, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vector_and_fields_correspond() {
        let x = Vector::from_fn(|row, _| row as f64);
        let errors = InstrumentErrors::from_vector(&x);
        assert_eq!(errors.to_vector(), x);
        assert_eq!(errors.gyro_bias_g[0], block::GYRO_BIAS as f64);
        assert_eq!(errors.heading, block::HEADING as f64);
        assert_eq!(PARAMETER_INFO[block::NON_PERPENDICULARITY].name, "axis_nonperpendicularity");
        assert_eq!(PARAMETER_INFO[block::ACCEL_SCALE].name, "accel_scale_x");
    }

    #[test]
    fn equation_m3_turns_about_the_tilted_inner_axis() {
        let errors = InstrumentErrors { axis_non_perpendicularity: 0.01_f64, ..Default::default() };
        let inner = Angle::from_rad(0.7);
        let axis_r = Vector3::new(0.01_f64.sin(), 0.0, 0.01_f64.cos());
        let expected = exp_so3(&(axis_r * -inner.rad::<f64>())) * frame_rotation_x::<f64>(Angle::from_rad(0.4));
        assert!((errors.rot_rr0(Angle::from_rad(0.4), inner) - expected).norm() < 1e-15);
    }

    #[test]
    fn heading_is_the_bearing_of_the_y_axis_clockwise_from_north() {
        let errors = InstrumentErrors { heading: 90.0 * DEG, ..Default::default() };
        let y_n = errors.rot_nb() * Vector3::y();
        assert!((y_n - Vector3::x()).norm() < 1e-15, "y axis must point east, is {y_n}");
    }
}
