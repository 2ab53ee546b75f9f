//! Information about the parameters, from measurements with independent noise.
//!
//! ```text
//! I = diag(1 / prior^2) + sum H^T R^-1 H        states: encoder errors of the stop before and of this
//!                                               stop, parameters; in units of their prior sigmas
//! ```
//! An encoder error belongs to one stop and to the two moves that meet at the stop. After both moves are added, the
//! error is eliminated exactly (Schur complement), and the error of the next stop takes its place.

use super::triangle::{factorize, substitute};
use rins_selfcal::base::linear::{ComplexField, Matrix, Vector};
use rins_selfcal::model::error_model::PARAMETERS;
use rins_selfcal::model::measurement::{ENCODER_ERRORS, Prediction};

/// Number of encoder errors and parameters.
pub const STATES: usize = ENCODER_ERRORS + PARAMETERS;

/// Information about encoder errors and parameters.
#[derive(Clone, Debug)]
pub struct Information {
    /// Lower triangle, in units of the prior sigmas.
    lower: Matrix<f64, STATES, STATES>,
    prior_sigmas: Vector<f64, STATES>,
}

impl Information {
    /// What is known before any measurement.
    pub fn prior(prior_sigmas: Vector<f64, STATES>) -> Self {
        Self { lower: Matrix::identity(), prior_sigmas }
    }

    /// Adds one scalar measurement.
    pub fn add(&mut self, h: &Vector<f64, STATES>, variance: f64) {
        let scale = ComplexField::sqrt(variance).recip();
        let scaled = h.component_mul(&self.prior_sigmas) * scale;
        for (column, factor) in scaled.iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
            let entries = self.lower.as_mut_slice()[column * STATES..(column + 1) * STATES].iter_mut();
            entries.zip(scaled.iter()).skip(column).for_each(|(entry, other)| *entry += factor * other);
        }
    }

    /// Adds the three channels of a segment, with white noise of `variance`.
    pub fn add_rows(&mut self, prediction: &Prediction<f64>, variance: f64) {
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
    pub fn renew_encoder_errors(&mut self) {
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
        factorize(factor.as_mut_slice(), STATES)?;
        Some(factor)
    }

    /// Column of a parameter in the inverse of [`Information::factor`], SI units. Its squared length is the variance,
    /// and the product of two columns is the covariance.
    pub fn inverse_column(&self, factor: &Matrix<f64, STATES, STATES>, parameter: usize) -> Vector<f64, STATES> {
        let state = ENCODER_ERRORS + parameter;
        let mut column = Vector::<f64, STATES>::zeros();
        column[state] = self.prior_sigmas[state];
        substitute(factor.as_slice(), column.as_mut_slice(), state);
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
