//! Noise of a log: white noise at its stops, and what its encoders must add so that its segments agree.

use super::allan::{AllanDeviation, AllanPoint, NoiseFigures, figures};
use super::passage::Passage;
use crate::calibration::{HOST_SEGMENTS, Setup};
use crate::files::unit_file::Noise;
use crate::log::{LogError, LogReader};
use rins_selfcal::base::sample::CHANNELS;
use rins_selfcal::base::units::{DEG_SQRT_H, MICRO_G};
use rins_selfcal::estimator::{BASIC_STATES, Estimator, EstimatorConfig, Solution};
use rins_selfcal::segment::{Segment, SegmentKind};
use rins_selfcal::verdict::CHANNEL_NAMES;
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Channels of a triad that are this much noisier than its mean are not alike.
const ALIKE: f64 = 1.15;
/// Encoder errors that are looked for, arcsec.
const ENCODERS_ARCSEC: [f64; 2] = [0.02, 200.0];
/// Halvings of that range, by ratio: to 1 %.
const HALVINGS: u32 = 10;
/// Half of the confidence that is left out of a range of one sigma.
const TAIL: f64 = 0.1587;
/// Intervals without a sample that end a stretch.
const GAP_INTERVALS: f64 = 1.5;

/// One channel.
#[derive(Clone, Debug, Serialize)]
pub struct ChannelNoise {
    /// Its name.
    pub channel: &'static str,
    /// What its curve says, SI; none where the stops are too short.
    pub figures: Option<NoiseFigures>,
    /// Allan deviation, SI.
    pub curve: Vec<AllanPoint>,
}

/// Error of the encoders by which the segments agree with the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EncoderNoise {
    /// So that the chi-square equals its degrees of freedom, arcsec.
    pub arcsec: f64,
    /// One sigma either way, arcsec.
    pub range_arcsec: [f64; 2],
    /// Degrees of freedom.
    pub degrees_of_freedom: u32,
}

/// All channels at the stops of a log.
///
/// # Errors
/// As reading it.
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

/// White noise of a triad, which has one number for its three channels: their root mean square, or, where one of them is
/// noisier than that, the noisiest one's.
fn white(channels: &[ChannelNoise]) -> Option<f64> {
    let all: Option<Vec<f64>> = channels.iter().map(|channel| Some(channel.figures?.white)).collect();
    let all = all.filter(|all| !all.is_empty())?;
    let mean = (all.iter().map(|white| white * white).sum::<f64>() / all.len() as f64).sqrt();
    let most = all.iter().copied().fold(0.0, f64::max);
    Some(if most > ALIKE * mean { most } else { mean })
}

/// The noise of these channels, with what is configured where nothing is seen.
pub fn of_channels(channels: &[ChannelNoise], configured: &Noise) -> Noise {
    let [accels, gyros] = [0..3, 3..6].map(|triad| channels.get(triad).and_then(white));
    Noise {
        accel_vrw_ug_sqrt_hz: accels.map_or(configured.accel_vrw_ug_sqrt_hz, |white| three_digits(white / MICRO_G)),
        gyro_arw_deg_sqrt_h: gyros.map_or(configured.gyro_arw_deg_sqrt_h, |white| three_digits(white / DEG_SQRT_H)),
        ..*configured
    }
}

/// With three significant digits, as it is worth to be written in a file.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// An estimator that has taken in these segments.
pub fn estimator(setup: &Setup, segments: &[Segment<f64>]) -> Box<Estimator<f64, HOST_SEGMENTS, BASIC_STATES>> {
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

/// The encoder error with which the segments agree, none where they agree without, or do not with any.
pub fn encoders(setup: &Setup, segments: &[Segment<f64>]) -> Option<EncoderNoise> {
    let degrees_of_freedom = solution(setup, segments, setup.noise.encoder_repeatability_arcsec)?.degrees_of_freedom;
    let distribution = ChiSquared::new(f64::from(degrees_of_freedom)).ok()?;
    let with = |chi_square: f64| with_chi_square(setup, segments, chi_square);
    let arcsec = with(f64::from(degrees_of_freedom))?;
    let low = with(distribution.inverse_cdf(1.0 - TAIL)).unwrap_or(0.0);
    let high = with(distribution.inverse_cdf(TAIL)).unwrap_or(f64::INFINITY);
    Some(EncoderNoise { arcsec: three_digits(arcsec), range_arcsec: [low, high].map(three_digits), degrees_of_freedom })
}

/// The chi-square falls as the error that is allowed for grows.
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
