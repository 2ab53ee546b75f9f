//! \[11\]: an extended Kalman filter on attitude and velocity of a strapdown navigation of the gimballed IMU.
//!
//! The IMU navigates through the moves. At the stops its velocity is zero and the force shows the vertical, once a
//! second. The filter has 27 states: the errors (computed minus true) of
//! ```text
//! phi  attitude, n-frame, rad: computed rot_ns = (I - [phi x]) rot_ns      3
//! dv   velocity, n-frame, m/s                                              3
//! bg   corrected rate, s-frame, rad/s                                      3
//! ba   corrected force, s-frame, m/s^2                                     3
//! dKg  matrix of the gyros, full                                           9
//! dKa  matrix of the accelerometers, lower triangular                      6
//! ```
//! with C = rot_ns, the outputs w of the gyros and those a of the accelerometers:
//! ```text
//! (S1) phi' = -w_ie x phi - C (bg + dKg w)
//! (S2) dv'  = f_n x phi + C (ba + dKa a)
//! (S3) at rest: v = dv,   (C f_s)_horizontal / g = (f_n x phi + C (ba + dKa a))_horizontal / g
//! ```
//! The lower triangle of dKa is the definition of the s-frame by the accelerometers, (M1), so the gyro matrix is
//! relative to that frame. The encoders are not used, except to find the stops.
//!
//! The errors are fed back after each of [`PASSES`] passes over the run. Fed back at every measurement, they would be
//! fed back while they are still combinations of several states, and the filter would take later measurements at a
//! wrong heading: on a unit of Table 3 that costs up to 1 arcsec. The paper's list of references has only the principle;
//! states, measurements and noise are choices of this project.

use super::error::SeparatingError;
use super::imu_correction::ImuCorrection;
use super::run::{GimballedRun, Interval};
use crate::files::unit_file::Noise;
use rins_selfcal::base::linear::{Matrix, Matrix3, Vector, Vector3, exp_so3, skew};
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{DEG, DEG_H, DEG_SQRT_H, MICRO_G};
use rins_selfcal::model::error_model::{InstrumentErrors, block};

/// Number of passes over the run. The second pass of a unit of Table 3 changes no angle by more than 1 arcsec, and the
/// fourth by less than 1e-4 arcsec.
pub const PASSES: usize = 4;

/// Largest step of the last pass of an estimate that has converged, in sigmas.
const CONVERGED_SIGMAS: f64 = 0.01;

/// First states of the blocks.
mod state {
    pub const PHI: usize = 0;
    pub const VELOCITY: usize = 3;
    pub const GYRO_BIAS: usize = 6;
    pub const ACCEL_BIAS: usize = 9;
    pub const GYRO_MATRIX: usize = 12;
    pub const ACCEL_MATRIX: usize = 21;
}
/// Number of states.
const STATES: usize = 27;
/// Number of states of the navigation: attitude and velocity.
const NAVIGATION: usize = state::GYRO_BIAS;

/// Rows and columns of the lower triangle of the accelerometer matrix.
const LOWER_TRIANGLE: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// State of an element of the gyro matrix.
const fn gyro_matrix(row: usize, column: usize) -> usize {
    state::GYRO_MATRIX + 3 * row + column
}

/// Elements of the matrices that are the nine non-orthogonality angles, in the order of the parameters.
const NINE: [usize; block::MOUNTING] = [
    gyro_matrix(0, 2),
    gyro_matrix(0, 1),
    gyro_matrix(1, 2),
    gyro_matrix(1, 0),
    gyro_matrix(2, 1),
    gyro_matrix(2, 0),
    state::ACCEL_MATRIX + 1,
    state::ACCEL_MATRIX + 4,
    state::ACCEL_MATRIX + 3,
];

/// Prior sigmas: wide against any unit of navigation or tactical grade. The filter is linear within a pass, so a wide
/// prior does no harm.
const PRIOR_GYRO_BIAS: f64 = 5.0 * DEG_H;
const PRIOR_ACCEL_BIAS: f64 = 5000.0 * MICRO_G;
const PRIOR_MATRIX: f64 = DEG;
/// Sigma of the velocity at rest, m/s. Within a second, the noise of a good accelerometer adds 2e-5 m/s.
const SIGMA_VELOCITY_M_S: f64 = 1e-5;
/// Least white noise. Below it, the covariance would lose its last digits.
const LEAST_ACCEL_PSD_SQRT: f64 = 0.01 * MICRO_G;
const LEAST_GYRO_PSD_SQRT: f64 = 1e-6 * DEG_SQRT_H;
/// Velocity and levelling at a stop come from the same force samples. Each of the two is given twice the variance of
/// the force noise, so both together count that noise once.
const SHARED_NOISE: f64 = 2.0;
/// Least horizontal part of the Earth rate, rad/s, that shows a heading: that of 5 deg from a pole.
const LEAST_HORIZONTAL_RATE_RAD_S: f64 = 6.4e-6;

