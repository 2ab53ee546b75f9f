//! White noise at a stop: what the means of its blocks show, against what is configured.
//!
//! What the encoders see of an axis that hunts is no noise (`scatter`), but single readings of a coarse encoder are wrong,
//! and with them the rate of an axis over a block. The gyros of that axis are allowed for as much.

use super::readings::Readings;
use super::types::{Segment, Standing};
use crate::base::angle::Angle;
use crate::base::linear::{ComplexField, Real};
use crate::base::sample::CHANNELS;
use serde::{Deserialize, Serialize};

/// Normal deviate beyond which the noise of a stop is larger than configured; 1e-3 each.
const LARGER_Z: f64 = 3.0;

/// Installation errors by which a gyro may feel an axis that is not its own, rad.
const INSTALLATION_RAD: f64 = 0.02;
/// Errors of readings cancel over a stop: of `n` blocks, this part over `n` of their variance is left in the trend.
const TREND_PART: f64 = 3.0;

/// White noise of the sensors and repeatability of the encoders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Velocity random walk, m/s^2/sqrt(Hz).
    pub accel_psd_sqrt: f64,
    /// Angular random walk, rad/sqrt(s).
    pub gyro_psd_sqrt: f64,
    /// Encoder error, drawn anew for each stop and axis, rad.
    pub encoder_sigma_rad: f64,
    /// How many times the configured variance of the white noise a stop may show, and is then allowed for; 1 for no more
    /// than configured.
    pub margin: f64,
}

/// How one channel scatters at a stop, in units of the noise that is allowed for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScatterRatios {
    /// Variance of the block means.
    pub variance: f64,
    /// The same, in units of the sensor's white noise alone.
    pub of_white: f64,
    /// Their trend, in sigmas.
    pub trend: f64,
    /// Degrees of freedom of the variances.
    pub freedom: u32,
}

impl Noise {
    /// How many times the configured variance is allowed for on each channel at a stop: 1 unless the stop significantly
    /// shows more.
    pub fn allowances<T: Real>(&self, stop: &Segment<T>) -> [f64; CHANNELS] {
        let mut allowances = [1.0; CHANNELS];
        if self.margin > 1.0 {
            for (channel, allowance) in (0_u8..).zip(&mut allowances) {
                *allowance = self.allowance(stop, channel);
            }
        }
        allowances
    }

    /// Scatter of a stop's block means on one channel. `None` for moves and for stops that are too short.
    pub fn scatter<T: Real>(&self, stop: &Segment<T>, channel: u8) -> Option<ScatterRatios> {
        let ScatterRatios { variance, of_white, trend, freedom } = self.unallowed(stop, channel)?;
        let allowance = self.allowance(stop, channel);
        Some(ScatterRatios {
            variance: variance / allowance,
            of_white: of_white / allowance,
            trend: trend / ComplexField::sqrt(allowance),
            freedom,
        })
    }

    fn allowance<T: Real>(&self, stop: &Segment<T>, channel: u8) -> f64 {
        match self.unallowed(stop, channel) {
            Some(ScatterRatios { variance, freedom, .. })
                if variance * f64::from(freedom) > chi_square_quantile(freedom, LARGER_Z) =>
            {
                // `clamp` can panic.
                variance.min(self.margin).max(1.0)
            }
            _ => 1.0,
        }
    }

    /// In units of the noise that is configured.
    fn unallowed<T: Real>(&self, stop: &Segment<T>, channel: u8) -> Option<ScatterRatios> {
        let Standing { scatter, readings, .. } = stop.standing().filter(|standing| standing.scatter.freedom >= 2)?;
        let psd_sqrt = if channel < 3 { self.accel_psd_sqrt } else { self.gyro_psd_sqrt };
        let blocks = f64::from(scatter.blocks);
        let block_s = stop.duration_s().widened() / blocks;
        let white = psd_sqrt * psd_sqrt / block_s;
        let readings = readings_variance(readings, scatter.axis_rates, stop.inner, channel, block_s);
        let variance = f64::from(*scatter.variance.get(usize::from(channel))?);
        let trend = f64::from(*scatter.trend.get(usize::from(channel))?);
        Some(ScatterRatios {
            variance: variance / (white + readings),
            of_white: variance / white,
            trend: trend / ComplexField::sqrt(white + readings * TREND_PART / blocks),
            freedom: scatter.freedom.into(),
        })
    }
}

