//! The virtual RINS in closed loop: it powers up, and the core turns it, measures, solves and judges.

use crate::calibration::{Covariance, Outcome, Precision, Setup, raw_sample};
use crate::drive::move_durations_s;
use crate::plant::Plant;
use crate::virtual_rins::VirtualRins;
use crate::virtual_run::VirtualRun;
use rins_selfcal::calibrator::{Calibrator, Progress};
use rins_selfcal::estimator::{BASIC_STATES, FULL_STATES, MAX_SEGMENTS, Solution};
use rins_selfcal::intake::IntakeCounts;
use rins_selfcal::linear::Real;
use rins_selfcal::segment::SegmentKind;
use rins_selfcal::self_calibration::{ConfigError, SelfCalibration, SelfCalibrationConfig};
use rins_selfcal::sequencer::{AbortReason, State};
use rins_selfcal::telemetry::Message;
use rins_selfcal::verdict::Verdict;

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
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS, STATES>::UNCONFIGURED);
    let mut core = SelfCalibration::new(core_config(run, setup), None, &mut calibrator)?;
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
    let covariance = Covariance::new(core.calibrator());
    Ok(match record.ended(setup) {
        Ended::Judged(outcome) => {
            Ended::Judged(Box::new(Outcome { covariance: Some(Box::new(covariance)), ..*outcome }))
        }
        aborted => aborted,
    })
}

fn core_config(run: &VirtualRun, setup: &Setup) -> SelfCalibrationConfig {
    SelfCalibrationConfig::new(setup.config(), run.scheme.clone())
}

/// What a run told, as far as its outcome needs it. The firmware tells the same.
#[derive(Clone, Debug, Default)]
pub struct Record {
    solved: Option<(Solution, IntakeCounts)>,
    verdict: Option<Verdict>,
    aborted: Option<AbortReason>,
    stops: usize,
    moves: usize,
}

impl Record {
    /// Takes in a message.
    pub fn note(&mut self, message: &Message) {
        match message {
            Message::Segment(Progress { kind: SegmentKind::Stop, .. }) => self.stops += 1,
            Message::Segment(Progress { kind: SegmentKind::Move, .. }) => self.moves += 1,
            Message::Solved { solution, counts } => self.solved = Some((*solution, *counts)),
            Message::Judged(verdict) => self.verdict = Some(verdict.clone()),
            Message::Aborted(reason) => self.aborted = Some(*reason),
            _ => {}
        }
    }

    /// How the run ended; one that told nothing was given up.
    pub fn ended(self, setup: &Setup) -> Ended {
        let (Some((solution, counts)), Some(verdict)) = (self.solved, self.verdict) else {
            return Ended::Aborted(self.aborted.unwrap_or(AbortReason::Commanded));
        };
        let (stops, moves) = (self.stops, self.moves);
        let setup = setup.clone();
        Ended::Judged(Box::new(Outcome { setup, solution, verdict, covariance: None, counts, stops, moves }))
    }
}
