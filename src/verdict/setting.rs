//! Checks three configured values: the latitude against the Earth rate that the gyros measure, the heading against the
//! heading that the gyros measure, and gravity against all three accelerometers.
//!
//! A wrong setting is reported if it explains the misfit, and if no change during the run explains the misfit as well.

use crate::base::linear::{ComplexField, RealField};
use crate::base::site::{EARTH_RATE_RAD_S, Site};
use crate::base::units::DEG;
use crate::estimator::constancy::SettingEvidence;
use crate::estimator::{KNOWN_LATITUDE_RAD, Solution};
use crate::model::effects::effect;
use crate::segment::white_noise::chi_square_quantile;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Smallest chi-square that a wrong setting must explain: 5.5 sigma, probability 4e-8.
const LEAST_EXPLAINED: f64 = 30.0;
/// A wrong setting must explain this part of the chi-square beyond its expectation and chance. The true cause explains
/// nearly all.
const LEAST_PART: f64 = 0.8;
/// What chance may add to the chi-square, in its sigmas.
const CHANCE_SIGMAS: f64 = 2.0;
/// An explanation is the only one if its chi-square is better by this much: a likelihood ratio of 90.
const BETTER: f64 = 9.0;
/// Largest misfit of the magnitude of the Earth rate, as a chi-square: 5 sigma, or a tenth of the error if that is
/// larger.
const MAGNITUDE_CHI_SQUARE: f64 = 25.0;
const MAGNITUDE_PART: f64 = 0.01;
/// Number of Newton steps to the latitude. They have converged by then.
const LATITUDE_STEPS: u8 = 8;
/// A configured latitude is refuted if the measured one differs by this many combined sigmas: probability 7e-6.
const REFUTED_SIGMAS: f64 = 4.5;
/// Largest normal deviate of a chi-square that agrees.
const AGREEING_Z: f64 = 3.6;
/// Three accelerometers have a common scale-factor error if they agree within this part of it.
const SHARED_PART: f64 = 0.2;

/// A configured value that is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(missing_docs, reason = "the text of a variant says what its fields are")]
pub enum WrongSetting {
    /// The gyros measure the Earth rate of another latitude, rad.
    Latitude { felt_rad: f64, sigma_rad: f64, configured_rad: f64 },
    /// The gyros measure a heading that differs from the configured heading by this angle, rad, and by this many
    /// sigmas.
    Heading { off_rad: f64, sigmas: f64 },
    /// All three accelerometers measure this many times the configured gravity, m/s^2.
    Gravity { of_configured: f64, configured_m_s2: f64 },
}

impl WrongSetting {
    /// Short name of the setting that is wrong, as [`Reason::code`](super::Reason::code).
    pub fn code(&self) -> &'static str {
        match self {
            Self::Latitude { .. } => "wrong-latitude",
            Self::Heading { .. } => "wrong-heading",
            Self::Gravity { .. } => "wrong-gravity",
        }
    }
}

impl fmt::Display for WrongSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Latitude { felt_rad, sigma_rad, configured_rad } => {
                let hemisphere = (felt_rad + configured_rad).abs() < 0.5 * (felt_rad - configured_rad).abs();
                write!(
                    f,
                    "the gyros measure the Earth rate of latitude {:.3} +- {:.3} deg, but {:.3} deg is configured{}",
                    felt_rad / DEG,
                    sigma_rad / DEG,
                    configured_rad / DEG,
                    if hemisphere { "; is the site in the other hemisphere?" } else { "" }
                )
            }
            Self::Heading { off_rad, sigmas } => write!(
                f,
                "the gyros measure a heading that differs from the configured heading by {:.3} deg, which is {:.1} sigma",
                off_rad / DEG,
                sigmas.abs()
            ),
            Self::Gravity { of_configured, configured_m_s2 } => write!(
                f,
                "all three accelerometers measure {of_configured:.5} times the configured gravity of {configured_m_s2:.5} \
                 m/s^2; check the measured gravity, the height and the latitude"
            ),
        }
    }
}

/// An explanation of the misfit.
pub(super) struct Explanation {
    pub(super) setting: WrongSetting,
    /// Whether no change during the run explains the misfit as well.
    pub(super) only: bool,
}

