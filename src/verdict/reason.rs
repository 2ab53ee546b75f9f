//! Doubts about a result, and their texts.

use super::scale::WrongScale;
use super::setting::WrongSetting;
use crate::base::clock_check::ClockFault;
use crate::base::sample::CHANNELS;
use crate::base::units::{ARCSEC, DEG, DEG_H, HOUR_S, MICRO_G, PPM};
use crate::estimator::constancy::{Change, Suspicion};
use crate::model::effects::{EFFECT_INFO, kind_keys};
use crate::model::error_model::{PARAMETER_INFO, ParameterInfo, block};
use crate::verdict::wiring::Wiring;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Names of the channels as reasons give them.
pub const CHANNEL_NAMES: [&str; CHANNELS] = ["accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z"];

/// Why a stop does not look like an instrument at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Unrest {
    /// The variance of the block means of the stop is this many times that of white noise.
    Variance(f32),
    /// The block means of the stop drift by this many sigmas.
    Trend(f32),
    /// The channel does not change during the stop.
    Stuck,
}

/// One channel or one triad of sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sensors {
    /// One channel, as in [`CHANNEL_NAMES`].
    Channel(u8),
    /// All three accelerometers.
    Accelerometers,
    /// All three gyros.
    Gyros,
}

/// One doubt about a result. Parameters are given by index, segments are counted from 0, channels are as in
/// [`CHANNEL_NAMES`].
///
/// Calibrations are stored with their reasons: whoever changes this type reads
/// [`REASONS_SCHEMA`](crate::run::result::REASONS_SCHEMA) first, and writes the page of a new [code](Self::code) into
/// the chapter [`reasons`](crate::guide::reasons) of the guide.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(missing_docs, reason = "the text of a variant says what its fields are")]
pub enum Reason {
    /// The samples are not in the expected units.
    Scale(WrongScale),
    /// A configured value contradicts the measurements.
    Setting(WrongSetting),
    /// The noise at most stops is far from the configured noise: this many times as large.
    NoiseLevel { sensors: Sensors, ratio: f64 },
    /// The longest permitted time of the run was over after this leg; the scheme has `legs` legs.
    Cut { leg: u16, legs: u16 },
    /// This many segments are too few for a calibration.
    TooFewSegments(u16),
    /// The estimate has not converged after this many sweeps.
    NotConverged(u8),
    /// A parameter or its sigma is not finite.
    NotFinite { parameter: u8 },
    /// The filter refused this many measurements, because they are not finite.
    Refused(u32),
    /// A parameter is not observed: its sigma is this fraction of its prior sigma.
    Unobserved { parameter: u8, of_prior: f64 },
    /// The sigma of a parameter, SI, exceeds the required sigma.
    Sigma { parameter: u8, sigma: f64, required: f64 },
    /// A parameter, SI, is outside its plausible range.
    Implausible { parameter: u8, value: f64, limit: f64 },
    /// The chi-square of the residuals is outside its bounds.
    ChiSquare { chi_square: f64, degrees_of_freedom: u32, low: f64, high: f64 },
    /// One measurement disagrees with all others, by this many sigmas.
    Innovation { segment: u16, channel: u8, normalized: f64 },
    /// The instrument was not at rest during a stop.
    Unrest { segment: u16, channel: u8, unrest: Unrest },
    /// The variance of a channel, over all stops from a segment on, is this many times the configured variance.
    Noise { segment: u16, channel: u8, ratio: f64 },
    /// A channel drifts during the stops: the mean square of its trends is this many times that of white noise.
    Trends { channel: u8, ratio: f64 },
    /// A channel repeats the same value over this many samples.
    Held { segment: u16, channel: u8, samples: u16 },
    /// This many samples of a segment repeat the sample before them.
    Stale { segment: u16, samples: u16 },
    /// Too many samples are missing: `missing` of `of` samples.
    Missing { missing: u32, of: u64 },
    /// A quantity that is constant by assumption changed during the run.
    Changing(Suspicion),
    /// A channel or an encoder has the wrong sign or the wrong place.
    Wiring(Wiring),
    /// Samples are missing in a segment for this time, us.
    Gap { segment: u16, longest_us: u64 },
    /// This many segments did not fit into memory and were left out.
    LeftOut(u16),
    /// A parameter differs from the stored calibration by this many combined sigmas.
    Changed { parameter: u8, sigmas: f64 },
    /// An effect of the hardware, by index, is larger than its configured size; size, sigma and configured size, SI.
    Hardware { effect: u8, size: f64, sigma: f64, configured: f64 },
    /// No latitude is configured, and the gyros find it to this sigma only, rad.
    UnknownLatitude { sigma_rad: f64 },
    /// The clock of the time stamps is wrong or was not checked.
    Clock(ClockFault),
}

