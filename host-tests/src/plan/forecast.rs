//! The information of a scheme, from its geometry alone: what the core's filter would have at the end, without
//! simulating a sample.
//!
//! The result is the inverse of the core's covariance, except for the lengths of the windows: the core counts in blocks
//! of 0.1 s, and here a stop loses the mean loss.

use super::information::{Information, STATES};
use super::leg_model::LegModel;
use super::shared_noise::{SharedNoise, Window};
use crate::calibration::Setup;
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::linear::{Matrix, Vector};
use rins_selfcal::base::site::Site;
use rins_selfcal::estimator::EstimatorConfig;
use rins_selfcal::estimator::rehearsal::{BLOCK_LOSS_S, stop_segment, usable_s};
use rins_selfcal::model::effects::SiteSigmas;
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETERS};
use rins_selfcal::model::measurement::{ENCODER_ERRORS, MeasurementModel};
use rins_selfcal::scheme::{Leg, Turning};
use rins_selfcal::segment::GUARD_S;
use rins_selfcal::segment::white_noise::Noise;
use std::borrow::Borrow;

/// Smallest sigma of an encoder error, rad (1/1000 arcsec), so that its information stays finite.
const LEAST_ENCODER_SIGMA_RAD: f64 = 5e-9;

/// Predicts the information of schemes for one unit without errors, level and facing north, as
/// [`crate::plan::prediction`] does.
#[derive(Clone, Debug)]
pub struct Forecast {
    model: MeasurementModel<f64>,
    config: EstimatorConfig,
    site: Site,
    turning: Turning,
    /// Settling time of the accelerometers after a move, s.
    settling_s: f64,
    prior_sigmas: Vector<f64, STATES>,
}

impl Forecast {
    /// A forecast for a unit with this configuration and the joint method. The axes turn as `turning` says. The
    /// accelerometers have settled `settling_s` after a move, and the core waits at least 0.3 s.
    pub fn new(setup: &Setup, turning: Turning, settling_s: f64) -> Self {
        let config = setup.config().estimator;
        let encoder_sigma = config.noise.encoder_sigma_rad.max(LEAST_ENCODER_SIGMA_RAD);
        let encoder = std::iter::repeat_n(encoder_sigma, ENCODER_ERRORS);
        let all = encoder.chain(config.prior_sigmas());
        let mut prior_sigmas = Vector::<f64, STATES>::zeros();
        prior_sigmas.iter_mut().zip(all).for_each(|(prior, sigma)| *prior = sigma);
        let site = setup.known_site();
        let model = MeasurementModel::new(&InstrumentErrors::default(), &site);
        Self { model, config, site, turning, settling_s: settling_s.max(GUARD_S), prior_sigmas }
    }

    /// Derivative of the mean specific force at a stop by the parameters, (3 x 28), SI.
    pub fn force_rows(&self, stand: &Leg) -> Matrix<f64, 3, PARAMETERS> {
        self.model.force_at_stop(&stop_segment(stand, 1.0)).by_parameters
    }

    /// The model of a leg; the first stop has no move before it.
    pub fn leg(&self, from: &Leg, to: &Leg) -> LegModel {
        LegModel::new(&self.model, &self.turning, from, to)
    }

    /// The information after all stops.
    pub fn information<L: Borrow<LegModel>>(&self, stands: &[Leg], legs: &[L]) -> Information {
        let knows_site = self.config.site_sigmas == SiteSigmas::EXACT;
        if self.config.hardware == Hardware::IDEAL && knows_site {
            self.with_white_noise(stands, legs)
        } else {
            let legs: Vec<&LegModel> = legs.iter().map(Borrow::borrow).collect();
            let windows = self.windows(stands, &legs);
            SharedNoise::new(&self.config, &self.site, &legs, &windows).information(&self.prior_sigmas)
        }
    }

