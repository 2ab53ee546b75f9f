//! Is the result good? Every doubt has a reason, with segment, channel or parameter, and number.
//!
//! Bounds follow from the distribution of each number under white noise of the configured size, at probabilities that
//! together reject fewer than one good calibration in a thousand.

use crate::error_model::{PARAMETER_INFO, PARAMETERS, block};
use crate::estimator::{Estimate, Noise, Solution};
use crate::linear::{ComplexField, Real};
use crate::segment::{CHANNELS, Segment, SegmentKind};
use crate::units::{DEG, DEG_H, MICRO_G, PPM};
use core::fmt;
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// Chi-square of the fit: normal deviate of its bounds; 5e-4 above, 3e-7 below, where only the sigmas are too large.
const CHI_SQUARE_UPPER_Z: f64 = 3.3;
const CHI_SQUARE_LOWER_Z: f64 = -5.0;
/// Largest normalized innovation; 6e-7 each, 1e-4 for 168 measurements.
const INNOVATION_LIMIT: f64 = 5.0;
/// Normal deviate of the variance of a stop's block means; 3e-7 each, 3e-5 for 19 stops of 6 channels.
const SCATTER_Z: f64 = 5.0;
/// Trend of a stop's block means in units of their sigma; 6e-8 each.
const TREND_LIMIT: f64 = 5.4;
/// A channel whose variance is this part of white noise's does not measure.
const STUCK_RATIO: f64 = 0.01;
/// A parameter is observed if its sigma is at most this part of its prior sigma.
const OBSERVED_RATIO: f64 = 0.1;
/// A change against the stored calibration is large beyond this many combined sigmas.
const CHANGE_LIMIT: f64 = 6.0;
/// Reasons that fit; more are counted.
const MAX_REASONS: usize = 12;

/// Names of the channels as reasons give them.
pub const CHANNEL_NAMES: [&str; CHANNELS] = ["accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z"];

/// What a result must fulfil beyond statistics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VerdictLimits {
    /// Largest plausible non-orthogonality and mounting angle, rad.
    pub installation_rad: f64,
    /// Largest plausible accelerometer bias, m/s^2.
    pub accel_bias_m_s2: f64,
    /// Largest plausible gyro bias, rad/s.
    pub gyro_bias_rad_s: f64,
    /// Largest plausible scale-factor error.
    pub scale: f64,
    /// Largest plausible non-perpendicularity, rad.
    pub non_perpendicularity_rad: f64,
    /// Largest plausible tilt of the base, rad.
    pub base_tilt_rad: f64,
    /// Required sigma of the twelve installation errors, rad.
    pub required_sigma_rad: Option<f64>,
    /// Whether a result that differs from the stored calibration may replace it.
    pub accept_change: bool,
}

impl Default for VerdictLimits {
    /// 5 deg; 20 mg; 20 deg/h; 5000 ppm; 0.5 deg; 15 deg; no requirement; a change is not accepted.
    fn default() -> Self {
        Self {
            installation_rad: 5.0 * DEG,
            accel_bias_m_s2: 20_000.0 * MICRO_G,
            gyro_bias_rad_s: 20.0 * DEG_H,
            scale: 5000.0 * PPM,
            non_perpendicularity_rad: 0.5 * DEG,
            base_tilt_rad: 15.0 * DEG,
            required_sigma_rad: None,
            accept_change: false,
        }
    }
}

/// Why a stop does not look like an instrument at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Unrest {
    /// The variance of its block means is this many times that of white noise.
    Variance(f32),
    /// Its block means drift by this many sigmas.
    Trend(f32),
    /// The channel does not change.
    Stuck,
}