impl Reason {
    /// Short name of the reason. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Scale(_) => "wrong-scale",
            Self::Setting(wrong) => wrong.code(),
            Self::NoiseLevel { .. } => "noise-level",
            Self::Cut { .. } => "cut-short",
            Self::TooFewSegments(_) => "too-few-segments",
            Self::NotConverged(_) => "not-converged",
            Self::NotFinite { .. } => "not-finite",
            Self::Refused(_) => "refused-measurements",
            Self::Unobserved { .. } => "unobserved",
            Self::Sigma { .. } => "sigma",
            Self::Implausible { .. } => "implausible",
            Self::ChiSquare { .. } => "chi-square",
            Self::Innovation { .. } => "innovation",
            Self::Unrest { unrest: Unrest::Variance(_) | Unrest::Trend(_), .. } => "unrest",
            Self::Unrest { unrest: Unrest::Stuck, .. } => "stuck-channel",
            Self::Noise { .. } => "noise-rise",
            Self::Trends { .. } => "drift",
            Self::Held { .. } => "held-value",
            Self::Stale { .. } => "stale-samples",
            Self::Missing { .. } => "missing-samples",
            Self::Changing(suspicion) => change_code(suspicion.change),
            Self::Wiring(_) => "wiring",
            Self::Gap { .. } => "gap",
            Self::LeftOut(_) => "left-out",
            Self::Changed { .. } => "changed",
            Self::Hardware { .. } => "hardware-effect",
            Self::UnknownLatitude { .. } => "unknown-latitude",
            Self::Clock(ClockFault::Absent) => "no-clock",
            Self::Clock(ClockFault::Off(_)) => "clock-off",
            Self::Clock(ClockFault::Unchecked) => "clock-not-checked",
        }
    }
}

fn change_code(change: Change) -> &'static str {
    match change {
        Change::Step(_) => "parameter-step",
        Change::Ramp(_) => "parameter-ramp",
        Change::Slip(_) => "encoder-slip",
        Change::EncoderScale(_) => "encoder-scale",
        Change::Outlier(_) => "outlier",
        Change::EarthRate(_) => "earth-rate",
        Change::Heading => "heading-error",
        Change::Effect(_) | Change::Kind(_) => "hardware-effect",
    }
}

/// A number with this many decimals, or in scientific notation if it is 1e6 or more.
struct Fixed(f64, usize);

impl fmt::Display for Fixed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value, decimals) = *self;
        if value.abs() < 1e6 { write!(f, "{value:.decimals$}") } else { write!(f, "{value:.3e}") }
    }
}

const UNKNOWN: ParameterInfo = ParameterInfo { name: "?", unit: "", unit_si: 1.0 };

fn info(parameter: u8) -> ParameterInfo {
    PARAMETER_INFO.get(usize::from(parameter)).copied().unwrap_or(UNKNOWN)
}

fn effect_info(effect: u8) -> ParameterInfo {
    EFFECT_INFO.get(usize::from(effect)).copied().unwrap_or(UNKNOWN)
}

/// The same as [`info`], but with changes of the attitude in arcsec, as they are small.
fn change_info(parameter: u8) -> ParameterInfo {
    let info = info(parameter);
    if usize::from(parameter) < block::ATTITUDE {
        info
    } else {
        ParameterInfo { unit: "arcsec", unit_si: ARCSEC, ..info }
    }
}

fn channel_name(channel: u8) -> &'static str {
    CHANNEL_NAMES.get(usize::from(channel)).copied().unwrap_or("?")
}

fn sensors_name(sensors: Sensors) -> &'static str {
    match sensors {
        Sensors::Channel(channel) => channel_name(channel),
        Sensors::Accelerometers => "the accelerometers",
        Sensors::Gyros => "the gyros",
    }
}

fn encoder_name(axis: u8) -> &'static str {
    if axis == 0 { "outer encoder" } else { "inner encoder" }
}

