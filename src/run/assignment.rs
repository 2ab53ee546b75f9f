//! What the instrument does after power-up. A product keeps this configuration in non-volatile memory; in the emulator
//! it is a file of the host.

use crate::base::hardware::Hardware;
use crate::base::method::Method;
use crate::base::site::Site;
use crate::base::units::{ARCSEC, DEG_SQRT_H, MICRO_G};
use crate::estimator::{BaiTuning, EstimatorConfig, HeadingSource};
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::MotorAndLoad;
use crate::model::effects::SiteSigmas;
use crate::run::config::CalibratorConfig;
use crate::run::config::SelfCalibrationConfig;
use crate::run::policy::PowerUpPolicy;
use crate::run::sequencer::Pace;
use crate::scheme::Scheme;
use crate::scheme::library::compiled_in;
use crate::segment::Stillness;
use crate::segment::white_noise::Noise;
use crate::verdict::VerdictLimits;
use serde::{Deserialize, Serialize};

/// Longest assignment encoded by postcard, bytes.
pub const MAX_ASSIGNMENT_BYTES: usize = 2048;

/// What to do after power-up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Assignment {
    /// Calibrate or use the stored calibration, then correct samples.
    SelfCalibrate(SelfCalibrationConfig),
    /// Treat the samples as a recording: no motion, no store. The solution follows when the samples end.
    Replay(CalibratorConfig),
}

impl Default for Assignment {
    /// A navigation-grade unit at an unknown site, the joint method, and the scheme that was compiled in.
    fn default() -> Self {
        let noise = Noise {
            accel_psd_sqrt: 10.0 * MICRO_G,
            gyro_psd_sqrt: 0.001 * DEG_SQRT_H,
            encoder_sigma_rad: 0.5 * ARCSEC,
            margin: 1.0,
        };
        let mut calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
        calibrator.estimator.site_sigmas = SiteSigmas::UNKNOWN;
        let scheme = compiled_in().unwrap_or_else(|| Scheme::default_for(Method::Joint));
        Self::SelfCalibrate(SelfCalibrationConfig::new(calibrator, scheme))
    }
}

impl CalibratorConfig {
    /// The usual configuration for a unit with this noise (SI) and this sample rate (Hz), at a site that is given.
    pub fn new(method: Method, site: Site, noise: Noise, rate_hz: f64) -> Self {
        let estimator = EstimatorConfig {
            method,
            site,
            noise,
            heading: HeadingSource::Gyrocompass,
            period_moves: None,
            // The first linearization is poor, so a gate would keep out good measurements. The verdict finds bad ones.
            gate_sigma: None,
            hardware: Hardware::NAVIGATION,
            site_sigmas: SiteSigmas::GIVEN,
            tuning: BaiTuning::STATED,
        };
        Self { rate_hz, stillness: Stillness::default(), estimator }
    }
}

impl SelfCalibrationConfig {
    /// The usual configuration of a run: default axes, limits and pace. A run begins at power-up if nothing is stored.
    pub fn new(calibrator: CalibratorConfig, scheme: Scheme) -> Self {
        Self {
            calibrator,
            scheme,
            axes: [AxisLimits::default(); 2],
            motors: [MotorAndLoad::default(); 2],
            limits: VerdictLimits::default(),
            pace: Pace::default(),
            policy: PowerUpPolicy::default(),
            utc_s: None,
            refuse_unobserved: true,
        }
    }
}
