//! The verdict on a result. Every doubt has a reason, which names the segment, channel or parameter and gives the
//! number.
//!
//! Each bound follows from the distribution of its number under white noise of the configured size. All bounds together
//! reject about two good calibrations in a thousand.

use super::assessment::{Assessment, Verdict};
use super::fit::{judge_fit, judge_flicker};
use super::limits::{INSTALLATION, VerdictLimits, plausible};
use super::motion::{NoiseLevels, unrest_but};
use super::noise::{judge_noise, judge_noise_levels, noise_levels};
use super::reason::Reason;
use super::scale::wrong_scales;
use super::setting::wrong_gravity;
use super::wiring::mistake;
use crate::base::linear::{ComplexField, Real};
use crate::base::sample::CHANNELS;
use crate::base::units::DEG;
use crate::estimator::{Estimate, KNOWN_LATITUDE_RAD, OBSERVED_RATIO};
use crate::model::effects::effect;
use crate::model::error_model::block;
use crate::segment::Segment;
use crate::segment::intake::IntakeCounts;
use core::ops::Range;

/// A channel that repeats the same value over this many samples does not measure. Even with a resolution of two sigma,
/// a good channel repeats a value with probability 0.68 only, and 64 times in a row with probability 2e-11.
const HELD_SAMPLES: u16 = 64;
/// Largest part of the samples that may be missing or repeat the sample before them. The variance grows by the same
/// part.
const LOST_PART: f64 = 0.03;

/// Largest sigma of the latitude, rad: over 2 deg the model is not linear enough, and gravity changes by 200 ppm at
/// most.
const LATITUDE_SIGMA_RAD: f64 = 2.0 * DEG;

/// A change from the stored calibration is large above this many combined sigmas.
const CHANGE_LIMIT: f64 = 6.0;

/// Judges a solution. If one doubt follows from another, only the cause is reported.
pub fn judge<T: Real>(assessment: &Assessment<'_, T>, limits: &VerdictLimits) -> Verdict {
    let mut verdict = Verdict::default();
    for wrong in wrong_scales(assessment.segments, assessment.site.gravity_m_s2(), limits) {
        verdict.doubt(Reason::Scale(wrong));
    }
    if let Some(wiring) = mistake(assessment.segments).filter(|_| verdict.accepted()) {
        verdict.doubt(Reason::Wiring(wiring));
    }
    if !verdict.accepted() {
        // All other doubts follow from this one.
        return verdict;
    }
    judge_samples(&mut verdict, assessment);
    let levels = noise_levels(assessment);
    judge_segments(&mut verdict, assessment, &levels);
    judge_flicker(&mut verdict, assessment);
    judge_noise_levels(&mut verdict, &levels);
    judge_noise(&mut verdict, assessment, &levels);
    judge_fit(&mut verdict, assessment, limits);
    judge_parameters(&mut verdict, assessment, limits);
    if let Some(stored) = assessment.stored {
        judge_change(&mut verdict, assessment, stored);
    }
    verdict
}

fn judge_samples<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>) {
    let IntakeCounts { admitted, missing, .. } = assessment.counts;
    let of = admitted + u64::from(missing);
    if f64::from(missing) > LOST_PART * of as f64 {
        verdict.doubt(Reason::Missing { missing, of });
    }
    let pulses = pulses(assessment.segments);
    let is_pulses = |channel: u8| pulses.get(usize::from(channel)).copied().unwrap_or(false);
    for (segment, Segment { held, samples, .. }) in (0_u16..).zip(assessment.segments) {
        if held.samples >= HELD_SAMPLES && !is_pulses(held.channel) {
            verdict.doubt(Reason::Held { segment, channel: held.channel, samples: held.samples });
        }
        if f64::from(held.stale) > LOST_PART * f64::from(*samples) && !pulses.iter().all(|is| *is) {
            verdict.doubt(Reason::Stale { segment, samples: held.stale });
        }
    }
}