/// One doubt. Parameters are given by index, segments counted from 0, channels as in [`CHANNEL_NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the text of a variant says what its fields are")]
pub enum Reason {
    /// There are too few segments to determine anything.
    TooFewSegments(u16),
    /// The estimate does not stand after this many sweeps.
    NotConverged(u8),
    /// A parameter or its sigma is not finite.
    NotFinite { parameter: u8 },
    /// A parameter is not observed: its sigma is this part of the prior.
    Unobserved { parameter: u8, of_prior: f64 },
    /// A sigma, SI, exceeds the required one.
    Sigma { parameter: u8, sigma: f64, required: f64 },
    /// A parameter, SI, is outside its plausible range.
    Implausible { parameter: u8, value: f64, limit: f64 },
    /// The residual chi-square is outside its bounds.
    ChiSquare { chi_square: f64, degrees_of_freedom: u32, low: f64, high: f64 },
    /// One measurement disagrees with all others.
    Innovation { segment: u16, channel: u8, normalized: f64 },
    /// A stop was not at rest.
    Unrest { segment: u16, channel: u8, unrest: Unrest },
    /// Samples are missing in a segment for too long, us.
    Gap { segment: u16, longest_us: u64 },
    /// More segments than fit were left out.
    LeftOut(u16),
    /// Differs from the stored calibration by this many combined sigmas.
    Changed { parameter: u8, sigmas: f64 },
}

/// Accepted, or rejected with reasons.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Doubts, in the order they were found; none means accepted.
    pub reasons: heapless::Vec<Reason, MAX_REASONS>,
    /// Doubts that did not fit.
    pub more: u16,
    /// Changes against the stored calibration that the limits allow.
    pub changes: heapless::Vec<Reason, MAX_REASONS>,
}

impl Verdict {
    /// Whether the result may be stored and used.
    pub fn accepted(&self) -> bool {
        self.reasons.is_empty()
    }

    fn doubt(&mut self, reason: Reason) {
        if self.reasons.push(reason).is_err() {
            self.more = self.more.saturating_add(1);
        }
    }
}

/// Everything that is judged.
#[derive(Clone, Copy, Debug)]
pub struct Assessment<'a, T: Real> {
    /// The outcome of all sweeps.
    pub solution: &'a Solution,
    /// Prior sigmas, SI; 0 for a parameter that the method takes as known.
    pub prior_sigmas: &'a [f64; PARAMETERS],
    /// The segments.
    pub segments: &'a [Segment<T>],
    /// The configured noise.
    pub noise: &'a Noise,
    /// The calibration in store.
    pub stored: Option<&'a Estimate>,
}

/// Judges a solution.
pub fn judge<T: Real>(assessment: &Assessment<'_, T>, limits: &VerdictLimits) -> Verdict {
    let mut verdict = Verdict::default();
    judge_segments(&mut verdict, assessment);
    judge_fit(&mut verdict, assessment.solution);
    judge_parameters(&mut verdict, assessment, limits);
    if let Some(stored) = assessment.stored {
        judge_change(&mut verdict, assessment, stored, limits);
    }
    verdict
}

fn judge_segments<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>) {
    if assessment.segments.len() < 3 {
        verdict.doubt(Reason::TooFewSegments(assessment.segments.len() as u16));
    }
    for (number, segment) in (0_u16..).zip(assessment.segments) {
        if segment.is_broken() {
            verdict.doubt(Reason::Gap { segment: number, longest_us: segment.longest_interval_us });
        }
        if let Some((channel, unrest)) = unrest(segment, assessment.noise) {
            verdict.doubt(Reason::Unrest { segment: number, channel, unrest });
        }
    }
    let broken = assessment.segments.iter().filter(|segment| segment.is_broken()).count() as u16;
    let left_out = assessment.solution.left_out.saturating_sub(broken);
    if left_out > 0 {
        verdict.doubt(Reason::LeftOut(left_out));
    }
}

fn judge_fit(verdict: &mut Verdict, solution: &Solution) {
    if !solution.converged {
        verdict.doubt(Reason::NotConverged(solution.sweeps));
    }
    let freedom = solution.degrees_of_freedom;
    let low = chi_square_quantile(freedom, CHI_SQUARE_LOWER_Z);
    let high = chi_square_quantile(freedom, CHI_SQUARE_UPPER_Z);
    let chi_square = solution.fit.chi_square;
    if freedom > 0 && !(low..=high).contains(&chi_square) {
        verdict.doubt(Reason::ChiSquare { chi_square, degrees_of_freedom: freedom, low, high });
    }
    let largest = solution.fit.largest;
    if largest.normalized.abs() > INNOVATION_LIMIT {
        let (segment, channel) = (largest.segment, largest.channel);
        verdict.doubt(Reason::Innovation { segment, channel, normalized: largest.normalized });
    }
}

