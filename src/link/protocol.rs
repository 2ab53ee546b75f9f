//! Commands and answers of the link. The other rooms define the messages.

use super::frame::{Dropped, PROTOCOL_VERSION, Payload};
use crate::base::units::DEG;
use crate::estimator::{Estimate, STATES};
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::MotorAndLoad;
use crate::gimbal::travel::LocateError;
use crate::keep::black_box::Entry;
use crate::keep::record::FORMAT_VERSION;
use crate::model::error_model::PARAMETERS;
use crate::run::config::CalibratorConfig;
use crate::run::config::{ConfigError, SelfCalibrationConfig};
use crate::run::policy::{MotionLock, PowerUpPolicy};
use crate::run::result::StoredCalibration;
use crate::run::sequencer::Pace;
use crate::run::state::State;
use crate::run::telemetry::Message;
use crate::run::unit::UnitName;
use crate::scheme::Scheme;
use crate::verdict::VerdictLimits;
use core::fmt;
use heapless::String;
use serde::{Deserialize, Serialize};

impl Payload for Message {
    const KIND: u8 = b'M';
}

/// A command to the instrument. Its frame has a number, which the answer repeats.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Command {
    /// Report what the instrument is: [`Answer::Hello`].
    Hello,
    /// Report the state of the instrument: [`Answer::Status`].
    Status,
    /// Begin a run, if no run is under way. Permitted only when unlocked.
    Start,
    /// Abort the run. Axes that this run has moved return to (0, 0), if base and axes are well.
    Abort,
    /// Report this item.
    Read(Item),
    /// Send every corrected sample as a [`super::CorrectedReport`], or stop doing so. A stream that is on already goes
    /// on counting: to count from 0, switch the stream off first.
    Stream(bool),
    /// Permit changes of settings and erasing for [`super::UNLOCKED_US`]. The number must be [`super::UNLOCK_WORD`].
    Unlock(u32),
    /// Change the configuration until power-off. Permitted only when unlocked and while no run is under way. The time
    /// of power-up may be set at any time.
    Set(Setting),
    /// Erase the stored calibrations. Samples are corrected with the calibration in use until power-off. Permitted only
    /// when unlocked and while no run is under way. Erasing takes seconds. Samples that do not fit into the queue
    /// meanwhile are not corrected, but counted.
    Erase,
    /// Bring both axes to rest and hold them. Permitted in every state, locked or not. A run under way ends, and no
    /// move follows.
    Stop,
    /// Keep the configuration in force as that of the unit with this name. The unit is then commissioned from the next
    /// power-up on. Permitted only when unlocked and while no run is under way.
    Commission(UnitName),
    /// Erase the configuration of the unit. From the next power-up on nothing moves. Permitted only when unlocked and
    /// while no run is under way. Calibrations are kept.
    Decommission,
    /// Say where axes of limited travel stand: the outer and the inner angle, counted over whole turns, rad, as exact
    /// as [`CONFIRM_TOLERANCE_RAD`]. Permitted only when unlocked and while no run is under way.
    ConfirmAngles([Option<f32>; 2]),
}

/// Greatest difference between an angle that an operator confirms and the reading of the encoder, rad.
pub const CONFIRM_TOLERANCE_RAD: f64 = 60.0 * DEG;

impl Payload for Command {
    const KIND: u8 = b'C';
}

/// An item that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Item {
    /// The stored calibration.
    Calibration,
    /// The live estimate.
    Estimate,
    /// A row of the live covariance of the parameters.
    Covariance {
        /// Index of the row's parameter.
        row: u8,
    },
    /// A part of the configuration.
    Setting(SettingName),
    /// An entry of the history of calibrations, rejected ones included.
    History {
        /// Number of newer entries.
        back: u16,
    },
    /// An event of the black box.
    Event {
        /// Number of newer events.
        back: u16,
    },
    /// The name of the unit.
    Unit,
}

