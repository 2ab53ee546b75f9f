//! `rins replicate`: repeats the studies of the paper. Each study has a command that repeats it alone.

use super::arguments::scheme::seconds;
use super::ending::Ending;
use super::files;
use super::monte_carlo::{self, MonteCarloArguments, Report};
use super::observability::{self, ObservabilityArguments};
use super::output::{say, sayln};
use super::progress::{self, Progress};
use super::replay::ReplayArguments;
use super::simulate::SimulateArguments;
use crate::base::bai::{TABLE_1_ERRORS, TABLE_3_DIFFERENCES, Twelve};
use crate::base::quantity::significant;
use crate::calibration::Setup;
use crate::files::json_file::write_json;
use crate::page::write_replication;
use crate::plan::prediction::Prediction;
use crate::result::report::{Named, ParameterReport, SOFTWARE, Software, parameters};
use crate::result::table;
use crate::study::monte_carlo::MonteCarlo;
use crate::study::replication::{Foresight, Replication, ShownRun, Study};
use crate::virtual_unit::presets::{
    Listed, REAL_ACCEL_BIAS, REAL_ACCEL_SCALE, REAL_AXES, REAL_BASE, REAL_GYRO_BIAS, REAL_GYRO_SCALE,
};
use anyhow::{Context, bail};
use clap::{Args, FromArgMatches};
use rayon::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETER_INFO};
use rins_selfcal::run::telemetry::Progress as Segmented;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug, Args)]
pub struct ReplicateArguments {
    /// Write the page to this file
    #[arg(long, value_name = "OUT.html", default_value = "rins-replication.html")]
    pub report: PathBuf,
    /// Write the numbers to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Runs of each study of a whole unit; each study of a single effect has at most 4 runs
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(2..))]
    pub runs: u64,
    /// Duration of every stop, s; 200 s in the paper
    #[arg(long, value_name = "S", default_value_t = 200.0, value_parser = seconds, allow_negative_numbers = true)]
    pub stop: f64,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Runs of each study of a single effect. The mean of so many runs is enough to tell the effect from the noise.
const IGNORED_RUNS: u64 = 4;
/// Errors of a study.
#[derive(Clone, Copy)]
enum Errors {
    /// Name of a set of errors, or the content of an error file in one line.
    Of(&'static str),
    /// These parameters of the unit `real`, and further parameters as text.
    Only(&'static Listed, &'static str),
}

impl fmt::Display for Errors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Of(errors) => f.write_str(errors),
            Self::Only(parameters, more) => {
                let parameters: Vec<_> = parameters.iter().map(|(name, value)| format!("{name} = {value:?}")).collect();
                write!(f, "parameters = {{ {}{more} }}", parameters.join(", "))
            }
        }
    }
}

