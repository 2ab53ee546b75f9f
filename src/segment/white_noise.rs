//! Noise at a stop: the scatter of the block means against the configured noise.
//!
//! Beyond white noise, an instrument may have flicker, warm up, rock on its base or report whole pulses
//! ([`Hardware`]). What these may add to the scatter and to the trend is allowed for.
//!
//! Hunting of an axis that the encoders see is not noise; the module `scatter` removes it. But single readings of a
//! coarse encoder have errors, and so has the rate of an axis over a block. The gyros of that axis are allowed as much
//! more scatter.

use super::readings::Readings;
use super::types::{Segment, Standing};
use crate::base::angle::Angle;
use crate::base::bounds::{ARCSECONDS, Bounded, Unit};
use crate::base::hardware::{FLICKER_DENSITY, Hardware};
use crate::base::linear::{ComplexField, Real};
use crate::base::sample::CHANNELS;
use crate::base::units::{DEG_SQRT_H, MICRO_G, STANDARD_GRAVITY_M_S2};
use serde::{Deserialize, Serialize};

/// Normal deviate above which the noise of a stop counts as larger than configured. The probability that chance exceeds
/// the limit is 1e-3 for each channel.
const LARGER_Z: f64 = 3.0;

/// Bound of the installation errors, through which a gyro feels the other axes, rad.
const INSTALLATION_RAD: f64 = 0.02;
/// Errors of the readings cancel over a stop. Over `n` blocks, this number divided by `n` is the fraction of their
/// variance that remains in the trend.
const TREND_PART: f64 = 3.0;

/// White noise of the sensors and repeatability of the encoders. [`NOISE_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Noise {
    /// Velocity random walk, m/s^2/sqrt(Hz).
    pub accel_psd_sqrt: f64,
    /// Angular random walk, rad/sqrt(s).
    pub gyro_psd_sqrt: f64,
    /// Standard deviation of the encoder error, rad. The error is independent from stop to stop and from axis to axis.
    pub encoder_sigma_rad: f64,
    /// Largest factor on the configured variance of the white noise that a stop is allowed. With 1, no more noise than
    /// configured is allowed.
    pub margin: f64,
}

/// The permitted range of every number of [`Noise`], far beyond every real sensor at both ends. A filter without noise
/// cannot be calculated.
pub static NOISE_BOUNDS: [Bounded<Noise>; 4] = [
    Bounded::new("velocity random walk", Unit { symbol: "ug/sqrt(Hz)", si: MICRO_G }, [1e-6, 1e6], |noise| {
        noise.accel_psd_sqrt
    }),
    Bounded::new("angle random walk", Unit { symbol: "deg/sqrt(h)", si: DEG_SQRT_H }, [1e-9, 1e3], |noise| {
        noise.gyro_psd_sqrt
    }),
    Bounded::new("repeatability of the encoders", ARCSECONDS, [1e-6, 3600.0], |noise| noise.encoder_sigma_rad),
    Bounded::new("noise margin", Unit::si(""), [1.0, 1e6], |noise| noise.margin),
];

/// Scatter of one channel at a stop, in units of the noise that is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ScatterRatios {
    /// Variance of the block means.
    pub variance: f64,
    /// Variance of the block means in units of the sensor's white noise alone.
    pub of_white: f64,
    /// Trend of the block means, in sigmas.
    pub trend: f64,
    /// Degrees of freedom of the variances.
    pub freedom: u32,
}

impl Noise {
    /// Factor on the configured variance that is allowed on each channel at a stop. The factor is 1 unless the stop
    /// shows significantly more noise.
    pub fn allowances<T: Real>(&self, hardware: &Hardware, stop: &Segment<T>) -> [f64; CHANNELS] {
        let mut allowances = [1.0; CHANNELS];
        if self.margin > 1.0 {
            for (channel, allowance) in (0_u8..).zip(&mut allowances) {
                *allowance = self.allowance(hardware, stop, channel);
            }
        }
        allowances
    }

