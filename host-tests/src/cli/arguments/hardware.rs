//! Imperfections of the hardware.

use super::value::of_option;
use crate::cli::files::NamedFile;
use crate::files::hardware::{HardwareTable, hardware_named};
use crate::files::unit_file::UnitConfig;
use clap::Args;
use std::path::Path;

/// Imperfections of the hardware.
#[derive(Debug, Args)]
pub struct HardwareArguments {
    /// Imperfections of the hardware: ideal, navigation, tactical, mems, a file, or keys in one line such as
    /// 'profile = "ideal", accel_floor_ug = 2.0' [default: those of --config, or navigation]
    #[arg(long, value_name = "NAME|FILE|KEYS")]
    hardware: Option<String>,
}

impl HardwareArguments {
    /// The unit with the hardware replaced if it is given.
    pub fn apply(&self, unit: UnitConfig) -> anyhow::Result<UnitConfig> {
        let Some(name) = &self.hardware else { return Ok(unit) };
        Ok(UnitConfig { hardware: HardwareTable(of_option("--hardware", hardware_named(name))?), ..unit })
    }

    /// The hardware as an input file, because its name may be the path of a file.
    pub fn input(&self) -> NamedFile<'_> {
        ("--hardware", self.hardware.as_deref().map(Path::new))
    }
}
