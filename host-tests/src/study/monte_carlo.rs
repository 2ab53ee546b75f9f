//! Calibrates many virtual units, and compares the errors with the Cramer-Rao bounds and with the sigmas.

use super::closed_loop::{Ended, PowerUp, Terms};
use super::statistics::{
    ErrorAndSigma, ErrorStatistics, binomial_quantile, chi_square_mean_bounds, probability_beyond,
};
use crate::base::quantity::{self, STATES};
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::calibration::{HostMethod, Outcome, Precision, Setup, refusal};
use crate::files::toml_file::TomlFileError;
use crate::files::unit_file::UnitConfig;
use crate::plan::prediction::bounds;
use crate::result::report::Named;
use crate::virtual_unit::imperfections::Imperfections;
use crate::virtual_unit::presets::{RandomErrors, UnitErrors, errors_named, uniform};
use crate::virtual_unit::unit::{Effects, VirtualUnit};
use anyhow::Result;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rayon::prelude::*;
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG_H, HOUR_S, MICRO_G};
use rins_selfcal::estimator::OBSERVED_RATIO;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::model::effects::{EFFECT_INFO, effect};
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETER_INFO, PARAMETERS, ParameterInfo, block};
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::telemetry::Progress;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::SegmentKind;
use serde::Serialize;

/// Confidence of all bounds.
pub const CONFIDENCE: f64 = 0.99;

/// An estimate is wrong if its error exceeds the larger of this many sigmas and this angle.
const WRONG_SIGMAS: f64 = 4.5;
const WRONG_ARCSEC: f64 = 1.0;

/// Source of the errors of each run's unit.
#[derive(Clone, Debug)]
pub enum ErrorSource {
    /// The same in every run.
    Fixed(Box<UnitErrors>),
    /// The preset "real", with a new heading in every run.
    Real,
    /// Drawn anew in every run.
    Random(RandomErrors),
    /// Drawn anew in every run, with imperfections of navigation grade times this factor.
    Typical(f64),
    /// Drawn anew in every run, with imperfections of these sizes.
    With(Box<Hardware>),
    /// Drawn anew in every run, with these effects.
    Beside(Box<Effects>),
}

impl ErrorSource {
    /// Names that [`Self::named`] accepts.
    const KNOWN: &str = "table1, table3, real, typical, typical:0.5, random, random:1deg, random:tactical";

    /// Finds a source by name: `typical`, `typical:` with a factor, `random`, `random:` with an angle such as `1deg`,
    /// `random:tactical`, or a name for [`errors_named`].
    ///
    /// # Errors
    /// One line that names the file and, for its contents, line and key.
    pub fn named(name: &str) -> std::result::Result<Self, TomlFileError> {
        let random = name.strip_prefix("random:").and_then(random_errors);
        match (name, random, typical(name)) {
            ("real", ..) => Ok(Self::Real),
            ("random", ..) => Ok(Self::Random(RandomErrors::default())),
            ("typical", ..) => Ok(Self::Typical(1.0)),
            (_, _, Some(factor)) => Ok(Self::Typical(factor)),
            (_, Some(sizes), _) => Ok(Self::Random(sizes)),
            _ => match errors_named(name, 0) {
                Err(TomlFileError::Name { name, .. }) => Err(TomlFileError::Name { name, known: Self::KNOWN }),
                found => Ok(Self::Fixed(Box::new(found?))),
            },
        }
    }

    /// Errors of the unit of one run.
    pub fn draw(&self, seed: u64) -> UnitErrors {
        match self {
            Self::Fixed(errors) => *errors.clone(),
            Self::Real => UnitErrors { errors: crate::virtual_unit::presets::real(seed), ..UnitErrors::default() },
            Self::Random(sizes) => UnitErrors { errors: sizes.draw(seed), ..UnitErrors::default() },
            Self::Typical(factor) => imperfect(&Hardware::NAVIGATION.scaled(*factor), *factor, seed),
            Self::With(hardware) => imperfect(hardware, 0.0, seed),
            Self::Beside(effects) => {
                UnitErrors { errors: RandomErrors::default().draw(seed), effects: *effects.clone() }
            }
        }
    }
}

/// Seed of the imperfections, so that they do not follow from the errors.
const EFFECTS_SEED: u64 = 0x6566_6665_6374_7300;

