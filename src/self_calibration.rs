//! Self-calibration of a running instrument: the assembly of all rooms.
//!
//! One sample and how the gimbal is in; motion commands, a corrected sample, messages out. Whoever owns the hardware calls
//! [`SelfCalibration::step`] for every sample and [`SelfCalibration::tick`] on every turn of the main loop, passes the
//! commands to the gimbal, and stores [`SelfCalibration::record`] when asked to.

use crate::angle::{Angle, ticks_to_rad};
use crate::axis::{AxisLimits, ROUNDING_RAD};
use crate::calibrator::{Calibrator, CalibratorConfig};
use crate::error_model::{Calibration, PARAMETER_INFO};
use crate::estimator::{BASIC_STATES, Estimate, FULL_STATES, HeadingSource, MAX_SEGMENTS, Solution};
use crate::gimbal::{Fault, GimbalStatus, MotionCommand};
use crate::linear::{Real, real};
use crate::policy::{Cause, Decision, Moment, PowerUpPolicy};
use crate::rehearsal::SHORTEST_STOP_S;
use crate::sample::{CorrectedSample, RawSample};
use crate::scheme::{Scheme, SchemeError};
use crate::segment::LONGEST_GAP_US;
use crate::sequencer::{Abort, AbortReason, Command, Input, Pace, Sequencer, State};
use crate::servo::MotorAndLoad;
use crate::store::{StoredCalibration, StoredVerdict};
use crate::telemetry::{Message, tell};
use crate::units::DEG;
use crate::verdict::{Reason, Verdict, VerdictLimits, unrest};
use core::fmt;
use core::mem;
use core::ops::RangeInclusive;
use heapless::String;
use serde::{Deserialize, Serialize};

/// A gyro output beyond this is motion, rad/s: fifty times Earth rate, a tenth of the slowest useful move.
const STILL_RAD_S: f64 = 0.2 * DEG;
/// Time without usable samples that ends a run, us.
const SAMPLE_LOSS_US: u64 = 1_000_000;
/// The same while an axis turns: nobody sees where, and the move is lost.
const TURNING_LOSS_US: u64 = LONGEST_GAP_US;
/// Corrected samples are reported once in this time, us.
const CORRECTED_REPORT_US: u64 = 1_000_000;

/// Everything that a run must know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelfCalibrationConfig {
    /// From samples to parameters.
    pub calibrator: CalibratorConfig,
    /// The rotation scheme.
    pub scheme: Scheme,
    /// Limits of the outer and the inner axis.
    pub axes: [AxisLimits; 2],
    /// Motors, loads and encoders of the outer and the inner axis.
    pub motors: [MotorAndLoad; 2],
    /// What a result must fulfil.
    pub limits: VerdictLimits,
    /// How long a run takes.
    pub pace: Pace,
    /// When a run begins at power-up.
    pub policy: PowerUpPolicy,
    /// Time of power-up, seconds since 1970-01-01 UTC; `None` where there is no clock.
    pub utc_s: Option<u64>,
    /// A scheme that would leave a parameter unobserved is refused before anything turns. Otherwise it is run, to see what
    /// it shows, and the result rejected.
    pub refuse_unobserved: bool,
}

