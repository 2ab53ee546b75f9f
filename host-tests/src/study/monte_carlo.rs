//! Calibrates many virtual units, and compares the errors with the Cramer-Rao bounds and with the sigmas.

use super::closed_loop::{Ended, PowerUp, Terms};
use super::statistics::{ErrorAndSigma, ErrorStatistics, chi_square_mean_bounds};
use crate::base::quantity::{self, STATES};
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::calibration::{Outcome, Precision, Setup, is_estimated, refusal};
use crate::files::toml_file::TomlFileError;
use crate::files::unit_file::UnitConfig;
use crate::plan::prediction::bounds;
use crate::virtual_unit::presets::{RandomErrors, UnitErrors, errors_named};
use crate::virtual_unit::unit::VirtualUnit;
use anyhow::Result;
use rayon::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::model::error_model::block;
use rins_selfcal::model::options::{OPTIONAL_INFO, Options};
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::scheme::Scheme;
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
}

impl ErrorSource {
    /// Names that [`Self::named`] accepts.
    const KNOWN: &str = "table1, table3, real, random, random:1deg, random:tactical";

    /// Finds a source by name: `random`, `random:` with an angle such as `1deg`, `random:tactical`, or a name for
    /// [`errors_named`].
    ///
    /// # Errors
    /// One line that names the file and, for its contents, line and key.
    pub fn named(name: &str) -> std::result::Result<Self, TomlFileError> {
        match (name, name.strip_prefix("random:").and_then(random_errors)) {
            ("real", _) => Ok(Self::Real),
            ("random", _) => Ok(Self::Random(RandomErrors::default())),
            (_, Some(sizes)) => Ok(Self::Random(sizes)),
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
        }
    }
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
    pub methods: Vec<Method>,
    /// Floating-point type of the core.
    pub precision: Precision,
    /// Optional states and noise of the joint method.
    pub options: Options,
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
    /// Site and noise.
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
    chi_square: f64,
    degrees_of_freedom: u32,
    accepted: bool,
    converged: bool,
    finite: bool,
    aborted: bool,
    wrong: bool,
    first_reason: Option<String>,
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
        let drawn = self.errors.draw(derived_seed(self.seed, run, Stream::Errors));
        VirtualRun {
            unit: VirtualUnit {
                errors: drawn.errors,
                effects: drawn.effects,
                site: self.unit.site(),
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
    pub fn setup(&self, method: Method) -> Setup {
        let options = if method == Method::Joint { self.options } else { Options::default() };
        Setup { options, ..Setup::new(&self.unit, self.rate_hz, method, self.precision) }
    }
}

impl RunResult {
    /// Whether the run was accepted.
    pub fn accepted(&self) -> bool {
        self.accepted
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
            chi_square: f64::NAN,
            degrees_of_freedom: 0,
            accepted: false,
            converged: false,
            finite: false,
            aborted: true,
            wrong: false,
            first_reason: Some(reason),
        }
    }

    fn new(outcome: &Outcome, bounds: &[f64; STATES], unit: &VirtualUnit) -> Self {
        let (errors, sigmas) = (errors(outcome, unit), outcome.state_sigmas());
        let finite = errors.iter().chain(&sigmas).all(|number| number.is_finite());
        let of_state =
            |state: usize| ErrorAndSigma { error: errors[state], sigma: sigmas[state], bound: bounds[state] };
        Self {
            states: std::array::from_fn(of_state),
            chi_square: outcome.solution.fit.chi_square,
            degrees_of_freedom: outcome.solution.degrees_of_freedom,
            accepted: outcome.verdict.accepted(),
            converged: outcome.solution.converged,
            finite,
            aborted: false,
            wrong: (0..block::ACCEL_BIAS).any(|index| is_wrong(errors[index], sigmas[index])),
            first_reason: outcome.reasons().into_iter().next(),
        }
    }
}

/// Estimates minus truth of all states, in report units.
fn errors(outcome: &Outcome, unit: &VirtualUnit) -> [f64; STATES] {
    let truth = outcome.truth.as_ref().unwrap_or(&unit.errors);
    let parameters = quantity::errors(&outcome.estimate().errors, truth);
    let solution = &outcome.solution;
    let (found, truth) = (&solution.optional.values, unit.optional_states(solution.duration_s));
    let optional = found.iter().zip(&truth).zip(&OPTIONAL_INFO);
    let optional = optional.map(|((found, truth), info)| (found - truth) / info.unit_si);
    let mut errors = [0.0; STATES];
    errors.iter_mut().zip(parameters.into_iter().chain(optional)).for_each(|(error, found)| *error = found);
    errors
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

/// Statistics of one method over all runs. Diverged runs are counted, and left out of all other statistics.
#[derive(Clone, Debug)]
pub struct MethodStatistics {
    /// The method.
    pub method: Method,
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
    /// Statistics of each parameter and optional state; `None` for states that the method does not estimate.
    pub states: [Option<ErrorStatistics>; STATES],
    /// Bounds of each mean normalized error squared.
    pub normalized_bounds: [f64; 2],
    /// The fit.
    pub fit: FitStatistics,
    /// First reasons of the first rejected runs.
    pub rejections: Vec<String>,
}

impl MethodStatistics {
    /// Number of rejected runs whose reason is kept.
    const SHOWN_REJECTIONS: usize = 5;

    fn new(setup: &Setup, results: &[RunResult]) -> Self {
        let (method, priors) = (setup.method, setup.prior_sigmas());
        let good: Vec<_> = results.iter().filter(|result| result.finite).collect();
        let of_state = |state: usize| {
            let runs: Vec<_> = good.iter().map(|result| result.states[state]).collect();
            (is_estimated(method, state) && priors[state] > 0.0 && !runs.is_empty())
                .then(|| ErrorStatistics::new(&runs))
        };
        let accepted = results.iter().filter(|result| result.accepted).count();
        let rejections = results.iter().filter(|result| !result.accepted).filter_map(|r| r.first_reason.clone());
        Self {
            method,
            runs: good.len(),
            accepted,
            accepted_wrong: results.iter().filter(|result| result.accepted && result.wrong).count(),
            rejected: results.iter().filter(|result| !result.accepted && !result.aborted).count(),
            unconverged: results.iter().filter(|result| !result.converged && !result.aborted).count(),
            diverged: results.iter().filter(|result| !result.finite && !result.aborted).count(),
            aborted: results.iter().filter(|result| result.aborted).count(),
            states: std::array::from_fn(of_state),
            normalized_bounds: chi_square_mean_bounds(good.len(), 1.0, CONFIDENCE),
            fit: FitStatistics::new(&good),
            rejections: rejections.take(Self::SHOWN_REJECTIONS).collect(),
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
}
