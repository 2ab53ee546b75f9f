//! Statistics of errors over many runs.

use serde::Serialize;
use statrs::distribution::{Binomial, ChiSquared, ContinuousCDF, DiscreteCDF, Normal};

/// Error and sigma of one state in one run, in report units.
#[derive(Clone, Copy, Debug)]
pub struct ErrorAndSigma {
    /// Estimate minus truth.
    pub error: f64,
    /// Sigma of the estimate.
    pub sigma: f64,
    /// Cramer-Rao bound for the unit of this run.
    pub bound: f64,
}

/// Statistics of one state over many runs, in report units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Root mean square error.
    pub rms_error: f64,
    /// Mean error.
    pub mean_error: f64,
    /// Root mean square of the units' Cramer-Rao bounds.
    pub bound: f64,
    /// `rms_error / bound`.
    pub ratio: f64,
    /// Standard deviation of the ratio if every error is normal with the bound of its unit.
    pub scatter: f64,
    /// Probability that the ratio then differs from 1 by more than [`TOLERANCE`].
    pub chance_outside: f64,
    /// Mean of `(error / sigma)^2`.
    pub mean_normalized_squared: f64,
}

/// Largest difference between 1 and a ratio of RMS error to bound that is accepted.
pub const TOLERANCE: f64 = 0.07;

impl ErrorStatistics {
    /// Statistics of these runs.
    ///
    /// The mean square of errors with different sigmas is a weighted sum of chi-square numbers. It scatters as the mean
    /// square of `n = (sum of bound^2)^2 / sum of bound^4` errors with one sigma (Welch and Satterthwaite).
    pub fn new(runs: &[ErrorAndSigma]) -> Self {
        let sum = |of: &dyn Fn(&ErrorAndSigma) -> f64| runs.iter().map(of).sum::<f64>();
        let mean = |of: &dyn Fn(&ErrorAndSigma) -> f64| sum(of) / runs.len() as f64;
        let rms_error = mean(&|run| run.error * run.error).sqrt();
        let bound = mean(&|run| run.bound * run.bound).sqrt();
        let equal_runs = sum(&|run| run.bound.powi(2)).powi(2) / sum(&|run| run.bound.powi(4));
        Self {
            rms_error,
            mean_error: mean(&|run| run.error),
            bound,
            ratio: rms_error / bound,
            scatter: (2.0 * equal_runs).sqrt().recip(),
            chance_outside: chance_outside(equal_runs),
            mean_normalized_squared: mean(&|run| (run.error / run.sigma).powi(2)),
        }
    }

    /// Whether the ratio differs from 1 by more than [`TOLERANCE`].
    pub fn is_outside(&self) -> bool {
        // NaN is outside too.
        !(1.0 - TOLERANCE..=1.0 + TOLERANCE).contains(&self.ratio)
    }
}

/// Probability that the root mean square of `count` normal numbers of sigma 1 differs from 1 by more than
/// [`TOLERANCE`].
fn chance_outside(count: f64) -> f64 {
    let Ok(distribution) = ChiSquared::new(count) else { return f64::NAN };
    let [low, high] = [1.0 - TOLERANCE, 1.0 + TOLERANCE].map(|ratio| distribution.cdf(count * ratio * ratio));
    1.0 - (high - low)
}

/// Two-sided bounds of the mean of `count` independent chi-square numbers of `freedom` degrees each.
pub fn chi_square_mean_bounds(count: usize, freedom: f64, confidence: f64) -> [f64; 2] {
    let total = count as f64 * freedom;
    let Ok(distribution) = ChiSquared::new(total) else { return [f64::NAN; 2] };
    let tail = 0.5 * (1.0 - confidence);
    [tail, 1.0 - tail].map(|probability| distribution.inverse_cdf(probability) / count as f64)
}

