//! The configuration of a run, and the reasons why a configuration is refused.

use crate::base::bounds::{ARCSECONDS, Bound, Bounded, Unit, first_outside};
use crate::base::hardware::{HARDWARE, HardwareSize};
use crate::base::method::Method;
use crate::base::site::SITE_BOUNDS;
use crate::estimator::EstimatorConfig;
use crate::estimator::rehearsal::SHORTEST_STOP_S;
use crate::estimator::{HEADING_BOUNDS, KNOWN_LATITUDE_RAD, MAX_SEGMENTS, TUNING_BOUNDS};
use crate::gimbal::axis::{AXIS_AND_MOTOR_BOUNDS, AXIS_BOUNDS, AxisLimits};
use crate::gimbal::fault::AXIS_NAMES;
use crate::gimbal::servo::{MOTOR_BOUNDS, MotorAndLoad};
use crate::model::effects::SITE_SIGMA_BOUNDS;
use crate::model::error_model::PARAMETER_INFO;
use crate::run::policy::{POLICY_BOUNDS, PowerUpPolicy};
use crate::run::sequencer::{PACE_BOUNDS, Pace};
use crate::scheme::{Scheme, SchemeError};
use crate::segment::Stillness;
use crate::segment::white_noise::NOISE_BOUNDS;
use crate::verdict::{LIMIT_BOUNDS, VerdictLimits};
use core::fmt;
use serde::{Deserialize, Serialize};

/// The configuration of the chain from samples to parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CalibratorConfig {
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// How moves are told from stops.
    pub stillness: Stillness,
    /// The configuration of the estimator.
    pub estimator: EstimatorConfig,
}

/// The configuration of a self-calibration run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfCalibrationConfig {
    /// The configuration of the chain from samples to parameters.
    pub calibrator: CalibratorConfig,
    /// The rotation scheme.
    pub scheme: Scheme,
    /// Limits of the outer and the inner axis.
    pub axes: [AxisLimits; 2],
    /// Motors, loads and encoders of the outer and the inner axis.
    pub motors: [MotorAndLoad; 2],
    /// The limits of the verdict.
    pub limits: VerdictLimits,
    /// The limits on the duration of a run.
    pub pace: Pace,
    /// When a run begins at power-up.
    pub policy: PowerUpPolicy,
    /// Time of power-up, seconds since 1970-01-01 UTC; `None` if there is no clock.
    pub utc_s: Option<u64>,
    /// Whether a scheme that leaves a parameter unobserved is refused before anything turns. If not, the scheme is run
    /// and its result is rejected.
    pub refuse_unobserved: bool,
}

/// A number of the configuration that has bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoundedNumber {
    /// A limit of an axis: the row of [`AXIS_BOUNDS`].
    Axis(u8),
    /// A number of a motor and its load: the row of [`MOTOR_BOUNDS`].
    Motor(u8),
    /// A number that follows from an axis and its motor: the row of [`AXIS_AND_MOTOR_BOUNDS`].
    AxisAndMotor(u8),
}

impl BoundedNumber {
    /// Name, unit and range of the number; `None` if the table has no such row.
    pub fn bound(self) -> Option<&'static Bound> {
        match self {
            Self::Axis(row) => AXIS_BOUNDS.get(usize::from(row)).map(|row| &row.bound),
            Self::Motor(row) => MOTOR_BOUNDS.get(usize::from(row)).map(|row| &row.bound),
            Self::AxisAndMotor(row) => AXIS_AND_MOTOR_BOUNDS.get(usize::from(row)).map(|row| &row.bound),
        }
    }
}