/// A wrong latitude or a wrong heading, if the measurements show one. `latitude_sigma_rad` is the sigma of the
/// configured latitude.
pub(super) fn wrong_setting(solution: &Solution, site: &Site, latitude_sigma_rad: f64) -> Option<Explanation> {
    if let Some(refuted) = refuted_latitude(solution, site, latitude_sigma_rad) {
        return Some(refuted);
    }
    let latitude = latitude(&solution.settings, site);
    let heading = heading(&solution.settings);
    let by = |explanation: &Option<(WrongSetting, f64)>| explanation.map_or(0.0, |(_, explained)| explained);
    let (setting, explained) = if by(&latitude) > by(&heading) { latitude } else { heading }?;
    let freedom = f64::from(solution.degrees_of_freedom);
    let excess = solution.fit.chi_square - freedom - CHANCE_SIGMAS * ComplexField::sqrt(2.0 * freedom);
    let by_change = solution.suspicion.sigmas * solution.suspicion.sigmas;
    let explains = explained > LEAST_EXPLAINED && explained > LEAST_PART * excess && explained > by_change - BETTER;
    explains.then_some(Explanation { setting, only: explained > by_change + BETTER })
}

/// The latitude that the gyros have found in place of the configured one, if all else agrees with it.
fn refuted_latitude(solution: &Solution, site: &Site, latitude_sigma_rad: f64) -> Option<Explanation> {
    let effects = &solution.effects;
    let (off_rad, sigma_rad) = effects.values.get(effect::LATITUDE).zip(effects.sigmas.get(effect::LATITUDE))?;
    let (off_rad, sigma_rad) = (f64::from(*off_rad), f64::from(*sigma_rad));
    let is_known = latitude_sigma_rad > 0.0 && latitude_sigma_rad <= KNOWN_LATITUDE_RAD;
    let is_refuted = off_rad.abs() > REFUTED_SIGMAS * ComplexField::hypot(latitude_sigma_rad, sigma_rad);
    let freedom = solution.degrees_of_freedom;
    let agrees = solution.fit.chi_square < chi_square_quantile(freedom, AGREEING_Z);
    let setting =
        WrongSetting::Latitude { felt_rad: site.latitude_rad + off_rad, sigma_rad, configured_rad: site.latitude_rad };
    (is_known && is_refuted && agrees).then_some(Explanation { setting, only: true })
}

/// The latitude whose Earth rate fits best, and the chi-square that it explains; `None` if no latitude has this Earth
/// rate.
fn latitude(settings: &SettingEvidence, site: &Site) -> Option<(WrongSetting, f64)> {
    let [_, north, up] = site.earth_rate_n();
    let error = settings.earth_rate_error_rad_s()?;
    let mut felt_rad = RealField::atan2(up + error[1], north + error[0]);
    let mut sigma_rad = 0.0;
    let mut off = error;
    for _ in 0..LATITUDE_STEPS {
        let (sin, cos) = ComplexField::sin_cos(felt_rad);
        off = [EARTH_RATE_RAD_S * cos - north, EARTH_RATE_RAD_S * sin - up];
        let by_latitude = [-EARTH_RATE_RAD_S * sin, EARTH_RATE_RAD_S * cos];
        let information = settings.product(by_latitude, by_latitude);
        felt_rad += settings.product(by_latitude, [error[0] - off[0], error[1] - off[1]]) / information;
        sigma_rad = ComplexField::sqrt(information).recip();
    }
    let explained = settings.explained_by(off);
    let misfit = settings.explained_by(error) - explained;
    let is_earth = misfit < MAGNITUDE_CHI_SQUARE + MAGNITUDE_PART * explained;
    let setting = WrongSetting::Latitude { felt_rad, sigma_rad, configured_rad: site.latitude_rad };
    is_earth.then_some((setting, explained))
}

fn heading(settings: &SettingEvidence) -> Option<(WrongSetting, f64)> {
    let SettingEvidence { heading_rad: off_rad, heading_sigmas: sigmas, .. } = *settings;
    Some((WrongSetting::Heading { off_rad, sigmas }, sigmas * sigmas))
}

/// A wrong gravity, if all accelerometers have a common scale-factor error beyond `limit`.
pub(super) fn wrong_gravity(solution: &Solution, site: &Site, limit: f64) -> Option<WrongSetting> {
    let [x, y, z] = solution.estimate.errors.accel_scale;
    let mean = (x + y + z) / 3.0;
    let shared = [x, y, z].iter().all(|scale| (scale - mean).abs() < SHARED_PART * mean.abs());
    let wrong = WrongSetting::Gravity { of_configured: 1.0 + mean, configured_m_s2: site.gravity_m_s2() };
    (shared && mean.abs() > limit).then_some(wrong)
}
