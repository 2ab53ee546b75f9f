//! Self-calibration of a running instrument: sequencer, calibrator and verdict together.
//!
//! One sample and the state of the gimbal come in; motion commands, a corrected sample and messages go out. The main loop
//! ([`Instrument`](crate::instrument::Instrument)) calls [`SelfCalibration::step`] for every sample and
//! [`SelfCalibration::tick`] on every turn, passes the commands to the gimbal, and stores [`SelfCalibration::record`] when
//! asked to.

use crate::base::angle::{Angle, ticks_to_rad};
use crate::base::linear::{Real, real};
use crate::base::sample::{CorrectedSample, RawSample};
use crate::base::units::DEG;
use crate::estimator::{BASIC_STATES, Estimate, FULL_STATES, MAX_SEGMENTS, Solution};
use crate::gimbal::{Fault, GimbalStatus, MotionCommand};
use crate::model::correction::Calibration;
use crate::run::abort::{Abort, AbortReason};
use crate::run::calibrator::Calibrator;
use crate::run::config::{ConfigError, SelfCalibrationConfig};
use crate::run::policy::{Cause, Conditions, Decision, PowerUpPolicy};
use crate::run::result::{StoredCalibration, StoredVerdict};
use crate::run::sequencer::{Action, Input, Sequencer};
use crate::run::state::State;
use crate::run::telemetry::{Message, tell};
use crate::scheme::Scheme;
use crate::segment::LONGEST_GAP_US;
use crate::verdict::{Reason, Verdict, unrest};
use core::mem;
use heapless::String;

/// A gyro output beyond this is motion, rad/s: fifty times Earth rate, a tenth of the slowest useful move.
const STILL_RAD_S: f64 = 0.2 * DEG;
/// Time without usable samples that ends a run, us.
const SAMPLE_LOSS_US: u64 = 1_000_000;
/// The same while an axis turns: nobody sees where, and the move is lost.
const TURNING_LOSS_US: u64 = LONGEST_GAP_US;
/// Corrected samples are reported once in this time, us.
const CORRECTED_REPORT_US: u64 = 1_000_000;

const COMMANDED: Decision = Decision::Calibrate(Cause::Commanded);

/// What is to be done after a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use]
pub struct Step<T: Real> {
    /// What the gimbal shall do from now on, if that changes.
    pub motion: Option<MotionCommand>,
    /// The sample with the instrument's errors taken out, once there is a calibration.
    pub corrected: Option<CorrectedSample<T>>,
    /// The record shall be stored now; answer with [`SelfCalibration::saved`].
    pub save: bool,
    /// The record of a rejected run may be added to the history; no answer is waited for.
    pub note: bool,
}

/// When the last usable sample came.
#[derive(Clone, Copy, Debug)]
struct Heard {
    /// By the board's clock, us.
    board_us: u64,
    /// Its own time, us.
    sample_us: u64,
}

