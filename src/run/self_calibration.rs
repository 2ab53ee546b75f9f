//! Self-calibration of a running instrument: sequencer, calibrator and verdict work together.
//!
//! The inputs are one sample and the state of the gimbal. The outputs are motion commands, a corrected sample and
//! messages. The main loop ([`Instrument`](crate::instrument::Instrument)) calls [`SelfCalibration::step`] for every
//! sample and [`SelfCalibration::tick`] once per turn. It passes the commands to the gimbal, and it stores
//! [`SelfCalibration::record`] when [`Step::save`] is set.

use crate::base::angle::{Angle, ticks_to_rad};
use crate::base::clock_check::ClockFault;
use crate::base::imu_identity::ImuIdentity;
use crate::base::linear::{Real, real};
use crate::base::sample::{CorrectedSample, RawSample};
use crate::base::units::DEG;
use crate::estimator::{Estimate, EstimatorConfig, MAX_SEGMENTS, Solution};
use crate::gimbal::{Fault, GimbalStatus, MotionCommand};
use crate::model::correction::Calibration;
use crate::run::abort::{Abort, AbortReason};
use crate::run::calibrator::Calibrator;
use crate::run::config::{ConfigError, SelfCalibrationConfig};
use crate::run::policy::{Cause, Conditions, Decision, MotionLock, PowerUpPolicy};
use crate::run::result::{StoredCalibration, StoredVerdict};
use crate::run::sequencer::{Action, Input, Sequencer};
use crate::run::state::State;
use crate::run::telemetry::{Message, tell};
use crate::scheme::Scheme;
use crate::segment::LONGEST_GAP_US;
use crate::segment::intake::Admission;
use crate::verdict::{Reason, Verdict, unrest};
use core::mem;
use heapless::String;

/// A gyro output above this limit shows motion, rad/s: fifty times Earth rate, a tenth of the slowest useful move.
const STILL_RAD_S: f64 = 0.2 * DEG;
/// A run ends after this time without usable samples, us.
const SAMPLE_LOSS_US: u64 = 1_000_000;
/// A run ends after this time without usable samples while an axis turns, us. The angle is not known then, and the move
/// cannot be measured again.
const TURNING_LOSS_US: u64 = LONGEST_GAP_US;
/// Interval between reports of a corrected sample, us.
const CORRECTED_REPORT_US: u64 = 1_000_000;

const COMMANDED: Decision = Decision::Calibrate(Cause::Commanded);

/// What the main loop must do after a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub struct Step<T: Real> {
    /// The new command to the gimbal, if there is a new command.
    pub motion: Option<MotionCommand>,
    /// The sample without the instrument's errors, if a calibration is available.
    pub corrected: Option<CorrectedSample<T>>,
    /// Samples are missing between the sample before and this sample.
    pub after_gap: bool,
    /// The sample has ended a segment, which the filter has processed.
    pub ends_segment: bool,
    /// The record must be stored now. Answer with [`SelfCalibration::saved`].
    pub save: bool,
    /// The record of a rejected run may be added to the history. No answer is expected.
    pub note: bool,
}

/// When the last usable sample arrived.
#[derive(Clone, Copy, Debug)]
struct Heard {
    /// Time of arrival by the board's clock, us.
    board_us: u64,
    /// Time stamp of the sample, us.
    sample_us: u64,
}