/// A part of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Setting {
    /// The configuration from samples to parameters: sample rate, site, noise, heading, options.
    Calibrator(CalibratorConfig),
    /// The rotation scheme.
    Scheme(Scheme),
    /// Limits of the outer and the inner axis.
    Axes([AxisLimits; 2]),
    /// The limits of the verdict.
    Limits(VerdictLimits),
    /// The limits on the duration of a run.
    Pace(Pace),
    /// When a run begins at power-up.
    Policy(PowerUpPolicy),
    /// Time of power-up, seconds since 1970-01-01 UTC.
    PowerUpUtc(Option<u64>),
    /// Motors, loads and encoders of the outer and the inner axis.
    Motors([MotorAndLoad; 2]),
}

/// Name of a part of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingName {
    /// See [`Setting::Calibrator`].
    Calibrator,
    /// See [`Setting::Scheme`].
    Scheme,
    /// See [`Setting::Axes`].
    Axes,
    /// See [`Setting::Limits`].
    Limits,
    /// See [`Setting::Pace`].
    Pace,
    /// See [`Setting::Policy`].
    Policy,
    /// See [`Setting::PowerUpUtc`].
    PowerUpUtc,
    /// See [`Setting::Motors`].
    Motors,
}

impl SettingName {
    /// All names.
    pub const ALL: [Self; 8] = [
        Self::Calibrator,
        Self::Scheme,
        Self::Axes,
        Self::Limits,
        Self::Pace,
        Self::Policy,
        Self::PowerUpUtc,
        Self::Motors,
    ];
}

impl Setting {
    /// The part of a configuration that has this name.
    pub fn of(config: &SelfCalibrationConfig, name: SettingName) -> Self {
        match name {
            SettingName::Calibrator => Self::Calibrator(config.calibrator),
            SettingName::Scheme => Self::Scheme(config.scheme.clone()),
            SettingName::Axes => Self::Axes(config.axes),
            SettingName::Limits => Self::Limits(config.limits),
            SettingName::Pace => Self::Pace(config.pace),
            SettingName::Policy => Self::Policy(config.policy),
            SettingName::PowerUpUtc => Self::PowerUpUtc(config.utc_s),
            SettingName::Motors => Self::Motors(config.motors),
        }
    }

    /// Writes this part into a configuration without any check.
    pub fn put(&self, config: &mut SelfCalibrationConfig) {
        match self {
            Self::Calibrator(calibrator) => config.calibrator = *calibrator,
            Self::Scheme(scheme) => config.scheme.clone_from(scheme),
            Self::Axes(axes) => config.axes = *axes,
            Self::Limits(limits) => config.limits = *limits,
            Self::Pace(pace) => config.pace = *pace,
            Self::Policy(policy) => config.policy = *policy,
            Self::PowerUpUtc(utc_s) => config.utc_s = *utc_s,
            Self::Motors(motors) => config.motors = *motors,
        }
    }
}

/// The answer to a command. Its frame has the number of the command. Number 0 marks an answer without a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Answer {
    /// The command was carried out, or has begun.
    Done,
    /// The instrument refused the command.
    Refused(Refusal),
    /// What the instrument is. Also sent at power-up, and after a frame of another version.
    Hello(Hello),
    /// The state of the instrument. Also sent twice a second.
    Status(Status),
    /// A stored calibration.
    Calibration(StoredCalibration),
    /// The live estimate.
    Estimate {
        /// Number of segments in the estimate.
        segments: u16,
        /// The estimate.
        estimate: Estimate,
    },
    /// A row of the live covariance of the parameters, SI.
    Covariance {
        /// Index of the row's parameter.
        row: u8,
        /// The row.
        values: [f64; PARAMETERS],
    },
    /// A part of the configuration.
    Setting(Setting),
    /// An event of the black box.
    Event(Entry),
    /// The name of the unit.
    Unit(UnitName),
}

impl Payload for Answer {
    const KIND: u8 = b'A';
}