const COMMANDED: Decision = Decision::Calibrate(Cause::Commanded);

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ConfigError {
    /// The sample rate is not from 50 to 10 000 Hz.
    Rate,
    /// A noise is not positive and finite, or its margin not at least 1.
    Noise,
    /// The heading or its sigma is not finite, or the sigma not positive.
    Heading,
    /// The range within which an axis stands, or the gate, is not positive and finite.
    Stillness,
    /// A limit of this axis (0 outer, 1 inner) is not positive and finite, or its travel is empty.
    Axis(u8),
    /// A number of this axis' motor and load (0 outer, 1 inner) makes no sense, or it cannot overcome its friction.
    Motor(u8),
    /// The longest run is not finite and positive.
    Pace,
    /// A limit of the power-up policy is not finite, or negative.
    Policy,
    /// A limit of the verdict is not positive and finite.
    Limits,
    /// A walk of an option is not finite, or negative.
    Options,
    /// A state is asked for that the filter of this build does not have.
    States,
    /// The scheme has more segments than fit.
    Segments,
    /// The latitude is not within a quarter turn, or height or gravity are not finite.
    Site,
    /// The scheme is wrong in itself.
    Scheme(SchemeError),
    /// The scheme turns or accelerates faster than this axis may (0 outer, 1 inner).
    TooFast(u8),
    /// This leg, counted from 1, or the start at (0, 0), leg 0, is outside the travel of this axis.
    Travel {
        /// Leg.
        leg: u8,
        /// Axis: 0 outer, 1 inner.
        axis: u8,
    },
    /// The stop of this leg, counted from 1, or the first one, leg 0, is too short to be found among the samples.
    ShortStop(u8),
    /// The scheme would leave this parameter unobserved.
    Unobserved(u8),
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: &u8| if *axis == 0 { "outer" } else { "inner" };
        match self {
            Self::Rate => f.write_str("the sample rate must be from 50 to 10 000 Hz"),
            Self::Noise => f.write_str("every noise must be finite and positive, and its margin at least 1"),
            Self::Heading => f.write_str("a configured heading must be finite, and its sigma positive"),
            Self::Stillness => f.write_str(
                "the range of an axis at rest must be positive and at most 1 deg, the gate finite and positive",
            ),
            Self::Axis(axis) => {
                write!(f, "the limits of the {} axis must be finite and positive, and its travel not empty", name(axis))
            }
            Self::Motor(axis) => write!(
                f,
                "motor and load of the {} axis must be finite and positive, and the torque above the friction",
                name(axis)
            ),
            Self::Pace => f.write_str("the longest run must be finite and positive"),
            Self::Policy => f.write_str("the temperature limit of the policy must be finite and not negative"),
            Self::Limits => f.write_str("every limit of the verdict must be finite and positive"),
            Self::Options => f.write_str("random walks of the biases must be finite and not negative"),
            Self::States => f.write_str(
                "this build has no room for bias ramps, encoder harmonics or tilt drift; build with feature \
                 optional-states, or leave them out",
            ),
            Self::Segments => write!(f, "the scheme has more than the {MAX_SEGMENTS} stops and moves that fit"),
            Self::Site => f.write_str("the latitude must be within 90 deg, height and gravity finite"),
            Self::Scheme(error) => write!(f, "the scheme: {error}"),
            Self::TooFast(axis) => {
                write!(f, "the scheme turns or accelerates faster than the {} axis may", name(axis))
            }
            Self::Travel { leg: 0, axis } => write!(f, "(0, 0) is outside the travel of the {} axis", name(axis)),
            Self::Travel { leg, axis } => write!(f, "leg {leg} leaves the travel of the {} axis", name(axis)),
            Self::ShortStop(0) => write!(f, "the first stop is too short to be measured, at least 0.5 s"),
            Self::ShortStop(leg) => write!(f, "the stop of leg {leg} is too short to be measured, at least 0.5 s"),
            Self::Unobserved(parameter) => {
                let info = PARAMETER_INFO.get(usize::from(*parameter));
                write!(f, "the scheme leaves {} unobserved", info.map_or("a parameter", |info| info.name))
            }
        }
    }
}

/// Sample rates with enough samples in a segmenter's block and within the position loop's time constant, and whole
/// microseconds between them.
const RATES_HZ: RangeInclusive<f64> = 50.0..=10_000.0;

fn positive(x: &f64) -> bool {
    x.is_finite() && *x > 0.0
}

