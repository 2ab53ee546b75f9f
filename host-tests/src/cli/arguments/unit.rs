//! Description of the virtual unit.

use super::hardware::HardwareArguments;
use super::value::{number_in, of_option};
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::cli::files::NamedFile;
use crate::files::unit_file::{Origin, UnitConfig};
use crate::study::monte_carlo::ErrorSource;
use crate::virtual_unit::presets::noise_named;
use crate::virtual_unit::unit::{DEFAULT_RATE_HZ, VirtualUnit};
use clap::Args;
use rins_selfcal::scheme::Scheme;
use std::path::{Path, PathBuf};

/// Site and noise of a unit.
#[derive(Debug, Args)]
pub struct DescriptionArguments {
    /// Noise: bai, navigation, tactical, or a file [default: that of --config, or navigation]
    #[arg(long, value_name = "NAME|FILE")]
    noise: Option<String>,
    /// Site, noise and rate of the unit [default: Bai's site, noise "navigation", 200 Hz]
    #[arg(long, value_name = "UNIT.toml")]
    config: Option<PathBuf>,
    #[command(flatten)]
    hardware: HardwareArguments,
}

impl DescriptionArguments {
    /// The unit description from its file or by default, with noise and hardware replaced if they are given. Unless its
    /// file says where it is, the unit is at Bai's site.
    pub fn config(&self) -> anyhow::Result<UnitConfig> {
        let mut unit = self.config.as_ref().map_or_else(|| Ok(UnitConfig::default()), |path| UnitConfig::read(path))?;
        if let Some(noise) = &self.noise {
            unit.noise = of_option("--noise", noise_named(noise))?;
        }
        self.hardware.apply(unit.somewhere())
    }

    /// Site, noise and hardware of the unit that [`Self::config`] describes, each on a line with its origin.
    fn described(&self, unit: &UnitConfig) -> anyhow::Result<String> {
        let of_file = self.config.as_ref().map(|path| UnitConfig::read_with_origin(path)).transpose()?;
        let origin = of_file.map_or_else(Origin::default, |(_, origin)| origin);
        Ok(unit.described(&origin.with_noise(self.noise.as_deref())))
    }

    /// The input files.
    pub fn inputs(&self) -> [NamedFile<'_>; 3] {
        let noise = ("--noise", self.noise.as_deref().map(Path::new));
        [noise, ("--config", self.config.as_deref()), self.hardware.input()]
    }
}

/// Site, noise, rate and seed of a virtual unit.
#[derive(Debug, Args)]
pub struct VirtualArguments {
    #[command(flatten)]
    description: DescriptionArguments,
    /// Sample rate, Hz [default: that of --config, or 200]
    #[arg(long, value_name = "HZ", value_parser = rate, allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl VirtualArguments {
    /// The unit description, with the rate replaced if it is given.
    pub fn config(&self) -> anyhow::Result<UnitConfig> {
        let mut unit = self.description.config()?;
        unit.sampling.rate_hz = self.rate.or(unit.sampling.rate_hz);
        Ok(unit)
    }

    /// Site, noise and hardware of the unit, each on a line with its origin.
    pub fn described(&self, unit: &UnitConfig) -> anyhow::Result<String> {
        self.description.described(unit)
    }

    /// The input files of the unit and of its errors.
    pub fn inputs<'a>(&'a self, errors: &'a str) -> [NamedFile<'a>; 4] {
        let [noise, config, hardware] = self.description.inputs();
        [("--errors", Some(Path::new(errors))), noise, config, hardware]
    }
}

#[derive(Debug, Args)]
pub struct UnitArguments {
    /// Errors: table1, table3, real, typical, typical:0.5, random, random:1deg, random:tactical, a file, or keys in
    /// one line such as 'parameters.Sgxy = 30, effects.hunting_hz = 1.5'
    #[arg(long, value_name = "NAME|FILE|KEYS", default_value = "real")]
    errors: String,
    #[command(flatten)]
    of_unit: VirtualArguments,
}

impl UnitArguments {
    pub fn config(&self) -> anyhow::Result<UnitConfig> {
        self.of_unit.config()
    }

    /// Site, noise and hardware of the unit, each on a line with its origin.
    pub fn described(&self, unit: &UnitConfig) -> anyhow::Result<String> {
        self.of_unit.described(unit)
    }

    /// The input files that describe the unit.
    pub fn inputs(&self) -> [NamedFile<'_>; 4] {
        self.of_unit.inputs(&self.errors)
    }

    /// The unit that runs a scheme.
    pub fn run(&self, config: &UnitConfig, scheme: Scheme) -> anyhow::Result<VirtualRun> {
        let seed = self.of_unit.seed;
        let drawn = errors_named(&self.errors)?.draw(derived_seed(seed, 0, Stream::Errors));
        let unit = VirtualUnit {
            errors: drawn.errors,
            effects: drawn.effects,
            site: config.site(),
            noise: config.noise,
            rate_hz: rate_hz(config),
        };
        Ok(VirtualRun { unit, scheme, seed: derived_seed(seed, 0, Stream::Noise) })
    }
}

/// Errors by name or from a file.
pub fn errors_named(name: &str) -> anyhow::Result<ErrorSource> {
    of_option("--errors", ErrorSource::named(name))
}

/// Sample rate of a virtual unit, Hz.
pub fn rate_hz(unit: &UnitConfig) -> f64 {
    unit.sampling.rate_hz.unwrap_or(DEFAULT_RATE_HZ)
}

fn rate(text: &str) -> Result<f64, String> {
    number_in(text, 10.0, 10_000.0)
}
