//! Noise of a log: the white noise at its stops, and the encoder error with which its segments agree with the model.

use super::allan::{AllanDeviation, AllanPoint, NoiseFigures, figures};
use super::passage::Passage;
use crate::calibration::{HOST_SEGMENTS, Setup};
use crate::files::unit_file::Noise;
use crate::log::{LogError, LogReader};
use rins_selfcal::base::sample::CHANNELS;
use rins_selfcal::base::units::{DEG_SQRT_H, MICRO_G};
use rins_selfcal::estimator::{Estimator, EstimatorConfig, Solution};
use rins_selfcal::segment::{Segment, SegmentKind};
use rins_selfcal::verdict::CHANNEL_NAMES;
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// A channel whose noise is larger than the triad's mean by more than this factor sets the noise of the triad.
const ALIKE: f64 = 1.15;
/// Range of encoder errors that is searched, arcsec.
const ENCODERS_ARCSEC: [f64; 2] = [0.02, 200.0];
/// Halvings of the logarithmic range, which give the encoder error to 1 %.
const HALVINGS: u32 = 10;
/// Probability beyond one sigma on one side.
const TAIL: f64 = 0.1587;
/// A longer time between two samples, in sample intervals, is a gap.
const GAP_INTERVALS: f64 = 1.5;

/// Noise of one channel.
#[derive(Clone, Debug, Serialize)]
pub struct ChannelNoise {
    /// Its name.
    pub channel: &'static str,
    /// Figures of the curve, SI. `None` if the stops are too short.
    pub figures: Option<NoiseFigures>,
    /// Allan deviation, SI.
    pub curve: Vec<AllanPoint>,
}

/// Error of the encoders with which the segments agree with the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EncoderNoise {
    /// Encoder error for which the chi-square equals its degrees of freedom, arcsec.
    pub arcsec: f64,
    /// Encoder errors one sigma below and above, arcsec.
    pub range_arcsec: [f64; 2],
    /// Degrees of freedom.
    pub degrees_of_freedom: u32,
}

/// Noise of all channels at the stops of a log.
///
/// # Errors
/// The log cannot be read.
pub fn channels(
    reader: LogReader,
    passage: &Passage,
    mut on_rows: impl FnMut(u64),
) -> Result<Vec<ChannelNoise>, LogError> {
    let interval_us = 1e6 / passage.rate_hz;
    let mut allan = AllanDeviation::<CHANNELS>::new(interval_us * 1e-6);
    let stops: Vec<_> = passage.segments.iter().filter(|segment| segment.kind() == SegmentKind::Stop).collect();
    let (mut stop, mut last_us) = (0, 0);
    for (row, read) in (1..).zip(reader.take(usize::try_from(passage.rows).unwrap_or(usize::MAX))) {
        let reading = read?.reading;
        if row % 10_000 == 0 {
            on_rows(row);
        }
        while stops.get(stop).is_some_and(|stop| stop.start_us + stop.duration_us < reading.time_us) {
            stop += 1;
            allan.restart();
        }
        if (reading.time_us - last_us) as f64 > GAP_INTERVALS * interval_us {
            allan.restart();
        }
        let repeated = std::mem::replace(&mut last_us, reading.time_us) == reading.time_us;
        if stops.get(stop).is_some_and(|stop| stop.start_us < reading.time_us) && !repeated {
            let ([gx, gy, gz], [ax, ay, az]) = (reading.omega_g, reading.force_a);
            allan.add([ax, ay, az, gx, gy, gz]);
        }
    }
    let channel = |(number, name): (usize, &&'static str)| {
        let curve = allan.curve(number);
        ChannelNoise { channel: name, figures: figures(&curve), curve }
    };
    Ok(CHANNEL_NAMES.iter().enumerate().map(channel).collect())
}

/// White noise of a triad, which has one number for its three channels: the root mean square of the three, or the noise
/// of the noisiest channel if it is clearly larger.
fn white(channels: &[ChannelNoise]) -> Option<f64> {
    let all: Option<Vec<f64>> = channels.iter().map(|channel| Some(channel.figures?.white)).collect();
    let all = all.filter(|all| !all.is_empty())?;
    let mean = (all.iter().map(|white| white * white).sum::<f64>() / all.len() as f64).sqrt();
    let most = all.iter().copied().fold(0.0, f64::max);
    Some(if most > ALIKE * mean { most } else { mean })
}

/// The noise of these channels. The configured value is kept where the channels show none.
pub fn of_channels(channels: &[ChannelNoise], configured: &Noise) -> Noise {
    let [accels, gyros] = [0..3, 3..6].map(|triad| channels.get(triad).and_then(white));
    Noise {
        accel_vrw_ug_sqrt_hz: accels.map_or(configured.accel_vrw_ug_sqrt_hz, |white| three_digits(white / MICRO_G)),
        gyro_arw_deg_sqrt_h: gyros.map_or(configured.gyro_arw_deg_sqrt_h, |white| three_digits(white / DEG_SQRT_H)),
        ..*configured
    }
}

/// Rounds to three significant digits, which is all that the estimate is worth in a file.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// An estimator that has processed these segments.
pub fn estimator(setup: &Setup, segments: &[Segment<f64>]) -> Box<Estimator<f64, HOST_SEGMENTS>> {
    let mut estimator = Box::new(Estimator::new());
    estimator.restart(&EstimatorConfig { gate_sigma: None, ..setup.config().estimator });
    for segment in segments {
        let _ = estimator.add(segment);
    }
    estimator
}

fn solution(setup: &Setup, segments: &[Segment<f64>], encoder_arcsec: f64) -> Option<Solution> {
    let noise = Noise { encoder_repeatability_arcsec: encoder_arcsec, ..setup.noise };
    let mut estimator = estimator(&Setup { noise, ..setup.clone() }, segments);
    while !estimator.solve_piece() {}
    estimator.solution().copied()
}

/// The encoder error with which the segments agree with the model. `None` if they agree with the smallest error of the
/// range, or do not agree with the largest.
pub fn encoders(setup: &Setup, segments: &[Segment<f64>]) -> Option<EncoderNoise> {
    let degrees_of_freedom = solution(setup, segments, setup.noise.encoder_repeatability_arcsec)?.degrees_of_freedom;
    let distribution = ChiSquared::new(f64::from(degrees_of_freedom)).ok()?;
    let with = |chi_square: f64| with_chi_square(setup, segments, chi_square);
    let arcsec = with(f64::from(degrees_of_freedom))?;
    let low = with(distribution.inverse_cdf(1.0 - TAIL)).unwrap_or(0.0);
    let high = with(distribution.inverse_cdf(TAIL)).unwrap_or(f64::INFINITY);
    Some(EncoderNoise { arcsec: three_digits(arcsec), range_arcsec: [low, high].map(three_digits), degrees_of_freedom })
}

/// The encoder error that gives this chi-square. The chi-square falls as the encoder error grows, so the range is
/// halved.
fn with_chi_square(setup: &Setup, segments: &[Segment<f64>], chi_square: f64) -> Option<f64> {
    let above = |arcsec: f64| Some(solution(setup, segments, arcsec)?.fit.chi_square > chi_square);
    let [mut low, mut high] = ENCODERS_ARCSEC;
    if !above(low)? || above(high)? {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if above(middle)? { low = middle } else { high = middle }
    }
    Some((low * high).sqrt())
}
