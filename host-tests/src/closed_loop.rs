//! The virtual RINS in closed loop: it powers up, and the core turns it, measures, solves and judges.

use crate::calibration::{Outcome, Precision, Setup, raw_sample};
use crate::drive::move_durations_s;
use crate::plant::Plant;
use crate::virtual_rins::VirtualRins;
use crate::virtual_run::VirtualRun;
use rins_selfcal::axis::AxisLimits;
use rins_selfcal::estimator::{BASIC_STATES, FULL_STATES, Solution};
use rins_selfcal::linear::Real;
use rins_selfcal::self_calibration::{ConfigError, SelfCalibration, SelfCalibrationConfig};
use rins_selfcal::sequencer::{AbortReason, State};
use rins_selfcal::telemetry::Message;
use rins_selfcal::verdict::{Verdict, VerdictLimits};

/// How often a disturbed stop is repeated.
const STOP_REPEATS: u8 = 2;

/// How a run ended.
#[derive(Clone, Debug)]
pub enum Ended {
    /// With a result, accepted or rejected.
    Judged(Box<Outcome>),
    /// Without one.
    Aborted(AbortReason),
}

/// Runs one self-calibration from power-up to its end. `on_message` gets the time, s, and all that the core tells.
///
/// # Errors
/// What the core has against the configuration.
pub fn calibrate(run: &VirtualRun, setup: &Setup, on_message: impl FnMut(f64, &Message)) -> Result<Ended, ConfigError> {
    match (setup.precision, setup.options.needs_states()) {
        (Precision::F64, false) => calibrate_in::<f64, BASIC_STATES>(run, setup, on_message),
        (Precision::F64, true) => calibrate_in::<f64, FULL_STATES>(run, setup, on_message),
        (Precision::F32, false) => calibrate_in::<f32, BASIC_STATES>(run, setup, on_message),
        (Precision::F32, true) => calibrate_in::<f32, FULL_STATES>(run, setup, on_message),
    }
}

fn calibrate_in<T: Real, const STATES: usize>(
    run: &VirtualRun,
    setup: &Setup,
    mut on_message: impl FnMut(f64, &Message),
) -> Result<Ended, ConfigError> {
    let mut core = Box::new(SelfCalibration::<T, STATES>::new(core_config(run, setup), None)?);
    let mut rins = VirtualRins::new(&run.unit, run.seed);
    rins.expect_moves(&move_durations_s(&run.scheme, run.unit.rate_hz));
    let mut record = Record::default();
    while !matches!(core.state(), State::Correcting | State::Parked) {
        let reading = rins.advance();
        let time_s = reading.time_us as f64 * 1e-6;
        let step = core.step(&raw_sample::<T>(&reading), &mut |message| {
            record.note(message);
            on_message(time_s, message);
        });
        rins.command_rates(step.rates_rad_s.map(Real::widened));
        if step.save {
            core.saved();
        }
    }
    Ok(record.ended(setup, &core))
}

fn core_config(run: &VirtualRun, setup: &Setup) -> SelfCalibrationConfig {
    SelfCalibrationConfig {
        calibrator: setup.config(),
        scheme: run.scheme.clone(),
        axes: [AxisLimits::default(); 2],
        limits: VerdictLimits::default(),
        stop_repeats: STOP_REPEATS,
        use_stored: false,
    }
}

/// What must be remembered of the messages.
#[derive(Default)]
struct Record {
    solution: Option<Solution>,
    verdict: Option<Verdict>,
    aborted: Option<AbortReason>,
}

impl Record {
    fn note(&mut self, message: &Message) {
        match message {
            Message::Solved { solution, .. } => self.solution = Some(*solution),
            Message::Judged(verdict) => self.verdict = Some(verdict.clone()),
            Message::Aborted(reason) => self.aborted = Some(*reason),
            _ => {}
        }
    }

    fn ended<T: Real, const STATES: usize>(self, setup: &Setup, core: &SelfCalibration<T, STATES>) -> Ended {
        match (self.solution, self.verdict) {
            (Some(solution), Some(verdict)) => {
                Ended::Judged(Box::new(Outcome::new(setup, core.calibrator(), solution, verdict)))
            }
            _ => Ended::Aborted(self.aborted.unwrap_or(AbortReason::Commanded)),
        }
    }
}
