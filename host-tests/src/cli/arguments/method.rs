//! Estimation method and its options.

use super::unit::rate_hz;
use super::value::number_in;
use crate::calibration::{Precision, Setup};
use crate::files::unit_file::UnitConfig;
use clap::{Args, ValueEnum};
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{DEG_H, MICRO_G};
use rins_selfcal::model::options::Options;

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum MethodArgument {
    /// All 28 parameters at once
    #[default]
    Joint,
    /// Bai's method: the twelve installation errors
    TwoStage,
}

#[derive(Debug, Args)]
pub struct MethodArguments {
    /// Estimation method
    #[arg(long, value_enum, default_value_t)]
    method: MethodArgument,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    #[command(flatten)]
    pub options: OptionArguments,
}

impl MethodArguments {
    pub fn method(&self) -> Method {
        match self.method {
            MethodArgument::Joint => Method::Joint,
            MethodArgument::TwoStage => Method::TwoStage,
        }
    }
}

/// Effects beyond the 28 parameters.
#[derive(Debug, Args)]
pub struct OptionArguments {
    /// Further effects that the joint method estimates, separated by commas
    #[arg(long, value_enum, value_name = "EFFECT", value_delimiter = ',')]
    effects: Vec<Effect>,
    /// Random walk of the gyro biases in the filter model, (deg/h)/sqrt(h)
    #[arg(long, value_name = "SIZE", default_value_t = 0.0, value_parser = walk, allow_negative_numbers = true)]
    gyro_bias_walk: f64,
    /// Random walk of the accelerometer biases in the filter model, ug/sqrt(h)
    #[arg(long, value_name = "SIZE", default_value_t = 0.0, value_parser = walk, allow_negative_numbers = true)]
    accel_bias_walk: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Effect {
    /// Ramps of all biases
    BiasRamp,
    /// First harmonic of the encoder errors
    Eccentricity,
    /// Second harmonic of the encoder errors
    SecondHarmonic,
    /// Base tilt that drifts at a constant rate
    TiltDrift,
}

impl OptionArguments {
    pub fn options(&self) -> Options {
        const SQRT_HOUR: f64 = 60.0;
        let on = |effect| self.effects.contains(&effect);
        Options {
            bias_ramp: on(Effect::BiasRamp),
            gyro_bias_walk: self.gyro_bias_walk * DEG_H / SQRT_HOUR,
            accel_bias_walk: self.accel_bias_walk * MICRO_G / SQRT_HOUR,
            encoder_eccentricity: on(Effect::Eccentricity),
            encoder_second_harmonic: on(Effect::SecondHarmonic),
            base_tilt_drift: on(Effect::TiltDrift),
        }
    }
}

impl MethodArguments {
    pub fn setup(&self, unit: &UnitConfig) -> Setup {
        let options = self.options.options();
        Setup { options, ..Setup::new(unit, rate_hz(unit), self.method(), self.precision) }
    }
}

fn walk(text: &str) -> Result<f64, String> {
    number_in(text, 0.0, 1e6)
}