/// The studies: name, title, errors, and the imperfections that the joint method expects.
const STUDIES: [(&str, &str, Errors, &str); 14] = [
    ("table1", "the unit of Table 1", Errors::Of("table1"), ""),
    ("table3", "the twelve errors of Table 3, all other errors zero", Errors::Of("table3"), ""),
    ("real", "the twelve errors of Table 3, and all other errors of a real unit", Errors::Of("real"), ""),
    ("nothing", "no errors, noise only", Errors::Of("parameters = {}"), ""),
    ("accel-bias", "accelerometer biases of 30 ug", Errors::Only(REAL_ACCEL_BIAS, ""), ""),
    ("accel-scale", "accelerometer scale factors off by 100 ppm", Errors::Only(REAL_ACCEL_SCALE, ""), ""),
    ("gyro-bias", "gyro biases of 0.005 deg/h", Errors::Only(REAL_GYRO_BIAS, ""), ""),
    ("gyro-scale", "gyro scale factors off by 20 ppm", Errors::Only(REAL_GYRO_SCALE, ""), ""),
    ("axes", "rotation axes with a non-perpendicularity of 4 arcsec", Errors::Only(REAL_AXES, ""), ""),
    ("attitude", "base tilted by 1.7 and -2.3 deg, heading 137 deg", Errors::Only(REAL_BASE, ", heading = 137.0"), ""),
    (
        "eccentricity",
        "encoder eccentricity of 2 arcsec",
        Errors::Of(
            "effects.hardware.encoder_harmonics_arcsec = [[[0.0, 2.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]], [[0.0, 2.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]]",
        ),
        "encoder_harmonic_1_arcsec = 2.0",
    ),
    (
        "second-harmonic",
        "second harmonic of the encoders of 2 arcsec",
        Errors::Of(
            "effects.hardware.encoder_harmonics_arcsec = [[[0.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 0.0]]]",
        ),
        "encoder_harmonic_2_arcsec = 2.0",
    ),
    (
        "tilt-drift",
        "base that tilts by 2 arcsec/h",
        Errors::Of("effects.base_tilt_drift_arcsec_h = [2.0, 2.0]"),
        "base_drift_arcsec_h = 2.0",
    ),
    (
        "bias-ramp",
        "accelerometer biases that drift by 1 ug/h",
        Errors::Of("effects.accel_bias_ramp_ug_h = [1.0, 1.0, 1.0]"),
        "accel_warm_up_ug = 1.0",
    ),
];
/// Number of studies, from the first one, that have all runs.
const FULL_STUDIES: usize = 3;
/// Options of `rins observability` for the schemes that are compared with the joint method.
const SCHEMES: [&str; 6] = [
    "--scheme bai",
    "--scheme bai --stop 20",
    "--scheme bai --stop 10",
    "--scheme fast-300",
    "--scheme fast-180",
    "--scheme fast-60",
];

pub fn run(arguments: &ReplicateArguments) -> anyhow::Result<Ending> {
    let outputs = [("--json", arguments.json.as_deref()), ("--report", Some(arguments.report.as_path()))];
    files::check(&[], &outputs)?;
    let studies: Vec<_> = studies(arguments)?;
    let bar = progress::bar(studies.iter().map(|study| study.monte_carlo.runs).sum(), "runs");
    let started = Instant::now();
    let found = replicate(arguments, &studies, &bar)?;
    drop(bar);
    if let Some(path) = &arguments.json {
        write_json(path, &json(&found, &studies))?;
    }
    write_replication(&arguments.report, &found)?;
    say!("{}", text(&found));
    sayln!("report: {}", arguments.report.display());
    if let Some(path) = &arguments.json {
        sayln!("numbers: {}", path.display());
    }
    progress::wall_time(started.elapsed());
    Ok(Ending::Done)
}

/// A study, and the command that repeats it.
struct Planned {
    name: &'static str,
    title: &'static str,
    command: String,
    arguments: MonteCarloArguments,
    monte_carlo: MonteCarlo,
}

fn studies(arguments: &ReplicateArguments) -> anyhow::Result<Vec<Planned>> {
    let planned = |(number, (name, title, errors, effects)): (usize, &(&'static str, &'static str, Errors, &str))| {
        let runs = if number < FULL_STUDIES { arguments.runs } else { arguments.runs.min(IGNORED_RUNS) };
        let (runs, motion, seed) = (runs.to_string(), motion(arguments), arguments.seed.to_string());
        let mut words = vec!["montecarlo", "--runs", &runs, "--method", "joint,bai", "--scheme", "bai"];
        words.extend(motion.iter().map(String::as_str));
        let errors = errors.to_string();
        words.extend(["--errors", &errors, "--noise", "bai", "--seed", &seed]);
        let hardware = if effects.is_empty() { "ideal".into() } else { format!("profile = \"ideal\", {effects}") };
        words.extend(["--hardware", &hardware]);
        let parsed: MonteCarloArguments = parsed(&words)?;
        let monte_carlo = monte_carlo::monte_carlo(&parsed)?;
        Ok(Planned { name, title, command: command_line(&words), arguments: parsed, monte_carlo })
    };
    STUDIES.iter().enumerate().map(planned).collect()
}

