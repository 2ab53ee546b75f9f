//! The information of a scheme, from its geometry alone: what the core's filter would have at the end, without
//! simulating a sample.
//!
//! ```text
//! I = diag(1 / prior^2) + sum H^T R^-1 H        states: encoder errors of the stop before and of this
//!                                               stop, parameters; in units of their prior sigmas
//! ```
//! H is the core's own. An encoder error belongs to one stop and to the two moves that meet at the stop. After both
//! moves are added, the error is eliminated exactly (Schur complement), and the error of the next stop takes its place.
//! The result is the inverse of the core's covariance for ideal hardware, except for the lengths of the windows: the core counts in blocks
//! of 0.1 s, and here a stop loses the mean loss.

use crate::calibration::Setup;
use crate::calibration::virtual_run::SETTLING_S;
use rins_selfcal::base::linear::{ComplexField, Matrix, Vector};
use rins_selfcal::base::site::EARTH_RATE_RAD_S;
use rins_selfcal::estimator::EstimatorConfig;
use rins_selfcal::estimator::rehearsal::{BLOCK_LOSS_S, move_segment, stop_segment, usable_s};
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETERS, block};
use rins_selfcal::model::measurement::{ENCODER_ERRORS, MeasurementModel, Prediction};
use rins_selfcal::scheme::{Leg, Turning};
use rins_selfcal::segment::white_noise::Noise;
use rins_selfcal::segment::{AngleIntegrals, Course, GUARD_S, Segment, SegmentKind};
use std::borrow::Borrow;

/// Rounding unit of the numbers of a model. Derivatives of rotation by attitude are rounded to this part of Earth rate.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;
/// Smallest sigma of an encoder error, rad (1/1000 arcsec), so that its information stays finite.
const LEAST_ENCODER_SIGMA_RAD: f64 = 5e-9;

/// Number of encoder errors and parameters.
pub(super) const STATES: usize = ENCODER_ERRORS + PARAMETERS;

/// Information about encoder errors and parameters.
#[derive(Clone, Debug)]
pub struct Information {
    /// Lower triangle, in units of the prior sigmas.
    lower: Matrix<f64, STATES, STATES>,
    prior_sigmas: Vector<f64, STATES>,
}

impl Information {
    fn prior(prior_sigmas: Vector<f64, STATES>) -> Self {
        Self { lower: Matrix::identity(), prior_sigmas }
    }

    /// Adds one scalar measurement.
    fn add(&mut self, h: &Vector<f64, STATES>, variance: f64) {
        let scale = ComplexField::sqrt(variance).recip();
        let scaled = h.component_mul(&self.prior_sigmas) * scale;
        for (column, factor) in scaled.iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
            let entries = self.lower.as_mut_slice()[column * STATES..(column + 1) * STATES].iter_mut();
            entries.zip(scaled.iter()).skip(column).for_each(|(entry, other)| *entry += factor * other);
        }
    }

    /// Adds the three channels of a segment, with white noise of `variance`.
    fn add_rows(&mut self, prediction: &Prediction<f64>, variance: f64) {
        for row in 0..3 {
            let mut h = Vector::<f64, STATES>::zeros();
            let (encoder, parameters) = (prediction.by_encoder_errors.row(row), prediction.by_parameters.row(row));
            h.iter_mut().zip(encoder.iter().chain(parameters.iter())).for_each(|(h, column)| *h = *column);
            self.add(&h, variance);
        }
    }

    /// Computes `I - i i^T / pivot` with column `state` of the information, from state `first` on.
    fn subtract_outer(&mut self, state: usize, pivot: f64, first: usize) {
        let column = Vector::<f64, STATES>::from_fn(|row, _| self.lower[(row.max(state), row.min(state))]);
        for (other, of_other) in column.iter().enumerate().skip(first) {
            let factor = of_other / pivot;
            let entries = self.lower.as_mut_slice()[other * STATES..(other + 1) * STATES].iter_mut();
            entries.zip(column.iter()).skip(other).for_each(|(entry, of_entry)| *entry -= factor * of_entry);
        }
    }

    /// The axes leave a stop: its encoder errors become those of the stop before, and the next stop's are new.
    fn renew_encoder_errors(&mut self) {
        const BEFORE: usize = ENCODER_ERRORS / 2;
        for state in 0..BEFORE {
            let pivot = self.lower[(state, state)];
            self.subtract_outer(state, pivot, state + 1);
        }
        for column in 0..BEFORE {
            for row in column..STATES {
                let from = if row < BEFORE { row + BEFORE } else { row };
                self.lower[(row, column)] = self.lower[(from, column + BEFORE)];
            }
        }
        for column in 0..ENCODER_ERRORS {
            let first = column.max(BEFORE);
            let last = if column < BEFORE { ENCODER_ERRORS } else { STATES };
            for row in first..last {
                self.lower[(row, column)] = if row == column { 1.0 } else { 0.0 };
            }
        }
    }

    /// Square root L of the information on the parameters, `I = L L^T`. The first columns eliminate
    /// the encoder errors. `None` if the information is not positive definite.
    pub fn factor(&self) -> Option<Matrix<f64, STATES, STATES>> {
        let mut factor = self.lower;
        for column in 0..STATES {
            let pivot = factor[(column, column)];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            let (done, rest) = factor.as_mut_slice().split_at_mut((column + 1) * STATES);
            let of_column = &mut done[column * STATES..];
            let root = ComplexField::sqrt(pivot).recip();
            of_column[column..].iter_mut().for_each(|entry| *entry *= root);
            for (other, entries) in (column + 1..).zip(rest.chunks_exact_mut(STATES)) {
                let of_other = of_column[other];
                let entries = entries.iter_mut().zip(&*of_column).skip(other);
                entries.for_each(|(entry, of_entry)| *entry -= of_other * of_entry);
            }
        }
        Some(factor)
    }

    /// Column of a parameter in the inverse of [`Information::factor`], SI units. Its squared length is the variance,
    /// and the product of two columns is the covariance.
    pub fn inverse_column(&self, factor: &Matrix<f64, STATES, STATES>, parameter: usize) -> Vector<f64, STATES> {
        let state = ENCODER_ERRORS + parameter;
        let mut column = Vector::<f64, STATES>::zeros();
        column[state] = self.prior_sigmas[state];
        for pivot in state..STATES {
            let of_pivot = &factor.as_slice()[pivot * STATES..(pivot + 1) * STATES];
            let value = column[pivot] / of_pivot[pivot];
            column[pivot] = value;
            let below = column.iter_mut().zip(of_pivot).skip(pivot + 1);
            below.for_each(|(entry, of_entry)| *entry -= value * of_entry);
        }
        column
    }

    /// Sigma of a parameter divided by its prior sigma.
    pub fn part_of_prior(&self, factor: &Matrix<f64, STATES, STATES>, parameter: usize) -> f64 {
        self.inverse_column(factor, parameter).norm() / self.prior_sigmas[ENCODER_ERRORS + parameter]
    }

    /// Sigmas of all parameters, SI units.
    pub fn sigmas(&self) -> Option<[f64; PARAMETERS]> {
        let factor = self.factor()?;
        Some(std::array::from_fn(|parameter| self.inverse_column(&factor, parameter).norm()))
    }
}