/// White noise of the sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// Square root of the spectral density of the force noise, m/s^2/sqrt(Hz).
    pub accel_psd_sqrt: f64,
    /// Square root of the spectral density of the rate noise, rad/s/sqrt(Hz).
    pub gyro_psd_sqrt: f64,
}

impl From<&Noise> for SensorNoise {
    fn from(noise: &Noise) -> Self {
        let psd = noise.psd();
        Self { accel_psd_sqrt: psd.accel_psd_sqrt, gyro_psd_sqrt: psd.gyro_psd_sqrt }
    }
}

/// Result of \[11\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Navigated {
    /// The correction of the IMU.
    pub correction: ImuCorrection,
    /// Sigmas of the nine non-orthogonality angles, rad, in the order of the parameters. They contain white noise only.
    pub sigmas: [f64; block::MOUNTING],
}

impl Navigated {
    /// The nine non-orthogonality angles with scale factors and biases; all other errors are zero.
    pub fn errors(&self) -> InstrumentErrors<f64> {
        self.correction.errors()
    }
}

/// Attitude rot_ns at rest: the force gives the vertical, the rate gives north (gyrocompass).
pub(super) fn aligned(force_s: &Vector3<f64>, omega_is_s: &Vector3<f64>) -> Matrix3<f64> {
    let up = force_s.normalize();
    let north = (omega_is_s - up * up.dot(omega_is_s)).normalize();
    Matrix3::from_columns(&[north.cross(&up), north, up]).transpose()
}

/// Estimates the correction of the IMU from a run.
///
/// # Errors
/// There is no heading near a pole; the run does not show all angles; the passes do not converge.
pub fn navigate(run: &GimballedRun, site: &Site, noise: &SensorNoise) -> Result<Navigated, SeparatingError> {
    let earth = Earth { rate_n: site.earth_rate_n().into(), gravity_m_s2: site.gravity_m_s2() };
    if earth.rate_n.y < LEAST_HORIZONTAL_RATE_RAD_S {
        return Err(SeparatingError::Heading);
    }
    let noise = SensorNoise {
        accel_psd_sqrt: noise.accel_psd_sqrt.max(LEAST_ACCEL_PSD_SQRT),
        gyro_psd_sqrt: noise.gyro_psd_sqrt.max(LEAST_GYRO_PSD_SQRT),
    };
    let mut correction = ImuCorrection::default();
    let mut last = None;
    for _ in 0..PASSES {
        let mut pass = Pass::new(run, correction, &earth, &noise);
        run.intervals.iter().for_each(|interval| pass.step(interval));
        correction = pass.fed_back();
        last = Some(pass);
    }
    let pass = last.ok_or(SeparatingError::Unobserved)?;
    let sigmas = NINE.map(|state| pass.covariance[(state, state)].sqrt());
    // A NaN is an estimate that has not been found either.
    if !sigmas.iter().all(|sigma| *sigma < 0.1 * PRIOR_MATRIX) {
        return Err(SeparatingError::Unobserved);
    }
    let steps = NINE.iter().zip(&sigmas).map(|(state, sigma)| (pass.x[*state] / sigma).abs());
    let step = steps.fold(0.0, f64::max);
    if step > CONVERGED_SIGMAS {
        return Err(SeparatingError::NotConverged { sigmas: step });
    }
    Ok(Navigated { correction, sigmas })
}

struct Earth {
    rate_n: Vector3<f64>,
    gravity_m_s2: f64,
}

/// One pass: the navigation with the correction of the pass before, and the filter of its errors.
struct Pass<'a> {
    correction: ImuCorrection,
    earth: &'a Earth,
    noise: &'a SensorNoise,
    rot_ns: Matrix3<f64>,
    velocity_n: Vector3<f64>,
    x: Vector<f64, STATES>,
    covariance: Matrix<f64, STATES, STATES>,
    /// Transition of attitude and velocity since the last measurement. The other states are constant.
    transition: Matrix<f64, NAVIGATION, STATES>,
    /// Covariance of the noise in attitude and velocity since the last measurement.
    noise_since: Matrix<f64, NAVIGATION, NAVIGATION>,
}

