//! Test of the promise that no wrong result is accepted: many runs with one fault each, compared with the truth.

use super::faults::{Fault, FaultKind, readings};
use super::monte_carlo::ErrorSource;
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::calibration::{self, Precision, Setup};
use crate::files::unit_file::UnitConfig;
use crate::virtual_unit::presets::{RandomErrors, UnitErrors};
use crate::virtual_unit::unit::VirtualUnit;
use rayon::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::estimator::Solution;
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETER_INFO, block};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::{Reason, Verdict};
use std::collections::BTreeMap;
use std::fmt;

/// A campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Campaign {
    /// Number of runs.
    pub runs: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Kinds of fault.
    pub faults: Faults,
    /// Whether the units have the imperfections of navigation grade, and the filter knows it. Otherwise they are ideal.
    pub typical: bool,
    /// Floating-point type of the core.
    pub precision: Precision,
}

/// Kinds of fault in a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Faults {
    /// No fault.
    None,
    /// All kinds in turn.
    All,
    /// One kind.
    Only(FaultKind),
}

/// An estimate of one of the twelve installation errors with an error above 4.5 sigma and above 1 arcsec.
#[derive(Clone, Debug, PartialEq)]
pub struct Wrong {
    /// Name of the parameter.
    pub parameter: &'static str,
    /// Error of the estimate, arcsec.
    pub error_arcsec: f64,
    /// Sigma of the estimate, arcsec.
    pub sigma_arcsec: f64,
}

/// Result of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbedRun {
    /// Seed of the run.
    pub seed: u64,
    /// The fault.
    pub fault: Option<Fault>,
    /// Verdict of the core.
    pub verdict: Verdict,
    /// The worst wrong estimate.
    pub wrong: Option<Wrong>,
    /// Largest error of the twelve installation errors, relative to its tolerance.
    pub worst: f64,
}

impl Campaign {
    /// Runs the campaign on all cores; `done` is called after each run.
    pub fn run(&self, done: impl Fn() + Sync) -> Vec<DisturbedRun> {
        let one = |number| {
            let outcome = self.run_one(number);
            done();
            outcome
        };
        (0..self.runs).into_par_iter().map(one).collect()
    }

    fn run_one(&self, number: u64) -> DisturbedRun {
        let seed = derived_seed(self.seed, number, Stream::Noise);
        let (config, source) = if self.typical {
            (UnitConfig::default().somewhere(), ErrorSource::Typical(1.0))
        } else {
            (UnitConfig::ideal(), ErrorSource::Random(RandomErrors::default()))
        };
        let UnitErrors { errors, effects } = source.draw(derived_seed(self.seed, number, Stream::Errors));
        let unit = VirtualUnit { errors, effects, noise: config.noise, site: config.site(), ..VirtualUnit::default() };
        let run = VirtualRun { unit, scheme: Scheme::bai(10.0, 1), seed };
        let kind = match self.faults {
            Faults::None => None,
            Faults::All => FaultKind::ALL.get(number as usize % FaultKind::ALL.len()).copied(),
            Faults::Only(kind) => Some(kind),
        };
        let samples = (run.scheme.duration_s() * run.unit.rate_hz) as usize;
        let fault = kind.map(|kind| Fault::draw(kind, !seed, samples));
        let setup = Setup::new(&config, run.unit.rate_hz, Method::Joint, self.precision).on_scheme(&run.scheme);
        let mut chain = setup.chain();
        for reading in readings(&run, fault.as_ref()) {
            // The live estimate is not used.
            let _ = chain.step(&reading);
        }
        let calibration::Outcome { solution, verdict, .. } = chain.conclude();
        let (worst, wrong) = compare(&solution, &run.unit.errors);
        DisturbedRun { seed, fault, verdict, wrong, worst }
    }
}

