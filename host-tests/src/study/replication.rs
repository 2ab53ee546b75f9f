//! Results to compare with Bai et al., Sensors 2019, 19(18), 4005, each with the command that repeats it alone.

use super::monte_carlo::MethodStatistics;
use super::statistics::ErrorStatistics;
use crate::calibration::virtual_run::VirtualRun;
use crate::calibration::{HOST_SEGMENTS, Outcome, Setup, raw_sample};
use crate::files::truth::ParameterTable;
use crate::plan::prediction::Prediction;
use crate::result::signals::Signals;
use crate::separating::{
    GimballedRun, RunBuilder, SensorNoise, Separated, SeparatingError, SeparatingMethod, navigate, with_mounting,
};
use rayon::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::estimator::Estimator;
use rins_selfcal::model::error_model::INSTALLATION_STATES;
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::telemetry::Progress;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::Segment;

/// A Monte Carlo study of both methods on the same data.
#[derive(Clone, Debug)]
pub struct Study {
    /// Short name, the same in all files.
    pub name: &'static str,
    /// Errors of the units, in words.
    pub title: &'static str,
    /// The command that repeats the study alone.
    pub command: String,
    /// Statistics of the joint method, then of the paper's method.
    pub methods: [MethodStatistics; 2],
}

impl Study {
    /// Statistics of one method.
    pub fn of(&self, method: Method) -> &MethodStatistics {
        &self.methods[usize::from(method == Method::Bai)]
    }

    /// Statistics of one of the twelve installation errors with one method, arcsec; `None` if all runs failed.
    pub fn installation(&self, method: Method, index: usize) -> Option<&ErrorStatistics> {
        self.of(method).states[..INSTALLATION_STATES].get(index)?.as_ref()
    }

    /// Index and size (arcsec) of the largest mean error of the twelve installation errors.
    pub fn worst_mean(&self, method: Method) -> Option<(usize, f64)> {
        let errors = self.of(method).states[..INSTALLATION_STATES].iter().enumerate();
        let sizes = errors.filter_map(|(index, errors)| Some((index, errors.as_ref()?.mean_error.abs())));
        sizes.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Index and size (arcsec) of the largest root mean square error of the twelve installation errors.
    pub fn worst_rms(&self, method: Method) -> Option<(usize, f64)> {
        let errors = self.of(method).states[..INSTALLATION_STATES].iter().enumerate();
        let sizes = errors.filter_map(|(index, errors)| Some((index, errors.as_ref()?.rms_error)));
        sizes.max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// One calibration with the paper's method, with signals and truth for figures.
#[derive(Clone, Debug)]
pub struct ShownRun {
    /// The commands that repeat signals, final estimates and separated angles alone.
    pub commands: Vec<String>,
    /// The calibration. Its estimate after a segment is the final estimate from all segments up to then.
    pub outcome: Outcome,
    /// The true parameters.
    pub truth: ParameterTable,
    /// Signals of IMU and encoders.
    pub signals: Signals,
    /// The same readings through the separating methods: \[11\] with \[13\], which is the paper's reference, and \[11\] with
    /// \[14\].
    pub separated: [Separated; 2],
}

impl ShownRun {
    /// Runs a unit on its scheme.
    ///
    /// # Errors
    /// The separating methods give no result.
    pub fn new(commands: Vec<String>, run: &VirtualRun, setup: &Setup) -> Result<Self, SeparatingError> {
        let mut signals = Signals::default();
        let mut calibrator = Box::new(Calibrator::<f64, HOST_SEGMENTS>::new(&setup.config()));
        let mut gimballed = RunBuilder::default();
        let mut outcomes = run.calibrate_noting(std::slice::from_ref(setup), |reading| {
            signals.note(reading);
            gimballed.note(reading);
            let _ = calibrator.step(&raw_sample(reading));
        });
        let _ = calibrator.finish();
        let live = finals(setup, calibrator.estimator().segments());
        let outcome = Outcome { live, ..outcomes.remove(0) };
        let separated = separate_run_of(&gimballed.build()?, run)?;
        Ok(Self { commands, outcome, truth: ParameterTable::from_errors(&run.unit.errors), signals, separated })
    }
}

/// \[11\] with \[13\], then \[11\] with \[14\].
fn separate_run_of(gimballed: &GimballedRun, run: &VirtualRun) -> Result<[Separated; 2], SeparatingError> {
    let site = &run.unit.site;
    let navigated = navigate(gimballed, site, &SensorNoise::from(&run.unit.noise))?;
    let of = |method| with_mounting(gimballed, site, &navigated, method);
    Ok([of(SeparatingMethod::ThinShell)?, of(SeparatingMethod::SingularValues)?])
}

/// The final estimate after every segment: all segments up to then are processed until the estimate has converged.
fn finals(setup: &Setup, segments: &[Segment<f64>]) -> Vec<Progress> {
    let up_to = |count: usize| {
        let mut estimator = Box::new(Estimator::<f64, HOST_SEGMENTS>::new());
        estimator.restart(&setup.config().estimator);
        let (last, all) = (segments.get(count)?, segments.get(..=count)?);
        all.iter().for_each(|segment| _ = estimator.add(segment));
        while !estimator.solve_piece() {}
        let estimate = estimator.solution()?.estimate;
        let end_us = last.start_us + last.duration_us;
        Some(Progress { segments: count as u16 + 1, kind: last.kind(), end_us, estimate })
    };
    (0..segments.len()).into_par_iter().filter_map(up_to).collect()
}

/// Prediction for a scheme, and the command that prints it.
#[derive(Clone, Debug)]
pub struct Foresight {
    /// The prediction.
    pub prediction: Prediction,
    /// The command.
    pub command: String,
}

/// All results that are compared with the paper.
#[derive(Clone, Debug)]
pub struct Replication {
    /// The command that writes all numbers.
    pub command: String,
    /// Both periods of the paper's scheme.
    pub scheme: Scheme,
    /// Setup of the paper's method.
    pub setup: Setup,
    /// Observability on the paper's scheme.
    pub observability: Foresight,
    /// The calibration of Table 3 as the paper has it: one run of a virtual unit of which only the twelve errors of Table 3
    /// are not zero.
    pub twelve: ShownRun,
    /// The simulated unit of Table 1.
    pub simulation: ShownRun,
    /// A virtual unit with the errors of Table 3 and all other errors of a real unit.
    pub laboratory: ShownRun,
    /// Many runs of the unit of Table 1.
    pub table_1: Study,
    /// Many runs of the twelve errors of Table 3 with all other errors zero.
    pub table_3: Study,
    /// Many runs of the twelve errors of Table 3 with all other errors of a real unit.
    pub real: Study,
    /// One study for each effect that the paper's method takes as zero.
    pub ignored: Vec<Study>,
    /// Predictions for schemes with the joint method.
    pub schemes: Vec<Foresight>,
}
