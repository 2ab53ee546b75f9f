//! The motion test: whether the axes and the base were at rest during a stop.

use super::reason::Unrest;
use crate::base::hardware::Hardware;
use crate::base::linear::Real;
use crate::base::sample::CHANNELS;
use crate::segment::Segment;
use crate::segment::white_noise::{Noise, ScatterRatios, chi_square_quantile};

/// Bound of the variance of a stop's block means, as a normal deviate: 3e-7 for one channel, 3e-5 for 19 stops of 6
/// channels.
const SCATTER_Z: f64 = 5.0;

/// Bound of the trend of a stop's block means, in sigmas: 6e-8 for one channel.
const TREND_LIMIT: f64 = 5.4;

/// A channel whose variance is below this fraction of the variance of white noise does not measure.
pub(super) const STUCK_RATIO: f64 = 0.01;

/// For each channel whose variance differs from that of white noise at most stops: the ratio of the two variances.
pub(super) type NoiseLevels = [Option<f64>; CHANNELS];

/// The motion test of a stop: the first channel that shows that the axes or the base were not at rest, if any, and how.
/// The variance and the trend of the stop's block means are compared with white noise of the configured size.
pub fn unrest<T: Real>(segment: &Segment<T>, noise: &Noise, hardware: &Hardware) -> Option<(u8, Unrest)> {
    unrest_but(segment, noise, hardware, &[None; CHANNELS])
}

/// The same as [`unrest`], without the channels that have a noise level of their own.
pub(super) fn unrest_but<T: Real>(
    segment: &Segment<T>,
    noise: &Noise,
    hardware: &Hardware,
    levels: &NoiseLevels,
) -> Option<(u8, Unrest)> {
    for channel in unnamed(levels) {
        let ScatterRatios { variance: ratio, of_white, trend, freedom } = noise.scatter(hardware, segment, channel)?;
        if trend.abs() > TREND_LIMIT {
            return Some((channel, Unrest::Trend(trend as f32)));
        } else if is_unrest(ratio, freedom) {
            return Some((channel, Unrest::Variance(ratio as f32)));
        } else if of_white < STUCK_RATIO && !is_pulses(segment, channel) {
            return Some((channel, Unrest::Stuck));
        }
    }
    None
}

/// Whether the output of a channel at a stop is known to be pulses. Between two pulses it does not change.
pub(super) fn is_pulses<T: Real>(segment: &Segment<T>, channel: u8) -> bool {
    let increments = segment.standing().map(|standing| standing.increments);
    increments.is_some_and(|increments| increments.get(usize::from(channel)).is_some_and(|by| *by > 0.0))
}

/// The channels that have no noise level of their own.
pub(super) fn unnamed(levels: &NoiseLevels) -> impl Iterator<Item = u8> {
    (0_u8..).zip(levels).filter(|(_, level)| level.is_none()).map(|(channel, _)| channel)
}

/// Whether the variance of a stop's block means is too large for white noise.
pub(super) fn is_unrest(variance_ratio: f64, freedom: u32) -> bool {
    variance_ratio * f64::from(freedom) > chi_square_quantile(freedom, SCATTER_Z)
}