/// Seeds of the drift of the base and of the site.
const DRIFT_SEED: u64 = 0x6472_6966_7400_0000;
const SITE_SEED: u64 = 0x7369_7465_7300_0000;
/// Lowest and highest place, m.
const HEIGHTS_M: [f64; 2] = [-400.0, 4000.0];

/// A place anywhere on the Earth, all parts of its surface alike.
fn anywhere(seed: u64) -> Site {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let [lowest, highest] = HEIGHTS_M;
    Site {
        latitude_rad: uniform(&mut rng, -1.0, 1.0).asin(),
        height_m: uniform(&mut rng, lowest, highest),
        measured_gravity_m_s2: None,
    }
}

/// A unit with imperfections of these sizes, at a site whose configuration is wrong by typical errors times a factor.
fn imperfect(hardware: &Hardware, site_factor: f64, seed: u64) -> UnitErrors {
    let of = |size: f32, unit: f64| f64::from(size) / unit;
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed ^ DRIFT_SEED);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let effects = Effects {
        hardware: Imperfections::draw(hardware, site_factor, seed ^ EFFECTS_SEED),
        accel_bias_walk_ug_sqrt_h: of(hardware.accel_walk, MICRO_G / HOUR_S.sqrt()),
        gyro_bias_walk_deg_h_sqrt_h: of(hardware.gyro_walk, DEG_H / HOUR_S.sqrt()),
        base_tilt_drift_arcsec_h: [(); 2].map(|()| of(hardware.base_drift, ARCSEC / HOUR_S) * normal()),
        ..Effects::default()
    };
    UnitErrors { errors: RandomErrors::default().draw(seed), effects }
}

/// Factor after `typical:`.
fn typical(name: &str) -> Option<f64> {
    let factor = name.strip_prefix("typical:")?.parse::<f64>().ok()?;
    (0.0..=100.0).contains(&factor).then_some(factor)
}

/// Sizes after `random:`: "tactical", or an angle with its unit for the installation errors.
fn random_errors(size: &str) -> Option<RandomErrors> {
    if size == "tactical" {
        return Some(RandomErrors { accel_bias_ug: 2000.0, gyro_bias_deg_h: 3.0, ..RandomErrors::default() });
    }
    let number = |suffix: &str| size.strip_suffix(suffix)?.parse::<f64>().ok();
    let size_deg = number("deg").or_else(|| number("arcsec").map(|arcsec| arcsec / 3600.0))?;
    (size_deg.is_finite() && size_deg >= 0.0).then(|| RandomErrors::default().with_installation_deg(size_deg))
}

/// A Monte Carlo study.
#[derive(Clone, Debug)]
pub struct MonteCarlo {
    /// Number of runs.
    pub runs: u64,
    /// Methods, all on the same data.
    pub methods: Vec<HostMethod>,
    /// Floating-point type of the core.
    pub precision: Precision,
    /// The scheme.
    pub scheme: Scheme,
    /// Limits of the outer and the inner axis.
    pub axes: [AxisLimits; 2],
    /// Whether a scheme that leaves parameters unobserved is refused. Otherwise it is run and every result rejected.
    pub refuse_unobserved: bool,
    /// Whether the core turns the axes, with a separate run for each method. Otherwise the scheme runs in open loop.
    pub closed_loop: bool,
    /// Errors of the units.
    pub errors: ErrorSource,
    /// Site and noise. Without a site, every unit is at another place.
    pub unit: UnitConfig,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Errors, sigmas and fit of one method in one run.
#[derive(Clone, Debug)]
pub struct RunResult {
    states: [ErrorAndSigma; STATES],
    live: Vec<LiveErrors>,
    chi_square: f64,
    degrees_of_freedom: u32,
    accepted: bool,
    converged: bool,
    finite: bool,
    aborted: bool,
    /// The worst of the twelve installation errors and the non-perpendicularity, if it is wrong, in words.
    wrong: Option<String>,
    first_reason: Option<String>,
}

/// Errors of the live estimate after one segment.
#[derive(Clone, Debug)]
struct LiveErrors {
    end_s: f64,
    kind: SegmentKind,
    /// Errors in units of their sigmas; `None` for a parameter that is not observed yet.
    normalized: [Option<f64>; PARAMETERS],
}

impl MonteCarlo {
    /// Runs the study on all cores. Returns the statistics of each method. `on_run` is called after each run with the
    /// results of all methods.
    ///
    /// # Errors
    /// The reason why the core refuses the configuration.
    pub fn run(&self, on_run: impl Fn(&[RunResult]) + Sync) -> Result<Vec<MethodStatistics>> {
        self.check()?;
        let of_every_run = matches!(self.errors, ErrorSource::Fixed(_)).then(|| self.bounds(&self.virtual_run(0)));
        let runs = (0..self.runs).into_par_iter().map(|run| {
            let results = self.run_one(run, of_every_run.as_deref());
            results.iter().for_each(|results| on_run(results));
            results
        });
        let results: Vec<Vec<RunResult>> = runs.collect::<Result<_>>()?;
        let of_method = |index: usize| results.iter().map(|run| run[index].clone()).collect::<Vec<_>>();
        let methods = self.methods.iter().enumerate();
        Ok(methods.map(|(index, method)| MethodStatistics::new(&self.setup(*method), &of_method(index))).collect())
    }

