//! Self-calibration of a running instrument: the assembly of all rooms.
//!
//! One sample in; rate commands, a corrected sample, messages out. Whoever owns the hardware calls [`SelfCalibration::step`]
//! for every sample, passes the rates to the drives, and stores [`SelfCalibration::record`] when asked to.

use crate::axis::{Axis, AxisLimits};
use crate::calibrator::{Calibrator, CalibratorConfig};
use crate::error_model::Calibration;
use crate::estimator::{BASIC_STATES, Estimate, FULL_STATES, MAX_SEGMENTS, Solution};
use crate::linear::{Real, real};
use crate::sample::{CorrectedSample, RawSample};
use crate::scheme::{Scheme, SchemeError};
use crate::sequencer::{AbortReason, Command, Input, Sequencer, State};
use crate::store::StoredCalibration;
use crate::telemetry::Message;
use crate::units::DEG;
use crate::verdict::{Verdict, VerdictLimits, unrest};
use core::fmt;
use heapless::String;
use serde::{Deserialize, Serialize};

/// A gyro output beyond this is motion, rad/s: fifty times Earth rate, a tenth of the slowest useful move.
const STILL_RAD_S: f64 = 0.2 * DEG;
/// A change of an encoder angle from sample to sample beyond this is motion, rad/s.
const AXIS_STILL_RAD_S: f64 = 0.2 * DEG;
/// Sample intervals from a sample's time, the middle of its interval, to the end of the next interval, by when the drives
/// reach the commanded rates.
const RATE_LEAD_INTERVALS: f64 = 1.5;
/// Time without samples that ends a run, us.
const SAMPLE_LOSS_US: u64 = 1_000_000;
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
    /// What a result must fulfil.
    pub limits: VerdictLimits,
    /// How often a disturbed stop may be repeated.
    pub stop_repeats: u8,
    /// Whether a calibration in store is used as it is, without a new run.
    pub use_stored: bool,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ConfigError {
    /// The sample rate is not positive and finite.
    Rate,
    /// A noise is not finite, or negative.
    Noise,
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
    /// This leg, counted from 1, leaves the travel of this axis.
    Travel {
        /// Leg.
        leg: u8,
        /// Axis: 0 outer, 1 inner.
        axis: u8,
    },
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: &u8| if *axis == 0 { "outer" } else { "inner" };
        match self {
            Self::Rate => f.write_str("the sample rate must be finite and positive"),
            Self::Noise => f.write_str("every noise must be finite and not negative"),
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
            Self::Travel { leg, axis } => write!(f, "leg {leg} leaves the travel of the {} axis", name(axis)),
        }
    }
}

impl SelfCalibrationConfig {
    /// Checks every number, so that nothing that follows can fail on one.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), ConfigError> {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        let estimator = &self.calibrator.estimator;
        let (noise, site) = (&estimator.noise, &estimator.site);
        if !positive(self.calibrator.rate_hz) {
            return Err(ConfigError::Rate);
        }
        let noises = [noise.accel_psd_sqrt, noise.gyro_psd_sqrt, noise.encoder_sigma_rad];
        if noises.iter().any(|noise| !noise.is_finite() || *noise < 0.0) {
            return Err(ConfigError::Noise);
        }
        if !estimator.options.are_finite() {
            return Err(ConfigError::Options);
        }
        if 2 * self.scheme.moves() + 1 > MAX_SEGMENTS {
            return Err(ConfigError::Segments);
        }
        if site.latitude_rad.abs() > 90.1 * DEG || !positive(site.gravity_m_s2()) {
            return Err(ConfigError::Site);
        }
        self.scheme.check().map_err(ConfigError::Scheme)?;
        self.check_travel()
    }

    fn check_travel(&self) -> Result<(), ConfigError> {
        for (axis, limits) in (0_u8..).zip(&self.axes) {
            if self.scheme.rate_rad_s > limits.rate_rad_s
                || self.scheme.acceleration_rad_s2 > limits.acceleration_rad_s2
            {
                return Err(ConfigError::TooFast(axis));
            }
            for (leg, to) in (1_u8..).zip(&self.scheme.legs) {
                let angle = if axis == 0 { to.outer_rad } else { to.inner_rad };
                if !(limits.lowest_rad..=limits.highest_rad).contains(&angle) {
                    return Err(ConfigError::Travel { leg, axis });
                }
            }
        }
        Ok(())
    }
}

