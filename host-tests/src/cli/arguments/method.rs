//! Estimation method and its options.

use super::unit::rate_hz;
use crate::calibration::{HostMethod, Precision, Setup};
use crate::files::unit_file::UnitConfig;
use clap::Args;

#[derive(Debug, Args)]
pub struct MethodArguments {
    /// Estimation method
    #[arg(long, value_enum, default_value_t)]
    pub method: HostMethod,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
}

impl MethodArguments {
    pub fn setup(&self, unit: &UnitConfig) -> Setup {
        Setup::new(unit, rate_hz(unit), self.method, self.precision)
    }
}
