//! Scatter of the block means of a stop. It shows whether the sensors see only white noise, or also motion.
//!
//! Motion that the encoders see is not a disturbance. Servos hunt by some arcsec, and an axis that starts slowly has
//! crept before the segmenter detects a move. Over such small angles the force is linear in the angles of the axes, and
//! the measured rate is linear in the rates of the axes. So the block means of the encoders are fitted to the block
//! means of each channel, and only the residuals are judged.

use crate::base::linear::{ComplexField, Real, real};
use crate::base::sample::CHANNELS;
use serde::{Deserialize, Serialize};

/// Number of axes, with one encoder each.
const AXES: usize = 2;
/// If less than this fraction of an encoder's scatter remains after the fits before, the encoder is not fitted.
const EXPLAINED: f64 = 1e-6;

/// Scatter of the block means of a stop, without the part that the encoders see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scatter {
    /// Number of blocks.
    pub blocks: u16,
    /// Degrees of freedom of the variances.
    pub freedom: u16,
    /// Variance of the block means per channel, (m/s^2)^2 and (rad/s)^2.
    pub variance: [f32; CHANNELS],
    /// Trend of the block means per channel, m/s^2 and rad/s. The trend is scaled so that under white noise its
    /// variance equals that of one block mean.
    pub trend: [f32; CHANNELS],
    /// Variance of the block means of the axes' rates, from the encoders, (rad/s)^2.
    pub axis_rates: [f32; AXES],
}

/// Means over one block.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BlockMeans<T> {
    /// Force per axis, m/s^2.
    pub force: [T; 3],
    /// Rate per axis, rad/s.
    pub rate: [T; 3],
    /// Outer and inner angle, relative to the angles where the stop began, rad.
    pub angles: [T; AXES],
    /// Outer and inner rate, rad/s.
    pub axis_rates: [T; AXES],
}

/// Sums over the block means of a stop.
#[derive(Clone, Copy, Debug)]
pub struct ScatterSums<T> {
    blocks: u16,
    force: TriadSums<T>,
    rate: TriadSums<T>,
}

/// Sums over three channels and over the encoder series that are fitted to them. Every series is taken relative to its
/// first value.
#[derive(Clone, Copy, Debug)]
struct TriadSums<T> {
    axes: [SeriesSums<T>; AXES],
    channels: [SeriesSums<T>; 3],
}

#[derive(Clone, Copy, Debug)]
struct SeriesSums<T> {
    first: T,
    sum: T,
    squares: T,
    by_number: T,
    by_axis: [T; AXES],
}

impl<T: Real> SeriesSums<T> {
    const ZERO: Self =
        Self { first: T::ZERO, sum: T::ZERO, squares: T::ZERO, by_number: T::ZERO, by_axis: [T::ZERO; AXES] };

    fn add(&mut self, deviation: T, number: T, axes: [T; AXES]) {
        self.sum += deviation;
        self.squares += deviation * deviation;
        self.by_number += deviation * number;
        for (sum, axis) in self.by_axis.iter_mut().zip(axes) {
            *sum += deviation * axis;
        }
    }
}

impl<T: Real> TriadSums<T> {
    const ZERO: Self = Self { axes: [SeriesSums::ZERO; AXES], channels: [SeriesSums::ZERO; 3] };

    fn add(&mut self, blocks: u16, channels: [T; 3], axes: [T; AXES]) {
        let [outer, inner] = &self.axes;
        let [outer_now, inner_now] = axes;
        let deviations = [outer_now - outer.first, inner_now - inner.first];
        let number = real(blocks.into());
        let series = self.axes.iter_mut().chain(&mut self.channels);
        for (series, value) in series.zip(axes.into_iter().chain(channels)) {
            if blocks == 0 {
                series.first = value;
            } else {
                series.add(value - series.first, number, deviations);
            }
        }
    }

    fn axis_variances(&self, blocks: u16) -> [f32; AXES] {
        let n = f64::from(blocks.max(2));
        let [outer, inner] = &self.axes;
        let variance = |axis: &SeriesSums<T>, squares: T| {
            let sum = axis.sum.widened();
            ((squares.widened() - sum * sum / n) / (n - 1.0)).max(0.0) as f32
        };
        // `by_axis` at the axis itself is the sum of squares.
        [variance(outer, outer.by_axis[0]), variance(inner, inner.by_axis[1])]
    }

    /// Moments about the means of: outer encoder series, inner encoder series, time, channel.
    fn moments(&self, channel: &SeriesSums<T>, blocks: u16) -> Moments {
        let n = f64::from(blocks);
        let number = n * (n - 1.0) / 2.0;
        let [outer, inner] = &self.axes;
        let about = |by: T, a: f64, b: T| by.widened() - a * b.widened() / n;
        let among = |a: &SeriesSums<T>| {
            let [by_outer, by_inner] = a.by_axis;
            let sum = a.sum.widened();
            [about(by_outer, sum, outer.sum), about(by_inner, sum, inner.sum), about(a.by_number, number, a.sum)]
        };
        let ([oo, oi, ot], [_, ii, it], [oc, ic, tc]) = (among(outer), among(inner), among(channel));
        let tt = n * (n * n - 1.0) / 12.0;
        let cc = about(channel.squares, channel.sum.widened(), channel.sum);
        Moments([[oo, oi, ot, oc], [oi, ii, it, ic], [ot, it, tt, tc], [oc, ic, tc, cc]])
    }
}