    /// Checks whether the core accepts the scheme. In open loop, the host has room for any number of segments.
    fn check(&self) -> Result<()> {
        for method in &self.methods {
            let setup = self.setup(*method).on_scheme(&self.scheme);
            let config = SelfCalibrationConfig::new(setup.config(), self.scheme.clone());
            let (axes, refuse_unobserved) = (self.axes, self.refuse_unobserved);
            match refusal::check(&SelfCalibrationConfig { axes, refuse_unobserved, ..config }) {
                Err(ConfigError::Segments) if !self.closed_loop => {}
                Err(error) => return Err(refusal::refused(error, &self.scheme, &self.axes)),
                Ok(()) => {}
            }
        }
        Ok(())
    }

    /// Duration of a run, s.
    pub fn duration_s(&self) -> f64 {
        self.virtual_run(0).duration_s()
    }

    fn run_one(&self, run: u64, bounds: Option<&[[f64; STATES]]>) -> Result<Vec<RunResult>> {
        let run = self.virtual_run(run);
        let bounds = bounds.map_or_else(|| self.bounds(&run), <[_]>::to_vec);
        let setups: Vec<_> = self.methods.iter().map(|method| self.setup(*method)).collect();
        if !self.closed_loop {
            let outcomes = run.calibrate(&setups);
            let both = outcomes.iter().zip(&bounds);
            return Ok(both.map(|(outcome, bounds)| RunResult::new(outcome, bounds, &run.unit)).collect());
        }
        let power_up = |(setup, bounds): (Setup, &[f64; STATES])| {
            let (axes, refuse_unobserved) = (self.axes, self.refuse_unobserved);
            let terms = Terms { axes, refuse_unobserved, ..Terms::default() };
            let setup = setup.on_scheme(&run.scheme);
            let ended = PowerUp::new(&run, &setup).on_terms(terms).in_process(|_| ())?;
            Ok(match ended {
                Ended::Judged(outcome) => RunResult::new(&outcome, bounds, &run.unit),
                Ended::Aborted(abort) => RunResult::none(abort.to_string()),
                Ended::NoRun(decision) => RunResult::none(decision.to_string()),
            })
        };
        setups.into_iter().zip(&bounds).map(power_up).collect()
    }

    /// Cramer-Rao bounds of each method for the unit of this run, on the scheme as written.
    fn bounds(&self, run: &VirtualRun) -> Vec<[f64; STATES]> {
        self.methods.iter().map(|method| bounds(&self.setup(*method), &run.unit, &run.scheme)).collect()
    }

    /// Unit and noise of one run.
    pub fn virtual_run(&self, run: u64) -> VirtualRun {
        let seed = derived_seed(self.seed, run, Stream::Errors);
        let drawn = self.errors.draw(seed);
        let site = if self.unit.site.is_unknown() { anywhere(seed ^ SITE_SEED) } else { self.unit.site() };
        VirtualRun {
            unit: VirtualUnit {
                errors: drawn.errors,
                effects: drawn.effects,
                site,
                noise: self.unit.noise,
                rate_hz: self.rate_hz,
            },
            scheme: self.scheme.clone(),
            seed: derived_seed(self.seed, run, Stream::Noise),
        }
    }
}

impl MonteCarlo {
    /// Setup of a method.
    pub fn setup(&self, method: impl Into<HostMethod>) -> Setup {
        Setup::new(&self.unit, self.rate_hz, method, self.precision)
    }
}

impl RunResult {
    /// Whether the run was accepted.
    pub fn accepted(&self) -> bool {
        self.accepted
    }

