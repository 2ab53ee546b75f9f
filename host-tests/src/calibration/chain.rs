//! One calibration on the host: the core's chain in single or double precision, and its outcome as `f64`.

use super::method::HostMethod;
use crate::base::quantity::{STATES, states};
use crate::files::unit_file::{Noise, UnitConfig};
use crate::virtual_unit::plant::Reading;
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::hardware::{HARDWARE, Hardware};
use rins_selfcal::base::linear::{Matrix, Real, Vector3, real};
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::sample::RawSample;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::{
    BEFORE_EFFECTS, BEFORE_PARAMETERS, BaiTuning, Estimate, Estimator, HeadingSource, KNOWN_LATITUDE_RAD,
    SegmentInnovations, Solution,
};
use rins_selfcal::model::effects::{EFFECT_INFO, SiteSigmas, effect};
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETERS, ParameterInfo};
use rins_selfcal::run::abort::Abort;
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::telemetry::Progress;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::SegmentKind;
use rins_selfcal::segment::intake::IntakeCounts;
use rins_selfcal::verdict::{Reason, Verdict, VerdictLimits};
use serde::Serialize;

/// Capacity for segments on the host, enough for a calibration of a whole day.
pub const HOST_SEGMENTS: usize = 1024;

/// Floating-point type of the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Double precision.
    #[default]
    F64,
    /// Single precision.
    F32,
}

/// Everything that a calibration needs to know.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Method.
    pub method: HostMethod,
    /// Floating-point type of the core.
    pub precision: Precision,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Site of the unit.
    pub site: Site,
    /// Noise of the unit.
    pub noise: Noise,
    /// Source of the heading.
    pub heading: HeadingSource,
    /// How well the site is known.
    pub site_sigmas: SiteSigmas,
    /// Imperfections of the unit's hardware.
    pub hardware: Hardware,
    /// P0 and Q of the paper's method.
    pub tuning: BaiTuning,
    /// Number of moves in period one, if the scheme is known and has several periods.
    pub period_moves: Option<u16>,
    /// Name of the scheme, if it is known.
    pub scheme: Option<String>,
    /// Whether to solve once more with the size of the hardware enlarged that the verdict names as too small.
    pub adapt: bool,
}

impl Setup {
    /// Setup for a unit that a file describes. The scheme is unknown.
    pub fn new(unit: &UnitConfig, rate_hz: f64, method: impl Into<HostMethod>, precision: Precision) -> Self {
        let configured = |heading_deg: f64| HeadingSource::Configured {
            heading_rad: heading_deg * DEG,
            sigma_rad: unit.initial.heading_sigma_deg * DEG,
        };
        Self {
            method: method.into(),
            precision,
            rate_hz,
            site: unit.site(),
            noise: unit.noise,
            heading: unit.initial.heading_deg.map_or(HeadingSource::Gyrocompass, configured),
            site_sigmas: unit.site_sigmas(),
            hardware: unit.hardware(),
            tuning: unit.bai.tuning(),
            period_moves: None,
            scheme: None,
            adapt: false,
        }
    }

    /// The same setup with a known scheme.
    #[must_use]
    pub fn on_scheme(self, scheme: &Scheme) -> Self {
        let period_moves = (scheme.periods > 1).then_some(scheme.legs.len() as u16);
        Self { period_moves, scheme: Some(scheme.name.as_str().into()), ..self }
    }

    /// Configuration for the core.
    pub fn config(&self) -> CalibratorConfig {
        let mut config = CalibratorConfig::new(self.method.core(), self.site, self.noise.psd(), self.rate_hz);
        config.estimator.heading = self.heading;
        config.estimator.period_moves = self.period_moves;
        config.estimator.hardware = self.hardware;
        config.estimator.site_sigmas = self.site_sigmas;
        config.estimator.tuning = self.tuning;
        config
    }

    /// Sigmas of all states before any data, SI units; zero for states that are not estimated.
    pub fn prior_sigmas(&self) -> [f64; STATES] {
        let config = self.config().estimator;
        let mut sigmas = [0.0; STATES];
        let both = config.prior_sigmas().into_iter().chain(config.effect_sigmas());
        sigmas.iter_mut().zip(both).for_each(|(sigma, prior)| *sigma = prior);
        sigmas
    }

    /// Whether the latitude is configured. Otherwise the gyros find it.
    pub fn knows_latitude(&self) -> bool {
        self.site_sigmas.latitude_rad <= KNOWN_LATITUDE_RAD
    }

    /// A site for a unit of this setup: that of the literature if the latitude is unknown.
    pub fn known_site(&self) -> Site {
        if self.knows_latitude() { self.site } else { Site::default() }
    }

