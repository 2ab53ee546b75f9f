//! Tests whether the effects of one kind are together as large as their configured sizes permit.
//!
//! The test of one effect ([`super::constancy`]) sees an effect that is far larger than configured. If a part is worse
//! than configured, all effects of its kind are larger, each by less than that test can tell from chance. With the
//! prior covariance P0 of the effects of a kind and their posterior covariance P, the estimate x has the covariance P0 -
//! P, so that
//! ```text
//! x' (P0 - P)^-1 x
//! ```
//! is chi-square with as many degrees of freedom as there are combinations of the effects that the measurements tell.
//! The flicker of the accelerometers has no state that lasts. If it is larger than configured, the innovations of the
//! forces are larger.

use super::configuration::BEFORE_EFFECTS;
use super::constancy::{Change, Suspicion};
use super::joint::Estimator;
use super::solution::{Filter, Forces};
use crate::base::linear::{ComplexField, Matrix, Real, Vector};
use crate::model::effects::{EFFECTS, KINDS, LARGEST_KIND, kind};
use crate::segment::white_noise::chi_square_deviate;

/// Limit of the chi-square of a kind, as a normal deviate. The probability of a false alarm is 2.3e-4 for each kind, and
/// at most 4e-3 for all kinds. The test sees what makes an answer wrong before it is wrong, so that this is worth it.
const LIMIT: f64 = 3.5;

/// Smallest part of its prior variance by which the measurements must narrow a combination of effects for the test to
/// count it.
const LEAST_TOLD: f32 = 0.01;

impl<T: Real, const SEGMENTS: usize> Estimator<T, SEGMENTS> {
    /// The finding that explains most, after a sweep: the most significant change alone, a kind, or the flicker. Not
    /// inlined, so that its stack is free again before the next sweep.
    #[inline(never)]
    pub(super) fn most_explaining(&self, alone: Suspicion) -> Suspicion {
        let priors = self.config.effect_sigmas();
        let kinds = (0..KINDS).map(|number| chi_square_of_kind(&self.filter, &self.effects, &priors, number));
        let Forces { chi_square, freedom } = self.forces;
        let flicker = (self.config.hardware.accel_floor > 0.0).then_some((chi_square, freedom));
        let all = (0..).zip(kinds.chain(flicker)).map(|(number, (chi_square, freedom))| {
            (of_chi_square(number, chi_square, freedom), gain(chi_square, freedom))
        });
        let most = |(found, gained): (Suspicion, f64), (other, by_other): (Suspicion, f64)| match (
            found.is_founded(),
            other.is_founded(),
        ) {
            (true, true) if by_other > gained => (other, by_other),
            (true, _) => (found, gained),
            (false, true) => (other, by_other),
            (false, false) => (found.more_significant(other), 0.0),
        };
        // If larger variances of all innovations explain more than those of a kind, it is not the kind.
        let all_variances = gain(self.fit.chi_square, self.degrees_of_freedom(&self.estimate()));
        all.fold((alone, all_variances.max(alone.sigmas * alone.sigmas)), most).0
    }
}

/// Twice the logarithm of the likelihood that is gained if the variances behind this chi-square are larger by a common
/// factor. A change alone gains the square of its significance. If one effect alone is large, it gains more than its
/// kind does, and if all are large, less.
fn gain(chi_square: f64, freedom: u32) -> f64 {
    let freedom = f64::from(freedom);
    chi_square - freedom - freedom * ComplexField::ln((chi_square / freedom).max(f64::MIN_POSITIVE))
}

/// Chi-square of the effects of kind `number`, and its degrees of freedom.
#[inline(never)]
fn chi_square_of_kind<T: Real>(
    filter: &Filter<T>,
    in_use: &[u8],
    priors: &[f64; EFFECTS],
    number: usize,
) -> (f64, u32) {
    let member = |effect: u8| {
        let place = in_use.iter().position(|used| *used == effect)?;
        Some((BEFORE_EFFECTS + place, *priors.get(usize::from(effect))?))
    };
    let members = || kind(number).filter_map(member);
    // Both in units of the prior sigmas.
    let mut told = Square::zeros();
    let mut values = Vector::<f32, LARGEST_KIND>::zeros();
    for ((state, prior), (value, mut column)) in members().zip(values.iter_mut().zip(told.column_iter_mut())) {
        *value = (filter.state().get(state).map_or(0.0, |value| value.widened()) / prior) as f32;
        for ((other, of_other), entry) in members().zip(column.iter_mut()) {
            let before = if other == state { 1.0 } else { 0.0 };
            *entry = (before - filter.covariance(state, other).widened() / (prior * of_other)) as f32;
        }
    }
    chi_square(&mut told, &mut values)
}