    /// Whether one of the twelve installation errors or the non-perpendicularity is wrong.
    pub fn is_wrong(&self) -> bool {
        self.wrong.is_some()
    }

    /// Error of a parameter in units of its sigma.
    pub fn normalized(&self, parameter: usize) -> f64 {
        self.states[parameter].error / self.states[parameter].sigma
    }

    /// Largest error of the twelve installation errors and the non-perpendicularity, in sigmas.
    fn largest_installation(&self) -> f64 {
        judged().map(|parameter| self.normalized(parameter).abs()).fold(0.0, f64::max)
    }

    /// Code of the first reason of a run that was not accepted.
    pub fn first_code(&self) -> Option<&str> {
        let reason = self.first_reason.as_deref()?;
        reason.strip_prefix('[').and_then(|rest| rest.split(']').next())
    }

    /// The largest sigma of the twelve installation errors, arcsec, and their largest error in sigmas.
    pub fn worst(&self) -> [f64; 2] {
        let twelve = &self.states[..block::ACCEL_BIAS];
        let largest = |of: &dyn Fn(&ErrorAndSigma) -> f64| twelve.iter().map(of).fold(0.0, f64::max);
        [largest(&|state| state.sigma), largest(&|state| (state.error / state.sigma).abs())]
    }

    /// Result of a run that gave no estimate, with the reason.
    fn none(reason: String) -> Self {
        Self {
            states: [ErrorAndSigma { error: f64::NAN, sigma: f64::NAN, bound: f64::NAN }; STATES],
            live: Vec::new(),
            chi_square: f64::NAN,
            degrees_of_freedom: 0,
            accepted: false,
            converged: false,
            finite: false,
            aborted: true,
            wrong: None,
            first_reason: Some(reason),
        }
    }

