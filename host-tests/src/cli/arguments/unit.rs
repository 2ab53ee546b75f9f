//! Description of the virtual unit.

use super::value::{number_in, of_option};
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::cli::files::NamedFile;
use crate::files::unit_file::UnitConfig;
use crate::study::monte_carlo::ErrorSource;
use crate::virtual_unit::presets::noise_named;
use crate::virtual_unit::unit::{DEFAULT_RATE_HZ, VirtualUnit};
use clap::Args;
use rins_selfcal::scheme::Scheme;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct UnitArguments {
    /// Errors: table1, table3, real, random, random:1deg, random:tactical, a file, or the content of a file in one line
    #[arg(long, value_name = "NAME|FILE", default_value = "real")]
    errors: String,
    /// Noise: bai, navigation, tactical, or a file [default: that of --config, or navigation]
    #[arg(long, value_name = "NAME|FILE")]
    noise: Option<String>,
    /// Site, noise and rate of the unit
    #[arg(long, value_name = "UNIT.toml")]
    config: Option<PathBuf>,
    /// Sample rate, Hz [default: that of --config, or 200]
    #[arg(long, value_name = "HZ", value_parser = rate, allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl UnitArguments {
    pub fn config(&self) -> anyhow::Result<UnitConfig> {
        unit_config(self.config.as_ref(), self.noise.as_deref(), self.rate)
    }

    /// The input files that describe the unit.
    pub fn inputs(&self) -> [NamedFile<'_>; 3] {
        unit_inputs(&self.errors, self.noise.as_deref(), self.config.as_deref())
    }

    /// The unit that runs a scheme.
    pub fn run(&self, config: &UnitConfig, scheme: Scheme) -> anyhow::Result<VirtualRun> {
        let drawn = errors(&self.errors)?.draw(derived_seed(self.seed, 0, Stream::Errors));
        let unit = VirtualUnit {
            errors: drawn.errors,
            effects: drawn.effects,
            site: config.site(),
            noise: config.noise,
            rate_hz: rate_hz(config),
        };
        Ok(VirtualRun { unit, scheme, seed: derived_seed(self.seed, 0, Stream::Noise) })
    }
}

/// Errors by name or from a file.
pub fn errors(name: &str) -> anyhow::Result<ErrorSource> {
    of_option("--errors", ErrorSource::named(name))
}

/// The input files that may describe a unit.
pub fn unit_inputs<'a>(errors: &'a str, noise: Option<&'a str>, config: Option<&'a Path>) -> [NamedFile<'a>; 3] {
    [("--errors", Some(Path::new(errors))), ("--noise", noise.map(Path::new)), ("--config", config)]
}

/// Unit description from a file or by default, with the noise and the rate replaced if they are given.
pub fn unit_config(config: Option<&PathBuf>, noise: Option<&str>, rate_hz: Option<f64>) -> anyhow::Result<UnitConfig> {
    let mut unit = config.map_or_else(|| Ok(UnitConfig::default()), |path| UnitConfig::read(path))?;
    if let Some(noise) = noise {
        unit.noise = of_option("--noise", noise_named(noise))?;
    }
    unit.sampling.rate_hz = rate_hz.or(unit.sampling.rate_hz);
    Ok(unit)
}

/// Sample rate of a virtual unit, Hz.
pub fn rate_hz(unit: &UnitConfig) -> f64 {
    unit.sampling.rate_hz.unwrap_or(DEFAULT_RATE_HZ)
}

pub fn rate(text: &str) -> Result<f64, String> {
    number_in(text, 10.0, 10_000.0)
}