/// Why a configuration is refused. An axis is 0 for the outer axis and 1 for the inner axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// The sample rate is outside [`RATE_BOUNDS`].
    Rate,
    /// A noise is outside [`NOISE_BOUNDS`], or P0 or Q of the paper's method outside [`TUNING_BOUNDS`].
    Noise,
    /// The heading or its sigma is outside [`HEADING_BOUNDS`].
    Heading,
    /// The range of an axis at rest or the innovation gate is outside [`STILLNESS_BOUNDS`].
    Stillness,
    /// A number is outside its bounds.
    OutOfBounds {
        /// The number.
        number: BoundedNumber,
        /// The axis, if the number belongs to an axis.
        axis: Option<u8>,
    },
    /// The longest time of a run is outside [`PACE_BOUNDS`].
    Pace,
    /// A limit of the power-up policy is outside [`POLICY_BOUNDS`].
    Policy,
    /// A limit of the verdict is outside [`LIMIT_BOUNDS`].
    Limits,
    /// A size of the hardware is outside its bounds: the row of [`HARDWARE`].
    Hardware(u8),
    /// The scheme has more segments than fit into memory.
    Segments,
    /// A number is outside [`SITE_BOUNDS`] or [`SITE_SIGMA_BOUNDS`], or the paper's method does not know the latitude.
    Site,
    /// The scheme is not valid.
    Scheme(SchemeError),
    /// The scheme turns or accelerates faster than the limits of this axis permit.
    TooFast(u8),
    /// This leg, counted from 1, or the start at (0, 0), leg 0, is outside the travel of this axis.
    Travel {
        /// The leg.
        leg: u8,
        /// The axis.
        axis: u8,
    },
    /// The stop of this leg, counted from 1, or the first stop, leg 0, is too short to be measured.
    ShortStop(u8),
    /// The scheme would leave this parameter unobserved.
    Unobserved(u8),
}

impl ConfigError {
    /// Short name of the error. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Rate => "config-rate",
            Self::Noise => "config-noise",
            Self::Heading => "config-heading",
            Self::Stillness => "config-stillness",
            Self::OutOfBounds { .. } => "config-bounds",
            Self::Pace => "config-pace",
            Self::Policy => "config-policy",
            Self::Limits => "config-limits",
            Self::Hardware(_) => "config-hardware",
            Self::Segments => "scheme-segments",
            Self::Site => "config-site",
            Self::Scheme(error) => error.code(),
            Self::TooFast(_) => "scheme-fast",
            Self::Travel { .. } => "scheme-travel",
            Self::ShortStop(_) => "scheme-short-stop",
            Self::Unobserved(_) => "scheme-unobserved",
        }
    }
}

/// The [code](ConfigError::code) in brackets, then the text in one line.
impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !matches!(self, Self::Scheme(_)) {
            write!(f, "[{}] ", self.code())?;
        }
        let name = |axis: &u8| AXIS_NAMES.get(usize::from(*axis)).copied().unwrap_or("?");
        match self {
            Self::Rate => write_bounds(f, &RATE_BOUNDS),
            Self::Noise => {
                write_bounds(f, &NOISE_BOUNDS)?;
                f.write_str("; ")?;
                write_bounds(f, &TUNING_BOUNDS)
            }
            Self::Heading => write_bounds(f, &HEADING_BOUNDS),
            Self::Stillness => write_bounds(f, &STILLNESS_BOUNDS),
            Self::OutOfBounds { number, axis } => write_outside(f, *number, axis.as_ref().map(name)),
            Self::Pace => write_bounds(f, &PACE_BOUNDS),
            Self::Policy => write_bounds(f, &POLICY_BOUNDS),
            Self::Limits => {
                f.write_str("of the limits of the verdict, ")?;
                write_bounds(f, &LIMIT_BOUNDS)
            }
            Self::Hardware(row) => match HARDWARE.get(usize::from(*row)) {
                Some(HardwareSize { key, unit, largest, .. }) => {
                    write!(f, "the size {key} of the hardware must be from 0 to {largest} {unit}")
                }
                None => f.write_str("a size of the hardware is outside its bounds"),
            },
            Self::Segments => {
                write!(f, "the scheme has more than {MAX_SEGMENTS} stops and moves, which do not fit into memory")
            }
            Self::Site => {
                write_bounds(f, &SITE_BOUNDS)?;
                f.write_str("; ")?;
                write_bounds(f, &SITE_SIGMA_BOUNDS)?;
                f.write_str("; and the method bai must know the latitude")
            }
            Self::Scheme(error) => error.fmt(f),
            Self::TooFast(axis) => {
                write!(f, "the scheme turns or accelerates faster than the limits of the {} axis permit", name(axis))
            }
            Self::Travel { leg: 0, axis } => {
                write!(f, "the start at (0, 0) is outside the travel of the {} axis", name(axis))
            }
            Self::Travel { leg, axis } => write!(f, "leg {leg} leaves the travel of the {} axis", name(axis)),
            Self::ShortStop(0) => write!(f, "the first stop is shorter than the 0.5 s that a measurement needs"),
            Self::ShortStop(leg) => {
                write!(f, "the stop of leg {leg} is shorter than the 0.5 s that a measurement needs")
            }
            Self::Unobserved(parameter) => {
                let info = PARAMETER_INFO.get(usize::from(*parameter));
                write!(f, "the scheme leaves {} unobserved", info.map_or("a parameter", |info| info.name))
            }
        }
    }
}