/// A running instrument. The caller owns the configuration and the memory of the calibrator; on a board that is a static.
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
/// let mut config = SelfCalibrationConfig::new(calibrator, Scheme::named("fast-180").expect("in the library"));
/// let mut memory = Box::new(Calibrator::UNCONFIGURED);
/// let mut instrument = SelfCalibration::<f64>::new(&mut config, None, &mut memory)?;
///
/// // On a board the samples come from the queue. The gimbal is [`Control`](crate::gimbal::control::Control).
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
/// // The axes are held until base and axes have been at rest for a second. Then the axes move to the scheme's start.
/// assert_eq!(commands[0], MotionCommand::Hold);
/// assert!(matches!(commands.last(), Some(MotionCommand::MoveTo { angles_rad: [0.0, 0.0], .. })));
/// # Ok::<(), rins_selfcal::run::config::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct SelfCalibration<'c, T: Real> {
    config: &'c mut SelfCalibrationConfig,
    stored: Option<(Estimate, Conditions)>,
    /// While motion is locked, no command is given to the gimbal.
    lock: Option<MotionLock>,
    imu: Option<ImuIdentity>,
    /// What is wrong with the clock of the time stamps.
    clock: Option<ClockFault>,
    decision: Option<Decision>,
    start: bool,
    sequencer: Sequencer,
    calibrator: &'c mut Calibrator<T, MAX_SEGMENTS>,
    measuring: bool,
    previous: Option<RawSample<T>>,
    heard: Option<Heard>,
    /// Angles of the outer and the inner axis at their last detected movement.
    rest_angles: Option<[Angle; 2]>,
    /// Number of commands given to the gimbal; wraps.
    commands: u16,
    /// The last reported fault of the gimbal.
    reported_fault: Option<Fault>,
    enough: Option<bool>,
    solution: Option<Solution>,
    accepted: Option<bool>,
    verdict: StoredVerdict,
    saved: bool,
    abort: Option<AbortReason>,
    calibration: Option<Calibration<T>>,
    /// Whether the calibration in use comes from a run since power-up.
    calibrated: bool,
    corrected_report_us: Option<u64>,
}

impl<'c, T: Real> SelfCalibration<'c, T> {
    /// The instrument at power-up, with the calibration from its store.
    ///
    /// # Errors
    /// What is wrong with the configuration.
    #[inline(never)]
    pub fn new(
        config: &'c mut SelfCalibrationConfig,
        stored: Option<&StoredCalibration>,
        calibrator: &'c mut Calibrator<T, MAX_SEGMENTS>,
    ) -> Result<Self, ConfigError> {
        prepare(config, calibrator)?;
        Ok(Self::prepared(config, stored, calibrator))
    }

