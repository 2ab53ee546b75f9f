//! Doubts about a result, and their texts.

use super::scale::WrongScale;
use super::setting::WrongSetting;
use crate::base::sample::CHANNELS;
use crate::base::units::{ARCSEC, DEG, DEG_H, MICRO_G, PPM};
use crate::estimator::constancy::{Change, Suspicion};
use crate::model::error_model::{PARAMETER_INFO, ParameterInfo, block};
use crate::verdict::wiring::Wiring;
use core::fmt;
use serde::{Deserialize, Serialize};

const HOUR_S: f64 = 3600.0;

/// Names of the channels as reasons give them.
pub const CHANNEL_NAMES: [&str; CHANNELS] = ["accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z"];

/// Why a stop does not look like an instrument at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Unrest {
    /// The variance of its block means is this many times that of white noise.
    Variance(f32),
    /// Its block means drift by this many sigmas.
    Trend(f32),
    /// The channel does not change.
    Stuck,
}

/// One channel, or a triad of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sensors {
    /// One, as in [`CHANNEL_NAMES`].
    Channel(u8),
    /// All three.
    Accelerometers,
    /// All three.
    Gyros,
}

/// One doubt. Parameters are given by index, segments counted from 0, channels as in [`CHANNEL_NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the text of a variant says what its fields are")]
pub enum Reason {
    /// Samples are not in the units they should be in.
    Scale(WrongScale),
    /// Something was configured that is not so.
    Setting(WrongSetting),
    /// The noise at most stops is far from the configured one: this many times as large.
    NoiseLevel { sensors: Sensors, ratio: f64 },
    /// The longest time that the run may take was over after this leg, of so many.
    Cut { leg: u16, legs: u16 },
    /// There are too few segments to determine anything.
    TooFewSegments(u16),
    /// The estimate does not stand after this many sweeps.
    NotConverged(u8),
    /// A parameter or its sigma is not finite.
    NotFinite { parameter: u8 },
    /// So many measurements were refused by the filter, because they are not finite.
    Refused(u32),
    /// A parameter is not observed: its sigma is this part of the prior.
    Unobserved { parameter: u8, of_prior: f64 },
    /// A sigma, SI, exceeds the required one.
    Sigma { parameter: u8, sigma: f64, required: f64 },
    /// A parameter, SI, is outside its plausible range.
    Implausible { parameter: u8, value: f64, limit: f64 },
    /// The residual chi-square is outside its bounds.
    ChiSquare { chi_square: f64, degrees_of_freedom: u32, low: f64, high: f64 },
    /// One measurement disagrees with all others.
    Innovation { segment: u16, channel: u8, normalized: f64 },
    /// A stop was not at rest.
    Unrest { segment: u16, channel: u8, unrest: Unrest },
    /// The noise of a channel, over all stops from a segment on, is this many times the configured one.
    Noise { segment: u16, channel: u8, ratio: f64 },
    /// A channel drifts during the stops: its trends are this many times those of white noise.
    Trends { channel: u8, ratio: f64 },
    /// A channel does not change over this many samples.
    Held { segment: u16, channel: u8, samples: u16 },
    /// This many samples of a segment repeat the one before.
    Stale { segment: u16, samples: u16 },
    /// Too many samples are missing, of so many.
    Missing { missing: u32, of: u64 },
    /// What should be constant changed.
    Changing(Suspicion),
    /// A channel or an encoder is not what it claims to be.
    Wiring(Wiring),
    /// Samples are missing in a segment for too long, us.
    Gap { segment: u16, longest_us: u64 },
    /// More segments than fit were left out.
    LeftOut(u16),
    /// Differs from the stored calibration by this many combined sigmas.
    Changed { parameter: u8, sigmas: f64 },
}

/// A number with so many decimals, or in scientific notation where it is huge.
struct Fixed(f64, usize);

impl fmt::Display for Fixed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value, decimals) = *self;
        if value.abs() < 1e6 { write!(f, "{value:.decimals$}") } else { write!(f, "{value:.3e}") }
    }
}

fn info(parameter: u8) -> ParameterInfo {
    const UNKNOWN: ParameterInfo = ParameterInfo { name: "?", unit: "", unit_si: 1.0 };
    PARAMETER_INFO.get(usize::from(parameter)).copied().unwrap_or(UNKNOWN)
}

/// As [`info`], with the attitude's small changes in arcsec.
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
        Sensors::Accelerometers => "accelerometers",
        Sensors::Gyros => "gyros",
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
            write!(
                f,
                "from segment {segment} on, {name} drifts by {} {unit} an hour",
                Fixed(size * HOUR_S / unit_si, 1)
            )
        }
        Change::Slip(axis) => {
            write!(f, "segment {segment}, {}: slip of {} arcsec", encoder_name(axis), Fixed(size / ARCSEC, 2))
        }
        Change::EncoderScale(axis) => {
            write!(f, "from segment {segment} on, {}: scale error of {} ppm", encoder_name(axis), Fixed(size / PPM, 2))
        }
        // Settings are told as such, by their own reason.
        Change::EarthRate(_) => write!(f, "the Earth rate differs by {} deg/h", Fixed(size / DEG_H, 4)),
        Change::Heading => write!(f, "the heading differs by {} deg", Fixed(size / DEG, 4)),
        Change::Outlier(channel) => {
            let (size, unit) = if channel < 3 { (size / MICRO_G, "ug") } else { (size / ARCSEC, "arcsec") };
            write!(f, "segment {segment}, {}: off by {} {unit}", channel_name(channel), Fixed(size, 2))
        }
    }?;
    write!(f, ", {} sigma, limit {}", Fixed(sigmas, 1), Fixed(limit, 1))
}