/// What the errors of single encoder readings may do to the means over a stop's blocks on one channel, less what the
/// encoders see: at most as much as they see.
fn readings_variance(readings: &[Readings; 2], axis_rates: [f32; 2], inner: Angle, channel: u8, block_s: f64) -> f64 {
    let (sin, cos) = inner.sin_cos::<f64>();
    let axes = match channel {
        3 => [cos, 0.0],
        4 => [sin, 0.0],
        5 => [0.0, 1.0],
        // Force depends on the mean of a block's readings, which is good.
        _ => return 0.0,
    };
    let readings = axes.iter().zip(readings).zip(axis_rates);
    readings.fold(0.0, |sum, ((by_axis, readings), seen)| {
        let gain = by_axis.abs() + INSTALLATION_RAD;
        sum + gain * gain * (2.0 * readings.variance() / (block_s * block_s)).min(seen.into())
    })
}

/// Quantile of chi-square at the normal deviate `z` (Wilson and Hilferty 1931; within 1 % from 10 degrees of freedom).
pub fn chi_square_quantile(degrees_of_freedom: u32, z: f64) -> f64 {
    let n = f64::from(degrees_of_freedom);
    let part = 2.0 / (9.0 * n);
    let root = (1.0 - part + z * ComplexField::sqrt(part)).max(0.0);
    n * root * root * root
}

#[cfg(test)]
mod tests {
    use super::super::scatter::Scatter;
    use super::*;

    const NOISE: Noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 4.0 };

    /// A stop of 100 blocks of 0.1 s with this many times the configured variance on accelerometer y.
    fn stop(ratio: f64) -> Segment<f64> {
        let variance = |psd_sqrt: f64| (psd_sqrt * psd_sqrt / 0.1) as f32;
        let (accel, gyro) = (variance(NOISE.accel_psd_sqrt), variance(NOISE.gyro_psd_sqrt));
        let scatter = Scatter {
            blocks: 100,
            freedom: 99,
            variance: [accel, accel * ratio as f32, accel, gyro, gyro, gyro],
            trend: [accel.sqrt(); 6],
            ..Scatter::default()
        };
        let mut stop = Segment::quiet_stop(10_000_000);
        stop.standing_mut().scatter = scatter;
        stop
    }

    #[test]
    fn larger_noise_is_allowed_for_up_to_the_margin() {
        // 99 degrees of freedom: a ratio beyond 1.48 is significant.
        for (ratio, allowed) in [(0.5, 1.0), (1.4, 1.0), (1.6, 1.6), (3.9, 3.9), (10.0, 4.0)] {
            let stop = stop(ratio);
            let allowances = NOISE.allowances(&stop);
            assert!((allowances[1] - allowed).abs() < 1e-6, "{allowances:?}");
            assert_eq!([allowances[0], allowances[2], allowances[3]], [1.0; 3]);
            let seen = NOISE.scatter(&stop, 1).expect("a stop");
            assert!((seen.variance - ratio / allowed).abs() < 1e-6);
            assert!((seen.trend - allowed.sqrt().recip()).abs() < 1e-6);
            assert_eq!(Noise { margin: 1.0, ..NOISE }.allowances(&stop), [1.0; CHANNELS]);
        }
    }

    #[test]
    fn chi_square_quantiles_are_those_of_tables() {
        // 99.9 % is a normal deviate of 3.0902.
        for (freedom, table) in [(10, 29.588), (30, 59.703), (100, 149.449)] {
            let found = chi_square_quantile(freedom, 3.0902);
            assert!((found / table - 1.0).abs() < 0.01, "{freedom}: {found}");
        }
    }
}
