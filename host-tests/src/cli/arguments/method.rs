//! Estimation method and its options.

use super::unit::rate_hz;
use crate::calibration::{Precision, Setup};
use crate::files::unit_file::UnitConfig;
use clap::{Args, ValueEnum};
use rins_selfcal::base::method::Method;

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
}

impl MethodArguments {
    pub fn method(&self) -> Method {
        match self.method {
            MethodArgument::Joint => Method::Joint,
            MethodArgument::TwoStage => Method::TwoStage,
        }
    }

    pub fn setup(&self, unit: &UnitConfig) -> Setup {
        Setup::new(unit, rate_hz(unit), self.method(), self.precision)
    }
}
