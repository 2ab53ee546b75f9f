//! What the residuals of a solution show: an encoder error, or something that has a name.
//!
//! The encoder error with which the segments agree is that whose chi-square equals its degrees of freedom. Any error of
//! the model enlarges the chi-square, and hardware that is better than its sizes reduces it. So the encoders never get
//! a smaller number than configured, and they get a larger one only if the residuals are unstructured:
//! - with the configured number, the likelihood-ratio tests of the solver name no effect of the hardware, and
//! - with the new number, they name nothing at all. An error that explains most of the chi-square is named with any
//!   number.

use super::rows::{Row, three_digits};
use crate::base::quantity::significant;
use crate::calibration::{Enlargement, HOST_SEGMENTS, Precision, Setup};
use crate::files::unit_file::UnitConfig;
use rins_selfcal::base::method::Method;
use rins_selfcal::estimator::{Estimator, EstimatorConfig, Solution};
use rins_selfcal::segment::Segment;
use rins_selfcal::segment::intake::IntakeCounts;
use rins_selfcal::verdict::{Assessment, Reason, Verdict, VerdictLimits, judge};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Range of encoder errors that is searched, arcsec.
const ENCODERS_ARCSEC: [f64; 2] = [0.02, 200.0];
/// Halvings of the logarithmic range, which give the encoder error to 1 %.
const HALVINGS: u32 = 10;
/// Probability beyond one sigma on one side.
const TAIL: f64 = 0.1587;

/// Significance above which residuals are structured with the new encoder error, which takes up most of them. Among 700
/// tests, chance exceeds it in 4 % of the logs.
const STRUCTURED_SIGMAS: f64 = 4.0;

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

/// What the residuals show.
#[derive(Clone, Debug, Serialize)]
pub struct Residuals {
    /// The encoder error with which the segments agree. `None` if none of the range makes them agree.
    pub encoders: Option<EncoderNoise>,
    /// Whether the encoder error is larger than configured: the segments say so, and their residuals are unstructured.
    pub is_noise: bool,
    /// What the verdict names with the configured encoder error.
    pub named: Vec<String>,
    /// Size of the hardware that would explain what the verdict names.
    pub enlargement: Option<Enlargement>,
}

impl Residuals {
    /// The residuals of the segments of a log with the noise and the hardware of a unit.
    pub fn of(segments: &[Segment<f64>], counts: IntakeCounts, rate_hz: f64, unit: &UnitConfig) -> Option<Self> {
        let log = Log { segments, counts, rate_hz };
        let (solution, verdict) = log.judged(unit)?;
        let named = verdict.reasons.iter().filter(|reason| is_named(reason)).map(Reason::to_string).collect();
        let hardware = unit.hardware();
        let enlarged = verdict.enlarged(&hardware);
        let encoders = log.encoders(unit, solution.degrees_of_freedom);
        let larger = encoders.filter(|found| found.range_arcsec[0] > unit.noise.encoder_repeatability_arcsec);
        let is_noise = enlarged.is_none()
            && larger.is_some_and(|found| {
                log.judged(&with_encoders(unit, found.arcsec))
                    .is_some_and(|(solution, verdict)| !is_structured(&solution, &verdict))
            });
        let enlargement = enlarged.and_then(|enlarged| Enlargement::between(&hardware, &enlarged));
        Some(Self { encoders, is_noise, named, enlargement })
    }

    /// The row of the encoders.
    pub fn row(&self, unit: &UnitConfig) -> Row {
        let seen = self.encoders.filter(|_| self.is_noise);
        // Half of the range of one sigma on either side.
        let sigma = seen.map(|EncoderNoise { range_arcsec: [low, high], .. }| three_digits(0.5 * (high - low)));
        let configured = unit.noise.encoder_repeatability_arcsec;
        Row {
            key: "encoder_repeatability_arcsec",
            unit: "arcsec",
            seen: seen.map(|found| found.arcsec),
            sigma: sigma.filter(|sigma| sigma.is_finite()),
            configured,
        }
    }

