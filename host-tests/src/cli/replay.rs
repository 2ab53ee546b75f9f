//! `rins replay`

use super::arguments::hardware::HardwareArguments;
use super::arguments::log::LogArguments;
use super::arguments::method::ReplayMethod;
use super::ending::Ending;
use super::output::{is_quiet, must_sayln, note, say, sayln};
use super::{files, progress, separating};
use crate::base::quantity;
use crate::calibration::Precision;
use crate::calibration::replay::{Replay, config_beside};
use crate::files::json_file::write_json;
use crate::files::truth::Truth;
use crate::files::unit_file::{Origin, UnitConfig};
use crate::page::{Content, write_page};
use crate::result::report::CalibrationReport;
use crate::result::saved::Saved;
use crate::result::signals::Signals;
use crate::result::table;
use crate::separating::SeparatingMethod;
use anyhow::{Context, bail};
use clap::Args;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::PARAMETER_INFO;
use rins_selfcal::run::telemetry::Progress;
use rins_selfcal::segment::SegmentKind;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct ReplayArguments {
    #[command(flatten)]
    pub source: LogArguments,
    /// Unit description: site, noise, rate and known heading [default: unknown site, noise and hardware "navigation"]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// Estimation method
    #[arg(long, value_enum, default_value_t)]
    pub method: ReplayMethod,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    #[command(flatten)]
    pub hardware: HardwareArguments,
    /// If the verdict names an effect of the hardware that is larger than configured, solve once more with its size;
    /// the result is accepted only if everything else passes, and says so
    #[arg(long)]
    pub adapt: bool,
    /// Write the result to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Write the report to this file
    #[arg(long, value_name = "OUT.html")]
    pub report: Option<PathBuf>,
    /// Compare with the result of an earlier calibration, in the report
    #[arg(long, value_name = "CAL.json", requires = "report")]
    pub previous: Option<PathBuf>,
    /// Compare with the true parameters
    #[arg(long, value_name = "TRUTH.json")]
    pub truth: Option<PathBuf>,
    /// Write the live estimate after every segment to this file
    #[arg(long, value_name = "OUT.csv")]
    pub csv_estimates: Option<PathBuf>,
}

pub fn run(arguments: &ReplayArguments) -> anyhow::Result<Ending> {
    let log = arguments.source.log.as_path();
    let [log_input, mapping] = arguments.source.inputs();
    let inputs = [
        log_input,
        mapping,
        ("--config", arguments.config.as_deref()),
        ("--truth", arguments.truth.as_deref()),
        ("--previous", arguments.previous.as_deref()),
        arguments.hardware.input(),
    ];
    let outputs = [
        ("--json", arguments.json.as_deref()),
        ("--report", arguments.report.as_deref()),
        ("--csv-estimates", arguments.csv_estimates.as_deref()),
    ];
    files::check(&inputs, &outputs)?;
    let truth = arguments.truth.as_deref().map(Truth::read).transpose()?;
    let previous = arguments.previous.as_deref().map(Saved::read).transpose()?;
    let (unit, origin) = unit(arguments)?;
    let unit = arguments.hardware.apply(unit)?;
    let method = match arguments.method {
        ReplayMethod::Separating(method) => return separated(arguments, &unit, method),
        ReplayMethod::Chain(method) => method,
    };
    if method == Method::Bai && unit.site.latitude_deg.is_none() {
        bail!("--method bai needs the latitude: give latitude_deg in the table [site] of --config");
    }
    let replay = Replay {
        path: log.into(),
        layout: arguments.source.layout()?,
        unit,
        method,
        precision: arguments.precision,
        adapt: arguments.adapt,
    };
    if let (Some(config), Some([configured, measured])) = (&arguments.config, replay.other_rate_hz()?) {
        let (config, log) = (config.display(), log.display());
        let measured = (measured * 1e3).round() / 1e3;
        note!(
            "{config}: rate_hz = {configured}, but the time stamps of {log} give {measured} Hz; gaps are counted at {configured} Hz"
        );
    }
    let mut signals = Signals::default();
    let counter = progress::counter("rows");
    let outcome = replay.run(|rows| counter.set_position(rows), |reading| signals.note(reading))?;
    drop(counter);
    if let Some(path) = &arguments.csv_estimates {
        write_estimates(path, &outcome.live).with_context(|| path.display().to_string())?;
    }
    let source = match arguments.report {
        Some(_) => identity(log)?,
        None => String::new(),
    };
    let content = Content {
        outcome: &outcome,
        truth: truth.as_ref().map(|truth| &truth.parameters),
        signals: Some(&signals),
        scheme: None,
        source: &source,
        previous: previous.as_ref(),
    };
    report(&content, arguments.json.as_deref(), arguments.report.as_deref(), &replay.unit.described(&origin))
}