/// The channels whose outputs are known to be pulses. They may repeat the same value for a long time.
fn pulses<T: Real>(segments: &[Segment<T>]) -> [bool; CHANNELS] {
    let last = segments.iter().rev().find_map(Segment::standing);
    last.map_or([false; CHANNELS], |standing| standing.increments.map(|increment| increment > 0.0))
}

fn judge_segments<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, levels: &NoiseLevels) {
    if assessment.segments.len() < 3 {
        verdict.doubt(Reason::TooFewSegments(assessment.segments.len() as u16));
    }
    for (number, segment) in (0_u16..).zip(assessment.segments) {
        if segment.is_broken() {
            verdict.doubt(Reason::Gap { segment: number, longest_us: segment.longest_interval_us.into() });
        }
        if let Some((channel, unrest)) = unrest_but(segment, assessment.noise, assessment.hardware, levels) {
            verdict.doubt(Reason::Unrest { segment: number, channel, unrest });
        }
    }
    let broken = assessment.segments.iter().filter(|segment| segment.is_broken()).count() as u16;
    let left_out = assessment.solution.left_out.saturating_sub(broken);
    if left_out > 0 {
        verdict.doubt(Reason::LeftOut(left_out));
    }
}

fn judge_parameters<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, limits: &VerdictLimits) {
    let estimate = &assessment.solution.estimate;
    let values = estimate.errors.to_vector();
    let gravity = wrong_gravity(assessment.solution, assessment.site, limits.scale);
    if let Some(gravity) = gravity {
        verdict.doubt(Reason::Setting(gravity));
    }
    let latitude = assessment.solution.effects.sigmas.get(effect::LATITUDE).copied().map_or(0.0, f64::from);
    let configured = assessment.effect_sigmas.get(effect::LATITUDE).copied().unwrap_or(0.0);
    if latitude.is_nan() || (configured > KNOWN_LATITUDE_RAD && latitude > LATITUDE_SIGMA_RAD) {
        verdict.doubt(Reason::UnknownLatitude { sigma_rad: latitude });
    }
    for (parameter, sigma, required) in limits.unmet(&estimate.sigmas) {
        verdict.doubt(Reason::Sigma { parameter, sigma, required });
    }
    let sigmas = estimate.sigmas.iter().zip(assessment.prior_sigmas);
    for ((parameter, value), (sigma, prior)) in (0_u8..).zip(values.iter()).zip(sigmas) {
        if !value.is_finite() || !sigma.is_finite() {
            verdict.doubt(Reason::NotFinite { parameter });
            continue;
        }
        let limit = plausible(parameter.into(), limits);
        let is_gravity = gravity.is_some() && ACCEL_SCALE.contains(&usize::from(parameter));
        if value.abs() > limit && !is_gravity {
            verdict.doubt(Reason::Implausible { parameter, value: *value, limit });
        }
        // The heading need not be observed. Its accuracy depends on the latitude and the gyros, and its sigma shows it.
        let is_named = limits.unmet(&estimate.sigmas).any(|(unmet, ..)| unmet == parameter);
        if usize::from(parameter) != block::HEADING && *sigma > OBSERVED_RATIO * prior && !is_named {
            verdict.doubt(Reason::Unobserved { parameter, of_prior: sigma / prior });
        }
    }
}

/// Lists what differs from the stored calibration by more than the sigmas explain. A change is no doubt: a unit that
/// has changed is why one calibrates.
fn judge_change<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, stored: &Estimate) {
    let now = &assessment.solution.estimate;
    let difference = now.errors.to_vector() - stored.errors.to_vector();
    let sigmas = now.sigmas.iter().zip(&stored.sigmas);
    for ((parameter, difference), (new, old)) in (0_u8..).zip(difference.iter()).zip(sigmas) {
        if *new == 0.0 || *old == 0.0 {
            // One of the two methods did not estimate the parameter.
            continue;
        }
        let combined = ComplexField::hypot(*new, *old);
        let constant =
            INSTALLATION.contains(&usize::from(parameter)) || usize::from(parameter) == block::NON_PERPENDICULARITY;
        if !constant || difference.abs() <= CHANGE_LIMIT * combined {
            continue;
        }
        // The list is for information, so changes that do not fit are dropped. The parameters show them.
        let _ = verdict.changes.push(Reason::Changed { parameter, sigmas: difference.abs() / combined });
    }
}

