//! Many runs of the separating methods, on the units, the noise and the seeds of a Monte Carlo study.

use super::monte_carlo::{MonteCarlo, joint_bounds};
use crate::base::quantity;
use crate::calibration::virtual_run::VirtualRun;
use crate::separating::{
    GimballedRun, SensorNoise, Separated, SeparatingError, SeparatingMethod, navigate, with_mounting,
};
use rayon::prelude::*;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::model::error_model::INSTALLATION_STATES;
use serde::Serialize;

/// Statistics of one installation error over many runs, arcsec.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SeparatedStatistics {
    /// Root mean square error.
    pub rms_error: f64,
    /// Mean error.
    pub mean_error: f64,
    /// Root mean square of the sigmas; `None` for a method without sigmas.
    pub sigma: Option<f64>,
    /// Mean of `(error / sigma)^2`.
    pub mean_normalized_squared: Option<f64>,
}

/// Statistics of one separating method over many runs. Runs without a result are counted and otherwise left out.
#[derive(Clone, Debug, PartialEq)]
pub struct SeparatingStudy {
    /// The method.
    pub method: SeparatingMethod,
    /// Number of runs with a result.
    pub runs: usize,
    /// Why the other runs gave no result.
    pub failures: Vec<SeparatingError>,
    /// Statistics of the twelve installation errors; `None` if no run has a result.
    pub installation: [Option<SeparatedStatistics>; INSTALLATION_STATES],
}

/// Result of a run.
struct Judged {
    separated: Separated,
    /// Estimates minus truth, arcsec.
    errors: [f64; INSTALLATION_STATES],
}

/// A run with its result, or the reason why it has none.
type Attempt = Result<Judged, SeparatingError>;

/// The separating methods on one virtual run, all on the same readings.
fn separate_run(run: &VirtualRun, methods: &[SeparatingMethod]) -> Vec<Result<Separated, SeparatingError>> {
    let site = &run.unit.site;
    let navigated = GimballedRun::new(run.drive()).and_then(|gimballed| {
        let navigated = navigate(&gimballed, site, &SensorNoise::from(&run.unit.noise))?;
        Ok((gimballed, navigated))
    });
    let of = |method: &SeparatingMethod| {
        let (gimballed, navigated) = navigated.as_ref().map_err(|error| *error)?;
        with_mounting(gimballed, site, navigated, *method)
    };
    methods.iter().map(of).collect()
}

/// Runs the study on all cores, one study for each method. `on_run` is called after each run.
pub fn separating_studies(
    monte_carlo: &MonteCarlo,
    methods: &[SeparatingMethod],
    on_run: impl Fn() + Sync,
) -> Vec<SeparatingStudy> {
    let run = |number: u64| {
        let run = monte_carlo.virtual_run(number);
        let judged = |found: Result<Separated, SeparatingError>| {
            let separated = found?;
            let errors = quantity::errors(&separated.errors, &run.unit.errors);
            Ok(Judged { separated, errors: std::array::from_fn(|index| errors[index]) })
        };
        let results: Vec<Attempt> = separate_run(&run, methods).into_iter().map(judged).collect();
        on_run();
        results
    };
    let results: Vec<Vec<Attempt>> = (0..monte_carlo.runs).into_par_iter().map(run).collect();
    let study = |(place, method): (usize, &SeparatingMethod)| {
        SeparatingStudy::new(*method, results.iter().map(|run| &run[place]))
    };
    methods.iter().enumerate().map(study).collect()
}

impl SeparatingStudy {
    fn new<'a>(method: SeparatingMethod, results: impl Iterator<Item = &'a Attempt> + Clone) -> Self {
        let good: Vec<_> = results.clone().filter_map(|result| result.as_ref().ok()).collect();
        let statistics = |index: usize| {
            let mean = |of: &dyn Fn(&Judged) -> Option<f64>| {
                let sum = good.iter().map(|run| of(run)).sum::<Option<f64>>()?;
                Some(sum / good.len() as f64)
            };
            let sigma = |run: &Judged| run.separated.sigmas[index].map(|sigma| sigma / ARCSEC);
            (!good.is_empty()).then(|| SeparatedStatistics {
                rms_error: mean(&|run| Some(run.errors[index].powi(2))).map_or(f64::NAN, f64::sqrt),
                mean_error: mean(&|run| Some(run.errors[index])).unwrap_or(f64::NAN),
                sigma: mean(&|run| Some(sigma(run)?.powi(2))).map(f64::sqrt),
                mean_normalized_squared: mean(&|run| Some((run.errors[index] / sigma(run)?).powi(2))),
            })
        };
        Self {
            method,
            runs: good.len(),
            failures: results.filter_map(|result| result.as_ref().err().copied()).collect(),
            installation: std::array::from_fn(statistics),
        }
    }

    /// Bounds of each mean `(error / sigma)^2`, within which they all are together.
    pub fn normalized_bounds(&self) -> [f64; 2] {
        let with_sigma = self.installation.iter().flatten().filter(|errors| errors.sigma.is_some());
        joint_bounds(self.runs, with_sigma.count())
    }
}