fn write_suspicion(f: &mut fmt::Formatter<'_>, suspicion: &Suspicion) -> fmt::Result {
    let Suspicion { change, segment, size, sigmas, limit } = *suspicion;
    match change {
        Change::Step(parameter) => {
            let ParameterInfo { name, unit, unit_si } = change_info(parameter);
            write!(f, "from segment {segment} on, {name} differs by {} {unit}", Fixed(size / unit_si, 3))
        }
        Change::Ramp(parameter) => {
            let ParameterInfo { name, unit, unit_si } = change_info(parameter);
            let an_hour = Fixed(size * HOUR_S / unit_si, 1);
            write!(f, "from segment {segment} on, {name} drifts by {an_hour} {unit} in an hour")
        }
        Change::Slip(axis) => {
            write!(f, "in segment {segment}, the {} slips by {} arcsec", encoder_name(axis), Fixed(size / ARCSEC, 2))
        }
        Change::EncoderScale(axis) => {
            let ppm = Fixed(size / PPM, 2);
            write!(f, "from segment {segment} on, the {} has a scale error of {ppm} ppm", encoder_name(axis))
        }
        Change::EarthRate(_) => {
            write!(f, "the measured Earth rate differs from that of the site by {} deg/h", Fixed(size / DEG_H, 4))
        }
        Change::Heading => {
            write!(f, "the measured heading differs from the configured heading by {} deg", Fixed(size / DEG, 4))
        }
        Change::Effect(effect) => {
            let ParameterInfo { name, unit, unit_si } = effect_info(effect);
            write!(f, "{name} is {} {unit}", Fixed(size / unit_si, decimals(unit)))
        }
        Change::Kind(kind) => {
            let (keys, times) = (kind_keys(kind), Fixed(size, 1));
            write!(f, "the effects of {keys} are together {times} times as large as their configured sizes permit")
        }
        Change::Outlier(channel) => {
            let (size, unit) = if channel < 3 { (size / MICRO_G, "ug") } else { (size / ARCSEC, "arcsec") };
            write!(f, "in segment {segment}, {} is off by {} {unit}", channel_name(channel), Fixed(size, 2))
        }
    }?;
    write!(f, "; this is {} sigma, and the limit is {} sigma", Fixed(sigmas, 1), Fixed(limit, 1))
}

/// Decimals of a value in a unit of the effects. Rates and latitudes in degrees are small numbers.
fn decimals(unit: &str) -> usize {
    if unit.starts_with("deg") { 4 } else { 2 }
}

fn write_hardware(f: &mut fmt::Formatter<'_>, effect: u8, [size, sigma, configured]: [f64; 3]) -> fmt::Result {
    let ParameterInfo { name, unit, unit_si } = effect_info(effect);
    let [size, sigma, configured] = [size, sigma, configured].map(|value| Fixed(value / unit_si, decimals(unit)));
    write!(f, "{name} is {size} +- {sigma} {unit}, but only {configured} {unit} is configured")
}

fn write_wiring(f: &mut fmt::Formatter<'_>, wiring: Wiring) -> fmt::Result {
    match wiring {
        Wiring::Reversed(channel) => write!(f, "the sign of {} is wrong", channel_name(channel)),
        Wiring::Swapped(channel) => {
            let next = channel / 3 * 3 + (channel + 1) % 3;
            write!(f, "{} and {} are swapped", channel_name(channel), channel_name(next))
        }
        Wiring::EncoderReversed(axis) => write!(f, "the sign of the {} is wrong", encoder_name(axis)),
        Wiring::EncodersSwapped => write!(f, "the two encoders are swapped, or an axis is wired wrongly"),
    }
}

fn write_unrest(f: &mut fmt::Formatter<'_>, segment: u16, channel: u8, unrest: Unrest) -> fmt::Result {
    let name = channel_name(channel);
    match unrest {
        Unrest::Variance(ratio) => {
            let ratio = Fixed(ratio.into(), 1);
            write!(f, "in segment {segment}, the variance of {name} is {ratio} times that of the configured noise")
        }
        Unrest::Trend(sigmas) => {
            write!(f, "in segment {segment}, {name} drifts by {} sigma during the stop", Fixed(sigmas.into(), 1))
        }
        Unrest::Stuck => write!(f, "in segment {segment}, {name} does not change"),
    }
}

fn write_sigma(f: &mut fmt::Formatter<'_>, parameter: u8, sigma: f64, required: f64) -> fmt::Result {
    let ParameterInfo { name, unit, unit_si } = info(parameter);
    let (sigma, required) = (Fixed(sigma / unit_si, 3), Fixed(required / unit_si, 3));
    write!(f, "the sigma of {name} is {sigma} {unit}, but {required} {unit} or less is required")
}