/// Columns that take the states to `C (bg + dKg w)`.
fn rate_error(rot_ns: &Matrix3<f64>, omega_g: &Vector3<f64>) -> Matrix<f64, 3, STATES> {
    let mut columns = Matrix::<f64, 3, STATES>::zeros();
    columns.fixed_columns_mut::<3>(state::GYRO_BIAS).copy_from(rot_ns);
    for (row, along) in rot_ns.column_iter().enumerate() {
        for (column, omega) in omega_g.iter().enumerate() {
            columns.set_column(gyro_matrix(row, column), &(along * *omega));
        }
    }
    columns
}

/// Columns that take the states to `C (ba + dKa a)`.
fn force_error(rot_ns: &Matrix3<f64>, force_a: &Vector3<f64>) -> Matrix<f64, 3, STATES> {
    let mut columns = Matrix::<f64, 3, STATES>::zeros();
    columns.fixed_columns_mut::<3>(state::ACCEL_BIAS).copy_from(rot_ns);
    for (element, (row, column)) in LOWER_TRIANGLE.into_iter().enumerate() {
        columns.set_column(state::ACCEL_MATRIX + element, &(rot_ns.column(row) * force_a[column]));
    }
    columns
}

impl<'a> Pass<'a> {
    /// Starts at the end of the first stop, whose means give the attitude.
    ///
    /// The alignment makes the horizontal force and the rate to the east zero, so its errors follow from those of the
    /// sensors: `f_n x phi = -C (ba + dKa a)` and `(w_ie x phi)_east = -(C (bg + dKg w))_east`.
    fn new(run: &GimballedRun, correction: ImuCorrection, earth: &'a Earth, noise: &'a SensorNoise) -> Self {
        let first = run.stops()[0];
        let rot_ns = aligned(&correction.force_s(&first.force_a), &correction.omega_is_s(&first.omega_g));
        let force = force_error(&rot_ns, &first.force_a) / earth.gravity_m_s2;
        let rate = rate_error(&rot_ns, &first.omega_g);
        let [phi_north, phi_east] = [force.row(0).into_owned(), -force.row(1)];
        let phi_up = (phi_north * earth.rate_n.z - rate.row(0)) / earth.rate_n.y;
        let mut by_sensors = Matrix::<f64, STATES, STATES>::identity();
        for (state, row) in [phi_east, phi_north, phi_up].iter().enumerate() {
            by_sensors.set_row(state::PHI + state, row);
        }
        let mut prior = Vector::<f64, STATES>::repeat(PRIOR_MATRIX);
        prior.fixed_rows_mut::<NAVIGATION>(0).fill(0.0);
        prior.fixed_rows_mut::<3>(state::GYRO_BIAS).fill(PRIOR_GYRO_BIAS);
        prior.fixed_rows_mut::<3>(state::ACCEL_BIAS).fill(PRIOR_ACCEL_BIAS);
        let mut covariance =
            by_sensors * Matrix::from_diagonal(&prior.map(|sigma| sigma * sigma)) * by_sensors.transpose();
        let level = (noise.accel_psd_sqrt / earth.gravity_m_s2).powi(2) / first.duration_s;
        let heading = (noise.gyro_psd_sqrt / earth.rate_n.y).powi(2) / first.duration_s;
        let velocity = SIGMA_VELOCITY_M_S.powi(2);
        let noises = [level, level, heading, velocity, velocity, velocity];
        noises.iter().enumerate().for_each(|(state, variance)| covariance[(state, state)] += variance);
        let mut pass = Self {
            correction,
            earth,
            noise,
            rot_ns,
            velocity_n: Vector3::zeros(),
            x: Vector::zeros(),
            covariance,
            transition: Matrix::zeros(),
            noise_since: Matrix::zeros(),
        };
        pass.restart_transition();
        pass
    }

    fn restart_transition(&mut self) {
        self.transition = Matrix::identity();
        self.noise_since = Matrix::zeros();
    }

    /// Navigates over an interval. At rest, measures at its end.
    fn step(&mut self, interval: &Interval) {
        // The first stop has been used for the alignment.
        if interval.stop == Some(0) {
            return;
        }
        let duration_s = interval.duration_s;
        let turned_s = self.correction.omega_is_s(&interval.omega_g) * duration_s;
        let turned_n = self.earth.rate_n * duration_s;
        let rot_ns = exp_so3(&(turned_n * -0.5)) * self.rot_ns * exp_so3(&(turned_s * 0.5));
        let force_n = rot_ns * self.correction.force_s(&interval.force_a);
        let by_rate = rate_error(&rot_ns, &interval.omega_g);
        let by_force = force_error(&rot_ns, &interval.force_a);
        self.predict(duration_s, &force_n, &by_rate, &by_force);
        self.rot_ns = exp_so3(&-turned_n) * self.rot_ns * exp_so3(&turned_s);
        self.velocity_n += (force_n - Vector3::z() * self.earth.gravity_m_s2) * duration_s;
        if interval.stop.is_some() {
            self.correct(duration_s, &force_n, &by_force);
        }
    }