/// Measurement model of a stop and the move to the stop. It does not depend on the duration of the stop.
#[derive(Clone, Debug)]
pub struct LegModel {
    /// Time of the move, s.
    pub move_s: f64,
    turn: Prediction<f64>,
    force: Prediction<f64>,
    /// Rotation over one second of rest.
    rest: Prediction<f64>,
}

/// Predicts the information of schemes for one unit without errors, level and facing north, as
/// [`crate::plan::prediction`] does.
#[derive(Clone, Debug)]
pub struct Forecast {
    model: MeasurementModel<f64>,
    config: EstimatorConfig,
    turning: Turning,
    /// Settling time of the accelerometers after a move, s.
    settling_s: f64,
    prior_sigmas: Vector<f64, STATES>,
}

impl Forecast {
    /// A forecast for a unit with this configuration and the joint method. The axes turn as `turning` says. The
    /// accelerometers have settled `settling_s` after a move, and the core waits at least 0.3 s.
    pub fn new(setup: &Setup, turning: Turning, settling_s: f64) -> Self {
        let config = setup.config().estimator;
        let encoder_sigma = config.noise.encoder_sigma_rad.max(LEAST_ENCODER_SIGMA_RAD);
        let encoder = std::iter::repeat_n(encoder_sigma, ENCODER_ERRORS);
        let all = encoder.chain(config.prior_sigmas());
        let mut prior_sigmas = Vector::<f64, STATES>::zeros();
        prior_sigmas.iter_mut().zip(all).for_each(|(prior, sigma)| *prior = sigma);
        let model = MeasurementModel::new(&InstrumentErrors::default(), &setup.known_site());
        Self { model, config, turning, settling_s: settling_s.max(GUARD_S), prior_sigmas }
    }

    /// Rate and acceleration of the axes.
    pub fn turning(&self) -> &Turning {
        &self.turning
    }

    /// Derivative of the mean specific force at a stop by the parameters, (3 x 28), SI.
    pub fn force_rows(&self, stand: &Leg) -> Matrix<f64, 3, PARAMETERS> {
        self.model.force_at_stop(&stop_segment(stand, 1.0)).by_parameters
    }

    /// The model of a leg; the first stop has no move before it.
    pub fn leg(&self, from: &Leg, to: &Leg) -> LegModel {
        let move_s = self.turning.move_s(from, to);
        let turn = move_segment(from, to, &self.turning);
        let at_rest = stop_segment(to, 1.0);
        let mut rest = self.model.rotation(&rest_segment(to));
        // The encoder error is the same at both ends, so it cancels.
        rest.by_encoder_errors.fill(0.0);
        let (turn, force) = (self.model.rotation(&turn), self.model.force_at_stop(&at_rest));
        let of_rotation = ROUNDING * EARTH_RATE_RAD_S;
        let (turn, rest) = (rounded(turn, of_rotation), rounded(rest, of_rotation));
        LegModel { move_s, turn, force: rounded(force, ROUNDING), rest }
    }