fn write_implausible(f: &mut fmt::Formatter<'_>, parameter: u8, value: f64, limit: f64) -> fmt::Result {
    let ParameterInfo { name, unit, unit_si } = info(parameter);
    let (value, limit) = (Fixed(value / unit_si, 1), Fixed(limit / unit_si, 1));
    write!(f, "{name} is {value} {unit}, but no more than {limit} {unit} is plausible")
}

/// The [code](Reason::code) in brackets, then the text in one line.
impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}] ", self.code())?;
        match *self {
            Self::Scale(wrong) => wrong.fmt(f),
            Self::Setting(wrong) => wrong.fmt(f),
            Self::NoiseLevel { sensors, ratio } => {
                write!(f, "the noise of {} is {} times the configured noise", sensors_name(sensors), Fixed(ratio, 2))
            }
            Self::Cut { leg, legs } => {
                write!(f, "the run ended after leg {leg} of {legs}, because its longest permitted time was over")
            }
            Self::TooFewSegments(count) => {
                write!(
                    f,
                    "the number of segments is {count}; a calibration needs at least 3: a stop, a move and another stop"
                )
            }
            Self::NotConverged(sweeps) => write!(f, "the estimate has not converged after {sweeps} sweeps"),
            Self::NotFinite { parameter } => write!(f, "the estimate of {} is not finite", info(parameter).name),
            Self::Refused(1) => write!(f, "1 measurement was refused because it is not finite"),
            Self::Refused(count) => write!(f, "{count} measurements were refused because they are not finite"),
            Self::Unobserved { parameter, of_prior } => {
                let name = info(parameter).name;
                write!(f, "{name} is not observed: its sigma is still {of_prior:.2} times its sigma before the run")
            }
            Self::Sigma { parameter, sigma, required } => write_sigma(f, parameter, sigma, required),
            Self::Implausible { parameter, value, limit } => write_implausible(f, parameter, value, limit),
            Self::ChiSquare { chi_square, degrees_of_freedom, low, high } => write!(
                f,
                "the chi-square {} with {degrees_of_freedom} degrees of freedom is outside its bounds, {low:.1} to {high:.1}",
                Fixed(chi_square, 1)
            ),
            Self::Innovation { segment, channel, normalized } => {
                let (name, sigmas) = (channel_name(channel), Fixed(normalized, 1));
                write!(f, "in segment {segment}, {name} differs by {sigmas} sigma from what all other segments predict")
            }
            Self::Unrest { segment, channel, unrest } => write_unrest(f, segment, channel, unrest),
            Self::Noise { segment, channel, ratio } => {
                let (name, ratio) = (channel_name(channel), Fixed(ratio, 2));
                write!(
                    f,
                    "from segment {segment} on, the variance of {name} is {ratio} times that of the configured noise"
                )
            }
            Self::Trends { channel, ratio } => {
                let (name, ratio) = (channel_name(channel), Fixed(ratio, 1));
                write!(
                    f,
                    "{name} drifts during the stops: the mean square of its trends is {ratio} times that of white noise"
                )
            }
            Self::Held { segment, channel, samples } => {
                write!(f, "in segment {segment}, {} does not change over {samples} samples", channel_name(channel))
            }
            Self::Stale { segment, samples } => {
                write!(f, "in segment {segment}, {samples} samples repeat the sample before them")
            }
            Self::Missing { missing, of } => write!(f, "{missing} of {of} samples are missing"),
            Self::Changing(suspicion) => write_suspicion(f, &suspicion),
            Self::Wiring(wiring) => write_wiring(f, wiring),
            Self::Hardware { effect, size, sigma, configured } => write_hardware(f, effect, [size, sigma, configured]),
            Self::UnknownLatitude { sigma_rad } => write!(
                f,
                "no latitude is configured, and the gyros find it to {} deg only; give it in the unit description",
                Fixed(sigma_rad / DEG, 1)
            ),
            Self::Clock(fault) => fault.fmt(f),
            Self::Gap { segment, longest_us } => {
                write!(f, "in segment {segment}, no sample arrived for {} ms", longest_us / 1000)
            }
            Self::LeftOut(1) => write!(f, "1 segment did not fit into memory and was left out"),
            Self::LeftOut(count) => write!(f, "{count} segments did not fit into memory and were left out"),
            Self::Changed { parameter, sigmas } => {
                let (name, sigmas) = (info(parameter).name, Fixed(sigmas, 1));
                write!(f, "{name} differs from the stored calibration by {sigmas} combined sigma")
            }
        }
    }
}