    /// A chain that has had no sample yet.
    pub fn chain(&self) -> Box<dyn Chain> {
        match self.precision {
            Precision::F64 => Box::new(CoreChain::<f64>::new(self)),
            Precision::F32 => Box::new(CoreChain::<f32>::new(self)),
        }
    }
}

/// A reading as a sample of the core.
pub fn raw_sample<T: Real>(reading: &Reading) -> RawSample<T> {
    RawSample {
        time_us: reading.time_us,
        omega_g: Vector3::from(reading.omega_g.map(real)),
        force_a: Vector3::from(reading.force_a.map(real)),
        outer: Angle::from_rad(reading.outer_rad),
        inner: Angle::from_rad(reading.inner_rad),
        temperature_c: reading.temperature_c,
    }
}

/// A calibration from readings to outcome, of either floating-point type.
pub trait Chain: Send {
    /// Processes a reading. Returns the live estimate if the reading completes a segment.
    fn step(&mut self, reading: &Reading) -> Option<Progress>;

    /// Ends the last stop after the last reading. Returns the live estimate if a stop has ended.
    fn finish(&mut self) -> Option<Progress>;

    /// Ends the last stop if `finish` has not, solves, and judges.
    fn conclude(&mut self) -> Outcome;

    /// Solves the segments so far for hardware of other sizes. Returns the sigmas of the parameters, SI units.
    fn sigmas_with(&mut self, hardware: &Hardware) -> [f64; PARAMETERS];

    /// Present covariance of all states, SI units; zero for states that are not estimated.
    fn covariance(&self) -> Matrix<f64, STATES, STATES>;
}

struct CoreChain<T: Real> {
    setup: Setup,
    record: Record,
    calibrator: Box<Calibrator<T, HOST_SEGMENTS>>,
}

impl<T: Real> CoreChain<T> {
    fn new(setup: &Setup) -> Self {
        Self { setup: setup.clone(), record: Record::default(), calibrator: Box::new(Calibrator::new(&setup.config())) }
    }
}

impl<T: Real> Chain for CoreChain<T> {
    fn step(&mut self, reading: &Reading) -> Option<Progress> {
        let progress = self.calibrator.step(&raw_sample(reading));
        self.record.live.extend(progress);
        progress
    }

    fn finish(&mut self) -> Option<Progress> {
        let progress = self.calibrator.finish();
        self.record.live.extend(progress);
        progress
    }

    fn conclude(&mut self) -> Outcome {
        for segment in self.calibrator.estimator().segments() {
            self.record.note_segment(segment.kind());
        }
        let record = &mut self.record;
        let solution = self.calibrator.conclude(&mut |message| record.note(message));
        let mut verdict = self.calibrator.judge(&solution, None, &VerdictLimits::default());
        let enlarged = verdict.enlarged(&self.setup.hardware);
        let mut setup = self.setup.clone();
        if let Some(hardware) = enlarged.filter(|_| setup.adapt) {
            self.calibrator.take_hardware(&hardware);
            setup.hardware = hardware;
            record.innovations.clear();
            let solution = self.calibrator.conclude(&mut |message| record.note(message));
            verdict = self.calibrator.judge(&solution, None, &VerdictLimits::default());
            // The live estimate after the last segment is the solution.
            record.live.last_mut().into_iter().for_each(|last| last.estimate = solution.estimate);
        }
        record.note(&Message::Judged(verdict));
        let outcome = std::mem::take(record).outcome(&setup).expect("solved and judged");
        Outcome { enlargement: enlarged.and_then(|to| Enlargement::between(&self.setup.hardware, &to)), ..outcome }
    }

    fn sigmas_with(&mut self, hardware: &Hardware) -> [f64; PARAMETERS] {
        self.calibrator.take_hardware(hardware);
        self.calibrator.conclude(&mut |_| ()).estimate.sigmas
    }

    fn covariance(&self) -> Matrix<f64, STATES, STATES> {
        covariance(self.calibrator.estimator())
    }
}

/// Present covariance of an estimator's parameters and effects, SI units; zero for states that are not estimated.
pub fn covariance<T: Real, const SEGMENTS: usize>(estimator: &Estimator<T, SEGMENTS>) -> Matrix<f64, STATES, STATES> {
    let mut covariance = Matrix::<f64, STATES, STATES>::zeros();
    let effects = estimator.effects().iter().enumerate();
    let effects = effects.map(|(place, effect)| (BEFORE_EFFECTS + place, PARAMETERS + usize::from(*effect)));
    let states: Vec<_> = (0..PARAMETERS).map(|state| (BEFORE_PARAMETERS + state, state)).chain(effects).collect();
    for (of_filter, state) in &states {
        let row = estimator.filter().covariance_row(*of_filter);
        for (of_filter, other) in &states {
            covariance[(*state, *other)] = row[*of_filter].widened();
        }
    }
    covariance
}