/// All bounds of a table: which of its numbers is wrong is not told.
fn write_bounds<C>(f: &mut fmt::Formatter<'_>, table: &[Bounded<C>]) -> fmt::Result {
    for (row, Bounded { bound, .. }) in table.iter().enumerate() {
        let separator = if row > 0 { ", " } else { "" };
        write!(f, "{separator}the {} must be {bound}", bound.name)?;
    }
    Ok(())
}

fn write_outside(f: &mut fmt::Formatter<'_>, number: BoundedNumber, axis: Option<&str>) -> fmt::Result {
    let Some(bound) = number.bound() else { return f.write_str("a number is outside its bounds") };
    match axis {
        Some(axis) => write!(f, "the {} of the {axis} axis must be {bound}", bound.name),
        None => write!(f, "the {} must be {bound}", bound.name),
    }
}

/// The permitted range of the sample rate. The lower limit keeps enough samples in a segmenter's block and in the time
/// constant of the position loop. The upper limit keeps the interval at 100 us or more, as time stamps are in whole
/// microseconds.
pub static RATE_BOUNDS: [Bounded<CalibratorConfig>; 1] =
    [Bounded::new("sample rate", Unit::si("Hz"), [50.0, 10_000.0], |config| config.rate_hz)];

/// The permitted range of the numbers by which stops are told from moves, and measurements from outliers. No gate is
/// permitted too.
pub static STILLNESS_BOUNDS: [Bounded<CalibratorConfig>; 2] = [
    Bounded::new("angle range of an axis at rest", ARCSECONDS, [1e-3, 3600.0], |config| config.stillness.still_rad),
    Bounded::new("innovation gate", Unit::si("sigmas"), [1e-3, 1e6], |config| {
        config.estimator.gate_sigma.unwrap_or(1.0)
    }),
];