    /// What the user should know.
    pub fn remarks(&self, unit: &UnitConfig) -> Vec<String> {
        let mut remarks = self.named.clone();
        if let Some(Enlargement { key, unit, configured, found }) = self.enlargement {
            let [configured, found] = [configured, found].map(significant);
            remarks.push(format!(
                "{key} of [hardware] stays at {configured} {unit}; {found} would explain what is named, as replay --adapt tries"
            ));
        }
        let too_small = |found: &EncoderNoise| found.range_arcsec[0] > unit.noise.encoder_repeatability_arcsec;
        if !self.is_noise && self.encoders.as_ref().is_some_and(too_small) {
            remarks
                .push("the residuals are larger than configured and not noise of the encoders: that row stays".into());
        }
        remarks
    }
}

/// Whether a reason names what the residuals show.
fn is_named(reason: &Reason) -> bool {
    matches!(reason, Reason::Hardware { .. } | Reason::Changing(_) | Reason::Setting(_))
}

fn is_structured(solution: &Solution, verdict: &Verdict) -> bool {
    solution.suspicion.sigmas.abs() > STRUCTURED_SIGMAS || verdict.reasons.iter().any(is_named)
}

fn with_encoders(unit: &UnitConfig, arcsec: f64) -> UnitConfig {
    let mut unit = *unit;
    unit.noise.encoder_repeatability_arcsec = arcsec;
    unit
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

/// The segments of a log.
struct Log<'a> {
    segments: &'a [Segment<f64>],
    counts: IntakeCounts,
    rate_hz: f64,
}

impl Log<'_> {
    fn solved(&self, unit: &UnitConfig) -> Option<(Solution, Box<Estimator<f64, HOST_SEGMENTS>>)> {
        let setup = Setup::new(unit, self.rate_hz, Method::Joint, Precision::F64);
        let mut estimator = estimator(&setup, self.segments);
        while !estimator.solve_piece() {}
        Some((*estimator.solution()?, estimator))
    }

    fn judged(&self, unit: &UnitConfig) -> Option<(Solution, Verdict)> {
        let (solution, estimator) = self.solved(unit)?;
        let config = estimator.config();
        let assessment = Assessment {
            solution: &solution,
            prior_sigmas: &config.prior_sigmas(),
            segments: estimator.segments(),
            noise: &config.noise,
            hardware: &config.hardware,
            effect_sigmas: &config.effect_sigmas(),
            site: &solution.site(config),
            counts: self.counts,
            stored: None,
        };
        let verdict = judge(&assessment, &VerdictLimits::default());
        Some((solution, verdict))
    }

    /// The encoder error with which the segments agree with the model. `None` if they agree with the smallest error of
    /// the range, or do not agree with the largest.
    fn encoders(&self, unit: &UnitConfig, degrees_of_freedom: u32) -> Option<EncoderNoise> {
        let distribution = ChiSquared::new(f64::from(degrees_of_freedom)).ok()?;
        let with = |chi_square: f64| self.with_chi_square(unit, chi_square);
        let arcsec = with(f64::from(degrees_of_freedom))?;
        let low = with(distribution.inverse_cdf(1.0 - TAIL)).unwrap_or(0.0);
        let high = with(distribution.inverse_cdf(TAIL)).unwrap_or(f64::INFINITY);
        let range_arcsec = [low, high].map(three_digits);
        Some(EncoderNoise { arcsec: three_digits(arcsec), range_arcsec, degrees_of_freedom })
    }

    /// The encoder error that gives this chi-square. The chi-square falls as the encoder error grows, so the range is
    /// halved.
    fn with_chi_square(&self, unit: &UnitConfig, chi_square: f64) -> Option<f64> {
        let above = |arcsec: f64| Some(self.solved(&with_encoders(unit, arcsec))?.0.fit.chi_square > chi_square);
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
}
