//! From samples to a solution: intake, segmenter and estimator in series. A live instrument and a recording use the
//! same code.

use crate::base::hardware::Hardware;
use crate::base::linear::Real;
use crate::base::sample::RawSample;
use crate::estimator::rehearsal::unobserved;
use crate::estimator::{Estimate, Estimator, MAX_SEGMENTS, Solution};
use crate::model::error_model::PARAMETERS;
use crate::run::config::CalibratorConfig;
use crate::run::telemetry::{Message, Progress, tell};
use crate::scheme::Scheme;
use crate::segment::intake::{Admission, Intake, IntakeCounts};
use crate::segment::{Segment, SegmentKind, Segmenter};
use crate::verdict::{Assessment, Verdict, VerdictLimits, is_good_fit, judge};

/// Turns samples into parameters. Use it directly for a recording; a live instrument uses
/// [`SelfCalibration`](crate::run::self_calibration::SelfCalibration), which contains it.
///
/// ```
/// use rins_selfcal::run::calibrator::Calibrator;
/// use rins_selfcal::run::config::CalibratorConfig;
/// use rins_selfcal::model::error_model::InstrumentErrors;
/// use rins_selfcal::base::linear::Vector3;
/// use rins_selfcal::base::method::Method;
/// use rins_selfcal::base::sample::RawSample;
/// use rins_selfcal::base::site::Site;
/// use rins_selfcal::base::units::DEG;
/// use rins_selfcal::segment::white_noise::Noise;
///
/// let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
/// let site = Site::default();
/// let mut calibrator = Box::new(Calibrator::<f64>::new(&CalibratorConfig::new(Method::Joint, site, noise, 200.0)));
/// // A perfect unit at rest for ten seconds on a base that is tilted by one degree. A real log has the whole scheme.
/// let unit = InstrumentErrors { base_roll: 1.0 * DEG, ..InstrumentErrors::default() };
/// let rot_bn = unit.rot_nb().transpose();
/// let (force_a, omega_g) = (rot_bn * Vector3::z() * site.gravity_m_s2(), rot_bn * Vector3::from(site.earth_rate_n()));
/// for number in 0..2000 {
///     assert_eq!(calibrator.step(&RawSample { time_us: 5000 * number, force_a, omega_g, ..RawSample::default() }), None);
/// }
/// let stop = calibrator.finish().expect("a stop");
/// assert!((stop.estimate.errors.base_roll / DEG - 1.0).abs() < 1e-3);
/// // The sigma of a state that a level instrument does not show, here a mounting angle, is still its prior sigma.
/// assert!(stop.estimate.sigmas[9] > 1.0 * DEG);
/// // At the end of a log, `conclude` gives the solution and `judge` the verdict.
/// ```
#[derive(Clone, Debug)]
pub struct Calibrator<T: Real, const SEGMENTS: usize = MAX_SEGMENTS> {
    intake: Intake,
    segmenter: Segmenter<T>,
    estimator: Estimator<T, SEGMENTS>,
    /// The last segment, until the estimate after it is linearized anew and told.
    untold: Option<Untold>,
}

/// A segment whose estimate is not told yet.
#[derive(Clone, Copy, Debug)]
struct Untold {
    segments: u16,
    kind: SegmentKind,
    end_us: u64,
}

impl<T: Real, const SEGMENTS: usize> Calibrator<T, SEGMENTS> {
    /// Memory for a calibrator. Call [`Self::restart`] before use.
    pub const UNCONFIGURED: Self =
        Self { intake: Intake::new(0.0), segmenter: Segmenter::new(), estimator: Estimator::new(), untold: None };

    /// A calibrator before the first sample.
    pub fn new(config: &CalibratorConfig) -> Self {
        let mut calibrator = Self::UNCONFIGURED;
        calibrator.restart(config);
        calibrator
    }