/// A running instrument. Its calibrator is memory of the caller's: a static on the board.
///
/// ```
/// use rins_selfcal::run::calibrator::Calibrator;
/// use rins_selfcal::run::config::CalibratorConfig;
/// use rins_selfcal::gimbal::{GimbalStatus, MotionCommand};
/// use rins_selfcal::base::linear::Vector3;
/// use rins_selfcal::run::self_calibration::SelfCalibration;
/// use rins_selfcal::run::config::SelfCalibrationConfig;
/// use rins_selfcal::base::method::Method;
/// use rins_selfcal::base::sample::RawSample;
/// use rins_selfcal::scheme::Scheme;
/// use rins_selfcal::base::site::Site;
/// use rins_selfcal::segment::white_noise::Noise;
///
/// let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
/// let calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
/// let config = SelfCalibrationConfig::new(calibrator, Scheme::named("fast-180").expect("in the library"));
/// let mut memory = Box::new(Calibrator::UNCONFIGURED);
/// let mut instrument = SelfCalibration::<f64>::new(config, None, &mut memory)?;
///
/// // On a board these come from the queue, and the gimbal is [`Control`](crate::gimbal::control::Control).
/// let mut gimbal = GimbalStatus { at_rest: true, arrived: true, ..GimbalStatus::default() };
/// let mut commands = Vec::new();
/// for number in 1..=300 {
///     let force_a = Vector3::new(0.0, 0.0, 9.79);
///     let sample = RawSample { time_us: 5000 * number, force_a, ..RawSample::default() };
///     let step = instrument.step(&sample, &gimbal, &mut |_message| ());
///     if let Some(motion) = step.motion {
///         gimbal.commands += 1;
///         commands.push(motion);
///     }
///     // Nothing is stored yet.
///     assert!(step.corrected.is_none() && !step.save);
/// }
/// // The axes are held until all has been still for a second; then they go to the scheme's start.
/// assert_eq!(commands[0], MotionCommand::Hold);
/// assert!(matches!(commands.last(), Some(MotionCommand::MoveTo { angles_rad: [0.0, 0.0], .. })));
/// # Ok::<(), rins_selfcal::run::config::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct SelfCalibration<'c, T: Real, const STATES: usize = BASIC_STATES> {
    config: SelfCalibrationConfig,
    stored: Option<(Estimate, Conditions)>,
    decision: Option<Decision>,
    start: bool,
    sequencer: Sequencer,
    calibrator: &'c mut Calibrator<T, MAX_SEGMENTS, STATES>,
    measuring: bool,
    previous: Option<RawSample<T>>,
    heard: Option<Heard>,
    /// Where the outer and the inner axis were when they were last seen to move.
    standing: Option<[Angle; 2]>,
    /// Commands given to the gimbal; wraps.
    commands: u16,
    /// The fault of the gimbal that was told last.
    told: Option<Fault>,
    enough: Option<bool>,
    solution: Option<Solution>,
    accepted: Option<bool>,
    verdict: StoredVerdict,
    saved: bool,
    abort: Option<AbortReason>,
    calibration: Option<Calibration<T>>,
    /// Whether the calibration is of a run since power-up.
    calibrated: bool,
    corrected_report_us: Option<u64>,
}

impl<'c, T: Real, const STATES: usize> SelfCalibration<'c, T, STATES> {
    /// The instrument at power-up, with the calibration that its store holds.
    ///
    /// # Errors
    /// What is wrong with the configuration.
    #[inline(never)]
    pub fn new(
        config: SelfCalibrationConfig,
        stored: Option<&StoredCalibration>,
        calibrator: &'c mut Calibrator<T, MAX_SEGMENTS, STATES>,
    ) -> Result<Self, ConfigError> {
        prepare(&config, calibrator)?;
        Ok(Self::prepared(config, stored, calibrator))
    }

    /// Not inlined: the rehearsal before needs the stack.
    #[inline(never)]
    fn prepared(
        config: SelfCalibrationConfig,
        stored: Option<&StoredCalibration>,
        calibrator: &'c mut Calibrator<T, MAX_SEGMENTS, STATES>,
    ) -> Self {
        let stored = stored.map(|record| (record.estimate(), record.conditions()));
        Self {
            sequencer: Sequencer::new(config.scheme.clone(), config.pace),
            calibrator,
            measuring: false,
            previous: None,
            heard: None,
            standing: None,
            commands: 0,
            told: None,
            enough: None,
            solution: None,
            accepted: None,
            verdict: StoredVerdict::default(),
            saved: false,
            abort: None,
            calibration: stored.as_ref().map(|(estimate, _)| calibration(estimate)),
            calibrated: false,
            decision: None,
            start: false,
            corrected_report_us: None,
            stored,
            config,
        }
    }

    /// Takes in one sample, and how the gimbal is. `report` is called with whatever there is to tell. A sample that cannot
    /// be used, repeated, out of order or not finite, changes nothing but its count.
    #[inline(never)]
    pub fn step(&mut self, sample: &RawSample<T>, gimbal: &GimbalStatus, report: &mut impl FnMut(&Message)) -> Step<T> {
        if !self.calibrator.admit(sample) {
            return Step { motion: None, corrected: None, save: false, note: false };
        }
        let last_us = self.previous.as_ref().map_or(sample.time_us, |previous| previous.time_us);
        self.previous = Some(*sample);
        let gimbal = &self.as_commanded(gimbal);
        self.tell_fault(gimbal, report);
        if self.measuring
            && let Some(progress) = self.calibrator.measure(sample)
        {
            tell(report, || Message::Segment(progress));
        }
        let state = self.sequencer.state();
        let input = self.input(sample, last_us, gimbal);
        let action = self.sequencer.step(&input);
        let motion = self.act(action, state, report);
        self.report_state(state, sample.time_us, report);
        let note = action == Action::GiveUp(None) && self.solution.is_some();
        Step { motion, corrected: self.correct(sample, report), save: action == Action::Save, note }
    }