/// The command that repeats this replication and writes the numbers to a file.
fn own_command(ReplicateArguments { runs, stop, seed, .. }: &ReplicateArguments) -> String {
    format!("rins replicate --runs {runs} --stop {stop} --seed {seed} --json replication.json")
}

/// Options for stop duration and number of periods.
fn motion(arguments: &ReplicateArguments) -> Vec<String> {
    ["--stop", &arguments.stop.to_string(), "--periods", "2"].map(String::from).to_vec()
}

/// Parses the arguments of a command; the first word is the name of the command.
fn parsed<A: Args + FromArgMatches>(words: &[&str]) -> anyhow::Result<A> {
    let matches = A::augment_args(clap::Command::new("rins")).try_get_matches_from(words);
    A::from_arg_matches(&matches.with_context(|| words.join(" "))?).with_context(|| words.join(" "))
}

/// Command line with the quotes that a shell needs.
fn command_line(words: &[&str]) -> String {
    let plain = |word: &str| word.chars().all(|letter| letter.is_ascii_alphanumeric() || "-._/=,".contains(letter));
    let quoted = words.iter().map(|word| if plain(word) { (*word).to_string() } else { format!("'{word}'") });
    std::iter::once("rins".to_string()).chain(quoted).collect::<Vec<_>>().join(" ")
}

fn replicate(arguments: &ReplicateArguments, studies: &[Planned], bar: &Progress) -> anyhow::Result<Replication> {
    let results: Vec<Study> = studies.par_iter().map(|planned| study(planned, bar)).collect::<anyhow::Result<_>>()?;
    let mut results = results.into_iter();
    let mut next = || results.next().context("one result for each study");
    let (table_1, table_3, real) = (next()?, next()?, next()?);
    let [of_table_1, of_table_3, of_real, ..] = studies else { bail!("no studies") };
    let setup = of_table_1.monte_carlo.setup(Method::Bai).on_scheme(&of_table_1.monte_carlo.scheme);
    let series = |planned: &Planned, errors| {
        let commands = series_commands(arguments, errors)?;
        ShownRun::new(commands, &planned.monte_carlo.virtual_run(0), &setup).with_context(|| planned.command.clone())
    };
    let (simulation, (twelve, laboratory)) = rayon::join(
        || series(of_table_1, "table1"),
        || rayon::join(|| series(of_table_3, "table3"), || series(of_real, "real")),
    );
    let stop = arguments.stop.to_string();
    Ok(Replication {
        command: own_command(arguments),
        scheme: of_table_1.monte_carlo.scheme.clone(),
        setup: setup.clone(),
        observability: foresight(&["--scheme", "bai", "--stop", &stop, "--method", "bai"])?,
        simulation: simulation?,
        twelve: twelve?,
        laboratory: laboratory?,
        table_1,
        table_3,
        real,
        ignored: results.collect(),
        schemes: SCHEMES
            .par_iter()
            .map(|words| foresight(&words.split(' ').collect::<Vec<_>>()))
            .collect::<anyhow::Result<_>>()?,
    })
}

fn study(planned: &Planned, bar: &Progress) -> anyhow::Result<Study> {
    let methods = planned.monte_carlo.run(|_| bar.inc(1)).with_context(|| planned.command.clone())?;
    let Ok(methods) = methods.try_into() else { bail!("{}: not two methods", planned.command) };
    Ok(Study { name: planned.name, title: planned.title, command: planned.command.clone(), methods })
}