/// Outcome of a calibration.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Setup of the calibration.
    pub setup: Setup,
    /// Size of the hardware that the first verdict has named as too small. With [`Setup::adapt`], the solution and the
    /// verdict are those with the size in this unit.
    pub enlargement: Option<Enlargement>,
    /// Parameters, sigmas and fit.
    pub solution: Solution,
    /// Verdict with its reasons.
    pub verdict: Verdict,
    /// Whether the instrument could store the result; `None` if there is nothing to store, or no store.
    pub stored: Option<bool>,
    /// Covariance of the parameters, SI units.
    pub covariance: Matrix<f64, PARAMETERS, PARAMETERS>,
    /// Sigmas before any data, SI units.
    pub prior_sigmas: [f64; PARAMETERS],
    /// Counts of admitted, missing and refused samples.
    pub counts: IntakeCounts,
    /// Samples lost between the IMU and the core; unknown for a log.
    pub losses: Option<LossCounts>,
    /// Number of stops.
    pub stops: usize,
    /// Number of moves.
    pub moves: usize,
    /// The live estimate after every segment.
    pub live: Vec<Progress>,
    /// Innovations of every segment in the last sweep.
    pub innovations: Vec<SegmentInnovations>,
    /// True errors of a virtual unit at the end of the last segment, the time to which the estimate refers.
    pub truth: Option<InstrumentErrors<f64>>,
    /// True errors of a virtual unit in open loop to which each live estimate refers.
    pub live_truth: Vec<InstrumentErrors<f64>>,
}

/// A size of the hardware that a verdict names as too small, in its unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Enlargement {
    /// Key in the unit description.
    pub key: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// The configured size.
    pub configured: f64,
    /// The size in this unit.
    pub found: f64,
}

impl Enlargement {
    pub(crate) fn between(configured: &Hardware, found: &Hardware) -> Option<Self> {
        let size = HARDWARE.iter().find(|size| size.get(configured) < size.get(found))?;
        let [configured, found] = [configured, found].map(|hardware| size.get(hardware) / size.unit_si);
        Some(Self { key: size.key, unit: size.unit, configured, found })
    }
}

/// Record of the messages of a run.
#[derive(Clone, Debug, Default)]
pub struct Record {
    solution: Option<(Solution, IntakeCounts)>,
    covariance: Matrix<f64, PARAMETERS, PARAMETERS>,
    verdict: Option<Verdict>,
    stored: Option<bool>,
    aborted: Option<Abort>,
    losses: Option<LossCounts>,
    stops: usize,
    moves: usize,
    live: Vec<Progress>,
    innovations: Vec<SegmentInnovations>,
}

impl Record {
    /// Adds a message.
    pub fn note(&mut self, message: &Message) {
        match message {
            Message::Segment(progress) => {
                self.note_segment(progress.kind);
                self.live.push(*progress);
            }
            Message::Innovations(innovations) => self.innovations.push(*innovations),
            Message::Solved { solution, counts } => self.solution = Some((*solution, *counts)),
            Message::Covariance { row, values } => {
                self.covariance.row_mut(usize::from(*row)).copy_from_slice(values);
            }
            Message::Judged(verdict) => self.verdict = Some(verdict.clone()),
            Message::Saved(stored) => self.stored = Some(*stored),
            Message::Aborted(abort) => self.aborted = Some(*abort),
            Message::Queue { losses, .. } => self.losses = Some(*losses),
            _ => {}
        }
    }

    fn note_segment(&mut self, kind: SegmentKind) {
        match kind {
            SegmentKind::Stop => self.stops += 1,
            SegmentKind::Move => self.moves += 1,
        }
    }

    /// Why the run was aborted, if it was aborted.
    pub fn aborted(&self) -> Option<Abort> {
        self.aborted
    }

    /// The outcome, if the run was solved and judged.
    pub fn outcome(self, setup: &Setup) -> Option<Outcome> {
        let (solution, counts) = self.solution?;
        Some(Outcome {
            setup: setup.clone(),
            enlargement: None,
            solution,
            verdict: self.verdict?,
            stored: self.stored,
            covariance: self.covariance,
            prior_sigmas: setup.config().estimator.prior_sigmas(),
            counts,
            losses: self.losses,
            stops: self.stops,
            moves: self.moves,
            live: self.live,
            innovations: self.innovations,
            truth: None,
            live_truth: Vec::new(),
        })
    }
}

