//! An inspection: what is asked of a log, and what is seen in it.

use super::guess::{Guess, Taken};
use super::noise::{ChannelNoise, EncoderNoise};
use super::passage::{Gap, Passage};
use super::shape::{Shape, ShapeError};
use super::sketch::{Sketch, SketchError};
use super::turned::Likeness;
use super::{noise, turned};
use crate::base::quantity::significant;
use crate::calibration::{Precision, Setup, covariance};
use crate::files::unit_file::{Noise, UnitConfig};
use crate::log::{Layout, LogError, LogReader, Mapping, Moment};
use crate::plan::prediction::Observed;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::{Segment, SegmentKind};
use rins_selfcal::verdict::{Reason, wiring};
use serde::Serialize;
use std::path::Path;

/// White noise is exceeded where the deviation at the longest time is so many times as large.
const EXCESS: f64 = 1.6;
/// Gravity of the site and of the accelerometers differ, as part of it: a tenth of a percent is another site or unit.
const GRAVITY_OFF: f64 = 2e-3;

/// Samples of a log.
#[derive(Clone, Debug, Serialize)]
pub struct Sampling {
    /// Rows.
    pub rows: u64,
    /// First and last time, s.
    pub times_s: [f64; 2],
    /// By the median interval, Hz.
    pub rate_hz: f64,
    /// Gaps.
    pub gaps: u32,
    /// Samples missing in the gaps.
    pub missing: u32,
    /// The longest gap.
    pub longest_gap: Option<Gap>,
    /// Samples with the time of the one before.
    pub repeated: u32,
    /// Part of an interval by which the encoders are read before its end, where that shows.
    pub encoders_early: Option<f64>,
    /// Lowest and highest temperature, deg C.
    pub temperature_c: Option<[f32; 2]>,
    /// Mean length of the force at the stops, m/s^2.
    pub gravity_m_s2: Option<f64>,
}

/// A stop or a move.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SegmentSeen {
    /// Stop or move.
    pub kind: SegmentKind,
    /// Start, s.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// Angles (outer, inner) of a stop, within half a turn, or how far a move turns, deg.
    pub angles_deg: [f64; 2],
    /// Whether a gap spoils it.
    pub is_broken: bool,
}

/// What a log is.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Columns of numbers and what they were taken for; empty where a mapping was given.
    pub columns: Vec<Taken>,
    /// The mapping that is proposed; none where the log is a standard one, or a mapping was given.
    pub mapping: Option<Mapping>,
    /// Samples.
    pub sampling: Sampling,
    /// Stops and moves.
    pub segments: Vec<SegmentSeen>,
    /// Noise to be configured.
    pub noise: Noise,
    /// Where it comes from: the channels at the stops.
    pub channels: Vec<ChannelNoise>,
    /// And the encoders, by the disagreement of the segments.
    pub encoders: Option<EncoderNoise>,
    /// The scheme of the library that is nearest.
    pub nearest_scheme: Option<Likeness>,
    /// The log's own.
    #[serde(skip)]
    pub scheme: Option<Scheme>,
    /// What is observable from the log; none without stops and moves.
    pub observed: Option<Observed>,
    /// What should be looked at.
    pub remarks: Vec<String>,
    /// Why it was not read to its end.
    pub stopped_by: Option<String>,
}

/// Why nothing can be said.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// It is not cut into columns of numbers.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A column cannot be read.
    #[error(transparent)]
    Sketch(#[from] SketchError),
    /// The columns cannot be told.
    #[error("{path}: {what}")]
    Columns {
        /// The log.
        path: String,
        /// What cannot be told.
        what: String,
    },
}

/// What is known before.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// The log.
    pub log: &'a Path,
    /// What it has in which columns, where that is known.
    pub layout: Option<Layout>,
    /// Site of the unit.
    pub unit: UnitConfig,
}

