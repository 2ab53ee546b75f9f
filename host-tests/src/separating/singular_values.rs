//! \[14\]: the mounting angles from the forces at the stops, by singular value decomposition.
//!
//! With C = rot_sr of (M2), R_k = rot_rr0 at stop k, and the force f_b of the base in the frame r0:
//! ```text
//! (S5) f_s,k = C R_k f_b
//! ```
//! For a given f_b, the rotation C with the least squares of (S5) is `U diag(1, 1, det U V^T) V^T` with the singular
//! value decomposition `U S V^T` of the sum of `f_s,k (R_k f_b)^T` (Wahba's problem). For a given C, f_b is the mean of
//! `R_k^T C^T f_s,k`. Both are computed in turn until the angles no longer change.

use super::error::SeparatingError;
use super::imu_correction::ImuCorrection;
use super::run::GimballedRun;
use rins_selfcal::base::linear::{Matrix3, Vector3};
use rins_selfcal::base::units::ARCSEC;

/// Largest number of turns. Scheme `bai` needs 15 from the angles zero.
const TURNS: usize = 10_000;
/// The angles have converged when a turn changes them by less, rad.
const CONVERGED_RAD: f64 = 1e-5 * ARCSEC;

/// Mounting angles alpha, beta, gamma, rad, from a run and the correction of the IMU.
///
/// # Errors
/// The angles do not converge: the stops do not show all of them.
pub fn mounting_by_singular_values(
    run: &GimballedRun,
    correction: &ImuCorrection,
) -> Result<[f64; 3], SeparatingError> {
    let stops: Vec<(Vector3<f64>, Matrix3<f64>)> =
        run.stops().iter().map(|stop| (correction.force_s(&stop.force_a), stop.rot_rr0())).collect();
    let mut rot_sr = Matrix3::identity();
    for _ in 0..TURNS {
        let in_base = stops.iter().map(|(force_s, rot_rr0)| rot_rr0.transpose() * (rot_sr.transpose() * force_s));
        let force_b = in_base.sum::<Vector3<f64>>() / stops.len() as f64;
        let sum = stops.iter().map(|(force_s, rot_rr0)| force_s * (rot_rr0 * force_b).transpose()).sum();
        let next = nearest_rotation(&sum).ok_or(SeparatingError::Unobserved)?;
        let step_rad = (next - rot_sr).norm();
        rot_sr = next;
        if step_rad < CONVERGED_RAD {
            return Ok(rotation_vector(&rot_sr).map(|angle| -angle).into());
        }
    }
    Err(SeparatingError::Unobserved)
}

/// The rotation C with the largest trace of `C^T m`.
fn nearest_rotation(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let decomposed = m.svd(true, true);
    let (u, v_t) = (decomposed.u?, decomposed.v_t?);
    let handed = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant()));
    Some(u * handed * v_t)
}

/// The vector v of less than a quarter turn with `exp([v x]) = rot`, rad.
fn rotation_vector(rot: &Matrix3<f64>) -> Vector3<f64> {
    let sine = Vector3::new(rot[(2, 1)] - rot[(1, 2)], rot[(0, 2)] - rot[(2, 0)], rot[(1, 0)] - rot[(0, 1)]) * 0.5;
    let size = sine.norm();
    if size > 0.0 { sine * (size.min(1.0).asin() / size) } else { sine }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::linear::exp_so3;

    #[test]
    fn the_nearest_rotation_is_a_rotation_and_undoes_a_stretch() {
        let vector = Vector3::new(0.02, -0.5, 0.3);
        let rot: Matrix3<f64> = exp_so3(&vector);
        // Two stops' worth: the third singular value is zero, and the determinant decides.
        let stretch = Matrix3::from_diagonal(&Vector3::new(2.0, 1.0, 0.0));
        let found = nearest_rotation(&(rot * stretch)).unwrap();
        assert!((found - rot).norm() < 1e-12);
        assert!((rotation_vector(&found) - vector).norm() < 1e-12);
    }
}
