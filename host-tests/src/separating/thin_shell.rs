//! \[13\]: the mounting angles from the residual rotation of the corrected gyros, by a search in thin shells (L. Kang,
//! L. Ye, K. Song, Y. Zhou, Sensors 2014, 14, 18075).
//!
//! With C = rot_sr of (M2), R = rot_rr0, and the rate w_r of the gimbals in the r-frame by the encoders, the residual
//! rotation is
//! ```text
//! (S4) r = w_s - C R C^T w_ie_s0 - C w_r
//! ```
//! With the right mounting angles r is noise, at rest as well as turning, so all vectors r end in one thin shell. The
//! angles are those that make the spread of |r| smallest. The search evaluates candidates on a shell around the best
//! angles. If one of them is better, the shell moves there; otherwise its radius is halved.
//!
//! The paper's introduction has only "thin-shell method". Averaging, candidates and radii are choices of this project.

use super::imu_correction::ImuCorrection;
use super::navigation::aligned;
use super::run::{GimballedRun, Interval};
use rins_selfcal::base::linear::{Matrix3, Vector3, exp_so3};
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG};

/// Duration over which the residual rotation of a turning axis is averaged, s. In that time an axis turns by 2 deg.
const TURNING_S: f64 = 0.1;
/// Largest relative change of the rate from one such duration to the next. Where the rate changes, the angle between
/// two samples is not known well enough: half an interval of 5 ms at 20 deg/s^2 gives 0.2 arcsec.
const STEADY: f64 = 0.01;
/// Radius of the first shell, and of the last one.
const FIRST_RADIUS_RAD: f64 = DEG;
const LAST_RADIUS_RAD: f64 = 1e-3 * ARCSEC;
/// The candidates are turned by this much, rad, for each shell, so that no direction is left out in the long run.
const TURN: [f64; 3] = [1.0, 0.7, 0.4];

/// Means that enter (S4).
struct Turning {
    omega_is_s: Vector3<f64>,
    /// Rate of the gimbals by the encoders, r-frame, rad/s.
    rate_r: Vector3<f64>,
    rot_rr0: Matrix3<f64>,
}

/// Mounting angles alpha, beta, gamma, rad, from a run and the correction of the IMU.
pub fn mounting_by_thin_shell(run: &GimballedRun, correction: &ImuCorrection, site: &Site) -> [f64; 3] {
    let first = run.stops()[0];
    let rot_ns = aligned(&correction.force_s(&first.force_a), &correction.omega_is_s(&first.omega_g));
    // The first stop is at gimbal angles that need not be (0, 0): the rate goes from there to s0.
    let earth_rate_s = rot_ns.transpose() * Vector3::from(site.earth_rate_n());
    let rot_first = first.rot_rr0();
    let turning = turning(run, correction);
    let spread = |theta: &Vector3<f64>| {
        let rot_sr = exp_so3(&-theta);
        let earth_rate_r0 = rot_first.transpose() * (rot_sr.transpose() * earth_rate_s);
        let sizes =
            turning.iter().map(|mean| (mean.omega_is_s - rot_sr * (mean.rot_rr0 * earth_rate_r0 + mean.rate_r)).norm());
        variance(sizes)
    };
    smallest(spread).into()
}

fn variance(numbers: impl Iterator<Item = f64>) -> f64 {
    let [count, sum, squares] =
        numbers.fold([0.0; 3], |[count, sum, squares], number| [count + 1.0, sum + number, squares + number * number]);
    squares / count - (sum / count).powi(2)
}

/// The angles with the smallest spread.
fn smallest(spread: impl Fn(&Vector3<f64>) -> f64) -> Vector3<f64> {
    let mut candidates = directions();
    let mut best = Vector3::zeros();
    let mut least = spread(&best);
    let mut radius_rad = FIRST_RADIUS_RAD;
    let turn = exp_so3(&Vector3::from(TURN));
    while radius_rad > LAST_RADIUS_RAD {
        candidates.iter_mut().for_each(|direction| *direction = turn * *direction);
        let on_shell = candidates.iter().map(|direction| best + direction * radius_rad);
        let found = on_shell.map(|theta| (spread(&theta), theta)).min_by(|a, b| a.0.total_cmp(&b.0));
        match found {
            Some((spread, theta)) if spread < least => (least, best) = (spread, theta),
            _ => radius_rad *= 0.5,
        }
    }
    best
}

/// Directions of the candidates: to the faces, edges and corners of a cube.
fn directions() -> Vec<Vector3<f64>> {
    let signs = [-1.0, 0.0, 1.0];
    let all = signs.into_iter().flat_map(|x| signs.into_iter().flat_map(move |y| signs.map(|z| Vector3::new(x, y, z))));
    all.filter(|direction| direction.norm() > 0.0).map(|direction| direction.normalize()).collect()
}

/// The means of a run: all intervals at rest, and the times at a steady rate.
fn turning(run: &GimballedRun, correction: &ImuCorrection) -> Vec<Turning> {
    let at_rest = |interval: &Interval| Turning {
        omega_is_s: correction.omega_is_s(&interval.omega_g),
        rate_r: Vector3::zeros(),
        rot_rr0: interval.rot_rr0(),
    };
    let mut means: Vec<Turning> =
        run.intervals.iter().filter(|interval| interval.stop.is_some()).map(at_rest).collect();
    for intervals in run.intervals.chunk_by(|a, b| a.stop.is_none() && b.stop.is_none()) {
        let blocks: Vec<Turning> = blocks(intervals, correction);
        for neighbours in blocks.windows(3) {
            if let [before, block, after] = neighbours {
                let change = |other: &Turning| (other.rate_r.norm() - block.rate_r.norm()).abs();
                if change(before).max(change(after)) < STEADY * block.rate_r.norm() {
                    means.push(Turning { ..*block });
                }
            }
        }
    }
    means
}

/// Means over [`TURNING_S`] of the intervals of one move.
fn blocks(intervals: &[Interval], correction: &ImuCorrection) -> Vec<Turning> {
    let mut blocks = Vec::new();
    let mut from = 1;
    while from < intervals.len() {
        let mut duration_s = 0.0;
        let mut to = from;
        while to + 1 < intervals.len() && duration_s < TURNING_S {
            duration_s += intervals[to].duration_s;
            to += 1;
        }
        if duration_s < TURNING_S {
            break;
        }
        blocks.push(block(&intervals[from - 1..=to], duration_s, correction));
        from = to;
    }
    blocks
}

/// Mean over all intervals but the first and the last one, which give the angles at the ends: an encoder's angle
/// belongs to the middle of an interval, so the angle between two intervals is the mean of both.
fn block(intervals: &[Interval], duration_s: f64, correction: &ImuCorrection) -> Turning {
    let mut omega_g = Vector3::zeros();
    let mut turned_r = Vector3::zeros();
    for three in intervals.windows(3) {
        if let [before, this, after] = three {
            omega_g += this.omega_g * (this.duration_s / duration_s);
            let [outer, inner] = [0, 1].map(|axis: usize| 0.5 * (after.angles_rad[axis] - before.angles_rad[axis]));
            let (sin, cos) = this.angles_rad[1].sin_cos();
            turned_r += Vector3::new(cos * outer, -sin * outer, inner);
        }
    }
    let middle = &intervals[intervals.len() / 2];
    Turning { omega_is_s: correction.omega_is_s(&omega_g), rate_r: turned_r / duration_s, rot_rr0: middle.rot_rr0() }
}
