//! From samples to a solution: intake, segmenter and estimator in series. A live instrument and a recording use the
//! same code.

use crate::base::linear::Real;
use crate::base::sample::RawSample;
use crate::estimator::rehearsal::unobserved;
use crate::estimator::{BASIC_STATES, Estimate, Estimator, MAX_SEGMENTS, Solution};
use crate::model::error_model::PARAMETERS;
use crate::run::config::CalibratorConfig;
use crate::run::telemetry::{Message, Progress, tell};
use crate::scheme::Scheme;
use crate::segment::intake::{Admission, Intake, IntakeCounts};
use crate::segment::{Segment, Segmenter};
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
pub struct Calibrator<T: Real, const SEGMENTS: usize = MAX_SEGMENTS, const STATES: usize = BASIC_STATES> {
    intake: Intake,
    segmenter: Segmenter<T>,
    estimator: Estimator<T, SEGMENTS, STATES>,
}

impl<T: Real, const SEGMENTS: usize, const STATES: usize> Calibrator<T, SEGMENTS, STATES> {
    /// Memory for a calibrator. Call [`Self::restart`] before use.
    pub const UNCONFIGURED: Self =
        Self { intake: Intake::new(0.0), segmenter: Segmenter::new(), estimator: Estimator::new() };

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
    }

    /// Takes one sample. Returns the live estimate if this sample completes a segment.
    pub fn step(&mut self, sample: &RawSample<T>) -> Option<Progress> {
        match self.admit(sample) {
            Admission::Admitted { .. } => self.measure(sample),
            Admission::Repeated | Admission::OutOfOrder | Admission::NonFinite => None,
        }
    }

    /// Checks whether a sample may be used. Samples that may not be used are counted.
    pub fn admit(&mut self, sample: &RawSample<T>) -> Admission {
        self.intake.admit(sample)
    }

    /// Takes an admitted sample. Otherwise the same as [`Self::step`].
    pub fn measure(&mut self, sample: &RawSample<T>) -> Option<Progress> {
        self.segmenter.step(sample).and_then(|segment| self.add(&segment))
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

    /// Closes the stop under way at the end of the samples.
    pub fn finish(&mut self) -> Option<Progress> {
        self.segmenter.finish().and_then(|segment| self.add(&segment))
    }

    /// Checks, one bounded piece a call, whether the run may end with the stop under way. Closes the stop. Returns
    /// whether every required sigma is met and the fit is good; `None` while more calls are needed.
    pub fn weigh_piece(&mut self, limits: &VerdictLimits, report: &mut impl FnMut(&Message)) -> Option<bool> {
        if let Some(progress) = self.finish() {
            tell(report, || Message::Segment(progress));
        }
        if !self.estimator.is_refreshing() && !self.meets(limits) {
            return Some(false);
        }
        let (chi_square, degrees_of_freedom) = self.estimator.refresh_piece()?;
        Some(self.meets(limits) && is_good_fit(chi_square, degrees_of_freedom))
    }

    fn meets(&self, limits: &VerdictLimits) -> bool {
        limits.required_sigmas.is_some() && limits.unmet(&self.estimator.estimate().sigmas).next().is_none()
    }

    /// Does one bounded piece of the work at the end of the samples: closes the last stop, processes all segments until
    /// the estimate has converged, and reports innovations, solution and covariance. Returns the solution when all is
    /// done.
    pub fn conclude_piece(&mut self, report: &mut impl FnMut(&Message)) -> Option<Solution> {
        if let Some(progress) = self.finish() {
            tell(report, || Message::Segment(progress));
        }
        let solved = self.estimator.solve_piece();
        for innovations in self.estimator.closing_innovations() {
            tell(report, || Message::Innovations(*innovations));
        }
        if solved { self.report_solution(report) } else { None }
    }

    /// Not inlined, because the pieces need the stack.
    #[inline(never)]
    fn report_solution(&self, report: &mut impl FnMut(&Message)) -> Option<Solution> {
        let solution = *self.estimator.solution()?;
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
            site: &self.estimator.config().site,
            counts: self.intake.counts(),
            stored,
        };
        judge(&assessment, limits)
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

    /// The first parameter that the scheme would leave unobserved. Forgets all samples and segments.
    pub fn rehearse(&mut self, scheme: &Scheme) -> Option<u8> {
        unobserved(&mut self.estimator, scheme)
    }

    /// The estimator, with its segments and its covariance.
    pub fn estimator(&self) -> &Estimator<T, SEGMENTS, STATES> {
        &self.estimator
    }

    fn add(&mut self, segment: &Segment<T>) -> Option<Progress> {
        self.estimator.add(segment).then(|| Progress {
            segments: self.estimator.segments().len() as u16,
            kind: segment.kind(),
            end_us: segment.start_us + segment.duration_us,
            estimate: self.estimator.estimate(),
        })
    }
}