/// The commands that simulate the same readings as a log, replay the log with a report, and separate the angles.
fn series_commands(arguments: &ReplicateArguments, errors: &str) -> anyhow::Result<Vec<String>> {
    let (motion, seed) = (motion(arguments), arguments.seed.to_string());
    let motion: Vec<&str> = motion.iter().map(AsRef::as_ref).collect();
    let unit =
        ["--errors", errors, "--noise", "bai", "--seed", &seed, "--out", "log.csv", "--write-config", "unit.toml"];
    let simulate = [&["simulate", "--scheme", "bai"][..], &motion, &unit].concat();
    let replay = ["replay", "log.csv", "--config", "unit.toml", "--method", "bai", "--report", "report.html"];
    let separate = ["replay", "log.csv", "--config", "unit.toml", "--method", "separating"];
    let _: (SimulateArguments, ReplayArguments) = (parsed(&simulate)?, parsed(&replay)?);
    let _: ReplayArguments = parsed(&separate)?;
    Ok(vec![command_line(&simulate), command_line(&replay), command_line(&separate)])
}

fn foresight(words: &[&str]) -> anyhow::Result<Foresight> {
    let words = [&["observability"], words, &["--noise", "bai"]].concat();
    let arguments: ObservabilityArguments = parsed(&words)?;
    let (setup, scheme): (Setup, _) = observability::inputs(&arguments)?;
    Ok(Foresight { prediction: Prediction::new(&setup, &scheme), command: command_line(&words) })
}

// ------------------------------------------------------------------------------------------------------------- results

/// Contents of the JSON file.
#[derive(Serialize)]
struct Numbers<'a> {
    studies: Named<StudyReport<'a>>,
    observability: &'a Prediction,
    schemes: Vec<&'a Prediction>,
    estimates: Named<Vec<EstimateReport>>,
    software: Software,
}

#[derive(Serialize)]
struct StudyReport<'a> {
    command: &'a str,
    #[serde(flatten)]
    report: Report<'a>,
}

/// The estimate from all segments up to this one, as the figure shows it.
#[derive(Serialize)]
struct EstimateReport {
    segment: u16,
    time_s: f64,
    parameters: Named<ParameterReport>,
}

fn estimates(series: &ShownRun) -> Vec<EstimateReport> {
    let report = |progress: &Segmented| EstimateReport {
        segment: progress.segments - 1,
        time_s: progress.end_us as f64 * 1e-6,
        parameters: parameters(&progress.estimate, series.outcome.setup.method),
    };
    series.outcome.live.iter().map(report).collect()
}

fn json<'a>(found: &'a Replication, studies: &'a [Planned]) -> Numbers<'a> {
    let results = [&found.table_1, &found.table_3, &found.real].into_iter().chain(&found.ignored);
    let report = |(planned, study): (&'a Planned, &'a Study)| {
        let report = Report::new(&planned.arguments, &planned.monte_carlo, &study.methods);
        (study.name, StudyReport { command: &study.command, report })
    };
    Numbers {
        studies: Named(studies.iter().zip(results).map(report).collect()),
        observability: &found.observability.prediction,
        schemes: found.schemes.iter().map(|scheme| &scheme.prediction).collect(),
        estimates: Named(vec![
            ("simulation", estimates(&found.simulation)),
            ("laboratory", estimates(&found.laboratory)),
        ]),
        software: SOFTWARE,
    }
}

fn text(found: &Replication) -> String {
    let row = |index: usize| {
        let rms = |study: &Study, method| {
            table::number_or_none(study.installation(method, index).map(|errors| errors.rms_error), significant)
        };
        let published = |table: &Twelve| format!("{:.3}", table[index]);
        vec![
            PARAMETER_INFO[index].name.into(),
            published(&TABLE_1_ERRORS),
            rms(&found.table_1, Method::Bai),
            rms(&found.table_1, Method::Joint),
            published(&TABLE_3_DIFFERENCES),
            rms(&found.table_3, Method::Bai),
            rms(&found.real, Method::Bai),
            rms(&found.real, Method::Joint),
        ]
    };
    let columns = ["arcsec", "Bai Table 1", "bai RMS", "joint RMS", "Bai Table 3", "bai RMS", "real unit", "joint RMS"];
    table::of_numbers(&columns, (0..INSTALLATION_STATES).map(row))
}