/// The largest error relative to its tolerance, and its parameter if the ratio exceeds one.
pub(super) fn compare(solution: &Solution, truth: &InstrumentErrors<f64>) -> (f64, Option<Wrong>) {
    const TOLERANCE_SIGMAS: f64 = 4.5;
    const TOLERANCE_ARCSEC: f64 = 1.0;
    let difference = solution.estimate.errors.to_vector() - truth.to_vector();
    let (mut worst, mut wrong) = (0.0, None);
    let errors = difference.iter().zip(&solution.estimate.sigmas).zip(&PARAMETER_INFO);
    for ((difference, sigma), info) in errors.take(block::ACCEL_BIAS) {
        let (error_arcsec, sigma_arcsec) = (difference / ARCSEC, sigma / ARCSEC);
        let size = error_arcsec.abs() / (TOLERANCE_SIGMAS * sigma_arcsec).max(TOLERANCE_ARCSEC);
        // NaN counts as wrong.
        if size > worst || size.is_nan() {
            worst = size;
            wrong = Some(Wrong { parameter: info.name, error_arcsec, sigma_arcsec });
        }
    }
    (worst, wrong.filter(|_| worst > 1.0 || worst.is_nan()))
}

/// Counts for one kind of fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Number of runs.
    pub runs: u32,
    /// Accepted runs.
    pub accepted: u32,
    /// Accepted runs with a wrong result.
    pub accepted_wrong: u32,
    /// Rejected runs with a correct result.
    pub rejected_right: u32,
}

impl Count {
    fn add(&mut self, outcome: &DisturbedRun) {
        let (accepted, wrong) = (outcome.verdict.accepted(), outcome.wrong.is_some());
        self.runs += 1;
        self.accepted += u32::from(accepted);
        self.accepted_wrong += u32::from(accepted && wrong);
        self.rejected_right += u32::from(!accepted && !wrong);
    }
}

/// Counts of a campaign.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Counts by kind of fault.
    pub kinds: BTreeMap<Option<FaultKind>, Count>,
    /// Counts over all runs.
    pub total: Count,
    /// Number of runs for each first reason.
    pub first_reasons: BTreeMap<&'static str, u32>,
}

impl Summary {
    /// Counts the results of runs.
    pub fn new(outcomes: &[DisturbedRun]) -> Self {
        let mut summary = Self::default();
        for outcome in outcomes {
            summary.kinds.entry(outcome.fault.as_ref().map(|fault| fault.kind)).or_default().add(outcome);
            summary.total.add(outcome);
            if let Some(reason) = outcome.verdict.reasons.first() {
                *summary.first_reasons.entry(reason_name(reason)).or_default() += 1;
            }
        }
        summary
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:34}{:>8}{:>10}{:>10}{:>16}{:>16}",
            "", "runs", "accepted", "rejected", "rejected, right", "accepted, wrong"
        )?;
        let mut line = |name: &str, count: &Count| {
            let Count { runs, accepted, accepted_wrong, rejected_right } = count;
            writeln!(f, "{name:34}{runs:8}{accepted:10}{:10}{rejected_right:16}{accepted_wrong:16}", runs - accepted)
        };
        for (kind, count) in &self.kinds {
            line(kind.map_or("no fault", FaultKind::name), count)?;
        }
        line("all", &self.total)?;
        writeln!(f, "first reasons of rejected runs:")?;
        self.first_reasons.iter().try_for_each(|(name, count)| writeln!(f, "{name:34}{count:8}"))
    }
}

fn reason_name(reason: &Reason) -> &'static str {
    match reason {
        Reason::Scale(_) => "units",
        Reason::Setting(_) => "setting",
        Reason::NoiseLevel { .. } => "noise at most stops",
        Reason::Cut { .. } => "cut short",
        Reason::TooFewSegments(_) => "too few segments",
        Reason::NotConverged(_) => "not converged",
        Reason::NotFinite { .. } => "not finite",
        Reason::Refused(_) => "measurements refused",
        Reason::Unobserved { .. } => "not observed",
        Reason::Sigma { .. } => "sigma above the required one",
        Reason::Implausible { .. } => "implausible",
        Reason::ChiSquare { .. } => "chi-square",
        Reason::Innovation { .. } => "innovation",
        Reason::Unrest { .. } => "unrest at a stop",
        Reason::Noise { .. } => "noise over the stops",
        Reason::Trends { .. } => "trends over the stops",
        Reason::Held { .. } => "channel does not change",
        Reason::Stale { .. } => "stale samples",
        Reason::Missing { .. } => "missing samples",
        Reason::Changing(_) => "change of what is constant",
        Reason::Wiring(_) => "wiring",
        Reason::Gap { .. } => "gap",
        Reason::LeftOut(_) => "segments left out",
        Reason::Changed { .. } => "changed",
        Reason::Hardware { .. } => "hardware effect",
        Reason::UnknownLatitude { .. } => "unknown latitude",
        Reason::Clock(_) => "clock",
    }
}