/// A replay with a separating method, which gives no verdict and no live estimates.
fn separated(arguments: &ReplayArguments, unit: &UnitConfig, method: SeparatingMethod) -> anyhow::Result<Ending> {
    let unavailable = [
        ("--report", arguments.report.is_some()),
        ("--csv-estimates", arguments.csv_estimates.is_some()),
        ("--adapt", arguments.adapt),
    ];
    if let Some((option, _)) = unavailable.iter().find(|(_, given)| *given) {
        bail!("{option} is not available with --method {}: it has no verdict and no live estimates", method.name());
    }
    let (truth, json) = (arguments.truth.as_deref(), arguments.json.as_deref());
    separating::replay(&separating::Files { source: &arguments.source, truth, json }, unit, method)
}

/// Name and SHA-256 hash of a log.
fn identity(log: &Path) -> anyhow::Result<String> {
    let context = || log.display().to_string();
    let (mut file, mut bytes) = (File::open(log).with_context(context)?, vec![0; 1 << 16]);
    let mut hash = Sha256::new();
    loop {
        match file.read(&mut bytes).with_context(context)? {
            0 => break,
            count => hash.update(&bytes[..count]),
        }
    }
    let digits: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(format!("{}, SHA-256 {digits}", log.display()))
}

/// Writes an outcome as JSON and as a page if files are given, and prints the outcome below `head`.
pub fn report(content: &Content, json: Option<&Path>, page: Option<&Path>, head: &str) -> anyhow::Result<Ending> {
    let (outcome, truth) = (content.outcome, content.truth);
    // The files come before the tables, so that they are complete even if the reader of the tables closes the pipe.
    if let Some(path) = json {
        write_json(path, &CalibrationReport::from(outcome))?;
    }
    if let Some(path) = page {
        write_page(path, content)?;
    }
    if is_quiet() {
        let reasons = table::folded(outcome.reasons());
        let verdict = std::iter::once(outcome.verdict_name().into()).chain(reasons).chain(table::adapted(outcome));
        let verdict: Vec<String> = verdict.collect();
        must_sayln!("{}", verdict.join("; "));
    }
    sayln!("{head}{}", table::samples(outcome));
    sayln!("{}", table::parameters(outcome, truth));
    say!("{}{}", table::effects(outcome), table::verdict(outcome));
    if let Some(path) = json {
        sayln!("result: {}", path.display());
    }
    if let Some(path) = page {
        sayln!("report: {}", path.display());
    }
    Ok(if outcome.is_in_use() { Ending::Done } else { Ending::NotAccepted })
}

fn unit(arguments: &ReplayArguments) -> anyhow::Result<(UnitConfig, Origin)> {
    if let Some(path) = &arguments.config {
        return Ok(UnitConfig::read_with_origin(path)?);
    }
    if let Some(beside) = config_beside(&arguments.source.log) {
        let beside = beside.display();
        note!("{beside} is not used; give it as --config {beside} if it describes this unit");
    }
    Ok(Default::default())
}

/// Live estimates and sigmas in report units, one row per segment.
fn write_estimates(path: &Path, segments: &[Progress]) -> csv::Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    let column = |suffix: &'static str| {
        PARAMETER_INFO.iter().map(move |info| format!("{}{suffix}_{}", info.name, info.unit.replace('/', "_")))
    };
    let first = ["time_s", "segment", "kind"].map(String::from);
    writer.write_record(first.into_iter().chain(column("")).chain(column("_sigma")))?;
    for progress in segments {
        let kind = if progress.kind == SegmentKind::Stop { "stop" } else { "move" };
        let values = quantity::values(&progress.estimate.errors);
        let sigmas = quantity::sigmas(&progress.estimate.sigmas);
        let time_s = format!("{:.6}", progress.end_us as f64 * 1e-6);
        let first = [time_s, (progress.segments - 1).to_string(), kind.into()];
        writer
            .write_record(first.into_iter().chain(values.iter().chain(&sigmas).map(|value| format!("{value:.9e}"))))?;
    }
    writer.flush()?;
    Ok(())
}
