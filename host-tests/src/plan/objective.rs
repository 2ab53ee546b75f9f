//! The objective of a plan: chosen parameters, and one number from their sigmas.

use super::information::{Information, STATES};
use crate::base::quantity::{HEADING, states};
use rins_selfcal::base::linear::{ComplexField, Matrix, Vector};
use rins_selfcal::estimator::OBSERVED_RATIO;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETERS};

/// Function of the weighted sigmas that is minimized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Criterion {
    /// The largest sigma
    #[default]
    Worst,
    /// Root mean square of the sigmas (A-optimal)
    A,
    /// Geometric mean of the axes of the error ellipsoid, from the determinant of the covariance (D-optimal)
    D,
}

/// A chosen parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// Index of the parameter.
    pub parameter: usize,
    /// Factor for the sigma in report units.
    pub factor: f64,
}

/// What a plan minimizes.
#[derive(Clone, Debug, PartialEq)]
pub struct Objective {
    criterion: Criterion,
    weights: Vec<Weight>,
}

impl Objective {
    /// Bai's twelve states, with equal weights.
    pub fn installation(criterion: Criterion) -> Self {
        let weights = (0..INSTALLATION_STATES).map(|parameter| Weight { parameter, factor: 1.0 }).collect();
        Self { criterion, weights }
    }

    /// Parameters by name, with factors.
    ///
    /// # Errors
    /// Names the parameter, and the fault of its name or factor.
    pub fn weighted(criterion: Criterion, weights: &[(String, f64)]) -> Result<Self, String> {
        let by_name = |(name, factor): &(String, f64)| {
            let parameter = states().take(PARAMETERS).position(|info| info.name == name);
            let parameter = parameter.ok_or_else(|| format!("{name}: unknown parameter"))?;
            if !(factor.is_finite() && *factor > 0.0) {
                return Err(format!("{name}: the weight must be finite and positive"));
            }
            Ok(Weight { parameter, factor: *factor })
        };
        Ok(Self { criterion, weights: weights.iter().map(by_name).collect::<Result<_, _>>()? })
    }

    /// Function of the weighted sigmas.
    pub fn criterion(&self) -> Criterion {
        self.criterion
    }

    /// The chosen parameters with their weights.
    pub fn weights(&self) -> &[Weight] {
        &self.weights
    }

    /// Value of the objective for this information. Unobserved parameters make the value many times larger. For the
    /// worst sigma, a finite `exponent` gives a p-norm, which is smooth, and an infinite one the worst sigma itself.
    /// `None` if the information is not positive definite.
    pub fn value(&self, information: &Information, exponent: f64) -> Option<f64> {
        let factor = information.factor()?;
        let columns = self.weights.iter().map(|weight| {
            let unit = states().nth(weight.parameter).map_or(1.0, |info| info.unit_si);
            information.inverse_column(&factor, weight.parameter) * (weight.factor / unit)
        });
        let value = match self.criterion {
            Criterion::Worst => power_mean(&columns.map(|column| column.norm()).collect::<Vec<_>>(), exponent),
            Criterion::A => power_mean(&columns.map(|column| column.norm()).collect::<Vec<_>>(), 2.0),
            Criterion::D => mean_edge(columns.collect()),
        };
        Some(value * unobserved_penalty(information, &factor))
    }
}

/// 1 if all parameters are observed by the verdict's measure. Otherwise the product of the factors by which their
/// sigmas are too large, so that every step towards a complete scheme lowers the value. The heading need not be
/// observed.
fn unobserved_penalty(information: &Information, factor: &Matrix<f64, STATES, STATES>) -> f64 {
    let others = (0..PARAMETERS).filter(|parameter| *parameter != HEADING);
    let lacks = others.map(|parameter| information.part_of_prior(factor, parameter) / OBSERVED_RATIO);
    lacks.map(|lack| lack.max(1.0)).product()
}

/// `(mean x^p)^(1/p)`
fn power_mean(values: &[f64], exponent: f64) -> f64 {
    let largest = values.iter().copied().fold(0.0, f64::max);
    if exponent.is_infinite() {
        return largest;
    }
    let sum: f64 = values.iter().map(|value| ComplexField::powf(value / largest, exponent)).sum();
    largest * ComplexField::powf(sum / values.len() as f64, exponent.recip())
}

/// Geometric mean of the edges of a box that has the volume spanned by these columns. The determinant of their products
/// is the square of the volume.
fn mean_edge(mut columns: Vec<Vector<f64, STATES>>) -> f64 {
    let mut sum_of_logs = 0.0;
    for number in 0..columns.len() {
        let (done, rest) = columns.split_at_mut(number + 1);
        let length = done[number].norm();
        sum_of_logs += ComplexField::ln(length);
        let unit = done[number] / length;
        rest.iter_mut().for_each(|other| *other -= unit * unit.dot(other));
    }
    ComplexField::exp(sum_of_logs / columns.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_with_a_large_exponent_is_near_the_largest_value() {
        let sigmas = [0.3, 0.5, 0.4];
        assert_eq!(power_mean(&sigmas, f64::INFINITY), 0.5);
        // The largest value alone gives (1/3)^(1/64) of itself.
        let found = power_mean(&sigmas, 64.0);
        assert!(found < 0.5 && found > 0.5 * 3_f64.powf(-1.0 / 64.0), "{found}");
        assert!((power_mean(&[3.0, 4.0], 2.0) - 12.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_determinant_is_a_volume() {
        // A box of 2 x 3 x 4, sheared.
        let columns = [[2.0, 0.0, 0.0], [5.0, 3.0, 0.0], [-7.0, 1.0, 4.0]];
        let columns = columns.map(|[x, y, z]| {
            let mut column = Vector::zeros();
            (column[0], column[1], column[2]) = (x, y, z);
            column
        });
        let columns = columns.to_vec();
        assert!((mean_edge(columns).powi(3) - 24.0).abs() < 1e-12);
    }

    #[test]
    fn weights_are_refused_by_name() {
        let weighted =
            |name: &str, factor| Objective::weighted(Criterion::Worst, &[(name.to_string(), factor)]).map(|_| ());
        assert_eq!(weighted("gamma", 1.0), Ok(()));
        assert_eq!(weighted("delta", 1.0), Err("delta: unknown parameter".into()));
        assert_eq!(weighted("accel_quadratic_x", 1.0), Err("accel_quadratic_x: unknown parameter".into()));
        assert_eq!(weighted("gamma", -1.0), Err("gamma: the weight must be finite and positive".into()));
    }
}
