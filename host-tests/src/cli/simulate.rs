//! `rins simulate`

use super::arguments::axes::AxisArguments;
use super::arguments::scheme::SchemeArguments;
use super::arguments::unit::UnitArguments;
use super::ending::Ending;
use super::output::sayln;
use super::{files, progress};
use crate::calibration::refusal::check_axes;
use crate::calibration::virtual_run::VirtualRun;
use crate::files::truth::Truth;
use crate::files::unit_file::UnitConfig;
use crate::log::LogWriter;
use anyhow::Context;
use clap::Args;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::InstrumentErrors;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct SimulateArguments {
    /// Log to write, compressed with gzip if the name ends in .gz
    #[arg(long, value_name = "LOG.csv")]
    pub out: PathBuf,
    /// Write the true parameters to this file
    #[arg(long, value_name = "TRUTH.json")]
    pub truth: Option<PathBuf>,
    /// Write the unit description for `replay --config` to this file
    #[arg(long, value_name = "UNIT.toml")]
    pub write_config: Option<PathBuf>,
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub unit: UnitArguments,
}

/// Samples between two updates of the progress bar.
const TICK: u64 = 10_000;

pub fn run(arguments: &SimulateArguments) -> anyhow::Result<Ending> {
    let [errors, noise, config, hardware] = arguments.unit.inputs();
    let outputs = [
        ("--out", Some(arguments.out.as_path())),
        ("--truth", arguments.truth.as_deref()),
        ("--write-config", arguments.write_config.as_deref()),
    ];
    files::check(&[arguments.scheme.input(), errors, noise, config, hardware], &outputs)?;
    let config = arguments.unit.config()?;
    let scheme = arguments.scheme.scheme(Method::Joint)?;
    check_axes(&scheme, &arguments.axes.axes())?;
    let run = arguments.unit.run(&config, scheme)?;
    let (samples, errors) = write_log(&run, &arguments.out)?;
    if let Some(path) = &arguments.truth {
        Truth::new(&errors).write(path)?;
    }
    if let Some(path) = &arguments.write_config {
        write_config(path, &config)?;
    }
    sayln!("{}: {samples} samples, {:.1} s of scheme {}", arguments.out.display(), run.duration_s(), run.scheme.name);
    Ok(Ending::Done)
}

/// Returns the number of samples, and the errors at the end of the log.
fn write_log(run: &VirtualRun, path: &Path) -> anyhow::Result<(u64, InstrumentErrors<f64>)> {
    let mut drive = run.drive();
    let samples = drive.total_samples();
    let bar = progress::bar(samples, "samples");
    let mut writer = LogWriter::create(path, run.unit.effects.temperature_c.is_some())?;
    for (number, reading) in (1..).zip(drive.by_ref()) {
        writer.write(&reading)?;
        if number % TICK == 0 {
            bar.set_position(number);
        }
    }
    drop(bar);
    writer.finish()?;
    Ok((samples, drive.rins().errors_now()))
}

fn write_config(path: &Path, config: &UnitConfig) -> anyhow::Result<()> {
    let name = || path.display().to_string();
    let text = toml::to_string(config).with_context(name)?;
    std::fs::write(path, text).with_context(name)
}
