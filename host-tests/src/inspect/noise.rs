//! Noise of the channels at the stops of a log.

use super::allan::{AllanDeviation, AllanPoint};
use super::hunting::{self, SERIES, Series};
use super::passage::Passage;
use super::shapes::{Process, Processes};
use crate::calibration::raw_sample;
use crate::log::{LogError, LogReader};
use rins_selfcal::segment::SegmentKind;
use rins_selfcal::verdict::CHANNEL_NAMES;
use serde::Serialize;

/// A longer time between two samples, in sample intervals, is a gap.
const GAP_INTERVALS: f64 = 1.5;

/// Noise of one channel.
#[derive(Clone, Debug, Serialize)]
pub struct ChannelNoise {
    /// Its name.
    pub channel: &'static str,
    /// The noise processes and their sizes, SI. None if the stops are too short.
    pub processes: Processes,
    /// Allan deviation without what the encoders predict, SI.
    pub curve: Vec<AllanPoint>,
}

/// Noise at the stops.
#[derive(Clone, Debug, Serialize)]
pub struct StopNoise {
    /// All channels: accelerometers, then gyros.
    pub channels: Vec<ChannelNoise>,
    /// Root mean square of the angles by which the axes hunt, rad.
    pub hunting_rad: f64,
}

/// Noise of all channels at the stops of a log.
///
/// # Errors
/// The log cannot be read.
pub fn at_stops(reader: LogReader, passage: &Passage, mut on_rows: impl FnMut(u64)) -> Result<StopNoise, LogError> {
    let interval_us = 1e6 / passage.rate_hz;
    let mut allan = AllanDeviation::<SERIES>::new(interval_us * 1e-6);
    let stops: Vec<_> = passage.segments.iter().filter(|segment| segment.kind() == SegmentKind::Stop).collect();
    let (mut stop, mut last_us) = (0, 0);
    let mut series = stops.first().map(|stop| Series::at(stop));
    for (row, read) in (1..).zip(reader.take(usize::try_from(passage.rows).unwrap_or(usize::MAX))) {
        let reading = read?.reading;
        if row % 10_000 == 0 {
            on_rows(row);
        }
        let before = stop;
        while stops.get(stop).is_some_and(|stop| stop.start_us + stop.duration_us < reading.time_us) {
            stop += 1;
        }
        if stop != before || (reading.time_us - last_us) as f64 > GAP_INTERVALS * interval_us {
            allan.restart();
            series = stops.get(stop).map(|stop| Series::at(stop));
        }
        let repeated = std::mem::replace(&mut last_us, reading.time_us) == reading.time_us;
        if let Some(series) = series.as_mut().filter(|_| stops[stop].start_us < reading.time_us && !repeated)
            && let Some(values) = series.step(&raw_sample(&reading), interval_us * 1e-6)
        {
            allan.add(values);
        }
    }
    let channel = |(number, weights): (usize, &[f64; SERIES])| {
        let curve = allan.curve(weights);
        let known = if number < 3 { &Process::OF_ACCELEROMETER[..] } else { &Process::OF_GYRO };
        ChannelNoise { channel: CHANNEL_NAMES[number], processes: Processes::of(&curve, known), curve }
    };
    let channels = hunting::removed(&allan).iter().enumerate().map(channel).collect();
    Ok(StopNoise { channels, hunting_rad: hunting::size_rad(&allan) })
}