fn of_chi_square(kind: u8, chi_square: f64, freedom: u32) -> Suspicion {
    let size = ComplexField::sqrt(chi_square / f64::from(freedom.max(1)));
    let sigmas = chi_square_deviate(freedom, chi_square).max(0.0);
    Suspicion { change: Change::Kind(kind), segment: 0, size, sigmas, limit: LIMIT }
}

/// Covariance of the effects of one kind. Single precision is enough for a significance.
type Square = Matrix<f32, LARGEST_KIND, LARGEST_KIND>;

/// Chi-square of values with this covariance, and the number of combinations of which it has more than [`LEAST_TOLD`].
/// Both are used up.
fn chi_square(covariance: &mut Square, values: &mut Vector<f32, LARGEST_KIND>) -> (f64, u32) {
    let (mut chi_square, mut freedom) = (0.0, 0);
    for _ in 0..LARGEST_KIND {
        // The component with the largest variance, given those before it.
        let components = covariance.column_iter().zip(values.iter()).enumerate();
        let components = components.filter_map(|(k, (column, value))| Some((*column.get(k)?, *value, column)));
        let largest = components.max_by(|(a, ..), (b, ..)| a.total_cmp(b));
        let Some((variance, value, column)) = largest.filter(|(variance, ..)| *variance > LEAST_TOLD) else { break };
        let column = column.into_owned();
        chi_square += f64::from(value * value / variance);
        freedom += 1;
        values.axpy(-value / variance, &column, 1.0);
        for (mut other, entry) in covariance.column_iter_mut().zip(column.iter()) {
            other.axpy(-entry / variance, &column, 1.0);
        }
    }
    (chi_square, freedom)
}

#[cfg(test)]
mod tests {
    use super::super::filter::Measurement;
    use super::*;
    use crate::model::effects::effect;

    /// The test of the quadratics of the accelerometers, whose prior is 1. They are measured as these values, with
    /// this variance.
    fn found(values: [f64; 3], r: f64) -> Suspicion {
        let in_use: [u8; 3] = core::array::from_fn(|axis| (effect::ACCEL_QUADRATIC.start + axis) as u8);
        let mut filter = Filter::<f64>::new(&Vector::repeat(1.0), None);
        for (state, z) in (BEFORE_EFFECTS..).zip(values) {
            let mut h = Vector::zeros();
            h[state] = 1.0;
            let _ = filter.update(&Measurement { z, h, r });
        }
        let (chi_square, freedom) = chi_square_of_kind(&filter, &in_use, &[1.0; EFFECTS], 0);
        of_chi_square(0, chi_square, freedom)
    }

    #[test]
    fn effects_that_are_no_doubt_alone_are_one_together() {
        // The deviation of each is 3.2 sigma of prior and noise. 3 degrees of freedom have 30.7.
        let each = 3.2 * 2.0_f64.sqrt();
        let together = found([each, -each, each], 1.0);
        assert_eq!(together.change, Change::Kind(0));
        assert!((together.size - 3.2).abs() < 1e-5 && together.is_founded(), "{together:?}");
        let one = found([each, 0.0, 0.0], 1.0);
        assert!(!one.is_founded(), "{one:?}");
    }

    #[test]
    fn a_change_gains_more_than_a_larger_variance_unless_there_are_several() {
        // One of ten deviations is 8 sigma, the others are 1 sigma.
        assert!(gain(9.0 + 64.0, 10) < 64.0);
        // All are 4 sigma.
        assert!(gain(10.0 * 16.0, 10) > 16.0);
        assert_eq!(gain(10.0, 10), 0.0);
    }

    #[test]
    fn effects_of_which_nothing_is_told_are_not_judged() {
        let untold = found([50.0; 3], 1e4);
        assert_eq!((untold.size, untold.sigmas), (0.0, 0.0));
    }

    #[test]
    fn a_combination_is_counted_once() {
        // The second component is the first one once more.
        let mut covariance = Square::zeros();
        covariance.view_mut((0, 0), (2, 2)).fill(0.5);
        let mut values = Vector::<f32, LARGEST_KIND>::zeros();
        values.rows_mut(0, 2).fill(1.0);
        assert_eq!(chi_square(&mut covariance, &mut values), (2.0, 1));
    }
}