/// Why a command is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// The frame is whole, but holds no command of this version.
    NotUnderstood,
    /// The command is not allowed in this state.
    NotNow(State),
    /// The power-up policy is never to calibrate.
    Policy,
    /// The instrument must be unlocked first.
    Locked,
    /// The word does not unlock the instrument.
    WrongWord,
    /// The configuration is not valid.
    Config(ConfigError),
    /// The instrument does not have the requested item.
    Nothing,
    /// The calibration memory does not work.
    Memory,
    /// The unit is not commissioned, so nothing may move.
    NotCommissioned,
    /// The axes cannot stand where the command says.
    Locate(LocateError),
}

impl Refusal {
    /// Short name of the refusal. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotUnderstood => "not-understood",
            Self::NotNow(_) => "not-now",
            Self::Policy => "policy-never",
            Self::NotCommissioned => "not-commissioned",
            Self::Locate(error) => error.code(),
            Self::Locked => "locked",
            Self::WrongWord => "wrong-word",
            Self::Config(error) => error.code(),
            Self::Nothing => "nothing-there",
            Self::Memory => "memory",
        }
    }
}

/// The [code](Refusal::code) in brackets, then the text in one line.
impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !matches!(self, Self::Config(_) | Self::Locate(_)) {
            write!(f, "[{}] ", self.code())?;
        }
        match self {
            Self::NotUnderstood => f.write_str("the instrument does not understand the command"),
            Self::NotNow(state) => write!(f, "the command is not allowed now; the instrument is {state}"),
            Self::Policy => f.write_str("the power-up policy is never to calibrate"),
            Self::NotCommissioned => f.write_str("the unit has no configuration of its own, so nothing may move"),
            Self::Locked => f.write_str("the instrument is locked; unlock it first"),
            Self::WrongWord => f.write_str("this word does not unlock the instrument"),
            Self::Config(error) => error.fmt(f),
            Self::Locate(error) => error.fmt(f),
            Self::Nothing => f.write_str("the instrument does not have the requested item"),
            Self::Memory => f.write_str("the calibration memory of the instrument does not work"),
        }
    }
}

/// What the instrument is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// Version of the protocol.
    pub protocol: u8,
    /// Version of the software.
    pub software: String<16>,
    /// Version of the store's format, a character.
    pub store_format: u8,
    /// Bits of the instrument's floating-point numbers.
    pub scalar_bits: u8,
    /// Number of states of the filter.
    pub states: u8,
}

impl Hello {
    /// The description of this build. Its floating-point numbers have the size of `T`.
    pub fn new<T>() -> Self {
        Self {
            protocol: PROTOCOL_VERSION,
            software: String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
            store_format: FORMAT_VERSION,
            scalar_bits: (8 * size_of::<T>()) as u8,
            states: STATES as u8,
        }
    }
}

/// The state of the instrument.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Time since power-up, us.
    pub time_us: u64,
    /// The state of the run.
    pub state: State,
    /// Number of legs of the whole run.
    pub legs: u16,
    /// Number of segments measured.
    pub segments: u16,
    /// Nominal time until the last segment is measured, s; 0 if no run is under way.
    pub left_s: f32,
    /// Outer and inner gimbal angle, rad, within half a turn; not a number before the first sample.
    pub angles_rad: [f32; 2],
    /// Whether samples are corrected.
    pub correcting: bool,
    /// Whether settings may be changed, calibrations erased and runs started.
    pub unlocked: bool,
    /// Why motion is locked, if it is.
    pub motion_lock: Option<MotionLock>,
    /// Number of missing samples.
    pub missing: u32,
    /// The counts of what the link lost.
    pub link: LinkCounts,
}

/// Counts of what the instrument's end of the link lost, since power-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkCounts {
    /// Received frames that were dropped.
    pub dropped: Dropped,
    /// Intact frames that contained no command.
    pub not_understood: u32,
    /// Received bytes that were lost because they were not fetched in time.
    pub overrun: u32,
    /// Frames that were not sent because the outbox was full.
    pub unsent: u32,
}