/// Number of events that is not exceeded with this confidence among `count` independent trials.
pub fn binomial_quantile(count: u64, probability: f64, confidence: f64) -> u64 {
    Binomial::new(probability, count).map_or(0, |events| events.inverse_cdf(confidence))
}

/// Probability that one of `count` independent normal numbers is beyond this many sigmas.
pub fn probability_beyond(sigmas: f64, count: u32) -> f64 {
    let tails = 2.0 * Normal::standard().cdf(-sigmas);
    1.0 - (1.0 - tails).powi(count as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    #[test]
    fn chi_square_bounds_agree_with_tables() {
        // chi-square with 10 and 100 degrees of freedom at 0.5 % and 99.5 % (Abramowitz and Stegun, table 26.8).
        let [low, high] = chi_square_mean_bounds(1, 10.0, 0.99);
        assert!((low - 2.15586).abs() < 1e-4 && (high - 25.1882).abs() < 1e-3);
        let [low, high] = chi_square_mean_bounds(100, 1.0, 0.99);
        assert!((low - 0.673_276).abs() < 1e-5 && (high - 1.401_69).abs() < 1e-4);
    }

    #[test]
    fn bounds_of_many_runs_are_near_the_normal_ones() {
        // Sigma of the mean of 1000 with 84 degrees of freedom is sqrt(2 * 84 / 1000) = 0.41.
        let [low, high] = chi_square_mean_bounds(1000, 84.0, 0.99);
        assert!((low - (84.0 - 2.5758 * 0.4099)).abs() < 0.01 && (high - (84.0 + 2.5758 * 0.4099)).abs() < 0.01);
    }

    #[test]
    fn wrong_answers_by_chance() {
        // 1 in 147 160 is beyond 4.5 sigma, so 13 numbers give 8.8 in 100 000.
        assert!((probability_beyond(4.5, 13) - 8.83e-5).abs() < 0.02e-5);
        // Poisson with mean 0.088: none in 91.6 %, at most one in 99.6 %. With mean 0.88: at most three in 98.8 %.
        assert_eq!([1000, 10_000].map(|runs| binomial_quantile(runs, probability_beyond(4.5, 13), 0.99)), [1, 4]);
    }

    #[test]
    fn statistics_of_two_runs() {
        let run = |error| ErrorAndSigma { error, sigma: 1.0, bound: 2.0 };
        let found = ErrorStatistics::new(&[run(3.0), run(-1.0)]);
        assert_eq!((found.mean_error, found.bound, found.mean_normalized_squared), (1.0, 2.0, 5.0));
        assert!((found.rms_error - 5.0_f64.sqrt()).abs() < 1e-15 && (found.scatter - 0.5).abs() < 1e-15);
    }

    #[test]
    fn the_expected_number_outside_agrees_with_random_draws() {
        // 500 errors, a tenth of them with three times the sigma, scatter as 500 (0.9 + 0.9)^2 / (0.9 + 8.1) = 180
        // equal errors.
        let sigmas = |run: usize| if run % 10 == 9 { 3.0 } else { 1.0 };
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut draw = || {
            let run = |run: usize| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                ErrorAndSigma { error: normal * sigmas(run), sigma: sigmas(run), bound: sigmas(run) }
            };
            ErrorStatistics::new(&(0..500).map(run).collect::<Vec<_>>())
        };
        let draws: Vec<_> = (0..2000).map(|_| draw()).collect();
        let outside = draws.iter().filter(|found| found.is_outside()).count() as f64 / 2000.0;
        let expected = draws[0].chance_outside;
        assert!((draws[0].scatter - 360.0_f64.sqrt().recip()).abs() < 1e-12 && (0.15..0.21).contains(&expected));
        // Four sigma of a share of 2000, plus 0.01 because a sum of two kinds is not exactly a chi-square number.
        let allowed = 4.0 * (expected * (1.0 - expected) / 2000.0).sqrt() + 0.01;
        assert!((outside - expected).abs() < allowed, "{outside} for {expected}");
    }
}