    fn new(outcome: &Outcome, bounds: &[f64; STATES], unit: &VirtualUnit) -> Self {
        let (errors, sigmas) = (errors(outcome, unit), outcome.state_sigmas());
        let finite = errors.iter().take(PARAMETERS).chain(&sigmas).all(|number| number.is_finite());
        let of_state =
            |state: usize| ErrorAndSigma { error: errors[state], sigma: sigmas[state], bound: bounds[state] };
        Self {
            states: std::array::from_fn(of_state),
            live: outcome
                .live
                .iter()
                .zip(&outcome.live_truth)
                .map(|(live, truth)| LiveErrors::new(outcome, live, truth))
                .collect(),
            chi_square: outcome.solution.fit.chi_square,
            degrees_of_freedom: outcome.solution.degrees_of_freedom,
            accepted: outcome.verdict.accepted(),
            converged: outcome.solution.converged,
            finite,
            aborted: false,
            wrong: wrong(&errors, &sigmas),
            first_reason: outcome.reasons().into_iter().next(),
        }
    }
}

impl LiveErrors {
    fn new(outcome: &Outcome, live: &Progress, truth: &InstrumentErrors<f64>) -> Self {
        let errors = quantity::errors(&live.estimate.errors, truth);
        let normalized = |parameter: usize| {
            let (sigma, prior) = (live.estimate.sigmas[parameter], outcome.prior_sigmas[parameter]);
            let observed = prior > 0.0 && sigma <= OBSERVED_RATIO * prior;
            observed.then(|| errors[parameter] * PARAMETER_INFO[parameter].unit_si / sigma)
        };
        Self { end_s: live.end_us as f64 * 1e-6, kind: live.kind, normalized: std::array::from_fn(normalized) }
    }
}

/// Estimates minus truth of all states, in report units; not a number for a state that has no truth of its own.
fn errors(outcome: &Outcome, unit: &VirtualUnit) -> [f64; STATES] {
    let truth = outcome.truth.as_ref().unwrap_or(&unit.errors);
    let parameters = quantity::errors(&outcome.estimate().errors, truth);
    let solution = &outcome.solution;
    let (found, mut truth) = (&solution.effects.values, unit.effect_states(solution.duration_s));
    // The unit may be elsewhere than configured.
    let configured = Site { latitude_rad: unit.site.latitude_rad, ..outcome.setup.site };
    let elsewhere = [
        (effect::LATITUDE, unit.site.latitude_rad - outcome.setup.site.latitude_rad),
        (effect::GRAVITY, unit.site.gravity_m_s2() - configured.gravity_m_s2()),
    ];
    for (effect, difference) in elsewhere {
        truth[effect] = truth[effect].map(|truth| truth + difference);
    }
    let effects = found.iter().zip(&truth).zip(&EFFECT_INFO);
    let effects = effects
        .map(|((found, truth), info)| truth.map_or(f64::NAN, |truth| (f64::from(*found) - truth) / info.unit_si));
    let mut errors = [0.0; STATES];
    errors.iter_mut().zip(parameters.into_iter().chain(effects)).for_each(|(error, found)| *error = found);
    errors
}

/// The parameters by which a result is right or wrong: the twelve installation errors and the non-perpendicularity.
fn judged() -> impl Iterator<Item = usize> {
    (0..block::ACCEL_BIAS).chain([block::NON_PERPENDICULARITY])
}

/// Bounds of means of squared normalized errors over so many runs. All of so many independent means are within them
/// with the probability [`CONFIDENCE`] or more (Bonferroni).
pub(super) fn joint_bounds(runs: usize, means: usize) -> [f64; 2] {
    chi_square_mean_bounds(runs, 1.0, 1.0 - (1.0 - CONFIDENCE) / means.max(1) as f64)
}

/// The worst of the estimates that are wrong, in words.
fn wrong(errors: &[f64; STATES], sigmas: &[f64; STATES]) -> Option<String> {
    let wrong = judged().filter(|index| is_wrong(errors[*index], sigmas[*index]));
    let worst = wrong.max_by(|a, b| (errors[*a] / sigmas[*a]).abs().total_cmp(&(errors[*b] / sigmas[*b]).abs()))?;
    let (error, sigmas) = (errors[worst], (errors[worst] / sigmas[worst]).abs());
    Some(format!("{} is off by {error:.2} arcsec, {sigmas:.1} sigma", PARAMETER_INFO[worst].name))
}

/// Whether an estimate of an installation error is wrong; error and sigma in arcsec.
fn is_wrong(error: f64, sigma: f64) -> bool {
    error.is_nan() || error.abs() > f64::max(WRONG_SIGMAS * sigma, WRONG_ARCSEC)
}

/// Chi-square of the fit over all runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FitStatistics {
    /// Mean over the runs.
    pub mean_chi_square: f64,
    /// Mean of the degrees of freedom.
    pub mean_degrees_of_freedom: f64,
    /// Bounds of the mean chi-square.
    pub bounds: [f64; 2],
}

/// Errors of the live estimate after one segment over all runs.
#[derive(Clone, Debug, Serialize)]
pub struct LiveStatistics {
    /// End of the segment, s.
    pub end_s: f64,
    /// Stop or move.
    pub kind: SegmentKind,
    /// Mean of `(error / sigma)^2` of each parameter that is observed in all runs.
    pub mean_normalized_squared: Named<f64>,
    /// Number of these means outside of the bounds.
    pub outside: usize,
}

impl LiveStatistics {
    /// Mean over all parameters that are observed.
    pub fn mean(&self) -> f64 {
        let means = &self.mean_normalized_squared.0;
        means.iter().map(|(_, mean)| mean).sum::<f64>() / means.len() as f64
    }

    /// The parameter with the largest mean.
    pub fn largest(&self) -> Option<(&'static str, f64)> {
        self.mean_normalized_squared.0.iter().copied().max_by(|(_, a), (_, b)| a.total_cmp(b))
    }
}

/// Live estimates over all runs.
#[derive(Clone, Debug, Serialize)]
pub struct LiveTable {
    /// Bounds of every mean in the table.
    pub bounds: [f64; 2],
    /// A row for each segment.
    pub segments: Vec<LiveStatistics>,
}