    /// The information for ideal hardware: the encoder errors are the only ones that measurements share.
    fn with_white_noise<L: Borrow<LegModel>>(&self, stands: &[Leg], legs: &[L]) -> Information {
        let mut information = Information::prior(self.prior_sigmas);
        let Noise { accel_psd_sqrt, gyro_psd_sqrt, .. } = self.config.noise;
        let (accel_psd, gyro_psd) = (accel_psd_sqrt * accel_psd_sqrt, gyro_psd_sqrt * gyro_psd_sqrt);
        for (number, (stand, leg)) in stands.iter().zip(legs).enumerate() {
            let leg: &LegModel = leg.borrow();
            if number > 0 {
                information.renew_encoder_errors();
                information.add_rows(&leg.turn, gyro_psd * window_s(leg));
            }
            let usable_s = self.usable_s(stand, number, stands.len());
            information.add_rows(&leg.force, accel_psd / usable_s);
            // The rotation is per second, so its variance is that of the mean rate.
            information.add_rows(&leg.rest, gyro_psd / usable_s);
        }
        information
    }

    fn usable_s(&self, stand: &Leg, number: usize, count: usize) -> f64 {
        usable_s(stand.stop_s, self.settling_s, number == 0, number + 1 == count)
    }

    /// When each stop and each move is.
    fn windows(&self, stands: &[Leg], legs: &[&LegModel]) -> Vec<Window> {
        let mut windows = Vec::with_capacity(2 * stands.len());
        let mut from_s = 0.0;
        for (number, (stand, leg)) in stands.iter().zip(legs).enumerate() {
            if number > 0 {
                windows.push(Window { from_s, duration_s: window_s(leg) });
                // The window of a move ends after the guard time, and the accelerometers may need longer.
                from_s += window_s(leg) + self.settling_s - GUARD_S;
            }
            let duration_s = self.usable_s(stand, number, stands.len());
            windows.push(Window { from_s, duration_s });
            from_s += duration_s;
        }
        windows
    }
}

/// Duration of the window of a move, s.
fn window_s(leg: &LegModel) -> f64 {
    leg.move_s + 2.0 * GUARD_S + BLOCK_LOSS_S
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Precision;
    use crate::files::unit_file::UnitConfig;
    use crate::plan::prediction::predicted_sigmas_si;
    use crate::virtual_unit::unit::VirtualUnit;
    use rins_selfcal::base::method::Method;
    use rins_selfcal::base::units::{ARCSEC, DEG_H, MICRO_G};
    use rins_selfcal::model::error_model::PARAMETER_INFO;
    use rins_selfcal::scheme::Scheme;

    fn setup() -> Setup {
        Setup::new(&UnitConfig::ideal(), VirtualUnit::default().rate_hz, Method::Joint, Precision::F64)
    }

    fn sigmas(setup: &Setup, scheme: &Scheme) -> [f64; PARAMETERS] {
        let stands: Vec<Leg> = scheme.stops().collect();
        let forecast = Forecast::new(setup, scheme.turning(), GUARD_S);
        let from = stands.iter().take(1).chain(&stands);
        let legs: Vec<LegModel> = from.zip(&stands).map(|(from, to)| forecast.leg(from, to)).collect();
        forecast.information(&stands, &legs).sigmas().expect("positive definite")
    }

    /// The core counts in blocks, and the forecast uses the mean loss. For stops of 3 s the difference is 2 % of the
    /// time, so 1 % of the sigma.
    #[test]
    fn the_forecast_agrees_with_the_core() {
        let agree = |setup: &Setup, scheme: &Scheme, within: f64| {
            let (found, core) = (sigmas(setup, scheme), predicted_sigmas_si(setup, scheme));
            for ((found, core), info) in found.iter().zip(&core).zip(&PARAMETER_INFO) {
                assert!((found / core - 1.0).abs() < within, "{}: {found} for {core}", info.name);
            }
        };
        let ideal = setup();
        // What the profile leaves out has a size too.
        let hardware = Hardware {
            accel_walk: (20.0 * MICRO_G / 60.0) as f32,
            gyro_walk: (0.02 * DEG_H / 60.0) as f32,
            base_drift: (3.0 * ARCSEC / 3600.0) as f32,
            ..Hardware::NAVIGATION
        };
        let elsewhere = Setup { site_sigmas: SiteSigmas::GIVEN, ..setup() };
        let real = Setup { hardware, site_sigmas: SiteSigmas::GIVEN, ..setup() };
        for (stop_s, within) in [(10.0, 0.004), (3.0, 0.01)] {
            agree(&ideal, &Scheme::bai(stop_s, 1), within);
            agree(&elsewhere, &Scheme::bai(stop_s, 1), within);
            agree(&real, &Scheme::bai(stop_s, 1), within);
        }
        agree(&real, &Scheme::named("fast-180").expect("in the library"), 0.004);
    }
}