impl SelfCalibrationConfig {
    /// Checks every number, so that nothing that follows can fail on one. Not inlined, as what prepares a run: the rehearsal
    /// needs the stack.
    ///
    /// # Errors
    /// The first thing that is wrong.
    #[inline(never)]
    pub fn check(&self) -> Result<(), ConfigError> {
        let estimator = &self.calibrator.estimator;
        let (noise, site) = (&estimator.noise, &estimator.site);
        if !RATES_HZ.contains(&self.calibrator.rate_hz) {
            return Err(ConfigError::Rate);
        }
        if ![noise.accel_psd_sqrt, noise.gyro_psd_sqrt, noise.encoder_sigma_rad, noise.margin].iter().all(positive)
            || noise.margin < 1.0
        {
            return Err(ConfigError::Noise);
        }
        if let HeadingSource::Configured { heading_rad, sigma_rad } = estimator.heading
            && !(heading_rad.is_finite() && positive(&sigma_rad))
        {
            return Err(ConfigError::Heading);
        }
        if !(f64::MIN_POSITIVE..=DEG).contains(&self.calibrator.stillness.still_rad)
            || !estimator.gate_sigma.as_ref().is_none_or(positive)
        {
            return Err(ConfigError::Stillness);
        }
        if !estimator.options.are_finite() {
            return Err(ConfigError::Options);
        }
        if !(-90.1 * DEG..=90.1 * DEG).contains(&site.latitude_rad) || !positive(&site.gravity_m_s2()) {
            return Err(ConfigError::Site);
        }
        if !self.pace.is_valid() {
            return Err(ConfigError::Pace);
        }
        if !self.policy.is_valid() {
            return Err(ConfigError::Policy);
        }
        if !self.limits.are_positive() {
            return Err(ConfigError::Limits);
        }
        check_motion(&self.scheme, &self.axes)?;
        if 2 * self.scheme.moves() + 1 > MAX_SEGMENTS {
            return Err(ConfigError::Segments);
        }
        self.check_motors()
    }

    fn check_motors(&self) -> Result<(), ConfigError> {
        let wrong = (0_u8..).zip(&self.motors).find(|(_, motor)| !motor.is_valid());
        wrong.map_or(Ok(()), |(axis, _)| Err(ConfigError::Motor(axis)))
    }

    /// What the calibrator must know for a run of the scheme.
    fn run(&self) -> CalibratorConfig {
        let mut calibrator = self.calibrator;
        if self.scheme.periods > 1 {
            calibrator.estimator.period_moves = Some(self.scheme.legs.len() as u16);
        }
        calibrator
    }
}