fn judge_parameters<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, limits: &VerdictLimits) {
    let estimate = &assessment.solution.estimate;
    let values = estimate.errors.to_vector();
    let sigmas = estimate.sigmas.iter().zip(assessment.prior_sigmas);
    for ((parameter, value), (sigma, prior)) in (0_u8..).zip(values.iter()).zip(sigmas) {
        if !value.is_finite() || !sigma.is_finite() {
            verdict.doubt(Reason::NotFinite { parameter });
            continue;
        }
        let limit = plausible(parameter.into(), limits);
        if value.abs() > limit {
            verdict.doubt(Reason::Implausible { parameter, value: *value, limit });
        }
        // How well the heading is known depends on the latitude and the gyros; its sigma says so.
        if usize::from(parameter) != HEADING && *sigma > OBSERVED_RATIO * prior {
            verdict.doubt(Reason::Unobserved { parameter, of_prior: sigma / prior });
        }
        if let Some(required) = limits.required_sigma_rad
            && INSTALLATION.contains(&usize::from(parameter))
            && *sigma > required
        {
            verdict.doubt(Reason::Sigma { parameter, sigma: *sigma, required });
        }
    }
}

fn judge_change<T: Real>(
    verdict: &mut Verdict,
    assessment: &Assessment<'_, T>,
    stored: &Estimate,
    limits: &VerdictLimits,
) {
    let now = &assessment.solution.estimate;
    let difference = now.errors.to_vector() - stored.errors.to_vector();
    let sigmas = now.sigmas.iter().zip(&stored.sigmas);
    for ((parameter, difference), (new, old)) in (0_u8..).zip(difference.iter()).zip(sigmas) {
        let combined = ComplexField::hypot(*new, *old);
        let constant =
            INSTALLATION.contains(&usize::from(parameter)) || usize::from(parameter) == block::NON_PERPENDICULARITY;
        if !constant || difference.abs() <= CHANGE_LIMIT * combined {
            continue;
        }
        let reason = Reason::Changed { parameter, sigmas: difference.abs() / combined };
        if limits.accept_change {
            // The list is for information; what does not fit is in the parameters.
            let _ = verdict.changes.push(reason);
        } else {
            verdict.doubt(reason);
        }
    }
}

/// The twelve of Bai.
const INSTALLATION: Range<usize> = 0..block::ACCEL_BIAS;
const HEADING: usize = block::ATTITUDE + 2;

fn plausible(parameter: usize, limits: &VerdictLimits) -> f64 {
    match parameter {
        block::GYRO_NON_ORTHOGONALITY..block::ACCEL_BIAS => limits.installation_rad,
        block::ACCEL_BIAS..block::ACCEL_SCALE => limits.accel_bias_m_s2,
        block::GYRO_BIAS..block::GYRO_SCALE => limits.gyro_bias_rad_s,
        block::ACCEL_SCALE..block::GYRO_BIAS | block::GYRO_SCALE..block::NON_PERPENDICULARITY => limits.scale,
        block::NON_PERPENDICULARITY => limits.non_perpendicularity_rad,
        HEADING => f64::INFINITY,
        _ => limits.base_tilt_rad,
    }
}

