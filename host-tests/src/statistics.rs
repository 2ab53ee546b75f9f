//! Statistics of errors over many runs.

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Error and sigma of one parameter in one run, report units.
#[derive(Clone, Copy, Debug)]
pub struct ErrorAndSigma {
    /// Estimate less truth.
    pub error: f64,
    /// What the estimator said of it.
    pub sigma: f64,
}

/// One parameter over many runs, report units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Root mean square error.
    pub rms_error: f64,
    /// Mean error.
    pub mean_error: f64,
    /// Cramer-Rao bound: root mean square of the sigmas, each from the information at that run's estimate.
    pub bound: f64,
    /// `rms_error / bound`.
    pub ratio: f64,
    /// Mean of `(error / sigma)^2`.
    pub mean_normalized_squared: f64,
}

impl ErrorStatistics {
    /// Of these runs.
    pub fn new(runs: &[ErrorAndSigma]) -> Self {
        let mean = |of: &dyn Fn(&ErrorAndSigma) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
        let rms_error = mean(&|run| run.error * run.error).sqrt();
        let bound = mean(&|run| run.sigma * run.sigma).sqrt();
        Self {
            rms_error,
            mean_error: mean(&|run| run.error),
            bound,
            ratio: rms_error / bound,
            mean_normalized_squared: mean(&|run| (run.error / run.sigma).powi(2)),
        }
    }
}

/// Two-sided bounds of the mean of `count` independent chi-square numbers of `freedom` degrees each.
pub fn chi_square_mean_bounds(count: usize, freedom: f64, confidence: f64) -> [f64; 2] {
    let total = count as f64 * freedom;
    let Ok(distribution) = ChiSquared::new(total) else { return [f64::NAN; 2] };
    let tail = 0.5 * (1.0 - confidence);
    [tail, 1.0 - tail].map(|probability| distribution.inverse_cdf(probability) / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_tables() {
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
    fn statistics_of_two_runs() {
        let runs = [ErrorAndSigma { error: 3.0, sigma: 1.0 }, ErrorAndSigma { error: -1.0, sigma: 1.0 }];
        let found = ErrorStatistics::new(&runs);
        assert_eq!((found.mean_error, found.bound, found.mean_normalized_squared), (1.0, 1.0, 5.0));
        assert!((found.rms_error - 5.0_f64.sqrt()).abs() < 1e-15);
    }
}
