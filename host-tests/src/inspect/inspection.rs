//! An inspection of a log: its input and its findings.

use super::guess::{Guess, Taken};
use super::noise::StopNoise;
use super::passage::{Gap, Passage};
use super::residuals::{self, Residuals};
use super::rows::{self, Row, Steps};
use super::shape::{Shape, ShapeError};
use super::sketch::{Sketch, SketchError};
use super::turned::Likeness;
use super::{noise, turned};
use crate::base::quantity::significant;
use crate::calibration::{Precision, Setup, covariance};
use crate::files::hardware::HardwareTable;
use crate::files::unit_file::{Noise, UnitConfig};
use crate::log::{Layout, LogError, LogReader, Mapping, Moment};
use crate::plan::prediction::Observed;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::{Segment, SegmentKind};
use rins_selfcal::verdict::{Reason, wiring};
use serde::Serialize;
use std::path::Path;

/// Root mean square of the angles by which the axes hunt that is reported, rad.
const HUNTING_RAD: f64 = 0.01 * ARCSEC;
/// Largest difference between the gravity of the site and of the accelerometers, as a fraction of gravity. A larger
/// difference comes from a wrong site, unit or scale.
const GRAVITY_OFF: f64 = 2e-3;

/// How a log is sampled.
#[derive(Clone, Debug, Serialize)]
pub struct Sampling {
    /// Rows.
    pub rows: u64,
    /// First and last time, s.
    pub times_s: [f64; 2],
    /// Sample rate by the median interval, Hz.
    pub rate_hz: f64,
    /// Number of gaps.
    pub gaps: u32,
    /// Samples missing in the gaps.
    pub missing: u32,
    /// The longest gap.
    pub longest_gap: Option<Gap>,
    /// Samples with the time of the previous sample.
    pub repeated: u32,
    /// Fraction of an interval by which the encoders are read before the end of the interval. `None` if the motion does
    /// not show it.
    pub encoders_early: Option<f64>,
    /// Lowest and highest temperature, deg C.
    pub temperature_c: Option<[f32; 2]>,
    /// Mean magnitude of the specific force at the stops, m/s^2.
    pub gravity_m_s2: Option<f64>,
}

/// A stop or a move in the log.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SegmentSeen {
    /// Stop or move.
    pub kind: SegmentKind,
    /// Start, s.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// For a stop the angles (outer, inner), within half a turn; for a move the angles that the axes turn by; deg.
    pub angles_deg: [f64; 2],
    /// Whether the segment has a gap too long to be used.
    pub is_broken: bool,
}

/// The findings in a log.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Columns of numbers and their recognized roles. Empty if a mapping was given.
    pub columns: Vec<Taken>,
    /// The proposed mapping. `None` if the log is a standard log or a mapping was given.
    pub mapping: Option<Mapping>,
    /// How the log is sampled.
    pub sampling: Sampling,
    /// Stops and moves.
    pub segments: Vec<SegmentSeen>,
    /// The noise to configure.
    pub noise: Noise,
    /// The imperfections of the hardware to configure.
    pub hardware: HardwareTable,
    /// The rows of noise and hardware that a log may show.
    pub rows: Vec<Row>,
    /// Noise of the channels at the stops.
    #[serde(flatten)]
    pub stops: StopNoise,
    /// What the residuals of the solution show. `None` without stops and moves.
    pub residuals: Option<Residuals>,
    /// The scheme of the library whose angles are nearest to the log's.
    pub nearest_scheme: Option<Likeness>,
    /// The scheme of the log.
    #[serde(skip)]
    pub scheme: Option<Scheme>,
    /// What is observable from the log. `None` without stops and moves.
    pub observed: Option<Observed>,
    /// What the user should check.
    pub remarks: Vec<String>,
    /// Why the log was not read to its end.
    pub stopped_by: Option<String>,
}

/// Why a log cannot be inspected.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log cannot be cut into columns of numbers.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A column cannot be read.
    #[error(transparent)]
    Sketch(#[from] SketchError),
    /// The columns cannot be recognized.
    #[error("{path}: {what}")]
    Columns {
        /// The log.
        path: String,
        /// What cannot be recognized.
        what: String,
    },
}

/// Input of an inspection.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// The log.
    pub log: &'a Path,
    /// Layout of the log, if it is known.
    pub layout: Option<Layout>,
    /// Site of the unit.
    pub unit: UnitConfig,
}

impl Request<'_> {
    /// Inspects the log. `on_rows` is called from time to time with the present task and the number of rows so far.
    ///
    /// # Errors
    /// The log cannot be read, or its columns cannot be recognized. A wrong row later in the log is not an error: it
    /// ends the inspection, and the inspection reports it.
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
        let stops = noise::at_stops(LogReader::open_as(self.log, &layout)?, &passage, |rows| on_rows("noise", rows))?;
        let columns = guess.as_ref().map_or_else(Vec::new, |guess| guess.columns.clone());
        let remarks = guess.map_or_else(Vec::new, |guess| guess.remarks);
        let mut found = self.concluded(&passage, stops);
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

    /// Adds the moment at which the encoders are read to the guessed mapping. Returns no mapping for a standard log.
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

    fn concluded(&self, passage: &Passage, at_stops: StopNoise) -> Inspection {
        let segments = &passage.segments;
        let mut unit = self.unit;
        let mut rows = rows::of_stops(&at_stops.channels, &Steps::of(segments, passage.rate_hz.recip()), &unit);
        rows.iter().for_each(|row| row.write(&mut unit));
        let moves = segments.iter().any(|segment| segment.kind() == SegmentKind::Move);
        let residuals = if moves { Residuals::of(segments, passage.counts, passage.rate_hz, &unit) } else { None };
        if let Some(residuals) = &residuals {
            let row = residuals.row(&unit);
            row.write(&mut unit);
            rows.push(row);
        }
        let observed = moves.then(|| {
            let setup = Setup::new(&unit, passage.rate_hz, Method::Joint, Precision::F64);
            Observed::new(&setup, &covariance(&*residuals::estimator(&setup, segments)))
        });
        let stops = turned::stops(&passage.segments);
        let mut found = Inspection {
            columns: Vec::new(),
            mapping: None,
            sampling: sampling(passage),
            segments: passage.segments.iter().map(seen_segment).collect(),
            noise: unit.noise,
            hardware: unit.hardware,
            rows,
            stops: at_stops,
            residuals,
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
                "the accelerometers show {seen:.4} m/s^2 at rest, the site has {expected:.4}: check unit, scale, site"
            ));
        }
        if found.stops.hunting_rad > HUNTING_RAD {
            remarks.push(format!(
                "the servos hunt by {} arcsec, root mean square; what the encoders see is no noise of the sensors",
                significant(found.stops.hunting_rad / ARCSEC)
            ));
        }
        remarks.extend(found.residuals.iter().flat_map(|residuals| residuals.remarks(&self.unit)));
        let broken = found.segments.iter().filter(|segment| segment.is_broken).count();
        if broken > 0 {
            remarks.push(format!(
                "{broken} stops and moves have gaps above 0.1 s: a replay leaves them out and rejects the run"
            ));
        }
        remarks
    }
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