/// What shows that a stop was not at rest, if anything, with its channel: the variance and the trend of its block means
/// against white noise of the configured size.
pub fn unrest<T: Real>(segment: &Segment<T>, noise: &Noise) -> Option<(u8, Unrest)> {
    let scatter = &segment.scatter;
    if segment.kind == SegmentKind::Move || scatter.blocks < 3 {
        return None;
    }
    let block_s = segment.duration_s().widened() / f64::from(scatter.blocks);
    let freedom = u32::from(scatter.blocks) - 1;
    let ratio_limit = chi_square_quantile(freedom, SCATTER_Z) / f64::from(freedom);
    let channels = (0_u8..).zip(scatter.variance.iter().zip(&scatter.trend));
    for (channel, (variance, trend)) in channels {
        let psd_sqrt = if channel < 3 { noise.accel_psd_sqrt } else { noise.gyro_psd_sqrt };
        let expected = psd_sqrt * psd_sqrt / block_s;
        let ratio = f64::from(*variance) / expected;
        let trend = f64::from(*trend) / ComplexField::sqrt(expected);
        if trend.abs() > TREND_LIMIT {
            return Some((channel, Unrest::Trend(trend as f32)));
        } else if ratio > ratio_limit {
            return Some((channel, Unrest::Variance(ratio as f32)));
        } else if ratio < STUCK_RATIO {
            return Some((channel, Unrest::Stuck));
        }
    }
    None
}

/// Quantile of chi-square at the normal deviate `z` (Wilson and Hilferty 1931; within 1 % from 10 degrees of freedom).
fn chi_square_quantile(degrees_of_freedom: u32, z: f64) -> f64 {
    let n = f64::from(degrees_of_freedom);
    let part = 2.0 / (9.0 * n);
    let root = (1.0 - part + z * ComplexField::sqrt(part)).max(0.0);
    n * root * root * root
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let info = |parameter: u8| PARAMETER_INFO.get(usize::from(parameter)).copied().unwrap_or(PARAMETER_INFO[0]);
        let channel_name = |channel: u8| CHANNEL_NAMES.get(usize::from(channel)).copied().unwrap_or("?");
        match *self {
            Self::TooFewSegments(count) => write!(f, "only {count} segments: no stop, move and stop to calibrate from"),
            Self::NotConverged(sweeps) => write!(f, "the estimate does not stand after {sweeps} sweeps"),
            Self::NotFinite { parameter } => write!(f, "{} is not finite", info(parameter).name),
            Self::Unobserved { parameter, of_prior } => {
                write!(f, "{} is not observed: its sigma is still {of_prior:.2} of the prior's", info(parameter).name)
            }
            Self::Sigma { parameter, sigma, required } => {
                let info = info(parameter);
                let (sigma, required) = (sigma / info.unit_si, required / info.unit_si);
                write!(f, "sigma of {} is {sigma:.3} {}, required {required:.3}", info.name, info.unit)
            }
            Self::Implausible { parameter, value, limit } => {
                let info = info(parameter);
                let (value, limit) = (value / info.unit_si, limit / info.unit_si);
                write!(f, "{} is {value:.1} {}, plausible up to {limit:.1}", info.name, info.unit)
            }
            Self::ChiSquare { chi_square, degrees_of_freedom, low, high } => write!(
                f,
                "chi-square {chi_square:.1} with {degrees_of_freedom} degrees of freedom is outside {low:.1} to {high:.1}"
            ),
            Self::Innovation { segment, channel, normalized } => {
                write!(f, "segment {segment}, {}: innovation of {normalized:.1} sigma", channel_name(channel))
            }
            Self::Unrest { segment, channel, unrest } => {
                write!(f, "segment {segment}, {}: ", channel_name(channel))?;
                match unrest {
                    Unrest::Variance(ratio) => write!(f, "variance {ratio:.1} times that of the configured noise"),
                    Unrest::Trend(sigmas) => write!(f, "drift of {sigmas:.1} sigma during the stop"),
                    Unrest::Stuck => write!(f, "the channel does not change"),
                }
            }
            Self::Gap { segment, longest_us } => {
                write!(f, "segment {segment}: no samples for {} ms", longest_us / 1000)
            }
            Self::LeftOut(count) => write!(f, "{count} segments did not fit and were left out"),
            Self::Changed { parameter, sigmas } => {
                write!(f, "{} differs from the stored calibration by {sigmas:.1} combined sigma", info(parameter).name)
            }
        }
    }
}
