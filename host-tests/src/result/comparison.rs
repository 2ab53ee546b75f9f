//! Two results of one unit: what changed, in sigmas of the difference.
//!
//! The results are taken as independent, of different runs: the variance of a difference is the sum of both. Attitude and
//! heading are those of the vehicle, which may have moved; they are shown, and do not count. A largest change of n normal
//! numbers stays below `quantile((1 + CONFIDENCE^(1/n)) / 2)`, so results agree up to there.

use super::report::SiteReport;
use super::saved::Saved;
use crate::base::quantity::{self, fixed};
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS, block};
use statrs::distribution::{ContinuousCDF, Normal};

/// Probability with which two right results agree.
pub const CONFIDENCE: f64 = 0.999;
/// A latitude this far off is another site, deg: 0.1 arcsec/s of Earth rate in 15.
const SITE_DEG: f64 = 0.01;
/// Another height, m.
const SITE_M: f64 = 10.0;
/// Another measured gravity: a common scale-factor error of the accelerometers of 0.1 ppm.
const SITE_GRAVITY: f64 = 1e-6;
/// Another temperature, K.
const TEMPERATURE_K: f64 = 2.0;

/// One parameter in both, report units.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    /// Second less first; of the heading, the shorter way.
    pub difference: f64,
    /// Standard deviation of the difference.
    pub sigma: f64,
}

impl Change {
    /// In sigmas.
    pub fn normalized(&self) -> f64 {
        self.difference / self.sigma
    }
}

/// What two results have in common, and what not.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Parameters that both estimate.
    pub changes: [Option<Change>; PARAMETERS],
    /// The largest change, in sigmas, that is still agreement.
    pub limit: f64,
    /// Circumstances that differ, in words.
    pub notes: Vec<String>,
}

impl Comparison {
    /// Of a first result and a second one.
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

    /// Whether a parameter counts: not that of the vehicle.
    pub fn counts(index: usize) -> bool {
        index < block::ATTITUDE
    }

    /// Parameters that changed by more than chance.
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
            format!("agree: no change beyond {limit} sigma, attitude and heading aside")
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
    fn the_limit_is_that_of_the_largest_of_many() {
        // Two-sided 0.1 % of one normal number; of 25, each may be beyond in one of 25 000 cases.
        assert!((limit(1) - 3.2905).abs() < 1e-4);
        assert!((limit(25) - 4.1073).abs() < 2e-3, "{}", limit(25));
    }
}