    /// Scatter of the block means of a stop on one channel. `None` for a move, and for a stop that is too short.
    pub fn scatter<T: Real>(&self, hardware: &Hardware, stop: &Segment<T>, channel: u8) -> Option<ScatterRatios> {
        let ScatterRatios { variance, of_white, trend, freedom } = self.unallowed(hardware, stop, channel)?;
        let allowance = self.allowance(hardware, stop, channel);
        Some(ScatterRatios {
            variance: variance / allowance,
            of_white: of_white / allowance,
            trend: trend / ComplexField::sqrt(allowance),
            freedom,
        })
    }

    fn allowance<T: Real>(&self, hardware: &Hardware, stop: &Segment<T>, channel: u8) -> f64 {
        match self.unallowed(hardware, stop, channel) {
            Some(ScatterRatios { variance, freedom, .. })
                if variance * f64::from(freedom) > chi_square_quantile(freedom, LARGER_Z) =>
            {
                // `clamp` can panic.
                variance.min(self.margin).max(1.0)
            }
            _ => 1.0,
        }
    }

    /// Scatter in units of the configured noise.
    fn unallowed<T: Real>(&self, hardware: &Hardware, stop: &Segment<T>, channel: u8) -> Option<ScatterRatios> {
        let Standing { scatter, readings, increments, .. } =
            stop.standing().filter(|standing| standing.scatter.freedom >= 2)?;
        let psd_sqrt = if channel < 3 { self.accel_psd_sqrt } else { self.gyro_psd_sqrt };
        let blocks = f64::from(scatter.blocks);
        let block_s = stop.duration_s().widened() / blocks;
        let white = psd_sqrt * psd_sqrt / block_s;
        let readings = readings_variance(readings, scatter.axis_rates, stop.inner, channel, block_s);
        let increment = increments.get(usize::from(channel)).map_or(0.0, |increment| f64::from(*increment));
        let interval_s = stop.duration_s().widened() / f64::from(stop.samples.max(1));
        let coloured = Coloured::of(hardware, channel, increment * interval_s, block_s, blocks);
        let variance = f64::from(*scatter.variance.get(usize::from(channel))?);
        let trend = f64::from(*scatter.trend.get(usize::from(channel))?);
        Some(ScatterRatios {
            variance: variance / (white + readings + coloured.variance),
            of_white: variance / white,
            trend: trend / ComplexField::sqrt(white + readings * TREND_PART / blocks + coloured.trend),
            freedom: scatter.freedom.into(),
        })
    }
}

/// What noise that is not white may add to the block means of a stop. For n blocks of length t:
///
/// ```text
/// process                                  variance of the means     variance of the trend
/// random walk, q per second                q t n / 6                 q t n^2 / 10
/// slope of s per second                    s^2 t^2 n^2 / 12          s^2 t^2 n^3 / 12
/// pulses of size p, two errors a mean      p^2 / (6 t^2)             3 / n of it
/// 1/f of density h at 1 Hz, at most        h (1 + ln n)              h n
/// rocking, an oscillation                  its power                 at most 0.6 n of its power
/// ```
/// The trend is [`Scatter::trend`](super::scatter::Scatter::trend): its weights grow in proportion to time.
struct Coloured {
    /// Variance that it adds to the block means.
    variance: f64,
    /// Variance that it adds to the trend of the block means.
    trend: f64,
}

/// Shortest time constant of a warm-up, s.
const SHORTEST_WARM_UP_S: f64 = 100.0;
/// Power of a slow oscillation that may appear as a trend.
const OSCILLATION_PART: f64 = 0.6;
/// Lowest frequency of the rocking of a base, rad/s: 0.1 Hz.
const ROCKING_RAD_S: f64 = 0.63;