fn write_wiring(f: &mut fmt::Formatter<'_>, wiring: Wiring) -> fmt::Result {
    match wiring {
        Wiring::Reversed(channel) => write!(f, "the sign of {} is wrong", channel_name(channel)),
        Wiring::Swapped(channel) => {
            let next = channel / 3 * 3 + (channel + 1) % 3;
            write!(f, "{} and {} are swapped", channel_name(channel), channel_name(next))
        }
        Wiring::EncoderReversed(axis) => write!(f, "the sign of the {} is wrong", encoder_name(axis)),
        Wiring::EncodersSwapped => write!(f, "the encoders are swapped, or an axis is wired wrongly"),
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Scale(wrong) => wrong.fmt(f),
            Self::Setting(wrong) => wrong.fmt(f),
            Self::NoiseLevel { sensors, ratio } => {
                write!(f, "{}: noise is {} times the configured", sensors_name(sensors), Fixed(ratio, 2))
            }
            Self::Cut { leg, legs } => {
                write!(f, "the run was cut after leg {leg} of {legs}: its longest time was over")
            }
            Self::TooFewSegments(count) => write!(f, "only {count} segments: no stop, move and stop to calibrate from"),
            Self::NotConverged(sweeps) => write!(f, "the estimate does not stand after {sweeps} sweeps"),
            Self::NotFinite { parameter } => write!(f, "{} is not finite", info(parameter).name),
            Self::Refused(1) => write!(f, "1 measurement is not finite"),
            Self::Refused(count) => write!(f, "{count} measurements are not finite"),
            Self::Unobserved { parameter, of_prior } => {
                write!(f, "{} is not observed: its sigma is still {of_prior:.2} of the prior's", info(parameter).name)
            }
            Self::Sigma { parameter, sigma, required } => {
                let info = info(parameter);
                let (sigma, required) = (sigma / info.unit_si, required / info.unit_si);
                write!(
                    f,
                    "sigma of {} is {} {}, required {}",
                    info.name,
                    Fixed(sigma, 3),
                    info.unit,
                    Fixed(required, 3)
                )
            }
            Self::Implausible { parameter, value, limit } => {
                let info = info(parameter);
                let (value, limit) = (value / info.unit_si, limit / info.unit_si);
                write!(f, "{} is {} {}, plausible up to {}", info.name, Fixed(value, 1), info.unit, Fixed(limit, 1))
            }
            Self::ChiSquare { chi_square, degrees_of_freedom, low, high } => write!(
                f,
                "chi-square {} with {degrees_of_freedom} degrees of freedom is outside {low:.1} to {high:.1}",
                Fixed(chi_square, 1)
            ),
            Self::Innovation { segment, channel, normalized } => {
                write!(f, "segment {segment}, {}: innovation of {} sigma", channel_name(channel), Fixed(normalized, 1))
            }
            Self::Unrest { segment, channel, unrest } => {
                write!(f, "segment {segment}, {}: ", channel_name(channel))?;
                match unrest {
                    Unrest::Variance(ratio) => {
                        write!(f, "variance {} times that of the configured noise", Fixed(ratio.into(), 1))
                    }
                    Unrest::Trend(sigmas) => write!(f, "drift of {} sigma during the stop", Fixed(sigmas.into(), 1)),
                    Unrest::Stuck => write!(f, "the channel does not change"),
                }
            }
            Self::Noise { segment, channel, ratio } => write!(
                f,
                "{} from segment {segment} on: {} times the variance of the configured noise",
                channel_name(channel),
                Fixed(ratio, 2)
            ),
            Self::Trends { channel, ratio } => {
                write!(
                    f,
                    "{}: drift during the stops, {} times that of white noise",
                    channel_name(channel),
                    Fixed(ratio, 1)
                )
            }
            Self::Held { segment, channel, samples } => {
                write!(f, "segment {segment}, {}: does not change over {samples} samples", channel_name(channel))
            }
            Self::Stale { segment, samples } => {
                write!(f, "segment {segment}: {samples} samples repeat the one before")
            }
            Self::Missing { missing, of } => write!(f, "{missing} of {of} samples are missing"),
            Self::Changing(suspicion) => write_suspicion(f, &suspicion),
            Self::Wiring(wiring) => write_wiring(f, wiring),
            Self::Gap { segment, longest_us } => {
                write!(f, "segment {segment}: no samples for {} ms", longest_us / 1000)
            }
            Self::LeftOut(count) => write!(f, "{count} segments did not fit and were left out"),
            Self::Changed { parameter, sigmas } => {
                write!(
                    f,
                    "{} differs from the stored calibration by {} combined sigma",
                    info(parameter).name,
                    Fixed(sigmas, 1)
                )
            }
        }
    }
}