impl LiveTable {
    fn new(results: &[&RunResult]) -> Self {
        let segments = results.iter().map(|result| result.live.len()).min().unwrap_or(0);
        let means: Vec<Vec<_>> = (0..segments)
            .map(|segment| {
                let mean = |(parameter, info): (usize, &ParameterInfo)| {
                    let squares = results.iter().map(|run| Some(run.live[segment].normalized[parameter]?.powi(2)));
                    Some((info.name, squares.sum::<Option<f64>>()? / results.len() as f64))
                };
                PARAMETER_INFO.iter().enumerate().filter_map(mean).collect()
            })
            .collect();
        let bounds = joint_bounds(results.len(), means.iter().map(Vec::len).sum());
        let row = |(segment, means): (usize, Vec<(&'static str, f64)>)| {
            let LiveErrors { end_s, kind, .. } = results[0].live[segment];
            let outside = means.iter().filter(|(_, mean)| !(bounds[0]..=bounds[1]).contains(mean)).count();
            LiveStatistics { end_s, kind, mean_normalized_squared: Named(means), outside }
        };
        Self { bounds, segments: means.into_iter().enumerate().map(row).collect() }
    }
}

/// Statistics of one method over all runs. Diverged runs are counted, and left out of all other statistics.
#[derive(Clone, Debug)]
pub struct MethodStatistics {
    /// The method.
    pub method: HostMethod,
    /// Number of runs in the statistics.
    pub runs: usize,
    /// Runs accepted.
    pub accepted: usize,
    /// Runs accepted with one of the twelve installation errors wrong by more than 4.5 sigma and 1 arcsec.
    pub accepted_wrong: usize,
    /// Runs rejected.
    pub rejected: usize,
    /// Runs whose estimate had not converged after the last sweep.
    pub unconverged: usize,
    /// Runs that gave a number that is not finite.
    pub diverged: usize,
    /// Runs that were aborted without a result.
    pub aborted: usize,
    /// Statistics of each parameter and effect of the hardware; `None` for states that the method does not estimate.
    pub states: [Option<ErrorStatistics>; STATES],
    /// Bounds of each mean normalized error squared, within which they all are together.
    pub normalized_bounds: [f64; 2],
    /// The live estimates; without rows in closed loop.
    pub live: LiveTable,
    /// Largest error of the twelve installation errors and the non-perpendicularity in an accepted run, in sigmas.
    pub largest_accepted: f64,
    /// The fit.
    pub fit: FitStatistics,
    /// First reasons of the first rejected runs.
    pub rejections: Vec<String>,
    /// What is wrong in the first accepted runs that are wrong.
    pub wrong: Vec<String>,
}

impl MethodStatistics {
    /// Number of rejected runs whose reason is kept.
    const SHOWN_REJECTIONS: usize = 5;

    fn new(setup: &Setup, results: &[RunResult]) -> Self {
        let (method, priors) = (setup.method, setup.prior_sigmas());
        let good: Vec<_> = results.iter().filter(|result| result.finite).collect();
        let of_state = |state: usize| {
            let runs: Vec<_> = good.iter().map(|result| result.states[state]).collect();
            let has_truth = runs.iter().all(|run| run.error.is_finite());
            (method.estimates(state) && priors[state] > 0.0 && !runs.is_empty() && has_truth)
                .then(|| ErrorStatistics::new(&runs))
        };
        let accepted = results.iter().filter(|result| result.accepted).count();
        let rejections = results.iter().filter(|result| !result.accepted).filter_map(|r| r.first_reason.clone());
        let numbered = (0..).zip(results).filter(|(_, result)| result.accepted);
        let wrong = numbered
            .filter_map(|(run, result): (u64, _)| result.wrong.as_ref().map(|wrong| format!("run {run}: {wrong}")));
        let states: [_; STATES] = std::array::from_fn(of_state);
        let largest = results.iter().filter(|result| result.accepted).map(RunResult::largest_installation);
        Self {
            method,
            runs: good.len(),
            accepted,
            accepted_wrong: results.iter().filter(|result| result.accepted && result.is_wrong()).count(),
            rejected: results.iter().filter(|result| !result.accepted && !result.aborted).count(),
            unconverged: results.iter().filter(|result| !result.converged && !result.aborted).count(),
            diverged: results.iter().filter(|result| !result.finite && !result.aborted).count(),
            aborted: results.iter().filter(|result| result.aborted).count(),
            normalized_bounds: joint_bounds(good.len(), states.iter().flatten().count()),
            states,
            live: LiveTable::new(&good),
            largest_accepted: largest.fold(0.0, f64::max),
            fit: FitStatistics::new(&good),
            rejections: rejections.take(Self::SHOWN_REJECTIONS).collect(),
            wrong: wrong.take(Self::SHOWN_REJECTIONS).collect(),
        }
    }