impl Coloured {
    /// For a channel with pulses of this size (m/s or rad, 0 if its output is not known to be pulses) at a stop of this
    /// number of blocks of `block_s`.
    fn of(hardware: &Hardware, channel: u8, pulse: f64, block_s: f64, blocks: f64) -> Self {
        let square = |x: f64| x * x;
        let is_accel = channel < 3;
        let (floor, walk, warm_up, configured_pulse) = if is_accel {
            (hardware.accel_floor, hardware.accel_walk, hardware.accel_warm_up, hardware.accel_pulse)
        } else {
            (hardware.gyro_floor, hardware.gyro_walk, hardware.gyro_warm_up, hardware.gyro_pulse)
        };
        let scale = if is_accel { STANDARD_GRAVITY_M_S2 * f64::from(hardware.scale_warm_up) } else { 0.0 };
        let flicker = FLICKER_DENSITY * square(floor.into());
        let walk = square(walk.into()) * block_s;
        let slope = square((f64::from(warm_up) + scale) / SHORTEST_WARM_UP_S * block_s);
        let rocking = square(hardware.base_rocking.into());
        let pulse = square(pulse.max(configured_pulse.into()) / block_s) / 6.0;
        let [rocking, rocking_trend] = if is_accel {
            let force = rocking * square(STANDARD_GRAVITY_M_S2);
            [force, OSCILLATION_PART * force * blocks]
        } else {
            let rate = 2.0 * rocking / square(block_s);
            [rate, OSCILLATION_PART * blocks * rocking * square(ROCKING_RAD_S) + TREND_PART * rate / blocks]
        };
        Self {
            variance: flicker * (1.0 + ComplexField::ln(blocks))
                + walk * blocks / 6.0
                + slope * blocks * blocks / 12.0
                + rocking
                + pulse,
            trend: flicker * blocks
                + walk * blocks * blocks / 10.0
                + slope * blocks * blocks * blocks / 12.0
                + rocking_trend
                + pulse * TREND_PART / blocks,
        }
    }
}

/// Variance that the errors of single encoder readings may add to the block means of one channel, because the part
/// that the encoders see is removed from them. The variance is at most the variance that the encoders show.
fn readings_variance(readings: &[Readings; 2], axis_rates: [f32; 2], inner: Angle, channel: u8, block_s: f64) -> f64 {
    let (sin, cos) = inner.sin_cos::<f64>();
    let axes = match channel {
        3 => [cos, 0.0],
        4 => [sin, 0.0],
        5 => [0.0, 1.0],
        // Force depends on the mean over the readings of a block, and the error of the mean is small.
        _ => return 0.0,
    };
    let readings = axes.iter().zip(readings).zip(axis_rates);
    readings.fold(0.0, |sum, ((by_axis, readings), seen)| {
        let gain = by_axis.abs() + INSTALLATION_RAD;
        sum + gain * gain * (2.0 * readings.variance() / (block_s * block_s)).min(seen.into())
    })
}

/// Quantile of chi-square at the normal deviate `z` (Wilson and Hilferty 1931). The error is below 1 % from 10 degrees
/// of freedom on.
pub fn chi_square_quantile(degrees_of_freedom: u32, z: f64) -> f64 {
    let n = f64::from(degrees_of_freedom);
    let part = 2.0 / (9.0 * n);
    let root = (1.0 - part + z * ComplexField::sqrt(part)).max(0.0);
    n * root * root * root
}

/// Normal deviate of a chi-square, the inverse of [`chi_square_quantile`].
pub fn chi_square_deviate(degrees_of_freedom: u32, chi_square: f64) -> f64 {
    let n = f64::from(degrees_of_freedom.max(1));
    let part = 2.0 / (9.0 * n);
    (ComplexField::cbrt(chi_square / n) - 1.0 + part) / ComplexField::sqrt(part)
}

#[cfg(test)]
mod tests {
    use super::super::scatter::Scatter;
    use super::*;