    /// Forgets all samples and segments, and begins again in place.
    pub fn restart(&mut self, config: &CalibratorConfig) {
        self.intake = Intake::new(config.rate_hz);
        self.segmenter.restart(&config.stillness);
        self.estimator.restart(&config.estimator);
        self.untold = None;
    }

    /// Takes one sample. Returns the live estimate if this sample completes a segment. For use where no sample is
    /// waiting: a live instrument calls [`Self::admit`], [`Self::measure`] and [`Self::refine_piece`].
    pub fn step(&mut self, sample: &RawSample<T>) -> Option<Progress> {
        match self.admit(sample) {
            Admission::Admitted { .. } => {
                self.measure(sample);
                self.refine()
            }
            Admission::Repeated | Admission::OutOfOrder | Admission::NonFinite => None,
        }
    }

    /// Checks whether a sample may be used. Samples that may not be used are counted.
    pub fn admit(&mut self, sample: &RawSample<T>) -> Admission {
        self.intake.admit(sample)
    }

    /// Takes an admitted sample. Returns whether it completes a segment, whose estimate [`Self::refine_piece`] gives.
    pub fn measure(&mut self, sample: &RawSample<T>) -> bool {
        self.segmenter.step(sample).is_some_and(|segment| self.add(&segment))
    }

    /// Does one bounded piece of the linearization of all segments about the live estimate, which follows a stop.
    /// Returns the live estimate after the last segment when it is ready, once.
    pub fn refine_piece(&mut self) -> Option<Progress> {
        let Untold { segments, kind, end_us } = self.untold?;
        // A pass that a short move has overtaken takes in the move too.
        if kind == SegmentKind::Stop || self.estimator.is_refreshing() {
            self.estimator.refresh_piece()?;
        }
        self.untold = None;
        Some(Progress { segments, kind, end_us, estimate: self.estimator.estimate() })
    }

    /// Whether [`Self::refine_piece`] has work to do.
    pub fn is_refining(&self) -> bool {
        self.untold.is_some()
    }

    fn refine(&mut self) -> Option<Progress> {
        while self.is_refining() {
            if let Some(progress) = self.refine_piece() {
                return Some(progress);
            }
        }
        None
    }

    /// Whether the samples come at another rate than the configured one.
    pub fn has_other_rate(&self) -> bool {
        self.intake.has_other_rate()
    }

    /// Restarts the sample counts, because the measurement begins here.
    pub fn restart_counts(&mut self) {
        self.intake.restart_counts();
    }

    /// Continues after a restart with the samples that follow the sample at this time, us.
    pub fn follow(&mut self, last_us: u64) {
        self.intake.follow(last_us);
    }

    /// Admits the next sample whatever its time, because samples were lost.
    pub fn resume(&mut self) {
        self.intake.resume();
    }

    /// Closes the stop under way at the end of the samples. Returns the live estimate if there was one.
    pub fn finish(&mut self) -> Option<Progress> {
        self.close_stop();
        self.refine()
    }

    fn close_stop(&mut self) {
        if let Some(segment) = self.segmenter.finish() {
            self.add(&segment);
        }
    }

    /// Checks, one bounded piece a call, whether the run may end with the stop under way. Closes the stop. Returns
    /// whether every required sigma is met and the fit is good; `None` while more calls are needed.
    pub fn weigh_piece(&mut self, limits: &VerdictLimits, report: &mut impl FnMut(&Message)) -> Option<bool> {
        self.close_stop();
        if self.is_refining() {
            if let Some(progress) = self.refine_piece() {
                tell(report, || Message::Segment(progress));
            }
            return None;
        }
        if !self.estimator.is_refreshing() && !self.meets(limits) {
            return Some(false);
        }
        let (chi_square, degrees_of_freedom) = self.estimator.refresh_piece()?;
        Some(
            self.meets(limits)
                && is_good_fit(chi_square, degrees_of_freedom, self.estimator.config().modelled_hardware()),
        )
    }

