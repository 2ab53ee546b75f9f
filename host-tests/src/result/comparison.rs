//! Comparison of two results of one unit, in sigmas of the difference.
//!
//! The results come from different runs and are taken as independent, so the variance of a difference is the sum of
//! both variances. Attitude and heading belong to the vehicle, which may have moved. They are shown, but not counted.
//! With probability CONFIDENCE the largest of n standard normal numbers stays below this limit in magnitude:
//! `quantile((1 + CONFIDENCE^(1/n)) / 2)`. Results agree up to the limit.

use super::report::SiteReport;
use super::saved::Saved;
use crate::base::quantity::{self, fixed};
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS, block};
use statrs::distribution::{ContinuousCDF, Normal};

/// Probability that two correct results agree.
pub const CONFIDENCE: f64 = 0.999;
/// Smallest difference of latitude between two sites, deg. It changes a component of Earth rate (15 arcsec/s) by
/// 0.003 arcsec/s at most.
const SITE_DEG: f64 = 0.01;
/// Smallest difference of height between two sites, m.
const SITE_M: f64 = 10.0;
/// Smallest relative difference of gravity between two sites. It acts as a common scale-factor error of the
/// accelerometers.
const SITE_GRAVITY: f64 = 1e-6;
/// Smallest temperature difference that is noted, K.
const TEMPERATURE_K: f64 = 2.0;

/// Change of one parameter between both results, in report units.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    /// Second minus first; for the heading, the shorter way round.
    pub difference: f64,
    /// Standard deviation of the difference.
    pub sigma: f64,
}

impl Change {
    /// The difference in sigmas.
    pub fn normalized(&self) -> f64 {
        self.difference / self.sigma
    }
}

/// Comparison of two results.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Parameters that both estimate.
    pub changes: [Option<Change>; PARAMETERS],
    /// Largest change with which the results still agree, in sigmas.
    pub limit: f64,
    /// Circumstances that differ (verdict, method, scheme, temperature, site), in words.
    pub notes: Vec<String>,
}

impl Comparison {
    /// Compares a second result with a first one.
    pub fn new(first: &Saved, second: &Saved) -> Self {
        let change = |index: usize| {
            let (a, b) = (first.parameters[index]?, second.parameters[index]?);
            let difference = quantity::error(index, b.value, a.value);
            Some(Change { difference, sigma: a.sigma.hypot(b.sigma) })
        };
        let changes = std::array::from_fn(change);
        let counted = changes[..block::ATTITUDE].iter().flatten().count().max(1);
        Self { changes, limit: limit(counted), notes: notes(first, second) }
    }

    /// Whether a parameter counts. Attitude and heading of the vehicle do not.
    pub fn counts(index: usize) -> bool {
        index < block::ATTITUDE
    }

    /// Parameters that changed by more than the limit.
    pub fn changed(&self) -> impl Iterator<Item = usize> + '_ {
        let beyond = |index: &usize| self.changes[*index].is_some_and(|change| change.normalized().abs() > self.limit);
        (0..block::ATTITUDE).filter(beyond)
    }

    /// The conclusion in one line.
    pub fn in_words(&self) -> String {
        let limit = fixed(self.limit, 2);
        let named = self.changed().filter_map(|index| {
            let change = self.changes[index]?;
            Some(format!("{} by {} sigma", PARAMETER_INFO[index].name, fixed(change.normalized(), 1)))
        });
        let named: Vec<_> = named.collect();
        if named.is_empty() {
            format!("agree: no change beyond {limit} sigma, not counting attitude and heading")
        } else {
            format!("differ beyond {limit} sigma: {}", named.join(", "))
        }
    }
}

fn limit(count: usize) -> f64 {
    let each = CONFIDENCE.powf(1.0 / count as f64);
    Normal::standard().inverse_cdf(0.5 * (1.0 + each))
}

fn notes(first: &Saved, second: &Saved) -> Vec<String> {
    let mut notes = Vec::new();
    for saved in [first, second].into_iter().filter(|saved| !saved.is_accepted()) {
        notes.push(format!("{} is {}", saved.path.display(), saved.verdict));
    }
    for (what, a, b) in [("method", &first.method, &second.method), ("scheme", &first.scheme, &second.scheme)] {
        if let (Some(a), Some(b)) = (a, b)
            && a != b
        {
            notes.push(format!("the {what}s differ: {a} and {b}"));
        }
    }
    if let (Some(a), Some(b)) = (first.temperature_c, second.temperature_c)
        && (a - b).abs() > TEMPERATURE_K
    {
        notes.push(format!("the temperatures differ by {:.1} K: {a:.1} and {b:.1} deg C", (b - a).abs()));
    }
    if let (Some(a), Some(b)) = (first.site, second.site) {
        notes.extend(other_site(&a, &b));
    }
    notes
}

fn other_site(a: &SiteReport, b: &SiteReport) -> Option<String> {
    let moved = (a.latitude_deg - b.latitude_deg).abs() > SITE_DEG || (a.height_m - b.height_m).abs() > SITE_M;
    let gravity = (a.gravity_m_s2 / b.gravity_m_s2 - 1.0).abs() > SITE_GRAVITY;
    let words =
        |site: &SiteReport| format!("{} deg, {} m, {:.6} m/s^2", site.latitude_deg, site.height_m, site.gravity_m_s2);
    (moved || gravity).then(|| format!("the sites differ: {} and {}", words(a), words(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_holds_for_the_largest_of_many_changes() {
        // One normal number exceeds the limit in 0.1 % of cases, two-sided. Each of 25 may exceed it in one of 25 000
        // cases.
        assert!((limit(1) - 3.2905).abs() < 1e-4);
        assert!((limit(25) - 4.1073).abs() < 2e-3, "{}", limit(25));
    }
}