impl SelfCalibrationConfig {
    /// Checks every number, so that no later step can fail because of the configuration. Every number has its bounds in
    /// one table beside its type. Not inlined, because the rehearsal that follows needs the stack.
    ///
    /// # Errors
    /// The first number that is wrong.
    #[inline(never)]
    pub fn check(&self) -> Result<(), ConfigError> {
        let Self { calibrator, limits, pace, policy, .. } = self;
        let estimator = &calibrator.estimator;
        within(&RATE_BOUNDS, calibrator, ConfigError::Rate)?;
        within(&NOISE_BOUNDS, &estimator.noise, ConfigError::Noise)?;
        within(&HEADING_BOUNDS, &estimator.heading, ConfigError::Heading)?;
        within(&STILLNESS_BOUNDS, calibrator, ConfigError::Stillness)?;
        within(&TUNING_BOUNDS, &estimator.tuning, ConfigError::Noise)?;
        let wrong = estimator.hardware.first_wrong();
        if let Some(row) = wrong.and_then(|wrong| HARDWARE.iter().position(|size| size.key == wrong.key)) {
            return Err(ConfigError::Hardware(row as u8));
        }
        within(&SITE_BOUNDS, &estimator.site, ConfigError::Site)?;
        within(&SITE_SIGMA_BOUNDS, &estimator.site_sigmas, ConfigError::Site)?;
        if estimator.site_sigmas.latitude_rad > KNOWN_LATITUDE_RAD && estimator.method == Method::Bai {
            return Err(ConfigError::Site);
        }
        within(&PACE_BOUNDS, pace, ConfigError::Pace)?;
        within(&POLICY_BOUNDS, policy, ConfigError::Policy)?;
        within(&LIMIT_BOUNDS, limits, ConfigError::Limits)?;
        check_motion(&self.scheme, &self.axes)?;
        if 2 * self.scheme.moves() + 1 > MAX_SEGMENTS {
            return Err(ConfigError::Segments);
        }
        self.check_motors()
    }

    fn check_motors(&self) -> Result<(), ConfigError> {
        for ((axis, limits), motor) in (0_u8..).zip(&self.axes).zip(&self.motors) {
            let of_motor = first_outside(&MOTOR_BOUNDS, motor).map(BoundedNumber::Motor);
            let of_both = || first_outside(&AXIS_AND_MOTOR_BOUNDS, &(*limits, *motor)).map(BoundedNumber::AxisAndMotor);
            within_bounds(of_motor.or_else(of_both), axis)?;
        }
        Ok(())
    }

    /// The calibrator's configuration for a run of the scheme.
    pub(super) fn run(&self) -> CalibratorConfig {
        let mut calibrator = self.calibrator;
        if self.scheme.periods > 1 {
            calibrator.estimator.period_moves = Some(self.scheme.legs.len() as u16);
        }
        calibrator
    }
}

/// # Errors
/// `error`, if a number is outside the bounds of its table.
fn within<C>(table: &[Bounded<C>], of: &C, error: ConfigError) -> Result<(), ConfigError> {
    first_outside(table, of).map_or(Ok(()), |_| Err(error))
}

fn within_bounds(outside: Option<BoundedNumber>, axis: u8) -> Result<(), ConfigError> {
    outside.map_or(Ok(()), |number| Err(ConfigError::OutOfBounds { number, axis: Some(axis) }))
}