    fn meets(&self, limits: &VerdictLimits) -> bool {
        limits.required_sigmas.is_some() && limits.unmet(&self.estimator.estimate().sigmas).next().is_none()
    }

    /// Does one bounded piece of the work at the end of the samples: closes the last stop, processes all segments until
    /// the estimate has converged, and reports innovations, solution and covariance. Returns the solution when all is
    /// done.
    pub fn conclude_piece(&mut self, report: &mut impl FnMut(&Message)) -> Option<Solution> {
        self.close_stop();
        let solved = self.estimator.solve_piece();
        for innovations in self.estimator.closing_innovations() {
            tell(report, || Message::Innovations(*innovations));
        }
        if solved { self.report_solution(report) } else { None }
    }

    /// Not inlined, because the pieces need the stack.
    #[inline(never)]
    fn report_solution(&mut self, report: &mut impl FnMut(&Message)) -> Option<Solution> {
        let solution = *self.estimator.solution()?;
        if let Some(Untold { segments, kind, end_us }) = self.untold.take() {
            // The live estimate after the last segment is the solution.
            tell(report, || Message::Segment(Progress { segments, kind, end_us, estimate: solution.estimate }));
        }
        tell(report, || Message::Solved { solution, counts: self.counts() });
        for row in 0..PARAMETERS {
            let values = self.estimator.covariance_row(row).map(Real::widened).data.0[0];
            tell(report, || Message::Covariance { row: row as u8, values });
        }
        Some(solution)
    }

    /// Calls [`Self::conclude_piece`] until the solution is complete. For use where no sample is waiting.
    pub fn conclude(&mut self, report: &mut impl FnMut(&Message)) -> Solution {
        loop {
            if let Some(solution) = self.conclude_piece(report) {
                return solution;
            }
        }
    }

    /// Judges a solution of this run's segments.
    pub fn judge(&self, solution: &Solution, stored: Option<&Estimate>, limits: &VerdictLimits) -> Verdict {
        let assessment = Assessment {
            solution,
            prior_sigmas: &self.estimator.config().prior_sigmas(),
            segments: self.estimator.segments(),
            noise: &self.estimator.config().noise,
            hardware: self.estimator.config().modelled_hardware(),
            effect_sigmas: &self.estimator.config().effect_sigmas(),
            site: &solution.site(self.estimator.config()),
            counts: self.intake.counts(),
            stored,
        };
        judge(&assessment, limits)
    }

    /// Takes hardware of other sizes for the segments so far. [`Self::conclude`] then solves once more.
    pub fn take_hardware(&mut self, hardware: &Hardware) {
        self.estimator.take_hardware(hardware);
    }

    /// The stop under way, to check its quality.
    pub fn stop_so_far(&self) -> Option<Segment<T>> {
        self.segmenter.stop_so_far()
    }

    /// Longest interval between two samples of the stop under way, us, up to the last sample.
    pub fn longest_interval_us(&self) -> u64 {
        self.segmenter.longest_interval_us()
    }

    /// Discards the sums of the stop under way.
    pub fn restart_stop(&mut self) {
        self.segmenter.restart_stop();
    }

    /// The counts of admitted and refused samples.
    pub fn counts(&self) -> IntakeCounts {
        self.intake.counts()
    }

    /// The first parameter that the scheme would leave unobserved. Forgets all samples and segments, and must be
    /// restarted then.
    pub fn rehearse(&mut self, scheme: &Scheme) -> Option<u8> {
        unobserved(&mut self.estimator, scheme)
    }

    /// The estimator, with its segments and its covariance.
    pub fn estimator(&self) -> &Estimator<T, SEGMENTS> {
        &self.estimator
    }

    fn add(&mut self, segment: &Segment<T>) -> bool {
        let used = self.estimator.add(segment);
        if used {
            self.untold = Some(Untold {
                segments: self.estimator.segments().len() as u16,
                kind: segment.kind(),
                end_us: segment.start_us + segment.duration_us,
            });
        }
        used
    }
}