    /// Looks at the board's clock, us: call it on every turn of the main loop, after the samples, and at least ten times a
    /// second. Where usable samples have failed to come for too long, the run ends and the axes are brought to rest by
    /// the command returned. They are parked when samples come again.
    #[inline(never)]
    pub fn tick(
        &mut self,
        board_us: u64,
        gimbal: &GimbalStatus,
        report: &mut impl FnMut(&Message),
    ) -> Option<MotionCommand> {
        let sample_us = self.previous.map_or(0, |sample| sample.time_us);
        let heard = *self.heard.get_or_insert(Heard { board_us, sample_us });
        if heard.sample_us != sample_us {
            self.heard = Some(Heard { board_us, sample_us });
            return None;
        }
        let silent_us = board_us.saturating_sub(heard.board_us);
        if silent_us <= self.longest_silence_us() {
            return None;
        }
        let (state, now_us) = (self.sequencer.state(), sample_us.saturating_add(silent_us));
        let gimbal = &self.as_commanded(gimbal);
        self.tell_fault(gimbal, report);
        self.calibrator.resume();
        // An axis that has failed is the better reason.
        let reason = gimbal.fault.map_or(AbortReason::SampleLoss, AbortReason::Gimbal);
        let action = self.sequencer.abort(now_us, reason);
        let motion = self.act(action, state, report);
        self.report_state(state, now_us, report);
        motion
    }

    /// How the gimbal is; where it has not taken the last command yet, it is on its way.
    fn as_commanded(&self, gimbal: &GimbalStatus) -> GimbalStatus {
        if gimbal.commands == self.commands { *gimbal } else { GimbalStatus::default() }
    }

    /// Says what stopped the axes, once.
    fn tell_fault(&mut self, gimbal: &GimbalStatus, report: &mut impl FnMut(&Message)) {
        if self.told != gimbal.fault {
            self.told = gimbal.fault;
            if let Some(fault) = gimbal.fault {
                tell(report, || Message::Fault(fault));
            }
        }
    }

    /// Starts a run, where none is under way. Returns whether the policy lets it.
    pub fn start(&mut self) -> bool {
        if self.config.policy == PowerUpPolicy::Never {
            return false;
        }
        self.start = true;
        self.decision = Some(COMMANDED);
        true
    }

    /// Gives the run up; the gimbals are parked and the stored calibration stays as it was.
    pub fn abort(&mut self) {
        self.abort = Some(AbortReason::Commanded);
    }