    const NOISE: Noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 4.0 };

    /// A stop of 100 blocks of 0.1 s. On accelerometer y the variance is `ratio` times the configured variance.
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

    const BLOCKS: usize = 60;
    const BLOCK_S: f64 = 0.1;

    /// Mean variance of the block means, and mean square of their trend, over 4000 stops with these block means.
    fn simulated(mut stop: impl FnMut(&mut dyn FnMut() -> f64) -> [f64; BLOCKS]) -> [f64; 2] {
        const STOPS: u32 = 4000;
        let mut seed = 3_u64;
        // A sum of twelve uniform numbers is normal enough.
        let mut normal = move || {
            let mut uniform = || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (seed >> 11) as f64 / (1_u64 << 53) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        };
        let n = BLOCKS as f64;
        let mut sums = [0.0; 2];
        for _ in 0..STOPS {
            let means = stop(&mut normal);
            let mean = means.iter().sum::<f64>() / n;
            let since_middle = |block: usize| block as f64 - (n - 1.0) / 2.0;
            let by_time: f64 = means.iter().enumerate().map(|(block, x)| since_middle(block) * x).sum();
            sums[0] += means.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
            sums[1] += by_time * by_time / (n * (n * n - 1.0) / 12.0);
        }
        sums.map(|sum| sum / f64::from(STOPS))
    }

    fn coloured(hardware: Hardware, channel: u8) -> [f64; 2] {
        let Coloured { variance, trend } = Coloured::of(&hardware, channel, 0.0, BLOCK_S, BLOCKS as f64);
        [variance, trend]
    }

    /// The relative sigma of the mean of 4000 squares is sqrt(2 / 4000) = 2.2 %.
    #[test]
    fn walks_and_pulses_are_as_large_as_simulated() {
        let walk = coloured(Hardware { accel_walk: 1.0, ..Hardware::IDEAL }, 0);
        let of_walk = simulated(|normal| {
            let mut x = 0.0;
            core::array::from_fn(|_| {
                x += normal() * BLOCK_S.sqrt();
                x
            })
        });
        let pulses = coloured(Hardware { accel_pulse: 1.0, ..Hardware::IDEAL }, 0);
        let of_pulses = simulated(|normal| {
            // The error of a counter is as uncertain as a number between 0 and 1: its variance is 1 / 12.
            let mut before = normal() / 12.0_f64.sqrt();
            core::array::from_fn(|_| {
                let error = core::mem::replace(&mut before, normal() / 12.0_f64.sqrt());
                (before - error) / BLOCK_S
            })
        });
        for (found, expected) in walk.iter().zip(of_walk).chain(pulses.iter().zip(of_pulses)) {
            // Five sigma, and 3 % for the finite number of blocks.
            assert!((found / expected - 1.0).abs() < 0.14, "{found} for {expected}");
        }
    }

    /// 1/f noise as processes with exponential correlation, one octave after the other. The bounds of the stop are
    /// upper ones, by no more than a factor of 2.
    #[test]
    fn flicker_is_at_most_as_large_as_allowed() {
        let allowed = coloured(Hardware { accel_floor: 1.0, ..Hardware::IDEAL }, 0);
        let of_flicker = simulated(|normal| {
            let sigma = (FLICKER_DENSITY * core::f64::consts::LN_2).sqrt();
            let mut means = [0.0; BLOCKS];
            for octave in 0..12 {
                let decay = (-0.5_f64.powi(octave)).exp();
                let mut x = sigma * normal();
                for mean in &mut means {
                    *mean += x;
                    x = decay * x + sigma * (1.0 - decay * decay).sqrt() * normal();
                }
            }
            means
        });
        for (allowed, found) in allowed.iter().zip(of_flicker) {
            assert!((1.0..2.0).contains(&(allowed / found)), "{allowed} allowed, {found} found");
        }
    }

    #[test]
    fn larger_noise_is_allowed_for_up_to_the_margin() {
        // With 99 degrees of freedom, a ratio above 1.48 is significant.
        for (ratio, allowed) in [(0.5, 1.0), (1.4, 1.0), (1.6, 1.6), (3.9, 3.9), (10.0, 4.0)] {
            let stop = stop(ratio);
            let allowances = NOISE.allowances(&Hardware::IDEAL, &stop);
            assert!((allowances[1] - allowed).abs() < 1e-6, "{allowances:?}");
            assert_eq!([allowances[0], allowances[2], allowances[3]], [1.0; 3]);
            let seen = NOISE.scatter(&Hardware::IDEAL, &stop, 1).expect("a stop");
            assert!((seen.variance - ratio / allowed).abs() < 1e-6);
            assert!((seen.trend - allowed.sqrt().recip()).abs() < 1e-6);
            assert_eq!(Noise { margin: 1.0, ..NOISE }.allowances(&Hardware::IDEAL, &stop), [1.0; CHANNELS]);
        }
    }

    #[test]
    fn chi_square_quantiles_are_those_of_tables() {
        // The probability 99.9 % is a normal deviate of 3.0902.
        for (freedom, table) in [(10, 29.588), (30, 59.703), (100, 149.449)] {
            let found = chi_square_quantile(freedom, 3.0902);
            assert!((found / table - 1.0).abs() < 0.01, "{freedom}: {found}");
            assert!((chi_square_deviate(freedom, found) - 3.0902).abs() < 1e-9, "{freedom}");
        }
    }
}