impl Outcome {
    /// The estimate.
    pub fn estimate(&self) -> &Estimate {
        &self.solution.estimate
    }

    /// The site, with the latitude that the gyros have found if it was not known.
    pub fn site(&self) -> Site {
        self.solution.site(&self.setup.config().estimator)
    }

    /// Sigmas of [`Self::site`]: as configured, but that of the estimate for a latitude that the gyros have found.
    pub fn site_sigmas(&self) -> SiteSigmas {
        let configured = self.setup.site_sigmas;
        let found_rad = f64::from(self.solution.effects.sigmas[effect::LATITUDE]);
        SiteSigmas {
            latitude_rad: if self.setup.knows_latitude() { configured.latitude_rad } else { found_rad },
            ..configured
        }
    }

    /// Whether the method estimates a parameter.
    pub fn is_estimated(&self, parameter: usize) -> bool {
        self.setup.method.estimates(parameter)
    }

    /// Sigmas of all states, in report units.
    pub fn state_sigmas(&self) -> [f64; STATES] {
        let found = self.estimate().sigmas.into_iter().chain(self.solution.effects.sigmas.map(f64::from));
        let mut sigmas = [0.0; STATES];
        for (sigma, (found, info)) in sigmas.iter_mut().zip(found.zip(states())) {
            *sigma = found / info.unit_si;
        }
        sigmas
    }

    /// Effects of the hardware and the site that were estimated: name and unit, value and sigma, in report units. The
    /// latitude is that of the site, whether one was configured or not.
    pub fn effects(&self) -> impl Iterator<Item = (&'static ParameterInfo, f64, f64)> {
        let effects = &self.solution.effects;
        let states = EFFECT_INFO.iter().enumerate().zip(effects.values.iter().zip(&effects.sigmas));
        let estimated = states.filter(|(_, (_, sigma))| **sigma > 0.0);
        let latitude_rad = self.setup.site.latitude_rad;
        estimated.map(move |((state, info), (value, sigma))| {
            let value = f64::from(*value) + if state == effect::LATITUDE { latitude_rad } else { 0.0 };
            (info, value / info.unit_si, f64::from(*sigma) / info.unit_si)
        })
    }

    /// Codes of the reasons, in the order of [`Self::reasons`].
    pub fn reason_codes(&self) -> Vec<&'static str> {
        self.verdict.reasons.iter().map(Reason::code).collect()
    }

    /// Every reason in words, with its code in front. A last line counts the reasons that were not kept.
    pub fn reasons(&self) -> Vec<String> {
        let mut reasons: Vec<String> = self.verdict.reasons.iter().map(ToString::to_string).collect();
        if self.verdict.more > 0 {
            reasons.push(format!("and {} more", self.verdict.more));
        }
        reasons
    }

    /// Whether the result is accepted, and stored if there is a store.
    pub fn is_in_use(&self) -> bool {
        self.verdict.accepted() && self.stored != Some(false)
    }

    /// "accepted" or "rejected".
    pub fn verdict_name(&self) -> &'static str {
        if self.verdict.accepted() { "accepted" } else { "rejected" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::virtual_run::VirtualRun;
    use crate::result::table;
    use crate::virtual_unit::unit::VirtualUnit;
    use rins_selfcal::base::method::Method;

    #[test]
    fn a_result_that_could_not_be_stored_is_not_in_use() {
        let scheme = Scheme::bai(1.0, 1);
        let setup = Setup::new(&UnitConfig::ideal(), 50.0, Method::Joint, Precision::F64).on_scheme(&scheme);
        let unit = VirtualUnit { rate_hz: 50.0, ..VirtualUnit::default() };
        let outcome = VirtualRun { unit, scheme, seed: 1 }.calibrate(std::slice::from_ref(&setup)).remove(0);
        let ended = |saved: Option<bool>| {
            let mut record = Record::default();
            record.note(&Message::Solved { solution: outcome.solution, counts: outcome.counts });
            record.note(&Message::Judged(Verdict::default()));
            saved.into_iter().for_each(|saved| record.note(&Message::Saved(saved)));
            record.outcome(&setup).expect("solved and judged")
        };
        assert!(ended(None).is_in_use() && ended(Some(true)).is_in_use());
        let lost = ended(Some(false));
        assert!(!lost.is_in_use());
        assert!(table::verdict(&lost).contains("\naccepted, but not stored: "), "{}", table::verdict(&lost));
        assert!(!table::verdict(&ended(Some(true))).contains("not stored"));
    }
}