    /// Mean and largest ratio of RMS error to bound over the states.
    pub fn ratios(&self) -> (f64, f64) {
        let ratios: Vec<_> = self.states.iter().flatten().map(|state| state.ratio).collect();
        (ratios.iter().sum::<f64>() / ratios.len() as f64, ratios.iter().copied().fold(0.0, f64::max))
    }

    /// Number of states whose ratio of RMS error to bound differs from 1 by more than the tolerance, and the number
    /// that is expected by chance.
    pub fn outside(&self) -> (usize, f64) {
        let states = || self.states.iter().flatten();
        (states().filter(|state| state.is_outside()).count(), states().map(|state| state.chance_outside).sum())
    }

    /// Number of wrong results among the accepted ones that chance does not exceed with the probability [`CONFIDENCE`].
    pub fn wrong_by_chance(&self) -> u64 {
        let probability = probability_beyond(WRONG_SIGMAS, judged().count() as u32);
        binomial_quantile(self.accepted as u64, probability, CONFIDENCE)
    }

    /// Number of states whose mean normalized error squared is inside its bounds, and number of all states.
    pub fn consistent(&self) -> (usize, usize) {
        let [low, high] = self.normalized_bounds;
        let inside = |state: &&ErrorStatistics| (low..=high).contains(&state.mean_normalized_squared);
        (self.states.iter().flatten().filter(inside).count(), self.states.iter().flatten().count())
    }
}

impl FitStatistics {
    fn new(results: &[&RunResult]) -> Self {
        let mean = |of: &dyn Fn(&RunResult) -> f64| {
            results.iter().map(|result| of(result)).sum::<f64>() / results.len() as f64
        };
        let mean_degrees_of_freedom = mean(&|result| f64::from(result.degrees_of_freedom));
        Self {
            mean_chi_square: mean(&|result| result.chi_square),
            mean_degrees_of_freedom,
            bounds: chi_square_mean_bounds(results.len(), mean_degrees_of_freedom, CONFIDENCE),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_sources_by_name() {
        let size = |name: &str| match ErrorSource::named(name) {
            Ok(ErrorSource::Random(sizes)) => Some(sizes.mounting_arcsec),
            _ => None,
        };
        assert!((size("random:1deg").unwrap() - 3600.0).abs() < 1e-9);
        assert!((size("random:20arcsec").unwrap() - 20.0).abs() < 1e-9);
        assert!(ErrorSource::named("random:much").is_err());
        assert!(matches!(ErrorSource::named("table3"), Ok(ErrorSource::Fixed(_))));
    }

    #[test]
    fn live_estimates_of_typical_units_are_honest_and_end_with_the_solution() {
        let study = MonteCarlo {
            runs: 40,
            methods: vec![HostMethod::Joint],
            precision: Precision::F64,
            scheme: Scheme::named("fast-180").unwrap(),
            axes: Default::default(),
            refuse_unobserved: true,
            closed_loop: false,
            errors: ErrorSource::Typical(1.0),
            unit: UnitConfig::default().somewhere(),
            rate_hz: 100.0,
            seed: 5,
        };
        let found = study.run(|_| ()).unwrap().remove(0);
        let [_, high] = found.live.bounds;
        let largest = found.live.segments.iter().filter_map(LiveStatistics::largest);
        // Before the last moves, the wide prior sigmas of what is not yet separated make the sigmas large.
        assert!(largest.clone().all(|(_, mean)| mean < high), "{:?} above {high}", largest.collect::<Vec<_>>());
        let last = &found.live.segments.last().unwrap().mean_normalized_squared.0;
        assert_eq!(last.len(), PARAMETERS);
        for ((name, mean), of_solution) in last.iter().zip(&found.states) {
            let of_solution = of_solution.unwrap().mean_normalized_squared;
            assert!((mean / of_solution - 1.0).abs() < 1e-9, "{name}: {mean} for {of_solution}");
        }
    }
}