    /// (S1) and (S2) over an interval, into the transition since the last measurement.
    fn predict(
        &mut self,
        duration_s: f64,
        force_n: &Vector3<f64>,
        by_rate: &Matrix<f64, 3, STATES>,
        by_force: &Matrix<f64, 3, STATES>,
    ) {
        let [phi, velocity] = [state::PHI, state::VELOCITY];
        let [earth_rate, force] = [skew(&self.earth.rate_n), skew(force_n)].map(|cross| cross * duration_s);
        let before = self.transition.fixed_rows::<3>(phi).into_owned();
        let after = before - earth_rate * before - by_rate * duration_s;
        let mut change = force * (before + after) * 0.5;
        change += by_force * duration_s;
        self.transition.fixed_rows_mut::<3>(phi).copy_from(&after);
        let mut velocity_rows = self.transition.fixed_rows_mut::<3>(velocity);
        velocity_rows += change;

        let mut step = Matrix::<f64, NAVIGATION, NAVIGATION>::identity();
        let mut of_phi = step.fixed_view_mut::<3, 3>(phi, phi);
        of_phi -= earth_rate;
        step.fixed_view_mut::<3, 3>(velocity, phi).copy_from(&force);
        self.noise_since = step * self.noise_since * step.transpose();
        let gyro = self.noise.gyro_psd_sqrt.powi(2) * duration_s;
        let accel = SHARED_NOISE * self.noise.accel_psd_sqrt.powi(2) * duration_s;
        for axis in 0..3 {
            self.noise_since[(phi + axis, phi + axis)] += gyro;
            self.noise_since[(velocity + axis, velocity + axis)] += accel;
        }
    }

    /// (S3) at the end of an interval at rest.
    fn correct(&mut self, duration_s: f64, force_n: &Vector3<f64>, by_force: &Matrix<f64, 3, STATES>) {
        self.take_transition();
        let mut by_states = *by_force;
        by_states.fixed_columns_mut::<3>(state::PHI).copy_from(&skew(force_n));
        let gravity = self.earth.gravity_m_s2;
        let var_tilt = SHARED_NOISE * (self.noise.accel_psd_sqrt / gravity).powi(2) / duration_s;
        for axis in 0..2 {
            self.take(force_n[axis] / gravity, &(by_states.row(axis).transpose() / gravity), var_tilt);
        }
        for axis in 0..3 {
            let mut h = Vector::zeros();
            h[state::VELOCITY + axis] = 1.0;
            self.take(self.velocity_n[axis], &h, SIGMA_VELOCITY_M_S.powi(2));
        }
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }

    /// Takes the transition since the last measurement into state and covariance.
    fn take_transition(&mut self) {
        let moved = self.transition * self.x;
        self.x.fixed_rows_mut::<NAVIGATION>(0).copy_from(&moved);
        let rows = self.transition * self.covariance;
        let corner = rows * self.transition.transpose() + self.noise_since;
        self.covariance.fixed_rows_mut::<NAVIGATION>(0).copy_from(&rows);
        self.covariance.fixed_columns_mut::<NAVIGATION>(0).copy_from(&rows.transpose());
        self.covariance.fixed_view_mut::<NAVIGATION, NAVIGATION>(0, 0).copy_from(&corner);
        self.restart_transition();
    }

    /// One scalar measurement `z = h x` with this variance.
    fn take(&mut self, z: f64, h: &Vector<f64, STATES>, variance: f64) {
        let by_state = self.covariance * h;
        let gain = by_state / (h.dot(&by_state) + variance);
        self.x += gain * (z - h.dot(&self.x));
        self.covariance.ger(-1.0, &gain, &by_state, 1.0);
    }

    /// The correction without the errors that this pass has found.
    fn fed_back(&self) -> ImuCorrection {
        let of = |first: usize| self.x.fixed_rows::<3>(first).into_owned();
        let mut correction = self.correction;
        correction.rate_bias_s += of(state::GYRO_BIAS);
        correction.force_bias_s += of(state::ACCEL_BIAS);
        for row in 0..3 {
            for column in 0..3 {
                correction.rate_matrix_sg[(row, column)] -= self.x[gyro_matrix(row, column)];
            }
        }
        for (element, place) in LOWER_TRIANGLE.into_iter().enumerate() {
            correction.force_matrix_sa[place] -= self.x[state::ACCEL_MATRIX + element];
        }
        correction
    }
}