impl Request<'_> {
    /// Looks at the log. `on_rows` is told now and then what is being done, and how many rows so far.
    ///
    /// # Errors
    /// It cannot be read, or its columns cannot be told. A wrong row later on ends the look and is told in the inspection.
    pub fn run(&self, mut on_rows: impl FnMut(&'static str, u64)) -> Result<Inspection, InspectError> {
        let guess = match self.layout {
            Some(_) => None,
            None => Some(self.guess(&mut on_rows)?),
        };
        let layout = match (&self.layout, &guess) {
            (Some(layout), _) => layout.clone(),
            (None, guess) => self.checked(guess.as_ref().map_or(&Mapping::default(), |guess| &guess.mapping))?,
        };
        let reader = LogReader::open_as(self.log, &layout)?;
        let (passage, stopped_by) = Passage::over(reader, |rows| on_rows("stops and moves", rows));
        let (layout, mapping) = self.aligned(&passage, layout, guess.as_ref())?;
        let channels =
            noise::channels(LogReader::open_as(self.log, &layout)?, &passage, |rows| on_rows("noise", rows))?;
        let columns = guess.as_ref().map_or_else(Vec::new, |guess| guess.columns.clone());
        let remarks = guess.map_or_else(Vec::new, |guess| guess.remarks);
        let mut found = self.concluded(&passage, channels);
        found.remarks.splice(0..0, remarks);
        Ok(Inspection { columns, mapping, stopped_by: stopped_by.map(|error| error.to_string()), ..found })
    }

    fn guess(&self, on_rows: &mut impl FnMut(&'static str, u64)) -> Result<Guess, InspectError> {
        let shape = Shape::of(self.log)?;
        let sketch = Sketch::of(self.log, &shape, |rows| on_rows("columns", rows))?;
        Guess::of(&shape, &sketch).map_err(|what| self.columns(what))
    }

    fn columns(&self, what: String) -> InspectError {
        InspectError::Columns { path: self.log.display().to_string(), what }
    }

    fn checked(&self, mapping: &Mapping) -> Result<Layout, InspectError> {
        let wrong = |(table, key, what): (&str, &str, String)| self.columns(format!("[{table}] {key}: {what}"));
        mapping.layout(self.log).map_err(wrong)
    }

    /// With the moment at which encoders are read; and no mapping where the log is a standard one.
    fn aligned(
        &self,
        passage: &Passage,
        layout: Layout,
        guess: Option<&Guess>,
    ) -> Result<(Layout, Option<Mapping>), InspectError> {
        let Some(Guess { mapping, .. }) = guess else { return Ok((layout, None)) };
        let mut mapping = mapping.clone();
        let usual = if layout.format.is_matrix() { Moment::End } else { Moment::Middle };
        mapping.time.stamp = Some(passage.moment().unwrap_or(usual));
        let layout = self.checked(&mapping)?;
        Ok(if layout == Layout::standard(self.log) { (layout, None) } else { (layout, Some(mapping)) })
    }

    fn concluded(&self, passage: &Passage, channels: Vec<ChannelNoise>) -> Inspection {
        let seen = noise::of_channels(&channels, &self.unit.noise);
        let whole: Vec<Segment<f64>> = passage.segments.clone();
        let moves = whole.iter().any(|segment| segment.kind() == SegmentKind::Move);
        let setup =
            |noise: Noise| Setup { noise, ..Setup::new(&self.unit, passage.rate_hz, Method::Joint, Precision::F64) };
        let encoders = if moves { noise::encoders(&setup(seen), &whole) } else { None };
        let noise = encoders.map_or(seen, |found| seen_or_configured(&found, seen));
        let observed = moves.then(|| {
            let setup = setup(noise);
            Observed::new(&setup, &covariance(&*noise::estimator(&setup, &whole)))
        });
        let stops = turned::stops(&passage.segments);
        let mut found = Inspection {
            columns: Vec::new(),
            mapping: None,
            sampling: sampling(passage),
            segments: passage.segments.iter().map(seen_segment).collect(),
            noise,
            channels,
            encoders,
            nearest_scheme: turned::nearest(&stops),
            scheme: turned::scheme(&stops, passage.pace),
            observed,
            remarks: Vec::new(),
            stopped_by: None,
        };
        found.remarks = self.remarks(passage, &found);
        found
    }

    fn remarks(&self, passage: &Passage, found: &Inspection) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(mistake) = wiring::mistake(&passage.segments) {
            remarks.push(Reason::Wiring(mistake).to_string());
        }
        let expected = self.unit.site().gravity_m_s2();
        if let Some(seen) = found.sampling.gravity_m_s2.filter(|seen| (seen / expected - 1.0).abs() > GRAVITY_OFF) {
            remarks.push(format!(
                "the accelerometers show {seen:.4} m/s^2 at rest, the site has {expected:.4}: unit, scale or site"
            ));
        }
        for channel in &found.channels {
            let Some(figures) = channel.figures.filter(|figures| figures.excess > EXCESS) else { continue };
            remarks.push(format!(
                "{}: {} times white noise at {} s: its bias wanders, or something moves",
                channel.channel,
                significant(figures.excess),
                significant(figures.longest_s)
            ));
        }
        let broken = found.segments.iter().filter(|segment| segment.is_broken).count();
        if broken > 0 {
            remarks.push(format!(
                "{broken} stops and moves have gaps above 0.1 s and will be left out, and the run rejected"
            ));
        }
        if found.observed.is_some() && found.encoders.is_none() {
            remarks
                .push("no error of the encoders makes the segments agree: their repeatability is as configured".into());
        }
        remarks
    }
}

/// The configured error of the encoders where it agrees with the segments, else that with which they agree best.
fn seen_or_configured(found: &EncoderNoise, noise: Noise) -> Noise {
    let [low, high] = found.range_arcsec;
    let agrees = (low..=high).contains(&noise.encoder_repeatability_arcsec);
    if agrees { noise } else { Noise { encoder_repeatability_arcsec: found.arcsec, ..noise } }
}

fn sampling(passage: &Passage) -> Sampling {
    let stops = passage.segments.iter().filter_map(Segment::standing);
    let (count, sum) = stops.fold((0, 0.0), |(count, sum), stop| (count + 1, sum + stop.force_a.norm()));
    Sampling {
        rows: passage.rows,
        times_s: passage.times_s,
        rate_hz: passage.rate_hz,
        gaps: passage.counts.gaps,
        missing: passage.counts.missing,
        longest_gap: passage.longest_gap,
        repeated: passage.counts.repeated,
        encoders_early: passage.lag,
        temperature_c: passage.temperature_c,
        gravity_m_s2: (count > 0).then(|| sum / f64::from(count)),
    }
}

fn seen_segment(segment: &Segment<f64>) -> SegmentSeen {
    let angles = match segment.kind() {
        SegmentKind::Stop => [segment.outer.rad(), segment.inner.rad()],
        SegmentKind::Move => [segment.turned.outer, segment.turned.inner],
    };
    SegmentSeen {
        kind: segment.kind(),
        start_s: segment.start_us as f64 * 1e-6,
        duration_s: segment.duration_s(),
        angles_deg: angles.map(|angle: f64| angle / DEG),
        is_broken: segment.is_broken(),
    }
}