/// Checks a scheme by itself, and against the limits of the outer and the inner axis.
///
/// # Errors
/// The first number that is wrong.
pub fn check_motion(scheme: &Scheme, axes: &[AxisLimits; 2]) -> Result<(), ConfigError> {
    scheme.check().map_err(ConfigError::Scheme)?;
    for (axis, limits) in (0_u8..).zip(axes) {
        within_bounds(first_outside(&AXIS_BOUNDS, limits).map(BoundedNumber::Axis), axis)?;
        if scheme.rate_rad_s > limits.rate_rad_s || scheme.acceleration_rad_s2 > limits.acceleration_rad_s2 {
            return Err(ConfigError::TooFast(axis));
        }
        let angles = scheme.legs.iter().map(|to| if axis == 0 { to.outer_rad } else { to.inner_rad });
        for (leg, angle) in (0_u8..).zip(core::iter::once(0.0).chain(angles)) {
            if !limits.travel.permits(angle) {
                return Err(ConfigError::Travel { leg, axis });
            }
        }
    }
    let stops = core::iter::once(scheme.first_stop_s).chain(scheme.legs.iter().map(|leg| leg.stop_s));
    let short = (0_u8..).zip(stops).find(|(_, stop_s)| *stop_s < SHORTEST_STOP_S);
    short.map_or(Ok(()), |(leg, _)| Err(ConfigError::ShortStop(leg)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::method::Method;
    use crate::base::site::Site;
    use crate::base::units::DEG;
    use crate::estimator::HeadingSource;
    use crate::gimbal::{Travel, TurnSource};
    use crate::segment::white_noise::Noise;
    use std::string::ToString;

    fn config() -> SelfCalibrationConfig {
        let noise = Noise { accel_psd_sqrt: 1e-4, gyro_psd_sqrt: 3e-7, encoder_sigma_rad: 2.5e-6, margin: 1.0 };
        let calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
        SelfCalibrationConfig::new(calibrator, Scheme::bai(10.0, 1))
    }

    #[test]
    fn every_wrong_number_of_a_configuration_is_refused() {
        type Spoil = fn(&mut SelfCalibrationConfig);
        let axis = |row, axis| ConfigError::OutOfBounds { number: BoundedNumber::Axis(row), axis: Some(axis) };
        let motor = |row, axis| ConfigError::OutOfBounds { number: BoundedNumber::Motor(row), axis: Some(axis) };
        let both = |row, axis| ConfigError::OutOfBounds { number: BoundedNumber::AxisAndMotor(row), axis: Some(axis) };
        let wrong: [(Spoil, ConfigError); 43] = [
            (|config| config.motors[1].inertia_kg_m2 = 0.0, motor(0, 1)),
            (|config| config.motors[0].viscous_nm_s = f64::INFINITY, motor(2, 0)),
            (|config| config.motors[0].inductance_h = -1e-3, motor(5, 0)),
            (|config| config.motors[0].coulomb_nm = 0.57, both(0, 0)),
            (|config| config.motors[1].encoder_bits = 16, both(5, 1)),
            (|config| config.scheme.first_stop_s = 0.49, ConfigError::ShortStop(0)),
            (|config| config.scheme.legs[6].stop_s = 0.49, ConfigError::ShortStop(7)),
            (|config| config.calibrator.estimator.noise.margin = 0.5, ConfigError::Noise),
            (|config| config.pace.longest_s = Some(f64::NAN), ConfigError::Pace),
            (|config| config.policy = too_cold(), ConfigError::Policy),
            (|config| config.calibrator.rate_hz = f64::INFINITY, ConfigError::Rate),
            (|config| config.calibrator.rate_hz = 0.0, ConfigError::Rate),
            (|config| config.calibrator.estimator.noise.accel_psd_sqrt = 0.0, ConfigError::Noise),
            (|config| config.calibrator.estimator.noise.gyro_psd_sqrt = f64::NAN, ConfigError::Noise),
            (|config| config.calibrator.estimator.noise.encoder_sigma_rad = -1e-6, ConfigError::Noise),
            (|config| config.calibrator.estimator.tuning.initial_sigma_rad = 0.0, ConfigError::Noise),
            (|config| config.calibrator.estimator.tuning.walk_rad_sqrt_s = -1e-6, ConfigError::Noise),
            (|config| config.calibrator.estimator.heading = heading(f64::NAN, 0.1), ConfigError::Heading),
            (|config| config.calibrator.estimator.heading = heading(1.0, 0.0), ConfigError::Heading),
            (|config| config.calibrator.stillness.still_rad = f64::NAN, ConfigError::Stillness),
            (|config| config.calibrator.stillness.still_rad = 1.1 * DEG, ConfigError::Stillness),
            (|config| config.calibrator.estimator.gate_sigma = Some(-5.0), ConfigError::Stillness),
            (|config| config.calibrator.estimator.site.latitude_rad = f64::NAN, ConfigError::Site),
            (|config| config.calibrator.estimator.site.measured_gravity_m_s2 = Some(0.0), ConfigError::Site),
            (|config| config.calibrator.estimator.site.latitude_rad = 90.05 * DEG, ConfigError::Site),
            (|config| config.calibrator.estimator.site.height_m = 1e6, ConfigError::Site),
            (|config| config.calibrator.estimator.site.measured_gravity_m_s2 = Some(1.62), ConfigError::Site),
            (|config| config.calibrator.estimator.site_sigmas.latitude_rad = f64::NAN, ConfigError::Site),
            (|config| config.calibrator.estimator.noise.margin = f64::INFINITY, ConfigError::Noise),
            (|config| config.calibrator.estimator.noise.accel_psd_sqrt = 1e300, ConfigError::Noise),
            (|config| config.limits = config.limits.requiring(f64::NAN), ConfigError::Limits),
            (|config| config.limits.scale = f64::NAN, ConfigError::Limits),
            (|config| config.limits = config.limits.requiring(0.0), ConfigError::Limits),
            (|config| config.scheme.first_stop_s = 0.0, ConfigError::Scheme(SchemeError::Stop(0))),
            (|config| config.scheme.periods = 3, ConfigError::Segments),
            (|config| config.axes[0].arrived_rad = f64::NAN, axis(3, 0)),
            (|config| config.axes[1].rate_rad_s = f64::INFINITY, axis(0, 1)),
            (|config| config.axes[1].travel = stored(13.0, 12.0), axis(8, 1)),
            (|config| config.axes[1].rate_rad_s = 0.1, ConfigError::TooFast(1)),
            (|config| config.axes[0].acceleration_rad_s2 = 0.1, ConfigError::TooFast(0)),
            (|config| config.axes[0].travel = stored(-4.0, 12.0), ConfigError::Travel { leg: 3, axis: 0 }),
            (|config| config.axes[0].travel = stored(-12.0, -0.1), ConfigError::Travel { leg: 0, axis: 0 }),
            (|config| config.axes[0].rate_rad_s = 2.2, axis(0, 0)),
        ];
        assert_eq!(config().check(), Ok(()));
        for (number, (spoil, error)) in wrong.into_iter().enumerate() {
            let mut config = config();
            spoil(&mut config);
            assert_eq!(config.check(), Err(error), "number {number}");
        }
    }

    #[test]
    fn a_number_outside_its_bounds_is_named_with_axis_and_range() {
        let outside = |number, axis| ConfigError::OutOfBounds { number, axis }.to_string();
        assert_eq!(
            outside(BoundedNumber::Axis(2), Some(0)),
            "[config-bounds] the jerk of the outer axis must be from 1 to 1e6 deg/s^3"
        );
        assert_eq!(
            outside(BoundedNumber::Motor(0), Some(1)),
            "[config-bounds] the moment of inertia of the inner axis must be from 1e-5 to 1000 kg m^2"
        );
        assert_eq!(
            outside(BoundedNumber::AxisAndMotor(0), Some(1)),
            "[config-bounds] the acceleration of the motor at the highest rate of the inner axis must be at least 1.5 times \
             the highest acceleration"
        );
        assert_eq!(outside(BoundedNumber::Motor(99), None), "[config-bounds] a number is outside its bounds");
    }

    #[test]
    fn the_bounds_of_a_wrong_number_are_told() {
        assert_eq!(ConfigError::Rate.to_string(), "[config-rate] the sample rate must be from 50 to 10000 Hz");
        let noise = ConfigError::Noise.to_string();
        assert!(noise.contains("the velocity random walk must be from 1e-6 to 1e6 ug/sqrt(Hz), the angle"), "{noise}");
        let site = ConfigError::Site.to_string();
        assert!(site.contains("the latitude must be from -90 to 90 deg, the height must be"), "{site}");
    }

    fn stored(lowest_rad: f64, highest_rad: f64) -> Travel {
        Travel::around(lowest_rad, highest_rad, TurnSource::Stored)
    }

    fn too_cold() -> PowerUpPolicy {
        PowerUpPolicy::WhenDue { age_s: None, temperature_k: Some(-1.0) }
    }

    fn heading(heading_rad: f64, sigma_rad: f64) -> HeadingSource {
        HeadingSource::Configured { heading_rad, sigma_rad }
    }
}