/// Symmetric matrix of the moments of: outer encoder series, inner encoder series, time, channel.
struct Moments([[f64; 4]; 4]);

/// Residual of a channel after the fit of the encoders.
struct Rest {
    freedom: u16,
    squares: f64,
    trend: f64,
}

impl Moments {
    /// Removes the part that the encoder of this axis explains. Returns `false` if the encoder adds nothing to the fits
    /// before.
    fn explain(&mut self, axis: usize, scatter: f64) -> bool {
        let Some(row) = self.0.get(axis).copied() else { return false };
        let pivot = row.get(axis).copied().unwrap_or(0.0);
        if pivot <= EXPLAINED * scatter {
            return false;
        }
        for (to, by) in self.0.iter_mut().zip(row) {
            for (moment, with) in to.iter_mut().zip(row) {
                *moment -= by * with / pivot;
            }
        }
        true
    }

    fn rest(mut self, blocks: u16) -> Rest {
        let [[oo, ..], [_, ii, ..], [_, _, tt, _], _] = self.0;
        let explained = u16::from(self.explain(0, oo)) + u16::from(self.explain(1, ii));
        let [_, _, [_, _, time, trend], [.., squares]] = self.0;
        // If the encoders drift in proportion to time, the fit has taken the trend of the channel with it.
        let trend = if time > EXPLAINED * tt { trend / ComplexField::sqrt(time) } else { 0.0 };
        Rest { freedom: blocks.saturating_sub(1 + explained), squares: squares.max(0.0), trend }
    }
}

impl<T: Real> ScatterSums<T> {
    /// Sums before the first block.
    pub const ZERO: Self = Self { blocks: 0, force: TriadSums::ZERO, rate: TriadSums::ZERO };

    /// Adds the means of one block.
    pub fn add(&mut self, block: &BlockMeans<T>) {
        self.force.add(self.blocks, block.force, block.angles);
        self.rate.add(self.blocks, block.rate, block.axis_rates);
        self.blocks = self.blocks.saturating_add(1);
    }

    /// The scatter of all blocks so far.
    pub fn scatter(&self) -> Scatter {
        let mut scatter = Scatter { blocks: self.blocks, ..Scatter::default() };
        let triads = [&self.force, &self.rate];
        let series = triads.into_iter().flat_map(|triad| triad.channels.iter().map(move |channel| (triad, channel)));
        let outputs = scatter.variance.iter_mut().zip(scatter.trend.iter_mut());
        let mut least = u16::MAX;
        for ((triad, channel), (variance, trend)) in series.zip(outputs) {
            let rest = triad.moments(channel, self.blocks).rest(self.blocks);
            least = least.min(rest.freedom);
            *variance = (rest.squares / f64::from(rest.freedom.max(1))) as f32;
            *trend = rest.trend as f32;
        }
        Scatter { freedom: least, axis_rates: self.rate.axis_variances(self.blocks), ..scatter }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;

    /// Scatter of a stop. The noise is replaced by alternating values of known square, and the axes move by `angle`.
    fn scatter(angle: impl Fn(f64) -> f64, drift: f64) -> Scatter {
        let mut sums = ScatterSums::<f64>::ZERO;
        for block in 0..40_u16 {
            let time_s = 0.1 * f64::from(block);
            let noise = if block % 2 == 0 { 1e-6 } else { -1e-6 };
            let axis_rate = (angle(time_s + 0.05) - angle(time_s - 0.05)) / 0.1;
            sums.add(&BlockMeans {
                force: [noise, 9.8 + noise, 0.03 * 9.8 * angle(time_s) + noise],
                rate: [noise + 0.99 * axis_rate, noise - 0.02 * axis_rate + drift * time_s, noise],
                angles: [angle(time_s), 0.0],
                axis_rates: [axis_rate, 0.0],
            });
        }
        sums.scatter()
    }

    #[test]
    fn motion_that_the_encoders_see_is_removed() {
        let still = scatter(|_| 0.0, 0.0);
        assert_eq!((still.blocks, still.freedom), (40, 39));
        let hunting = scatter(|time_s| 2e-5 * (TAU * 1.3 * time_s).sin(), 0.0);
        assert_eq!((hunting.blocks, hunting.freedom), (40, 38));
        let creeping = scatter(|time_s| 1e-5 * (time_s - 3.0).max(0.0).powi(3), 0.0);
        for stop in [still, hunting, creeping] {
            for (variance, trend) in stop.variance.iter().zip(stop.trend) {
                // 40 squares of 1e-6. The tolerance allows for the correlation of the alternating signs with the
                // motion.
                assert!((variance / 1.026e-12 - 1.0).abs() < 0.04, "{stop:?}");
                assert!(trend.abs() < 0.3e-6, "{stop:?}");
            }
        }
    }

    #[test]
    fn motion_that_the_encoders_do_not_see_remains() {
        let hunting = scatter(|time_s| 2e-5 * (TAU * 1.3 * time_s).sin(), 3e-6);
        // A ramp of 3e-6 per second over 4 s gives 40 block means of variance (3e-6 * 4)^2 / 12 = 12e-12.
        assert!((hunting.variance[4] / 13e-12 - 1.0).abs() < 0.05, "{hunting:?}");
        assert!((hunting.trend[4] / 21.9e-6 - 1.0).abs() < 0.02, "{hunting:?}");
        assert!(hunting.variance[3] < 1.1e-12);
    }
}