    /// The instrument with a configuration for which [`prepare`] has prepared the calibrator. Not inlined, because the
    /// rehearsal before it needs the stack.
    #[inline(never)]
    pub(crate) fn prepared(
        config: &'c mut SelfCalibrationConfig,
        stored: Option<&StoredCalibration>,
        calibrator: &'c mut Calibrator<T, MAX_SEGMENTS>,
    ) -> Self {
        let stored = stored.map(|record| (record.estimate(), record.conditions()));
        Self {
            sequencer: Sequencer::new(config.scheme.clone(), config.pace),
            calibrator,
            lock: None,
            imu: None,
            clock: None,
            measuring: false,
            previous: None,
            heard: None,
            rest_angles: None,
            commands: 0,
            reported_fault: None,
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

    /// Locks all motion, before the first sample. Samples are corrected as usual.
    pub fn lock_motion(&mut self, lock: MotionLock) {
        self.lock = Some(lock);
    }

    /// Why motion is locked, if it is.
    pub fn motion_lock(&self) -> Option<MotionLock> {
        self.lock
    }

    /// Tells which IMU gives the samples, before the first sample. Samples are not corrected with a stored calibration
    /// of another IMU.
    pub fn identify_imu(&mut self, imu: Option<ImuIdentity>) {
        self.imu = imu;
        let now = self.conditions();
        if self.stored.as_ref().is_some_and(|(_, stored)| stored.has_other_imu(&now)) {
            self.calibration = None;
        }
    }

    /// Tells what is wrong with the clock of the time stamps, before the first run.
    pub fn note_clock(&mut self, fault: Option<ClockFault>) {
        self.clock = fault;
    }

    /// Sets the time of power-up, seconds since 1970-01-01 UTC; `None` if it is not known. Permitted at any time: a
    /// decision and a record that come later use it.
    pub fn set_power_up_utc(&mut self, utc_s: Option<u64>) {
        self.config.utc_s = utc_s;
    }

    /// Takes one sample and the state of the gimbal. Calls `report` with every message. A sample that cannot be used
    /// (repeated, out of order or not finite) is only counted.
    #[inline(never)]
    pub fn step(&mut self, sample: &RawSample<T>, gimbal: &GimbalStatus, report: &mut impl FnMut(&Message)) -> Step<T> {
        let Admission::Admitted { after_gap, .. } = self.calibrator.admit(sample) else {
            return Step {
                motion: None,
                corrected: None,
                after_gap: false,
                ends_segment: false,
                save: false,
                note: false,
            };
        };
        let last_us = self.previous.as_ref().map_or(sample.time_us, |previous| previous.time_us);
        self.previous = Some(*sample);
        let gimbal = &self.as_commanded(gimbal);
        self.report_fault(gimbal, report);
        let ends_segment = self.measuring && self.calibrator.measure(sample);
        let state = self.sequencer.state();
        let input = self.input(sample, last_us, gimbal);
        let action = self.sequencer.step(&input);
        let motion = self.act(action, state, report);
        self.report_state(state, sample.time_us, report);
        let note = action == Action::GiveUp(None) && self.solution.is_some();
        let save = action == Action::Save;
        Step { motion, corrected: self.correct(sample, report), after_gap, ends_segment, save, note }
    }

    /// Does one bounded piece of the work on the live estimate, and reports the estimate when it is ready. Returns
    /// whether there was a piece to do. Call it after every sample.
    #[inline(never)]
    pub fn refine(&mut self, report: &mut impl FnMut(&Message)) -> bool {
        let is_due = self.measuring && self.calibrator.is_refining();
        if is_due && let Some(progress) = self.calibrator.refine_piece() {
            tell(report, || Message::Segment(progress));
        }
        is_due
    }

    /// Checks, by the board's clock (us), that samples still arrive. Call it on every turn of the main loop, after the
    /// samples, and at least ten times a second. If no usable sample has arrived for too long, the run ends, and the
    /// returned command brings the axes to rest. The axes are parked when samples arrive again.
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
        self.report_fault(gimbal, report);
        self.calibrator.resume();
        // A fault of an axis is the more useful reason.
        let reason = gimbal.fault.map_or(AbortReason::SampleLoss, AbortReason::Gimbal);
        let action = self.sequencer.abort(now_us, reason);
        let motion = self.act(action, state, report);
        self.report_state(state, now_us, report);
        motion
    }

    /// The state of the gimbal. A gimbal that has not yet taken the last command counts as moving.
    fn as_commanded(&self, gimbal: &GimbalStatus) -> GimbalStatus {
        if gimbal.commands == self.commands { *gimbal } else { GimbalStatus::default() }
    }

    /// Reports the fault that stopped the axes, once.
    fn report_fault(&mut self, gimbal: &GimbalStatus, report: &mut impl FnMut(&Message)) {
        if self.reported_fault != gimbal.fault {
            self.reported_fault = gimbal.fault;
            if let Some(fault) = gimbal.fault {
                tell(report, || Message::Fault(fault));
            }
        }
    }

    /// Starts a run if no run is under way. Whoever calls this has the authority to move the axes, so that it ends a
    /// lock after a reset.
    ///
    /// # Errors
    /// Why no run may start: the policy is never to calibrate, or the unit is not commissioned.
    pub fn start(&mut self) -> Result<(), Cause> {
        if self.lock == Some(MotionLock::NotCommissioned) {
            return Err(Cause::NotCommissioned);
        }
        if self.config.policy == PowerUpPolicy::Never {
            return Err(Cause::Policy);
        }
        self.lock = None;
        self.start = true;
        self.decision = Some(COMMANDED);
        Ok(())
    }

    /// Brings the axes to rest and holds them, in any state. A run under way ends, and no move follows. Returns the
    /// command to the gimbal, which needs no sample. Axes that were never controlled, or that are released because of a
    /// fault, receive no command.
    #[inline(never)]
    #[must_use = "the command must be given to the gimbal"]
    pub fn stop(&mut self, gimbal: &GimbalStatus, report: &mut impl FnMut(&Message)) -> Option<MotionCommand> {
        (self.start, self.abort) = (false, None);
        let (state, now_us) = (self.sequencer.state(), self.previous.map_or(0, |sample| sample.time_us));
        let action = self.sequencer.stop(now_us);
        self.carry_out(action, state, report);
        // After a fault the gimbal brings the axes to rest by itself, as well as it still can.
        let motion = if gimbal.fault.is_none() { self.command(action) } else { None };
        self.report_state(state, now_us, report);
        motion
    }

    /// Ends the run. Axes that this run has moved return to (0, 0), if base and axes are well. The stored calibration
    /// is unchanged.
    pub fn abort(&mut self) {
        self.abort_with(AbortReason::Commanded);
    }

    /// Ends the run for this reason at the next sample.
    pub(crate) fn abort_with(&mut self, reason: AbortReason) {
        self.abort = Some(reason);
    }

    /// Changes the configuration while no run is under way. Forgets segments and covariance of the last run. The
    /// calibration in use does not change.
    ///
    /// # Errors
    /// What is wrong with the changed configuration. The old configuration stays in force. Segments and covariance are
    /// kept, unless the scheme left a parameter unobserved: the rehearsal that finds this uses their memory.
    #[inline(never)]
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut SelfCalibrationConfig)) -> Result<(), ConfigError> {
        let before = self.config.clone();
        change(self.config);
        let prepared = prepare(self.config, self.calibrator);
        match prepared {
            Ok(()) => self.sequencer.reconfigure(self.config.scheme.clone(), self.config.pace),
            Err(error) => {
                *self.config = before;
                if matches!(error, ConfigError::Unobserved(_)) {
                    self.calibrator.restart(&self.config.run());
                }
            }
        }
        prepared
    }

    /// The configuration.
    pub fn config(&self) -> &SelfCalibrationConfig {
        self.config
    }

    /// Number of legs of the whole run, including the move to the start.
    pub fn legs(&self) -> u16 {
        self.sequencer.legs()
    }

    /// Nominal time from the last sample until the last segment is measured, s.
    pub fn left_s(&self) -> f64 {
        self.previous.map_or(0.0, |sample| self.sequencer.left_s(sample.time_us))
    }

    /// Outer and inner angle at the last sample, rad, from -pi to pi.
    pub fn angles_rad(&self) -> Option<[f64; 2]> {
        let rad = |angle: Angle| ticks_to_rad(i64::from(angle.ticks().cast_signed()));
        self.previous.map(|sample| [rad(sample.outer), rad(sample.inner)])
    }

    /// Whether samples are corrected.
    pub fn is_correcting(&self) -> bool {
        self.calibration.is_some()
    }

    /// Whether an accepted run since power-up gave the calibration in use.
    pub fn has_calibrated(&self) -> bool {
        self.calibrated
    }

    /// Notes that storing has ended.
    pub fn saved(&mut self) {
        self.saved = true;
    }

    /// The state of the run.
    pub fn state(&self) -> State {
        self.sequencer.state()
    }

    /// The run's calibrator, with its segments and its covariance.
    pub fn calibrator(&self) -> &Calibrator<T, MAX_SEGMENTS> {
        self.calibrator
    }

    /// The solution in the form in which it is stored once it is judged.
    pub fn record(&self) -> Option<StoredCalibration> {
        let estimator = &self.config.calibrator.estimator;
        self.solution.map(|solution| StoredCalibration {
            errors: solution.estimate.errors,
            sigmas: solution.estimate.sigmas,
            method: estimator.method,
            scheme: self.config.scheme.name.clone(),
            site: solution.site(estimator),
            utc_s: self.config.utc_s,
            temperature_c: solution.temperature_c,
            chi_square: solution.fit.chi_square,
            degrees_of_freedom: solution.degrees_of_freedom,
            software_version: String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
            verdict: self.verdict.clone(),
            imu: self.imu,
        })
    }

    fn input(&mut self, sample: &RawSample<T>, last_us: u64, gimbal: &GimbalStatus) -> Input {
        let now_us = sample.time_us;
        let lost = now_us.saturating_sub(last_us) > self.longest_silence_us();
        let (commanded, loss) = (self.abort.take(), lost.then_some(AbortReason::SampleLoss));
        let rate = self.calibrator.has_other_rate().then_some(AbortReason::SampleRate);
        // A fault of an axis comes before every other reason, because it may forbid parking.
        let abort = gimbal.fault.map(AbortReason::Gimbal).or(commanded).or(loss).or(rate);
        Input {
            now_us,
            decision: self.decision,
            start: mem::take(&mut self.start),
            still: matches!(self.sequencer.state(), State::AwaitStill | State::Stopping) && self.is_still(sample),
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

    /// Longest permitted time without usable samples, us.
    fn longest_silence_us(&self) -> u64 {
        if self.sequencer.state().is_turning() { TURNING_LOSS_US } else { SAMPLE_LOSS_US }
    }

    fn report_state(&self, before: State, time_us: u64, report: &mut impl FnMut(&Message)) {
        let (state, legs) = (self.sequencer.state(), self.sequencer.legs());
        if state != before {
            tell(report, || Message::State { time_us, state, legs });
        }
    }

    /// Whether the gyros show no motion, and both axes are still at the angles of their last detected movement. Called
    /// only while a run waits for base and axes to come to rest.
    fn is_still(&mut self, sample: &RawSample<T>) -> bool {
        let angles = [sample.outer, sample.inner];
        let rest_angles = *self.rest_angles.get_or_insert(angles);
        let away_rad =
            angles.into_iter().zip(rest_angles).map(|(now, then)| ticks_to_rad::<f64>(now.since(then).into()));
        let still_rad = self.config.calibrator.stillness.still_rad;
        if away_rad.into_iter().any(|away| away.abs() > still_rad) {
            self.rest_angles = Some(angles);
            return false;
        }
        sample.omega_g.norm() <= real(STILL_RAD_S)
    }

    /// Factor by which the stop under way must be longer than planned because of its noise. Computed when the dwell is
    /// over.
    fn extension(&self) -> f64 {
        let EstimatorConfig { noise, hardware, .. } = &self.config.calibrator.estimator;
        if noise.margin <= 1.0 || !self.is_dwell_over() {
            return 1.0;
        }
        let allowances = self.calibrator.stop_so_far().map(|stop| noise.allowances(hardware, &stop));
        allowances.iter().flatten().copied().fold(1.0, f64::max)
    }

    fn is_dwell_over(&self) -> bool {
        self.previous.is_some_and(|sample| self.sequencer.is_dwell_over(sample.time_us))
    }

    /// Whether the instrument was not at rest during the stop under way, or samples were lost. Checked when the dwell
    /// is over.
    fn is_disturbed(&self) -> bool {
        let EstimatorConfig { noise, hardware, .. } = &self.config.calibrator.estimator;
        let unrest = |calibrator: &Calibrator<T, MAX_SEGMENTS>| {
            calibrator.stop_so_far().is_some_and(|stop| unrest(&stop, noise, hardware).is_some())
        };
        self.is_dwell_over() && (self.calibrator.longest_interval_us() > LONGEST_GAP_US || unrest(self.calibrator))
    }

    /// Carries out an action of the sequencer, which was decided in the state `during`. Returns the new command to the
    /// gimbal, if there is a new command.
    fn act(&mut self, action: Action, during: State, report: &mut impl FnMut(&Message)) -> Option<MotionCommand> {
        self.carry_out(action, during, report);
        self.command(action)
    }

    /// The part of an action that is not a command to the gimbal.
    fn carry_out(&mut self, action: Action, during: State, report: &mut impl FnMut(&Message)) {
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
    }

    /// The counted command to the gimbal that belongs to an action.
    fn command(&mut self, action: Action) -> Option<MotionCommand> {
        let motion = self.motion(action);
        self.commands = self.commands.wrapping_add(motion.is_some().into());
        motion
    }

    /// The command to the gimbal that belongs to an action; none while motion is locked. A gimbal with a fault has
    /// already stopped by itself. All commands to the gimbal come from here.
    fn motion(&self, action: Action) -> Option<MotionCommand> {
        match action {
            _ if self.lock.is_some() => None,
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
        let stored = self.stored.as_ref().map(|(_, conditions)| *conditions);
        let decision = self.config.policy.decide(stored, self.conditions(), self.lock);
        self.decision = Some(decision);
        tell(report, || Message::Decided(decision));
    }

    /// The conditions now.
    fn conditions(&self) -> Conditions {
        let temperature_c = self.previous.map_or(f32::NAN, |sample| sample.temperature_c);
        Conditions { utc_s: self.config.utc_s, temperature_c, imu: self.imu }
    }

    /// Begins a run and forgets the previous run.
    fn begin(&mut self, report: &mut impl FnMut(&Message)) {
        if self.decision == Some(COMMANDED) {
            tell(report, || Message::Decided(COMMANDED));
        }
        self.calibrator.restart(&self.config.run());
        if let Some(sample) = &self.previous {
            self.calibrator.follow(sample.time_us);
        }
        (self.measuring, self.enough, self.solution) = (false, None, None);
        (self.accepted, self.saved) = (None, false);
    }

    /// Does one piece of the solution, so that the next samples do not wait for the whole. Not inlined, because most
    /// samples do not need its stack.
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
        verdict.note_clock(self.clock);
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

/// Checks a configuration by itself, then rehearses its scheme. After that the calibrator is ready for a run.
///
/// # Errors
/// What is wrong with the configuration.
#[inline(never)]
pub(crate) fn prepare<T: Real>(
    config: &SelfCalibrationConfig,
    calibrator: &mut Calibrator<T, MAX_SEGMENTS>,
) -> Result<(), ConfigError> {
    config.check()?;
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
    fn a_scheme_with_unobserved_parameters_is_refused_unless_configured_otherwise() {
        let mut calibrator = std::boxed::Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
        for name in ["8-position", "16-position"] {
            let mut config = SelfCalibrationConfig { scheme: Scheme::named(name).expect("there"), ..config() };
            // Sgxz
            let refusal = SelfCalibration::new(&mut config, None, &mut calibrator).err();
            assert_eq!(refusal, Some(ConfigError::Unobserved(1)), "{name}");
            config.refuse_unobserved = false;
            assert!(SelfCalibration::new(&mut config, None, &mut calibrator).is_ok(), "{name}");
        }
    }

    #[test]
    fn a_step_tells_whether_samples_are_missing_before_its_sample() {
        let mut calibrator = std::boxed::Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
        let mut unit = config();
        let mut run = SelfCalibration::new(&mut unit, None, &mut calibrator).expect("it is right");
        let after_gap = [5000, 10_000, 20_000, 25_000, 25_000, 30_000].map(|time_us| {
            let sample = RawSample { time_us, ..RawSample::default() };
            run.step(&sample, &GimbalStatus::default(), &mut |_| ()).after_gap
        });
        assert_eq!(after_gap, [false, false, true, false, false, false]);
    }

    #[test]
    fn a_refused_configuration_leaves_the_old_one_in_force() {
        let mut calibrator = std::boxed::Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
        let mut unit = config();
        let mut run = SelfCalibration::new(&mut unit, None, &mut calibrator).expect("it is right");
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