/// What is to be done after a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use]
pub struct Step<T: Real> {
    /// Rates that the outer and the inner drive shall reach by the next sample, rad/s.
    pub rates_rad_s: [T; 2],
    /// The sample with the instrument's errors taken out, once there is a calibration.
    pub corrected: Option<CorrectedSample<T>>,
    /// The record shall be stored now; answer with [`SelfCalibration::saved`].
    pub save: bool,
}

/// A running instrument. Its calibrator is memory of the caller's: a static on the board.
#[derive(Debug)]
pub struct SelfCalibration<'c, T: Real, const STATES: usize = BASIC_STATES> {
    config: SelfCalibrationConfig,
    stored: Option<Estimate>,
    sequencer: Sequencer,
    calibrator: &'c mut Calibrator<T, MAX_SEGMENTS, STATES>,
    measuring: bool,
    axes: [Axis<T>; 2],
    previous: Option<RawSample<T>>,
    solution: Option<Solution>,
    accepted: Option<bool>,
    saved: bool,
    abort: Option<AbortReason>,
    calibration: Option<Calibration<T>>,
    corrected_report_us: u64,
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
        config.check()?;
        if config.calibrator.estimator.options.needs_states() && STATES < FULL_STATES {
            return Err(ConfigError::States);
        }
        let use_stored = config.use_stored && stored.is_some();
        let stored = stored.map(|record| Estimate { errors: record.errors, sigmas: record.sigmas });
        let mut calibrator_config = config.calibrator;
        if config.scheme.periods > 1 {
            calibrator_config.estimator.period_moves = Some(config.scheme.legs.len() as u16);
        }
        calibrator.restart(&calibrator_config);
        Ok(Self {
            sequencer: Sequencer::new(config.scheme.clone(), use_stored, config.stop_repeats),
            calibrator,
            measuring: false,
            axes: [Axis::new(&config.axes[0]), Axis::new(&config.axes[1])],
            previous: None,
            solution: None,
            accepted: None,
            saved: false,
            abort: None,
            calibration: stored.as_ref().map(calibration),
            corrected_report_us: 0,
            stored,
            config,
        })
    }

    /// Takes in one sample. `report` is called with whatever there is to tell.
    #[inline(never)]
    pub fn step(&mut self, sample: &RawSample<T>, report: &mut impl FnMut(&Message)) -> Step<T> {
        let previous = self.previous.replace(*sample);
        self.axes[0].measure(sample.outer);
        self.axes[1].measure(sample.inner);
        if self.measuring
            && let Some(progress) = self.calibrator.step(sample)
        {
            report(&Message::Segment(progress));
        }
        let state = self.sequencer.state();
        let input = self.input(sample, previous.as_ref());
        let command = self.sequencer.step(&input);
        let save = self.act(command, sample.time_us, report);
        if state != self.sequencer.state() {
            let (state, legs) = (self.sequencer.state(), self.sequencer.legs());
            report(&Message::State { time_us: sample.time_us, state, legs });
        }
        let lead_s = real(RATE_LEAD_INTERVALS / self.config.calibrator.rate_hz);
        Step {
            rates_rad_s: self.axes.each_mut().map(|axis| axis.rate_command(sample.time_us, lead_s)),
            corrected: self.correct(sample, report),
            save,
        }
    }

    /// Gives the run up; the gimbals are parked and the stored calibration stays as it was.
    pub fn abort(&mut self) {
        self.abort = Some(AbortReason::Commanded);
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

    /// The solution, as it is to be stored.
    pub fn record(&self) -> Option<StoredCalibration> {
        let estimator = &self.config.calibrator.estimator;
        self.solution.map(|solution| StoredCalibration {
            errors: solution.estimate.errors,
            sigmas: solution.estimate.sigmas,
            method: estimator.method,
            scheme: self.config.scheme.name.clone(),
            site: estimator.site,
            temperature_c: solution.temperature_c,
            chi_square: solution.fit.chi_square,
            degrees_of_freedom: solution.degrees_of_freedom,
            software_version: String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
        })
    }

    fn input(&mut self, sample: &RawSample<T>, previous: Option<&RawSample<T>>) -> Input {
        let now_us = sample.time_us;
        let last_us = previous.map_or(now_us, |previous| previous.time_us);
        let lost = now_us.saturating_sub(last_us) > SAMPLE_LOSS_US;
        let following = |axis: &Axis<T>| axis.following_error_rad(now_us).is_some();
        let abort = match &self.axes {
            _ if self.abort.is_some() => self.abort.take(),
            _ if lost => Some(AbortReason::SampleLoss),
            [outer, _] if following(outer) => Some(AbortReason::OuterFollowing),
            [_, inner] if following(inner) => Some(AbortReason::InnerFollowing),
            _ => None,
        };
        Input {
            now_us,
            still: previous.is_some_and(|previous| self.is_still(sample, previous)),
            arrived: self.axes.iter().all(|axis| axis.has_arrived(now_us)),
            disturbed: self.is_disturbed(),
            abort,
            solved: self.solution.is_some(),
            accepted: self.accepted,
            saved: self.saved,
        }
    }

    fn is_still(&self, sample: &RawSample<T>, previous: &RawSample<T>) -> bool {
        let step_rad = AXIS_STILL_RAD_S / self.config.calibrator.rate_hz;
        let still = |now: crate::angle::Angle, before: crate::angle::Angle| {
            crate::angle::ticks_to_rad::<f64>(now.since(before).into()).abs() <= step_rad
        };
        sample.omega_g.norm() <= real(STILL_RAD_S)
            && still(sample.outer, previous.outer)
            && still(sample.inner, previous.inner)
    }

    /// Whether the stop under way was not at rest. Looked at when the dwell is over.
    fn is_disturbed(&self) -> bool {
        let noise = &self.config.calibrator.estimator.noise;
        self.sequencer.is_dwell_over(self.previous.map_or(0, |sample| sample.time_us))
            && self.calibrator.stop_so_far().is_some_and(|stop| unrest(&stop, noise).is_some())
    }

    /// Carries out a command. Returns whether the record shall be stored.
    fn act(&mut self, command: Command, now_us: u64, report: &mut impl FnMut(&Message)) -> bool {
        match command {
            Command::Continue => {}
            Command::Hold => self.axes.iter_mut().for_each(Axis::hold),
            Command::MoveTo { outer_rad, inner_rad } => {
                let Scheme { rate_rad_s, acceleration_rad_s2, .. } = *self.sequencer.scheme();
                for (axis, target_rad) in self.axes.iter_mut().zip([outer_rad, inner_rad]) {
                    axis.move_to(target_rad, rate_rad_s, acceleration_rad_s2, now_us);
                }
            }
            Command::Measure => self.measuring = true,
            Command::RepeatStop => self.calibrator.restart_stop(),
            Command::Solve => self.solve(report),
            Command::Judge => self.judge(report),
            Command::Save => return true,
            Command::Correct => {}
            Command::GiveUp(reason) => {
                self.measuring = false;
                self.axes.iter_mut().for_each(Axis::hold);
                if let Some(reason) = reason {
                    report(&Message::Aborted(reason));
                }
            }
        }
        false
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
            self.calibrator.judge(solution, self.stored.as_ref(), &self.config.limits)
        });
        let accepted = self.solution.is_some() && verdict.accepted();
        if accepted {
            self.calibration = self.solution.map(|solution| calibration(&solution.estimate));
        }
        self.accepted = Some(accepted);
        report(&Message::Judged(verdict));
    }

    fn correct(&mut self, sample: &RawSample<T>, report: &mut impl FnMut(&Message)) -> Option<CorrectedSample<T>> {
        if !matches!(self.sequencer.state(), State::Correcting | State::Parked) {
            return None;
        }
        let corrected = self.calibration.as_ref()?.correct(sample);
        if sample.time_us >= self.corrected_report_us {
            self.corrected_report_us = sample.time_us + CORRECTED_REPORT_US;
            report(&Message::Corrected {
                time_us: sample.time_us,
                force_s: corrected.force_s.map(Real::widened).into(),
                omega_is_s: corrected.omega_is_s.map(Real::widened).into(),
            });
        }
        Some(corrected)
    }
}

fn calibration<T: Real>(estimate: &Estimate) -> Calibration<T> {
    let errors = estimate.errors.to_vector().map(real);
    Calibration::new(&crate::error_model::InstrumentErrors::from_vector(&errors))
}
