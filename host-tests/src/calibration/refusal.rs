//! Refusals of schemes: the reason of the core, with the numbers of the scheme.

use anyhow::{Error, Result, anyhow};
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig, check_motion};
use rins_selfcal::run::self_calibration::SelfCalibration;
use rins_selfcal::scheme::Scheme;

/// Checks a scheme by itself and against the limits of the axes.
///
/// # Errors
/// One line that names the scheme and the leg.
pub fn check_axes(scheme: &Scheme, axes: &[AxisLimits; 2]) -> Result<()> {
    check_motion(scheme, axes).map_err(|error| refused(error, scheme, axes))
}

/// Checks whether the core would start a calibration.
///
/// # Errors
/// The reason why the core refuses the configuration.
pub fn check(config: &SelfCalibrationConfig) -> Result<(), ConfigError> {
    let mut calibrator = Box::new(Calibrator::<f64, MAX_SEGMENTS>::UNCONFIGURED);
    SelfCalibration::new(&mut config.clone(), None, &mut calibrator).map(|_| ())
}

/// Error for a configuration that the core refuses.
pub fn refused(error: ConfigError, scheme: &Scheme, axes: &[AxisLimits; 2]) -> Error {
    anyhow!("the configuration with scheme {} is refused: {error}{}", scheme.name, numbers(error, scheme, axes))
}

fn numbers(error: ConfigError, scheme: &Scheme, axes: &[AxisLimits; 2]) -> String {
    match error {
        ConfigError::Travel { leg, axis } => {
            let to = usize::from(leg).checked_sub(1).and_then(|leg| scheme.legs.get(leg));
            let angles = to.map_or([0.0; 2], |leg| [leg.outer_rad, leg.inner_rad]);
            let (lowest_rad, highest_rad) = axes[usize::from(axis)].travel.usable_rad().into_inner();
            let [angle, low, high] = [angles[usize::from(axis)], lowest_rad, highest_rad].map(|angle| angle / DEG);
            format!(": {angle:.1} deg, travel {low:.1} to {high:.1} deg")
        }
        ConfigError::TooFast(axis) => {
            let limits = &axes[usize::from(axis)];
            let scheme = [scheme.rate_rad_s, scheme.acceleration_rad_s2].map(|number| number / DEG);
            let limits = [limits.rate_rad_s, limits.acceleration_rad_s2].map(|number| number / DEG);
            format!(
                ": {:.1} deg/s and {:.1} deg/s^2, at most {:.1} and {:.1}",
                scheme[0], scheme[1], limits[0], limits[1]
            )
        }
        ConfigError::Unobserved(_) => {
            "; `rins observability` lists all unobserved parameters, and --run-unobserved runs the scheme nevertheless"
                .into()
        }
        _ => String::new(),
    }
}