    /// The information after all stops. `on_segment` receives the information after each segment, with the time, s.
    pub fn information<L: Borrow<LegModel>>(
        &self,
        stands: &[Leg],
        legs: &[L],
        mut on_segment: impl FnMut(SegmentKind, f64, &Information),
    ) -> Information {
        let mut information = Information::prior(self.prior_sigmas);
        let Noise { accel_psd_sqrt, gyro_psd_sqrt, .. } = self.config.noise;
        let (accel_psd, gyro_psd) = (accel_psd_sqrt * accel_psd_sqrt, gyro_psd_sqrt * gyro_psd_sqrt);
        let mut time_s = 0.0;
        for (number, (stand, leg)) in stands.iter().zip(legs).enumerate() {
            let (is_first, is_last) = (number == 0, number + 1 == stands.len());
            let leg: &LegModel = leg.borrow();
            if !is_first {
                let window_s = leg.move_s + 2.0 * GUARD_S + BLOCK_LOSS_S;
                information.renew_encoder_errors();
                information.add_rows(&leg.turn, gyro_psd * window_s);
                time_s += leg.move_s;
                on_segment(SegmentKind::Move, time_s, &information);
            }
            let usable_s = usable_s(stand.stop_s, self.settling_s, is_first, is_last);
            information.add_rows(&leg.force, accel_psd / usable_s);
            // The rotation is per second, so its variance is that of the mean rate.
            information.add_rows(&leg.rest, gyro_psd / usable_s);
            time_s += stand.stop_s + SETTLING_S;
            on_segment(SegmentKind::Stop, time_s, &information);
        }
        information
    }

    /// The information of a whole scheme.
    pub fn of_stands(&self, stands: &[Leg]) -> Information {
        let from = stands.iter().take(1).chain(stands);
        let legs: Vec<LegModel> = from.zip(stands).map(|(from, to)| self.leg(from, to)).collect();
        self.information(stands, &legs, |_, _, _| ())
    }
}

/// One second at rest, written as a move by zero. A stop has angles in whole ticks of the encoders, and the result of a
/// search must not depend on the ticks.
fn rest_segment(stand: &Leg) -> Segment<f64> {
    let ((so, co), (si, ci)) = (stand.outer_rad.sin_cos(), stand.inner_rad.sin_cos());
    let attitude_s = [1.0, ci, si].map(|inner| [1.0, co, so].map(|outer| (inner * outer) as f32));
    let integrals = AngleIntegrals { attitude_s, ..AngleIntegrals::default() };
    Segment { course: Course::Move(integrals), ..stop_segment(stand, 1.0) }
}

/// A prediction without its last digits, which depend on the order of operations in the core. So a search finds the
/// same scheme after a change of the core that does not change the model. Derivatives by attitude are rounded to
/// `by_attitude`.
fn rounded(mut prediction: Prediction<f64>, by_attitude: f64) -> Prediction<f64> {
    let round = |value: &mut f64, unit: f64| *value = ComplexField::round(*value / unit) * unit;
    prediction.by_encoder_errors.iter_mut().for_each(|value| round(value, ROUNDING));
    for (parameter, mut column) in prediction.by_parameters.column_iter_mut().enumerate() {
        let unit = if parameter < block::ATTITUDE { ROUNDING } else { by_attitude };
        column.iter_mut().for_each(|value| round(value, unit));
    }
    prediction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Precision;
    use crate::files::unit_file::UnitConfig;
    use crate::plan::prediction::predicted_sigmas_si;
    use crate::virtual_unit::unit::VirtualUnit;
    use rins_selfcal::base::method::Method;
    use rins_selfcal::model::error_model::PARAMETER_INFO;
    use rins_selfcal::scheme::Scheme;

    fn setup() -> Setup {
        Setup::new(&UnitConfig::ideal(), VirtualUnit::default().rate_hz, Method::Joint, Precision::F64)
    }

    fn sigmas(setup: &Setup, scheme: &Scheme) -> [f64; PARAMETERS] {
        let stands: Vec<Leg> = scheme.stops().collect();
        let information = Forecast::new(setup, scheme.turning(), GUARD_S).of_stands(&stands);
        information.sigmas().expect("positive definite")
    }

    /// The core counts in blocks, and the forecast uses the mean loss. For stops of 3 s the difference is 2 % of the
    /// time, so 1 % of the sigma.
    #[test]
    fn the_forecast_agrees_with_the_core() {
        let plain = setup();
        let agree = |found: [f64; PARAMETERS], core: [f64; PARAMETERS], within: f64| {
            for ((found, core), info) in found.iter().zip(&core).zip(&PARAMETER_INFO) {
                assert!((found / core - 1.0).abs() < within, "{}: {found} for {core}", info.name);
            }
        };
        for (stop_s, within) in [(10.0, 0.004), (3.0, 0.01)] {
            let scheme = Scheme::bai(stop_s, 1);
            agree(sigmas(&plain, &scheme), predicted_sigmas_si(&plain, &scheme), within);
        }
    }
}