const ACCEL_SCALE: Range<usize> = block::ACCEL_SCALE..block::GYRO_BIAS;

#[cfg(test)]
mod tests {
    use super::super::assessment::MAX_REASONS;
    use super::super::wiring::Wiring;
    use super::*;
    use crate::base::hardware::Hardware;
    use crate::base::linear::Vector3;
    use crate::base::site::Site;
    use crate::base::units::{ARCSEC, DEG_H, MICRO_G, PPM};
    use crate::estimator::constancy::{Change, SettingEvidence, Suspicion};
    use crate::estimator::{EffectEstimates, Fit, LargestInnovation, Solution};
    use crate::model::effects::EFFECTS;
    use crate::model::error_model::{InstrumentErrors, PARAMETERS};
    use crate::segment::scatter::Scatter;
    use crate::segment::white_noise::Noise;
    use crate::segment::{AngleIntegrals, Course, Held, Turned};
    use std::string::ToString;
    use std::vec::Vec;

    const NOISE: Noise =
        Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 0.5 * ARCSEC, margin: 1.0 };
    const PRIOR: [f64; PARAMETERS] = [0.05; PARAMETERS];
    const NO_INNOVATION: LargestInnovation = LargestInnovation { normalized: 0.0, segment: 0, channel: 0 };

    /// The input of a verdict, which a test changes.
    #[derive(Clone)]
    struct Case {
        solution: Solution,
        segments: Vec<Segment<f64>>,
        counts: IntakeCounts,
        stored: Option<Estimate>,
        limits: VerdictLimits,
    }

    fn stop() -> Segment<f64> {
        let sigma = |psd_sqrt: f64| (psd_sqrt * psd_sqrt / 0.1) as f32;
        let (accel, gyro) = (sigma(NOISE.accel_psd_sqrt), sigma(NOISE.gyro_psd_sqrt));
        let mut stop = Segment::quiet_stop(10_000_000);
        stop.standing_mut().scatter.variance = [accel, accel, accel, gyro, gyro, gyro];
        stop
    }

    fn good() -> Case {
        let estimate = Estimate { errors: InstrumentErrors::default(), sigmas: [0.3 * ARCSEC; PARAMETERS] };
        Case {
            solution: Solution {
                estimate,
                fit: Fit { chi_square: 140.0, measurements: 168, gated: 0, refused: 0, largest: NO_INNOVATION },
                degrees_of_freedom: 140,
                sweeps: 3,
                converged: true,
                segments: 19,
                left_out: 0,
                duration_s: 290.0,
                temperature_c: 20.0,
                effects: EffectEstimates::NONE,
                suspicion: Suspicion::default(),
                settings: SettingEvidence::default(),
            },
            segments: std::vec![stop(); 19],
            counts: IntakeCounts { admitted: 58_000, ..IntakeCounts::default() },
            stored: None,
            limits: VerdictLimits::default(),
        }
    }

    fn verdict(case: &Case) -> Verdict {
        let assessment = Assessment {
            solution: &case.solution,
            prior_sigmas: &PRIOR,
            segments: &case.segments,
            noise: &NOISE,
            hardware: &Hardware::IDEAL,
            effect_sigmas: &[0.0; EFFECTS],
            site: &Site::default(),
            counts: case.counts,
            stored: case.stored.as_ref(),
        };
        judge(&assessment, &case.limits)
    }

    fn scatter(case: &mut Case, segment: usize) -> &mut Scatter {
        &mut case.segments[segment].standing_mut().scatter
    }

    /// The texts of the reasons of a good case after the change `spoil`.
    fn reasons(spoil: impl FnOnce(&mut Case)) -> Vec<std::string::String> {
        let mut case = good();
        spoil(&mut case);
        verdict(&case).reasons.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_good_case_is_accepted() {
        assert!(verdict(&good()).accepted(), "{:?}", verdict(&good()).reasons);
    }

    #[test]
    fn segments_give_their_reasons() {
        let few = reasons(|case| case.segments.truncate(1));
        assert_eq!(
            few,
            [
                "[too-few-segments] the number of segments is 1; a calibration needs at least 3: a stop, a move and another stop"
            ]
        );
        let gap = reasons(|case| case.segments[4].longest_interval_us = 250_000);
        assert_eq!(gap, ["[gap] in segment 4, no sample arrived for 250 ms"]);
        let variance = reasons(|case| scatter(case, 7).variance[1] *= 3.0);
        assert_eq!(
            variance[0],
            "[unrest] in segment 7, the variance of accel y is 3.0 times that of the configured noise"
        );
        let trend = reasons(|case| scatter(case, 3).trend[5] = 6.0 * 3e-7 / 0.1_f32.sqrt());
        assert_eq!(trend, ["[unrest] in segment 3, gyro z drifts by 6.0 sigma during the stop"]);
        let stuck = reasons(|case| scatter(case, 2).variance[3] = 0.0);
        assert_eq!(stuck, ["[stuck-channel] in segment 2, gyro x does not change"]);
        assert_eq!(
            reasons(|case| case.solution.left_out = 2),
            ["[left-out] 2 segments did not fit into memory and were left out"]
        );
    }

    #[test]
    fn all_stops_together_show_noise_that_no_stop_shows_alone() {
        // 1.3 times over 12 stops of 99 degrees of freedom: 0.3 / sqrt(2 / 1188) = 7.3 sigma; one stop alone shows 2.1
        // sigma.
        let noise = reasons(|case| {
            case.segments[7..].iter_mut().for_each(|stop| stop.standing_mut().scatter.variance[2] *= 1.3)
        });
        assert_eq!(noise.len(), 1);
        assert!(
            noise[0].starts_with("[noise-rise] from segment ") && noise[0].contains(" accel z is 1.30 times "),
            "{}",
            noise[0]
        );
        let little = reasons(|case| {
            case.segments[7..].iter_mut().for_each(|stop| stop.standing_mut().scatter.variance[2] *= 1.1)
        });
        assert_eq!(little.len(), 0);
        let trend = 2.0 * 1e-4 / 0.1_f32.sqrt();
        let trends =
            reasons(|case| case.segments.iter_mut().for_each(|stop| stop.standing_mut().scatter.trend[0] = trend));
        assert_eq!(
            trends,
            ["[drift] accel x drifts during the stops: the mean square of its trends is 4.0 times that of white noise"]
        );
        // Too little for one channel, and too much for a triad.
        let trend = |case: &mut Case, channels: usize| {
            let trend = 1.6 * 1e-4 / 0.1_f32.sqrt();
            case.segments.iter_mut().for_each(|stop| stop.standing_mut().scatter.trend[..channels].fill(trend));
        };
        assert_eq!(reasons(|case| trend(case, 1)).len(), 0);
        assert_eq!(reasons(|case| trend(case, 3)).len(), 1);
    }

    #[test]
    fn samples_give_their_reasons() {
        let held = reasons(|case| case.segments[5].held = Held { samples: 64, channel: 4, stale: 0 });
        assert_eq!(held, ["[held-value] in segment 5, gyro y does not change over 64 samples"]);
        let stale = reasons(|case| case.segments[5].held.stale = 61);
        assert_eq!(stale, ["[stale-samples] in segment 5, 61 samples repeat the sample before them"]);
        assert_eq!(reasons(|case| case.segments[5].held = Held { samples: 63, channel: 4, stale: 60 }).len(), 0);
        let missing = reasons(|case| case.counts.missing = 2000);
        assert_eq!(missing, ["[missing-samples] 2000 of 60000 samples are missing"]);
    }

    #[test]
    fn the_fit_gives_its_reasons() {
        let high = reasons(|case| case.solution.fit.chi_square = 220.0);
        assert_eq!(
            high,
            ["[chi-square] the chi-square 220.0 with 140 degrees of freedom is outside its bounds, 71.5 to 208.4"]
        );
        assert_eq!(reasons(|case| case.solution.fit.chi_square = 60.0).len(), 1);
        assert_eq!(reasons(|case| case.solution.fit.chi_square = f64::NAN).len(), 1);
        let innovation = reasons(|case| {
            case.solution.fit.largest = LargestInnovation { normalized: -7.5, segment: 12, channel: 3 };
        });
        let huge = reasons(|case| case.solution.fit.chi_square = 123_456_789_012.3);
        assert_eq!(
            huge,
            ["[chi-square] the chi-square 1.235e11 with 140 degrees of freedom is outside its bounds, 71.5 to 208.4"]
        );
        assert_eq!(
            innovation,
            ["[innovation] in segment 12, gyro x differs by -7.5 sigma from what all other segments predict"]
        );
        assert_eq!(
            reasons(|case| case.solution.fit.refused = 2),
            ["[refused-measurements] 2 measurements were refused because they are not finite"]
        );
        assert_eq!(
            reasons(|case| case.solution.converged = false),
            ["[not-converged] the estimate has not converged after 3 sweeps"]
        );
    }

    #[test]
    fn changes_are_named_with_segment_size_and_significance() {
        let suspicion = |change, size| {
            let found = Suspicion { change, segment: 9, size, sigmas: 6.2, limit: 5.0 };
            reasons(|case| case.solution.suspicion = found).remove(0)
        };
        let step = suspicion(Change::Step(block::ACCEL_BIAS as u8), 10.0 * MICRO_G);
        assert_eq!(
            step,
            "[parameter-step] from segment 9 on, accel_bias_x differs by 10.000 ug; this is 6.2 sigma, and the limit is 5.0 sigma"
        );
        let knock = suspicion(Change::Step(block::ATTITUDE as u8), 3.0 * ARCSEC);
        assert_eq!(
            knock,
            "[parameter-step] from segment 9 on, base_roll differs by 3.000 arcsec; this is 6.2 sigma, and the limit is 5.0 sigma"
        );
        let ramp = suspicion(Change::Ramp(block::GYRO_BIAS as u8), 0.01 * DEG_H / 3600.0);
        assert!(
            ramp.starts_with("[parameter-ramp] from segment 9 on, gyro_bias_x drifts by 0.0 deg/h in an hour;"),
            "{ramp}"
        );
        assert!(
            suspicion(Change::Slip(0), 2.0 * ARCSEC)
                .starts_with("[encoder-slip] in segment 9, the outer encoder slips by 2.00 arcsec;")
        );
        let scale = suspicion(Change::EncoderScale(1), 5.0 * PPM);
        assert!(
            scale.starts_with("[encoder-scale] from segment 9 on, the inner encoder has a scale error of 5.00 ppm;"),
            "{scale}"
        );
        assert!(
            suspicion(Change::Outlier(4), ARCSEC).starts_with("[outlier] in segment 9, gyro y is off by 1.00 arcsec;")
        );
        let below = Suspicion { sigmas: 4.9, limit: 5.0, ..Suspicion::default() };
        assert_eq!(reasons(|case| case.solution.suspicion = below).len(), 0);
        let unknown = Suspicion { sigmas: f64::NAN, ..below };
        assert_eq!(reasons(|case| case.solution.suspicion = unknown).len(), 1);
    }

    /// The evidence of gyros that measure an Earth rate with this error, with a sigma of 1e-8 rad/s.
    fn felt(error_rad_s: [f64; 2]) -> SettingEvidence {
        let information = 1e16;
        SettingEvidence {
            earth_rate_score: error_rad_s.map(|error| information * error),
            earth_rate_information: [information, 0.0, information],
            ..SettingEvidence::default()
        }
    }

    #[test]
    fn a_wrong_setting_is_named_where_it_explains_more_than_any_change() {
        let earth_rate = |latitude_rad| Site { latitude_rad, ..Site::default() }.earth_rate_n();
        let ([_, north, up], [_, felt_north, felt_up]) = (Site::default().earth_rate_n(), earth_rate(35.0 * DEG));
        let error = [felt_north - north, felt_up - up];
        let explained = felt(error).explained_by(error);
        let found = |error, by_change: f64| {
            reasons(|case| {
                case.solution.settings = felt(error);
                case.solution.fit.chi_square = 140.0 + explained;
                case.solution.suspicion =
                    Suspicion { change: Change::Slip(0), sigmas: by_change.sqrt(), ..Suspicion::default() };
            })
        };
        let latitude = "[wrong-latitude] the gyros measure the Earth rate of latitude 35.000 +- 0.008 deg, but 30.930 deg is configured";
        let (alone, beside) = (found(error, 0.9 * explained), found(error, explained));
        assert_eq!((alone.len(), alone[0].as_str()), (2, latitude));
        assert_eq!((beside.len(), beside[0].as_str()), (3, latitude));
        assert!(beside[1].contains("the outer encoder slips"), "{beside:?}");
        let by_change = found(error, explained + 10.0);
        assert!(by_change[0].contains("the outer encoder slips"), "{by_change:?}");
        let implausible = reasons(|case| {
            case.solution.settings = felt(error);
            case.solution.estimate.errors.gyro_scale[0] = 0.02;
        });
        assert!(
            implausible.iter().all(|reason| reason != latitude),
            "a wrong instrument may look like it: {implausible:?}"
        );
        let not_earth = found([0.0, explained.sqrt() * 1e-8], 100.0);
        assert!(not_earth[0].contains("the outer encoder slips"), "{not_earth:?}");
        let south = reasons(|case| case.solution.settings = felt([0.0, -2.0 * up]));
        assert!(south[0].ends_with(
            "latitude -30.930 +- 0.008 deg, but 30.930 deg is configured; is the site in the other hemisphere?"
        ));
        let heading = reasons(|case| {
            case.solution.settings =
                SettingEvidence { heading_rad: 3.0 * DEG, heading_sigmas: -6.0, ..SettingEvidence::default() };
        });
        assert_eq!(
            heading,
            [
                "[wrong-heading] the gyros measure a heading that differs from the configured heading by 3.000 deg, which is 6.0 sigma"
            ]
        );
    }

    #[test]
    fn a_scale_error_that_all_accelerometers_share_is_gravity() {
        let scaled = |scales: [f64; 3]| reasons(|case| case.solution.estimate.errors.accel_scale = scales);
        let gravity = scaled([6000e-6, 6100e-6, 5900e-6]);
        assert_eq!(gravity.len(), 1);
        assert!(gravity[0].starts_with(
            "[wrong-gravity] all three accelerometers measure 1.00600 times the configured gravity of 9.79"
        ));
        assert_eq!(
            scaled([6000e-6, 100e-6, -50e-6])[0],
            "[implausible] accel_scale_x is 6000.0 ppm, but no more than 5000.0 ppm is plausible"
        );
        assert_eq!(scaled([900e-6; 3]).len(), 0);
    }

    #[test]
    fn wrong_wiring_is_the_first_reason() {
        let upside_down = reasons(|case| {
            case.solution.fit.chi_square = 1e9;
            case.segments.iter_mut().for_each(|stop| stop.standing_mut().force_a.z = -9.8);
        });
        assert_eq!(upside_down[0], "[wiring] the sign of accel z is wrong");
        assert_eq!(Reason::Wiring(Wiring::Swapped(5)).to_string(), "[wiring] gyro z and gyro x are swapped");
        assert_eq!(
            Reason::Wiring(Wiring::EncoderReversed(1)).to_string(),
            "[wiring] the sign of the inner encoder is wrong"
        );
    }

    #[test]
    fn parameters_give_their_reasons() {
        let nan = reasons(|case| case.solution.estimate.errors.mounting[0] = f64::NAN);
        assert_eq!(nan, ["[not-finite] the estimate of alpha is not finite"]);
        let far = reasons(|case| case.solution.estimate.errors.mounting[1] = 6.0 * DEG);
        assert_eq!(far, ["[implausible] beta is 21600.0 arcsec, but no more than 18000.0 arcsec is plausible"]);
        let unobserved = reasons(|case| case.solution.estimate.sigmas[0] = 0.025);
        assert_eq!(
            unobserved,
            ["[unobserved] Sgxy is not observed: its sigma is still 0.50 times its sigma before the run"]
        );
        let sigma = reasons(|case| case.limits = case.limits.requiring(0.2 * ARCSEC));
        assert_eq!(
            (sigma.len(), sigma[0].as_str()),
            (12, "[sigma] the sigma of Sgxy is 0.300 arcsec, but 0.200 arcsec or less is required")
        );
        let heading = reasons(|case| case.solution.estimate.sigmas[block::HEADING] = 0.05);
        assert_eq!(heading.len(), 0, "the heading need not be observed; its sigma shows how well it is known");
    }

    #[test]
    fn a_change_against_the_store_is_told_and_no_doubt() {
        let mut case = good();
        case.stored = Some(case.solution.estimate);
        case.solution.estimate.errors.mounting[2] = 5.0 * ARCSEC;
        let verdict = verdict(&case);
        assert!(verdict.accepted());
        let told: Vec<_> = verdict.changes.iter().map(Reason::to_string).collect();
        assert_eq!(told, ["[changed] gamma differs from the stored calibration by 11.8 combined sigma"]);
    }

    #[test]
    fn axes_must_be_constant_while_biases_may_change() {
        let mut case = good();
        case.stored = Some(case.solution.estimate);
        case.solution.estimate.errors.gyro_bias_g[0] = 5.0 * ARCSEC;
        assert_eq!(verdict(&case).changes, []);
        case.solution.estimate.errors.axis_non_perpendicularity = 5.0 * ARCSEC;
        assert_eq!(
            verdict(&case).changes[0].to_string(),
            "[changed] axis_nonperpendicularity differs from the stored calibration by 11.8 combined sigma"
        );
    }

    #[test]
    fn a_parameter_that_only_one_method_estimates_is_not_compared() {
        let mut case = good();
        let mut bai = case.solution.estimate;
        bai.sigmas[block::NON_PERPENDICULARITY] = 0.0;
        case.stored = Some(bai);
        case.solution.estimate.errors.axis_non_perpendicularity = 4.0 * ARCSEC;
        assert_eq!(verdict(&case).changes, []);
        std::mem::swap(&mut case.solution.estimate, case.stored.as_mut().unwrap());
        assert_eq!(verdict(&case).changes, []);
    }

    #[test]
    fn wrong_units_are_the_only_reason() {
        let spoilt = |case: &mut Case| {
            case.solution.fit.chi_square = 1e9;
            case.segments.iter_mut().for_each(|stop| stop.standing_mut().scatter.variance = [1.0; CHANNELS]);
        };
        let in_g = reasons(|case| {
            spoilt(case);
            case.segments.iter_mut().for_each(|stop| stop.standing_mut().force_a /= 9.8);
        });
        assert_eq!(
            in_g,
            [
                "[wrong-scale] the accelerometers measure 0.102 times gravity at the stops; probable cause: g in place of m/s^2"
            ]
        );
        let turning = |case: &mut Case, gyro: f64, encoder: f64| {
            let turn = core::f64::consts::FRAC_PI_2;
            for (number, segment) in case.segments.iter_mut().enumerate().filter(|(number, _)| number % 2 == 1) {
                let (outer, inner) = if number % 4 == 1 { (turn, 0.0) } else { (0.0, turn) };
                segment.rotation_g = Vector3::new(outer, 0.0, inner) * gyro;
                let (outer, inner) = (outer * encoder, inner * encoder);
                segment.turned = Turned { outer, inner, outer_cos_inner: outer, ..Turned::default() };
                segment.course = Course::Move(AngleIntegrals::default());
            }
        };
        assert!(reasons(|case| turning(case, 1.0, 1.0)).is_empty());
        let degrees = 1.0 / DEG;
        for (gyro, encoder, expected) in [
            (degrees, 1.0, "gyros in deg/s"),
            (1.0, degrees, "encoders in deg"),
            // 2000 samples in 6 s.
            (0.003, 1.0, "gyro increments"),
            (degrees, degrees, "gyros and encoders in deg"),
        ] {
            let found = reasons(|case| {
                spoilt(case);
                case.segments.iter_mut().for_each(|segment| segment.duration_us = 6_000_000);
                turning(case, gyro, encoder);
            });
            assert!(
                found.len() == 1 && found[0].contains(&format!("; probable cause: {expected} in place of rad")),
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_wrong_scale_in_one_stop_or_channel_is_not_a_wrong_unit() {
        let one = reasons(|case| case.segments[3].standing_mut().force_a *= 0.1);
        assert!(one.is_empty(), "left to the fit: {one:?}");
        let dead = reasons(|case| {
            case.segments.iter_mut().for_each(|stop| {
                stop.standing_mut().force_a = Vector3::zeros();
                stop.held = Held { samples: 2000, channel: 2, stale: 0 };
            });
        });
        assert_eq!(dead[0], "[held-value] in segment 0, accel z does not change over 2000 samples");
    }

    #[test]
    fn wrong_noise_in_all_stops_is_one_reason() {
        let scaled = |channels: Range<usize>, factor: f32| {
            reasons(|case| {
                for stop in &mut case.segments {
                    stop.standing_mut().scatter.variance[channels.clone()]
                        .iter_mut()
                        .for_each(|variance| *variance *= factor);
                    stop.standing_mut().scatter.trend[channels.clone()].fill(6.0 * 1e-4 / 0.1_f32.sqrt());
                }
            })
        };
        assert_eq!(
            scaled(0..3, 9.0),
            ["[noise-level] the noise of the accelerometers is 3.00 times the configured noise"]
        );
        assert_eq!(scaled(3..6, 1e-4), ["[noise-level] the noise of the gyros is 0.01 times the configured noise"]);
        assert_eq!(scaled(4..5, 9.0), ["[noise-level] the noise of gyro y is 3.00 times the configured noise"]);
        let quiet = reasons(|case| {
            case.solution.fit.chi_square = 60.0;
            case.segments.iter_mut().for_each(|stop| stop.standing_mut().scatter.variance[5] *= 0.36);
        });
        assert_eq!(
            (quiet.len(), quiet[0].as_str()),
            (2, "[noise-level] the noise of gyro z is 0.60 times the configured noise")
        );
        let few = reasons(|case| {
            case.segments[..9].iter_mut().for_each(|stop| stop.standing_mut().scatter.variance[1] *= 9.0)
        });
        assert_eq!(few[0], "[unrest] in segment 0, the variance of accel y is 9.0 times that of the configured noise");
    }

    #[test]
    fn the_noise_is_wrong_if_most_of_few_stops_show_it() {
        let loud = |stops: usize| {
            reasons(|case| {
                case.segments.truncate(5);
                case.segments[..stops].iter_mut().for_each(|stop| stop.standing_mut().scatter.variance[1] *= 9.0);
            })
        };
        assert_eq!(loud(3), ["[noise-level] the noise of accel y is 3.00 times the configured noise"]);
        assert_eq!(
            loud(2)[0],
            "[unrest] in segment 0, the variance of accel y is 9.0 times that of the configured noise"
        );
    }

    #[test]
    fn reasons_that_do_not_fit_are_counted() {
        let mut case = good();
        case.limits = case.limits.requiring(0.0);
        case.solution.converged = false;
        assert_eq!((verdict(&case).reasons.len(), verdict(&case).more), (MAX_REASONS, 1));
    }
}