    /// Changes the configuration, while no run is under way. Segments and covariance of the last run are forgotten; the
    /// calibration in use stays.
    ///
    /// # Errors
    /// What would be wrong with it; it stays as it was. So do segments and covariance, unless the scheme had to be rehearsed
    /// to find it out, which takes their memory.
    #[inline(never)]
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut SelfCalibrationConfig)) -> Result<(), ConfigError> {
        let before = self.config.clone();
        change(&mut self.config);
        let prepared = prepare(&self.config, self.calibrator);
        match prepared {
            Ok(()) => self.sequencer.reconfigure(self.config.scheme.clone(), self.config.pace),
            Err(error) => {
                self.config = before;
                if matches!(error, ConfigError::Unobserved(_)) {
                    self.calibrator.restart(&self.config.run());
                }
            }
        }
        prepared
    }

    /// The configuration.
    pub fn config(&self) -> &SelfCalibrationConfig {
        &self.config
    }

    /// Legs of the whole run, the way to the start included.
    pub fn legs(&self) -> u16 {
        self.sequencer.legs()
    }

    /// Nominal time until all is measured, s, at the last sample.
    pub fn left_s(&self) -> f64 {
        self.previous.map_or(0.0, |sample| self.sequencer.left_s(sample.time_us))
    }

    /// Outer and inner angle at the last sample, rad, within half a turn.
    pub fn angles_rad(&self) -> Option<[f64; 2]> {
        let rad = |angle: Angle| ticks_to_rad(i64::from(angle.ticks().cast_signed()));
        self.previous.map(|sample| [rad(sample.outer), rad(sample.inner)])
    }

    /// Whether samples are corrected.
    pub fn is_correcting(&self) -> bool {
        self.calibration.is_some()
    }

    /// Whether the correction in use was found since power-up, by a run that was accepted.
    pub fn has_calibrated(&self) -> bool {
        self.calibrated
    }

    /// Tells that storing has ended.
    pub fn saved(&mut self) {
        self.saved = true;
    }

    /// Where the run is.
    pub fn state(&self) -> State {
        self.sequencer.state()
    }

    /// The calibrator of the run, with its segments and covariance.
    pub fn calibrator(&self) -> &Calibrator<T, MAX_SEGMENTS, STATES> {
        self.calibrator
    }

    /// The solution, as it is to be stored once it is judged.
    pub fn record(&self) -> Option<StoredCalibration> {
        let estimator = &self.config.calibrator.estimator;
        self.solution.map(|solution| StoredCalibration {
            errors: solution.estimate.errors,
            sigmas: solution.estimate.sigmas,
            method: estimator.method,
            scheme: self.config.scheme.name.clone(),
            site: estimator.site,
            utc_s: self.config.utc_s,
            temperature_c: solution.temperature_c,
            chi_square: solution.fit.chi_square,
            degrees_of_freedom: solution.degrees_of_freedom,
            software_version: String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
            verdict: self.verdict.clone(),
        })
    }

    fn input(&mut self, sample: &RawSample<T>, last_us: u64, gimbal: &GimbalStatus) -> Input {
        let now_us = sample.time_us;
        let lost = now_us.saturating_sub(last_us) > self.longest_silence_us();
        let (commanded, loss) = (self.abort.take(), lost.then_some(AbortReason::SampleLoss));
        // An axis that has failed must not be parked, whatever else ends the run.
        let abort = gimbal.fault.map(AbortReason::Gimbal).or(commanded).or(loss);
        Input {
            now_us,
            decision: self.decision,
            start: mem::take(&mut self.start),
            still: self.sequencer.state() == State::AwaitStill && self.is_still(sample),
            arrived: gimbal.arrived,
            at_rest: gimbal.at_rest,
            move_us: gimbal.move_us,
            disturbed: self.is_disturbed(),
            abort,
            extension: self.extension(),
            enough: self.enough.take(),
            solved: self.solution.is_some(),
            accepted: self.accepted,
            saved: self.saved,
        }
    }

    /// Longest time without usable samples that the run bears, us.
    fn longest_silence_us(&self) -> u64 {
        if self.sequencer.state().is_turning() { TURNING_LOSS_US } else { SAMPLE_LOSS_US }
    }

    fn report_state(&self, before: State, time_us: u64, report: &mut impl FnMut(&Message)) {
        let (state, legs) = (self.sequencer.state(), self.sequencer.legs());
        if state != before {
            tell(report, || Message::State { time_us, state, legs });
        }
    }

    /// Whether the gyros feel no motion, and both axes are where they were when they were last seen to move. Looked at
    /// while a run waits for it.
    fn is_still(&mut self, sample: &RawSample<T>) -> bool {
        let angles = [sample.outer, sample.inner];
        let standing = *self.standing.get_or_insert(angles);
        let away_rad = angles.into_iter().zip(standing).map(|(now, then)| ticks_to_rad::<f64>(now.since(then).into()));
        let still_rad = self.config.calibrator.stillness.still_rad;
        if away_rad.into_iter().any(|away| away.abs() > still_rad) {
            self.standing = Some(angles);
            return false;
        }
        sample.omega_g.norm() <= real(STILL_RAD_S)
    }

    /// How many times as long as planned the stop under way shall last, for as much noise. Looked at when the dwell is over.
    fn extension(&self) -> f64 {
        let noise = &self.config.calibrator.estimator.noise;
        if noise.margin <= 1.0 || !self.is_dwell_over() {
            return 1.0;
        }
        let allowances = self.calibrator.stop_so_far().map(|stop| noise.allowances(&stop));
        allowances.iter().flatten().copied().fold(1.0, f64::max)
    }

    fn is_dwell_over(&self) -> bool {
        self.previous.is_some_and(|sample| self.sequencer.is_dwell_over(sample.time_us))
    }

    /// Whether the stop under way was not at rest, or lost samples. Looked at when the dwell is over.
    fn is_disturbed(&self) -> bool {
        let noise = &self.config.calibrator.estimator.noise;
        let unrest = |calibrator: &Calibrator<T, MAX_SEGMENTS, STATES>| {
            calibrator.stop_so_far().is_some_and(|stop| unrest(&stop, noise).is_some())
        };
        self.is_dwell_over() && (self.calibrator.longest_interval_us() > LONGEST_GAP_US || unrest(self.calibrator))
    }

    /// Carries out an action of the sequencer that was decided in the state `during`. Returns what the gimbal shall do, if that changes.
    fn act(&mut self, action: Action, during: State, report: &mut impl FnMut(&Message)) -> Option<MotionCommand> {
        match action {
            Action::Continue | Action::Save => {}
            Action::Decide => self.decide(report),
            Action::Begin => self.begin(report),
            Action::Release => tell(report, || Message::Released),
            Action::Hold | Action::MoveTo { .. } => {}
            Action::Measure => {
                self.calibrator.restart_counts();
                self.measuring = true;
            }
            Action::RepeatStop => self.calibrator.restart_stop(),
            Action::Weigh => self.enough = self.calibrator.weigh_piece(&self.config.limits, report),
            Action::Solve => self.solve(report),
            Action::Judge => self.judge(report),
            Action::Correct => {
                if let Some(record) = self.record() {
                    self.stored = Some((record.estimate(), record.conditions()));
                }
            }
            Action::GiveUp(reason) => {
                self.measuring = false;
                if let Some(reason) = reason {
                    tell(report, || Message::Aborted(Abort { reason, during }));
                }
            }
        }
        let motion = self.motion(action);
        self.commands = self.commands.wrapping_add(motion.is_some().into());
        motion
    }

    /// What an action means for the gimbal. One that has stopped for a fault of its own does so in its own way.
    fn motion(&self, action: Action) -> Option<MotionCommand> {
        match action {
            Action::GiveUp(Some(AbortReason::Gimbal(_))) => None,
            Action::Decide | Action::Begin | Action::Hold | Action::GiveUp(_) => Some(MotionCommand::Hold),
            Action::Release => Some(MotionCommand::Release),
            Action::MoveTo { outer_rad, inner_rad } => {
                let Scheme { rate_rad_s, acceleration_rad_s2, .. } = *self.sequencer.scheme();
                let angles_rad = [outer_rad, inner_rad];
                Some(MotionCommand::MoveTo { angles_rad, rate_rad_s, acceleration_rad_s2 })
            }
            Action::Continue
            | Action::Measure
            | Action::RepeatStop
            | Action::Weigh
            | Action::Solve
            | Action::Judge
            | Action::Save
            | Action::Correct => None,
        }
    }

    fn decide(&mut self, report: &mut impl FnMut(&Message)) {
        let temperature_c = self.previous.map_or(f32::NAN, |sample| sample.temperature_c);
        let now = Conditions { utc_s: self.config.utc_s, temperature_c };
        let decision = self.config.policy.decide(self.stored.as_ref().map(|(_, conditions)| *conditions), now);
        self.decision = Some(decision);
        tell(report, || Message::Decided(decision));
    }

    /// Begins a run as if there had been none before.
    fn begin(&mut self, report: &mut impl FnMut(&Message)) {
        if self.decision == Some(COMMANDED) {
            tell(report, || Message::Decided(COMMANDED));
        }
        self.calibrator.restart(&self.config.run());
        (self.measuring, self.enough, self.solution) = (false, None, None);
        (self.accepted, self.saved) = (None, false);
    }

    /// One piece of it: the next samples do not wait for the whole. Not inlined: what it needs on the stack, most samples
    /// do not.
    #[inline(never)]
    fn solve(&mut self, report: &mut impl FnMut(&Message)) {
        self.measuring = false;
        self.solution = self.calibrator.conclude_piece(report);
    }

    #[inline(never)]
    fn judge(&mut self, report: &mut impl FnMut(&Message)) {
        let verdict = self.solution.as_ref().map_or_else(Verdict::default, |solution| {
            let stored = self.stored.as_ref().map(|(estimate, _)| estimate);
            self.calibrator.judge(solution, stored, &self.config.limits)
        });
        let mut verdict = verdict;
        if let Some(leg) = self.sequencer.cut_after() {
            verdict.explain(Reason::Cut { leg, legs: self.sequencer.legs() - 1 });
        }
        let accepted = self.solution.is_some() && verdict.accepted();
        if accepted {
            self.calibration = self.solution.map(|solution| calibration(&solution.estimate));
            self.calibrated = true;
        }
        self.accepted = Some(accepted);
        self.verdict = StoredVerdict::new(&verdict);
        tell(report, || Message::Judged(verdict));
    }

    fn correct(&mut self, sample: &RawSample<T>, report: &mut impl FnMut(&Message)) -> Option<CorrectedSample<T>> {
        let corrected = self.calibration.as_ref()?.correct(sample);
        if self.corrected_report_us.is_none_or(|last| sample.time_us.abs_diff(last) >= CORRECTED_REPORT_US) {
            self.corrected_report_us = Some(sample.time_us);
            tell(report, || Message::Corrected {
                time_us: sample.time_us,
                force_s: corrected.force_s.map(Real::widened).into(),
                omega_is_s: corrected.omega_is_s.map(Real::widened).into(),
            });
        }
        Some(corrected)
    }
}