/// Checks a scheme in itself, and against what the outer and the inner axis can do.
///
/// # Errors
/// The first thing that is wrong.
pub fn check_motion(scheme: &Scheme, axes: &[AxisLimits; 2]) -> Result<(), ConfigError> {
    scheme.check().map_err(ConfigError::Scheme)?;
    for (axis, limits) in (0_u8..).zip(axes) {
        if !limits.are_valid() {
            return Err(ConfigError::Axis(axis));
        }
        if scheme.rate_rad_s > limits.rate_rad_s || scheme.acceleration_rad_s2 > limits.acceleration_rad_s2 {
            return Err(ConfigError::TooFast(axis));
        }
        let angles = scheme.legs.iter().map(|to| if axis == 0 { to.outer_rad } else { to.inner_rad });
        let travel = limits.lowest_rad - ROUNDING_RAD..=limits.highest_rad + ROUNDING_RAD;
        for (leg, angle) in (0_u8..).zip(core::iter::once(0.0).chain(angles)) {
            if !travel.contains(&angle) {
                return Err(ConfigError::Travel { leg, axis });
            }
        }
    }
    let stops = core::iter::once(scheme.first_stop_s).chain(scheme.legs.iter().map(|leg| leg.stop_s));
    let short = (0_u8..).zip(stops).find(|(_, stop_s)| *stop_s < SHORTEST_STOP_S);
    short.map_or(Ok(()), |(leg, _)| Err(ConfigError::ShortStop(leg)))
}

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
/// use rins_selfcal::calibrator::{Calibrator, CalibratorConfig};
/// use rins_selfcal::gimbal::{GimbalStatus, MotionCommand};
/// use rins_selfcal::linear::Vector3;
/// use rins_selfcal::self_calibration::{SelfCalibration, SelfCalibrationConfig};
/// use rins_selfcal::{method::Method, sample::RawSample, scheme::Scheme, site::Site, white_noise::Noise};
///
/// let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
/// let calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
/// let config = SelfCalibrationConfig::new(calibrator, Scheme::named("fast-180").expect("in the library"));
/// let mut memory = Box::new(Calibrator::UNCONFIGURED);
/// let mut instrument = SelfCalibration::<f64>::new(config, None, &mut memory)?;
///
/// // On a board these come from the queue, and the gimbal is [`Control`](crate::control::Control).
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
/// # Ok::<(), rins_selfcal::self_calibration::ConfigError>(())
/// ```
#[derive(Debug)]
pub struct SelfCalibration<'c, T: Real, const STATES: usize = BASIC_STATES> {
    config: SelfCalibrationConfig,
    stored: Option<(Estimate, Moment)>,
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
        let stored = stored.map(|record| (record.estimate(), record.moment()));
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
        let command = self.sequencer.step(&input);
        let motion = self.act(command, state, report);
        self.report_state(state, sample.time_us, report);
        let note = command == Command::GiveUp(None) && self.solution.is_some();
        Step { motion, corrected: self.correct(sample, report), save: command == Command::Save, note }
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
        let command = self.sequencer.abort(now_us, reason);
        let motion = self.act(command, state, report);
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

    /// Carries out a command that was given in the state `during`. Returns what the gimbal shall do, if that changes.
    fn act(&mut self, command: Command, during: State, report: &mut impl FnMut(&Message)) -> Option<MotionCommand> {
        match command {
            Command::Continue | Command::Save => {}
            Command::Decide => self.decide(report),
            Command::Begin => self.begin(report),
            Command::Release => tell(report, || Message::Released),
            Command::Hold | Command::MoveTo { .. } => {}
            Command::Measure => {
                self.calibrator.restart_counts();
                self.measuring = true;
            }
            Command::RepeatStop => self.calibrator.restart_stop(),
            Command::Weigh => self.enough = self.calibrator.weigh_piece(&self.config.limits, report),
            Command::Solve => self.solve(report),
            Command::Judge => self.judge(report),
            Command::Correct => {
                if let Some(record) = self.record() {
                    self.stored = Some((record.estimate(), record.moment()));
                }
            }
            Command::GiveUp(reason) => {
                self.measuring = false;
                if let Some(reason) = reason {
                    tell(report, || Message::Aborted(Abort { reason, during }));
                }
            }
        }
        let motion = self.motion(command);
        self.commands = self.commands.wrapping_add(motion.is_some().into());
        motion
    }

    /// What a command means for the gimbal. One that has stopped for a fault of its own does so in its own way.
    fn motion(&self, command: Command) -> Option<MotionCommand> {
        match command {
            Command::GiveUp(Some(AbortReason::Gimbal(_))) => None,
            Command::Decide | Command::Begin | Command::Hold | Command::GiveUp(_) => Some(MotionCommand::Hold),
            Command::Release => Some(MotionCommand::Release),
            Command::MoveTo { outer_rad, inner_rad } => {
                let Scheme { rate_rad_s, acceleration_rad_s2, .. } = *self.sequencer.scheme();
                let angles_rad = [outer_rad, inner_rad];
                Some(MotionCommand::MoveTo { angles_rad, rate_rad_s, acceleration_rad_s2 })
            }
            _ => None,
        }
    }

    fn decide(&mut self, report: &mut impl FnMut(&Message)) {
        let temperature_c = self.previous.map_or(f32::NAN, |sample| sample.temperature_c);
        let now = Moment { utc_s: self.config.utc_s, temperature_c };
        let decision = self.config.policy.decide(self.stored.as_ref().map(|(_, moment)| *moment), now);
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
    Calibration::new(&crate::error_model::InstrumentErrors::from_vector(&errors))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::Method;
    use crate::site::Site;
    use crate::white_noise::Noise;

    fn config() -> SelfCalibrationConfig {
        let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
        let calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
        SelfCalibrationConfig::new(calibrator, Scheme::bai(10.0, 1))
    }

    #[test]
    fn every_wrong_number_of_a_configuration_is_refused() {
        type Spoil = fn(&mut SelfCalibrationConfig);
        let wrong: [(Spoil, ConfigError); 32] = [
            (|config| config.motors[1].inertia_kg_m2 = 0.0, ConfigError::Motor(1)),
            (|config| config.motors[0].viscous_nm_s = f64::INFINITY, ConfigError::Motor(0)),
            (|config| config.motors[0].inductance_h = -1e-3, ConfigError::Motor(0)),
            (|config| config.scheme.first_stop_s = 0.49, ConfigError::ShortStop(0)),
            (|config| config.scheme.legs[6].stop_s = 0.49, ConfigError::ShortStop(7)),
            (|config| config.calibrator.estimator.noise.margin = 0.5, ConfigError::Noise),
            (|config| config.pace.longest_s = Some(f64::NAN), ConfigError::Pace),
            (|config| config.policy = too_cold(), ConfigError::Policy),
            (|config| config.calibrator.rate_hz = f64::INFINITY, ConfigError::Rate),
            (|config| config.calibrator.rate_hz = 0.0, ConfigError::Rate),
            (|config| config.calibrator.estimator.noise.accel_psd_sqrt = 0.0, ConfigError::Noise),
            (|config| config.calibrator.estimator.noise.gyro_psd_sqrt = f64::NAN, ConfigError::Noise),
            (|config| config.calibrator.estimator.noise.encoder_sigma_rad = -1e-6, ConfigError::Noise),
            (|config| config.calibrator.estimator.heading = heading(f64::NAN, 0.1), ConfigError::Heading),
            (|config| config.calibrator.estimator.heading = heading(1.0, 0.0), ConfigError::Heading),
            (|config| config.calibrator.stillness.still_rad = f64::NAN, ConfigError::Stillness),
            (|config| config.calibrator.stillness.still_rad = 1.1 * DEG, ConfigError::Stillness),
            (|config| config.calibrator.estimator.gate_sigma = Some(-5.0), ConfigError::Stillness),
            (|config| config.calibrator.estimator.site.latitude_rad = f64::NAN, ConfigError::Site),
            (|config| config.calibrator.estimator.site.measured_gravity_m_s2 = Some(0.0), ConfigError::Site),
            (|config| config.limits.scale = f64::NAN, ConfigError::Limits),
            (|config| config.limits = config.limits.requiring(0.0), ConfigError::Limits),
            (|config| config.scheme.first_stop_s = 0.0, ConfigError::Scheme(SchemeError::Stop(0))),
            (|config| config.scheme.periods = 3, ConfigError::Segments),
            (|config| config.axes[0].arrived_rad = f64::NAN, ConfigError::Axis(0)),
            (|config| config.axes[1].rate_rad_s = f64::INFINITY, ConfigError::Axis(1)),
            (|config| config.axes[1].lowest_rad = 13.0, ConfigError::Axis(1)),
            (|config| config.axes[1].rate_rad_s = 0.1, ConfigError::TooFast(1)),
            (|config| config.axes[0].acceleration_rad_s2 = 0.1, ConfigError::TooFast(0)),
            (|config| config.axes[0].lowest_rad = -4.0, ConfigError::Travel { leg: 3, axis: 0 }),
            (|config| config.axes[0].highest_rad = -0.1, ConfigError::Travel { leg: 0, axis: 0 }),
            (|config| config.axes[0].rate_rad_s = 2.2, ConfigError::Axis(0)),
        ];
        assert_eq!(config().check(), Ok(()));
        for (number, (spoil, error)) in wrong.into_iter().enumerate() {
            let mut config = config();
            spoil(&mut config);
            assert_eq!(config.check(), Err(error), "number {number}");
        }
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

    fn too_cold() -> PowerUpPolicy {
        PowerUpPolicy::WhenDue { age_s: None, temperature_k: Some(-1.0) }
    }

    fn heading(heading_rad: f64, sigma_rad: f64) -> HeadingSource {
        HeadingSource::Configured { heading_rad, sigma_rad }
    }
}