/// Checks a configuration against itself and the scheme against the calibrator, which is ready for a run after that.
#[inline(never)]
fn prepare<T: Real, const STATES: usize>(
    config: &SelfCalibrationConfig,
    calibrator: &mut Calibrator<T, MAX_SEGMENTS, STATES>,
) -> Result<(), ConfigError> {
    config.check()?;
    if config.calibrator.estimator.options.needs_states() && STATES < FULL_STATES {
        return Err(ConfigError::States);
    }
    calibrator.restart(&config.run());
    let unobserved = calibrator.rehearse(&config.scheme).filter(|_| config.refuse_unobserved);
    calibrator.restart(&config.run());
    unobserved.map_or(Ok(()), |parameter| Err(ConfigError::Unobserved(parameter)))
}

fn calibration<T: Real>(estimate: &Estimate) -> Calibration<T> {
    let errors = estimate.errors.to_vector().map(real);
    Calibration::new(&crate::model::error_model::InstrumentErrors::from_vector(&errors))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::method::Method;
    use crate::base::site::Site;
    use crate::run::config::CalibratorConfig;
    use crate::segment::white_noise::Noise;

    fn config() -> SelfCalibrationConfig {
        let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
        let calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
        SelfCalibrationConfig::new(calibrator, Scheme::bai(10.0, 1))
    }

    #[test]
    fn a_scheme_that_hides_parameters_is_refused_unless_it_is_wanted_all_the_same() {
        let mut calibrator = std::boxed::Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
        for name in ["8-position", "16-position"] {
            let mut config = SelfCalibrationConfig { scheme: Scheme::named(name).expect("there"), ..config() };
            // Sgxz
            let refusal = SelfCalibration::new(config.clone(), None, &mut calibrator).err();
            assert_eq!(refusal, Some(ConfigError::Unobserved(1)), "{name}");
            config.refuse_unobserved = false;
            assert!(SelfCalibration::new(config, None, &mut calibrator).is_ok(), "{name}");
        }
    }

    #[test]
    fn a_refused_configuration_leaves_the_old_one_in_force() {
        let mut calibrator = std::boxed::Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
        let mut run = SelfCalibration::new(config(), None, &mut calibrator).expect("it is right");
        let in_force = *run.calibrator().estimator().config();
        let noisy = |config: &mut SelfCalibrationConfig| config.calibrator.estimator.noise.gyro_psd_sqrt = 4e-7;
        let refused = run.reconfigure(|config| {
            noisy(config);
            config.scheme = Scheme::named("8-position").expect("there");
        });
        assert_eq!(refused, Err(ConfigError::Unobserved(1)));
        assert_eq!((run.config(), *run.calibrator().estimator().config()), (&config(), in_force));
        assert_eq!(run.reconfigure(noisy), Ok(()));
        assert_eq!(run.calibrator().estimator().config().noise.gyro_psd_sqrt, 4e-7);
    }
}
