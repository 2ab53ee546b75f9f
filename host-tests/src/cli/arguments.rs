//! The command line.

use super::files::Named;
use super::guide::GuideArguments;
use super::history::HistoryArguments;
use super::monitor::MonitorArguments;
use crate::bench::Imu;
use crate::calibration::virtual_run::{Stream, VirtualRun, derived_seed};
use crate::calibration::{Precision, Setup};
use crate::files::scheme_file::scheme_named;
use crate::files::toml_file::TomlFileError;
use crate::files::unit_file::UnitConfig;
use crate::plan::objective::{Criterion, Objective};
use crate::plan::{PlanRequest, Travel};
use crate::study::closed_loop::Terms;
use crate::study::monte_carlo::ErrorSource;
use crate::virtual_unit::presets::noise_named;
use crate::virtual_unit::unit::{DEFAULT_RATE_HZ, VirtualUnit};
use anyhow::Context;
use clap::{Args, Parser, Subcommand, ValueEnum};
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G};
use rins_selfcal::estimator::rehearsal::Turning;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::model::options::Options;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::sequencer::Pace;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::VerdictLimits;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Self-calibration of a dual-axis rotational INS.
///
/// Without a command: `calibrate`. Exit status: 0 accepted or done, 1 error, 2 calibration not accepted.
#[derive(Debug, Parser)]
#[command(name = "rins", version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    /// Say how it ends, and nothing else: no progress, tables or notes
    #[arg(long, short, global = true)]
    pub quiet: bool,
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub calibrate: CalibrateArguments,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// A virtual RINS powers up and calibrates itself, closed loop
    #[command(
        after_help = "Examples:\n  rins calibrate --scheme fast-60 --seed 3\n  rins calibrate --firmware --eeprom eeprom.bin\n  rins calibrate --errors random --noise tactical --json cal.json --report page.html"
    )]
    Calibrate(CalibrateArguments),
    /// Write the log of a virtual RINS on a scheme, and the truth about it
    #[command(after_help = "Example: rins simulate --out log.csv --truth truth.json --write-config unit.toml")]
    Simulate(SimulateArguments),
    /// Calibrate from a log
    #[command(
        after_help = "Examples:\n  rins replay log.csv.gz --config unit.toml --json cal.json\n  rins replay flight.parquet --mapping map.toml --config unit.toml"
    )]
    Replay(ReplayArguments),
    /// Say what a log is: columns, rate, gaps, noise, stops and moves, scheme, what is observable
    ///
    /// Columns of any names and units are recognized by what they show while the axes turn; the mapping that is proposed
    /// is good for `replay` and `apply`.
    #[command(
        after_help = "Examples:\n  rins inspect log.csv\n  rins inspect foreign.csv --write-mapping map.toml --write-config unit.toml\n  rins replay foreign.csv --mapping map.toml --config unit.toml"
    )]
    Inspect(InspectArguments),
    /// Correct a log by a result
    #[command(after_help = "Example: rins apply log.csv --calibration cal.json --out corrected.csv")]
    Apply(ApplyArguments),
    /// Say what changed between two results, in sigmas; status 2 if more than chance
    #[command(after_help = "Example: rins compare before.json after.json")]
    Compare(CompareArguments),
    /// Predict sigmas, rank and condition number of a scheme
    #[command(
        after_help = "Examples:\n  rins observability --all\n  rins observability --scheme bai --stop 10 --noise tactical\n  rins observability --scheme mine.toml --config unit.toml --plot sigmas.svg"
    )]
    Observability(ObservabilityArguments),
    /// Find a scheme for the time given; one to two minutes by default
    #[command(
        after_help = "Examples:\n  rins plan --time 120 --out mine.toml\n  rins plan --time 90 --limits=-180..180,-90..90 --axis-rate 30 --out mine.toml\n  rins plan --time 60 --weights gyro_scale_z,gamma=3 --angles 45 --out mine.toml"
    )]
    Plan(PlanArguments),
    /// Calibrate many virtual units: errors against bounds, sigmas against errors
    #[command(
        after_help = "Examples:\n  rins montecarlo --runs 1000 --scheme fast-120 --closed-loop\n  rins montecarlo --method two-stage --errors table1 --noise bai"
    )]
    Montecarlo(MonteCarloArguments),
    /// Repeat what Bai et al. publish, and lay it beside theirs on a page; one to two minutes
    #[command(after_help = "Example: rins replicate --report replication.html --json replication.json")]
    Replicate(ReplicateArguments),
    /// Show an instrument on a serial line live, and command it
    #[command(
        after_help = "Examples:\n  rins monitor --port /dev/ttyACM0\n  rins monitor --port /dev/ttyACM0 --start --quiet\n  rins monitor --port tcp:10.0.0.7:4000 --read calibration --json cal.json"
    )]
    Monitor(MonitorArguments),
    /// Show the calibrations that an instrument keeps, from an image of its memory
    #[command(after_help = "Example: rins history eeprom.bin --json history.json")]
    History(HistoryArguments),
    /// Print a chapter of the guide, or the list of chapters
    #[command(after_help = "Examples:\n  rins guide\n  rins guide tutorial")]
    Guide(GuideArguments),
    /// Print the completions of a shell
    #[command(after_help = "Example: rins completions bash > ~/.local/share/bash-completion/completions/rins")]
    Completions(CompletionsArguments),
    /// Print the manual page
    #[command(after_help = "Example: rins man > ~/.local/share/man/man1/rins.1")]
    Man,
}

#[derive(Debug, Args)]
pub struct CalibrateArguments {
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub unit: UnitArguments,
    #[command(flatten)]
    pub method: MethodArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub terms: TermsArguments,
    /// Interface of the IMU; how good it is, --noise says
    #[arg(long, value_enum, default_value_t)]
    pub imu: Imu,
    /// Run the firmware in the emulator, twice: calibrate, then find the stored calibration
    #[arg(long)]
    pub firmware: bool,
    /// Content of the firmware's EEPROM, kept from run to run [default: blank]
    #[arg(long, value_name = "FILE", requires = "firmware")]
    pub eeprom: Option<PathBuf>,
    /// Run the firmware in real time until interrupted, its serial line at this Unix socket, for `rins monitor --port SOCKET`
    #[arg(long, value_name = "SOCKET", requires = "firmware")]
    pub serial: Option<PathBuf>,
    /// Write the result
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Write the report
    #[arg(long, value_name = "OUT.html", default_value = "rins-report.html")]
    pub report: PathBuf,
    /// Compare with the result of another calibration, in the report
    #[arg(long, value_name = "CAL.json")]
    pub previous: Option<PathBuf>,
}

/// When a run begins and ends, and what it must reach.
#[derive(Debug, Args)]
pub struct TermsArguments {
    /// When a calibration begins at power-up
    #[arg(long, value_enum, default_value_t)]
    policy: PolicyArgument,
    /// With --policy when-due: greatest age of the stored calibration, h [default: any]
    #[arg(long, value_name = "H", value_parser = positive)]
    longest_age: Option<f64>,
    /// With --policy when-due: greatest difference of temperature to the stored calibration, K [default: any]
    #[arg(long, value_name = "K", value_parser = positive)]
    temperature_change: Option<f64>,
    /// Required sigma of the 12 installation errors, arcsec [default: none]
    #[arg(long, value_name = "ARCSEC", value_parser = positive)]
    required_sigma: Option<f64>,
    /// End the run as soon as the required sigma is reached and the fit is good
    #[arg(long, requires = "required_sigma")]
    early_finish: bool,
    /// End the run after this time, s, with the stop under way
    #[arg(long, value_name = "S", value_parser = positive)]
    longest_run: Option<f64>,
    /// Stay up to this many times as long at a stop whose noise has as many times the configured variance
    #[arg(long, value_name = "RATIO", default_value_t = 1.0, value_parser = at_least_one)]
    noise_margin: f64,
    #[command(flatten)]
    unobserved: UnobservedArguments,
}

/// What is done about a scheme that leaves parameters unobserved.
#[derive(Debug, Args)]
pub struct UnobservedArguments {
    /// Run a scheme that leaves parameters unobserved, to see what it shows: it is rejected in the end, not refused before
    #[arg(long)]
    pub run_unobserved: bool,
}

/// What the axes can do.
#[derive(Debug, Args)]
pub struct AxisArguments {
    /// Travel of the outer and the inner axis, deg, or none [default: none, two turns either way]
    #[arg(long, value_name = "LOW..HIGH,LOW..HIGH", value_parser = travel, allow_hyphen_values = true)]
    limits: Option<TravelArgument>,
    /// Highest rate of the axes, deg/s [default: 60]
    #[arg(long, value_name = "DEG_S", value_parser = pace, allow_negative_numbers = true)]
    axis_rate: Option<f64>,
    /// Their highest acceleration, deg/s^2 [default: 60]
    #[arg(long, value_name = "DEG_S2", value_parser = pace, allow_negative_numbers = true)]
    acceleration: Option<f64>,
}

impl AxisArguments {
    pub fn axes(&self) -> [AxisLimits; 2] {
        let usual = AxisLimits::default();
        let travel = self.limits.and_then(|limits| limits.0).unwrap_or_default();
        travel.map(|Travel { lowest_rad, highest_rad }| AxisLimits {
            rate_rad_s: self.axis_rate.map_or(usual.rate_rad_s, |rate| rate * DEG),
            acceleration_rad_s2: self.acceleration.map_or(usual.acceleration_rad_s2, |limit| limit * DEG),
            lowest_rad,
            highest_rad,
            ..usual
        })
    }
}

/// When a calibration begins at power-up.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum PolicyArgument {
    /// At every power-up
    Always,
    /// When none is stored, or it is too old or of another temperature
    #[default]
    WhenDue,
    /// On command only
    OnCommand,
    /// Never
    Never,
}

impl TermsArguments {
    pub fn terms(&self) -> Terms {
        let limits = VerdictLimits::default();
        Terms {
            policy: match self.policy {
                PolicyArgument::Always => PowerUpPolicy::Always,
                PolicyArgument::OnCommand => PowerUpPolicy::OnCommand,
                PolicyArgument::Never => PowerUpPolicy::Never,
                PolicyArgument::WhenDue => PowerUpPolicy::WhenDue {
                    age_s: self.longest_age.map(|hours| (hours * 3600.0) as u64),
                    temperature_k: self.temperature_change.map(|change| change as f32),
                },
            },
            utc_s: SystemTime::now().duration_since(UNIX_EPOCH).ok().map(|since| since.as_secs()),
            pace: Pace { early_finish: self.early_finish, longest_s: self.longest_run, ..Pace::default() },
            limits: self.required_sigma.map_or(limits, |sigma| limits.requiring(sigma * ARCSEC)),
            noise_margin: self.noise_margin,
            refuse_unobserved: !self.unobserved.run_unobserved,
            ..Terms::default()
        }
    }
}

#[derive(Debug, Args)]
pub struct SimulateArguments {
    /// Log to write, compressed if its name ends in .gz
    #[arg(long, value_name = "LOG.csv")]
    pub out: PathBuf,
    /// Write the true parameters
    #[arg(long, value_name = "TRUTH.json")]
    pub truth: Option<PathBuf>,
    /// Write the unit description that `replay --config` takes
    #[arg(long, value_name = "UNIT.toml")]
    pub write_config: Option<PathBuf>,
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub unit: UnitArguments,
}

#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The log: CSV, Parquet or a raw matrix; all but Parquet also compressed with gzip
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// What the log has in which columns and units [default: the standard ones]
    #[arg(long, value_name = "MAP.toml")]
    pub mapping: Option<PathBuf>,
    /// Site, noise and more of the unit [default: Bai's site, noise "navigation"]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    pub method: MethodArguments,
    /// Write the result
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Write the report
    #[arg(long, value_name = "OUT.html")]
    pub report: Option<PathBuf>,
    /// Compare with the result of another calibration, in the report
    #[arg(long, value_name = "CAL.json", requires = "report")]
    pub previous: Option<PathBuf>,
    /// Compare with the true parameters
    #[arg(long, value_name = "TRUTH.json")]
    pub truth: Option<PathBuf>,
    /// Write the live estimate after every segment
    #[arg(long, value_name = "OUT.csv")]
    pub csv_estimates: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct InspectArguments {
    /// The log, of any columns and units: CSV, Parquet or a raw matrix; all but Parquet also compressed with gzip
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// What the log has in which columns and units [default: as it shows]
    #[arg(long, value_name = "MAP.toml")]
    pub mapping: Option<PathBuf>,
    /// Site of the unit, and noise where none is seen [default: Bai's site, noise "navigation"]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// Write the mapping that is proposed
    #[arg(long, value_name = "MAP.toml", conflicts_with = "mapping")]
    pub write_mapping: Option<PathBuf>,
    /// Write the unit description, with the noise that is seen
    #[arg(long, value_name = "UNIT.toml")]
    pub write_config: Option<PathBuf>,
    /// Write the scheme that the log follows
    #[arg(long, value_name = "SCHEME.toml")]
    pub write_scheme: Option<PathBuf>,
    /// Write all that is seen
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ApplyArguments {
    /// The log, as for replay
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// Result of `replay --json` or `calibrate --json`
    #[arg(long, value_name = "CAL.json")]
    pub calibration: PathBuf,
    /// What the log has in which columns and units [default: the standard ones]
    #[arg(long, value_name = "MAP.toml")]
    pub mapping: Option<PathBuf>,
    /// Corrected log to write: CSV, compressed if its name ends in .gz, or Parquet
    #[arg(long, value_name = "CORRECTED.csv")]
    pub out: PathBuf,
    /// Frame of the corrected rates and forces
    #[arg(long, value_enum, default_value_t)]
    pub frame: FrameArgument,
}

/// Frame of corrected rates and forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FrameArgument {
    /// s: x along accelerometer x
    #[default]
    Imu,
    /// r: x along the outer axis at inner angle 0, z along the inner axis
    Rotation,
}

#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

#[derive(Debug, Args)]
pub struct CompareArguments {
    /// The first result
    #[arg(value_name = "A.json")]
    pub first: PathBuf,
    /// The second result
    #[arg(value_name = "B.json")]
    pub second: PathBuf,
}

#[derive(Debug, Args)]
pub struct ObservabilityArguments {
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    /// Site, noise and rate of the unit [default: Bai's site, noise "navigation", 200 Hz]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// bai, navigation, tactical, or a file [default: that of --config]
    #[arg(long, value_name = "NAME|FILE")]
    pub noise: Option<String>,
    #[command(flatten)]
    pub method: MethodArguments,
    /// Compare all schemes of the library, by the joint method
    #[arg(long, conflicts_with_all = ["scheme", "stop", "periods", "method", "limits", "axis_rate", "acceleration"])]
    pub all: bool,
    /// Draw the sigmas of Bai's twelve against time
    #[arg(long, value_name = "OUT.svg", conflicts_with = "all")]
    pub plot: Option<PathBuf>,
    /// Write the prediction
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct PlanArguments {
    /// Time for all of it, first stop, ramps and settling included, s
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    time: f64,
    /// Scheme to write
    #[arg(long, value_name = "SCHEME.toml")]
    pub out: PathBuf,
    /// Name of the scheme [default: the file's]
    #[arg(long)]
    pub name: Option<String>,
    /// Travel of the outer and the inner axis, deg, or none [default: none, two turns either way]
    #[arg(long, value_name = "LOW..HIGH,LOW..HIGH", value_parser = travel, allow_hyphen_values = true)]
    limits: Option<TravelArgument>,
    /// Rate of a turning axis, deg/s
    #[arg(long, value_name = "DEG_S", default_value_t = 20.0, value_parser = pace, allow_negative_numbers = true)]
    axis_rate: f64,
    /// Its acceleration, deg/s^2
    #[arg(long, value_name = "DEG_S2", default_value_t = 20.0, value_parser = pace, allow_negative_numbers = true)]
    acceleration: f64,
    /// Stop at multiples of this, deg, or at any angle: free
    #[arg(long, value_name = "DEG|free", default_value = "free", value_parser = angle_step)]
    angles: AngleStep,
    /// Time after a move until the accelerometers are good, s; the firmware waits 0.3 s in any case
    #[arg(long, value_name = "S", default_value_t = 0.3, value_parser = settling, allow_negative_numbers = true)]
    settling: f64,
    /// Parameters that matter, by name [default: Bai's twelve]; a factor for each as NAME=FACTOR
    #[arg(long, value_name = "NAME[=FACTOR],..", value_delimiter = ',', value_parser = weight)]
    weights: Vec<(String, f64)>,
    /// What shall be small of their sigmas
    #[arg(long, value_enum, default_value_t)]
    criterion: Criterion,
    #[command(flatten)]
    options: OptionArguments,
    /// Site and noise of the unit [default: Bai's site, noise "navigation"]
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// bai, navigation, tactical, or a file [default: that of --config]
    #[arg(long, value_name = "NAME|FILE")]
    pub noise: Option<String>,
    /// How many schemes to look at; the time that planning takes is proportional to it
    #[arg(long, value_name = "N", default_value_t = 1_500_000, value_parser = clap::value_parser!(u64).range(100..))]
    evaluations: u64,
    /// Of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the prediction
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

impl PlanArguments {
    pub fn request(&self, unit: &UnitConfig) -> anyhow::Result<PlanRequest> {
        let options = self.options.options();
        let setup = Setup { options, ..Setup::new(unit, rate_hz(unit), Method::Joint, Precision::F64) };
        let objective = if self.weights.is_empty() {
            Objective::installation(self.criterion)
        } else {
            Objective::weighted(self.criterion, &self.weights, &options).map_err(anyhow::Error::msg)?
        };
        Ok(PlanRequest {
            setup,
            time_s: self.time,
            turning: Turning { rate_rad_s: self.axis_rate * DEG, acceleration_rad_s2: self.acceleration * DEG },
            settling_s: self.settling,
            travel: self.limits.and_then(|limits| limits.0).unwrap_or_default(),
            angle_step_rad: self.angles.0,
            objective,
            evaluations: self.evaluations,
            seed: self.seed,
        })
    }
}

/// Travel of both axes, or no limits.
#[derive(Clone, Copy, Debug)]
struct TravelArgument(Option<[Travel; 2]>);

/// Step of the stops' angles, rad, or free.
#[derive(Clone, Copy, Debug)]
struct AngleStep(Option<f64>);

fn travel(text: &str) -> Result<TravelArgument, String> {
    if text == "none" {
        return Ok(TravelArgument(None));
    }
    let axis = |text: &str| {
        let (low, high) = text.split_once("..")?;
        let (low, high) = (low.trim().parse::<f64>().ok()?, high.trim().parse::<f64>().ok()?);
        let inside = (-36_000.0..=0.0).contains(&low) && (0.0..=36_000.0).contains(&high);
        inside.then_some(Travel { lowest_rad: low * DEG, highest_rad: high * DEG })
    };
    let both = text.split_once(',').and_then(|(outer, inner)| Some([axis(outer)?, axis(inner)?]));
    both.map(|both| TravelArgument(Some(both))).ok_or_else(|| "not LOW..HIGH,LOW..HIGH in deg with 0 in both".into())
}

fn angle_step(text: &str) -> Result<AngleStep, String> {
    if text == "free" { Ok(AngleStep(None)) } else { Ok(AngleStep(Some(number_in(text, 0.01, 180.0)? * DEG))) }
}

fn weight(text: &str) -> Result<(String, f64), String> {
    let (name, factor) = text.split_once('=').unwrap_or((text, "1"));
    let factor = factor.parse().map_err(|_| format!("{name}: the weight is not a number"))?;
    Ok((name.into(), factor))
}

fn pace(text: &str) -> Result<f64, String> {
    number_in(text, 0.1, 1e4)
}

fn settling(text: &str) -> Result<f64, String> {
    number_in(text, 0.0, 60.0)
}

#[derive(Debug, Args)]
pub struct MonteCarloArguments {
    /// Number of runs
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    pub runs: u64,
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub unobserved: UnobservedArguments,
    /// Let the core turn the axes, as at power-up, and repeat disturbed stops [default: play the scheme open loop]
    #[arg(long)]
    pub closed_loop: bool,
    /// Which method, or both on the same data
    #[arg(long, value_enum, default_value_t)]
    pub method: MethodsArgument,
    /// Scalar of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    #[command(flatten)]
    pub options: OptionArguments,
    /// table1, table3, real, random, random:1deg, random:tactical, a file, or what would be in it in one line
    #[arg(long, value_name = "NAME|FILE", default_value = "random")]
    pub errors: String,
    /// bai, navigation, tactical, or a file [default: that of --config, or navigation]
    #[arg(long, value_name = "NAME|FILE")]
    pub noise: Option<String>,
    /// Site, noise and rate of the unit
    #[arg(long, value_name = "UNIT.toml")]
    pub config: Option<PathBuf>,
    /// Sample rate, Hz [default: that of --config, or 200]
    #[arg(long, value_name = "HZ", value_parser = rate, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Of everything random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Write the statistics
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ReplicateArguments {
    /// Page to write
    #[arg(long, value_name = "OUT.html", default_value = "rins-replication.html")]
    pub report: PathBuf,
    /// Write the numbers
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Runs of each unit; of each effect alone at most 4
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(2..))]
    pub runs: u64,
    /// Time of every stop, s, 200 in the paper
    #[arg(long, value_name = "S", default_value_t = 200.0, value_parser = seconds, allow_negative_numbers = true)]
    pub stop: f64,
    /// Of everything random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Which methods are compared.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum MethodsArgument {
    /// All 28 parameters at once
    #[default]
    Joint,
    /// Bai's twelve
    TwoStage,
    /// Both on the same data
    Both,
}

impl MethodsArgument {
    pub fn methods(self) -> Vec<Method> {
        match self {
            Self::Joint => vec![Method::Joint],
            Self::TwoStage => vec![Method::TwoStage],
            Self::Both => vec![Method::Joint, Method::TwoStage],
        }
    }
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum MethodArgument {
    /// All 28 parameters at once
    #[default]
    Joint,
    /// Bai's twelve
    TwoStage,
}

#[derive(Debug, Args)]
pub struct MethodArguments {
    /// How to estimate
    #[arg(long, value_enum, default_value_t)]
    method: MethodArgument,
    /// Scalar of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    #[command(flatten)]
    pub options: OptionArguments,
}

/// Effects beyond the 28 parameters.
#[derive(Debug, Args)]
pub struct OptionArguments {
    /// Effects that the joint method estimates too, separated by commas
    #[arg(long, value_enum, value_name = "EFFECT", value_delimiter = ',')]
    effects: Vec<Effect>,
    /// Random walk of the gyro biases that is allowed for, (deg/h)/sqrt(h)
    #[arg(long, value_name = "SIZE", default_value_t = 0.0, value_parser = walk, allow_negative_numbers = true)]
    gyro_bias_walk: f64,
    /// Random walk of the accelerometer biases that is allowed for, ug/sqrt(h)
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
    /// Steady tilting of the base
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
    pub fn method(&self) -> Method {
        match self.method {
            MethodArgument::Joint => Method::Joint,
            MethodArgument::TwoStage => Method::TwoStage,
        }
    }
}

#[derive(Debug, Args)]
pub struct SchemeArguments {
    /// A scheme of the library (`rins observability --all` lists them), or a file [default: fast-180, two-stage bai]
    #[arg(long, value_name = "NAME|FILE")]
    scheme: Option<String>,
    /// Time of every stop, s [default: as the scheme says]
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    stop: Option<f64>,
    /// How often the scheme is run [default: as the scheme says, two-stage bai 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    periods: Option<u8>,
}

impl SchemeArguments {
    /// The scheme, the usual one of this method where nothing else is asked for.
    pub fn scheme(&self, method: Method) -> anyhow::Result<Scheme> {
        let usual = Scheme::default_for(method);
        let name = self.scheme.as_deref().unwrap_or(&usual.name);
        let periods = self.periods.or((name == usual.name).then_some(usual.periods));
        of_option("--scheme", scheme_named(name, self.stop, periods))
    }

    /// The file that it may be.
    pub fn input(&self) -> Named<'_> {
        ("--scheme", self.scheme.as_deref().map(Path::new))
    }
}

#[derive(Debug, Args)]
pub struct UnitArguments {
    /// table1, table3, real, random, random:1deg, random:tactical, a file, or what would be in it in one line
    #[arg(long, value_name = "NAME|FILE", default_value = "real")]
    errors: String,
    /// bai, navigation, tactical, or a file [default: that of --config, or navigation]
    #[arg(long, value_name = "NAME|FILE")]
    noise: Option<String>,
    /// Site, noise and rate of the unit
    #[arg(long, value_name = "UNIT.toml")]
    config: Option<PathBuf>,
    /// Sample rate, Hz [default: that of --config, or 200]
    #[arg(long, value_name = "HZ", value_parser = rate, allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl UnitArguments {
    pub fn config(&self) -> anyhow::Result<UnitConfig> {
        unit_config(self.config.as_ref(), self.noise.as_deref(), self.rate)
    }

    /// The files that describe it.
    pub fn inputs(&self) -> [Named<'_>; 3] {
        unit_inputs(&self.errors, self.noise.as_deref(), self.config.as_deref())
    }

    /// The unit on a scheme.
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

/// The files that may describe a unit.
pub fn unit_inputs<'a>(errors: &'a str, noise: Option<&'a str>, config: Option<&'a Path>) -> [Named<'a>; 3] {
    [("--errors", Some(Path::new(errors))), ("--noise", noise.map(Path::new)), ("--config", config)]
}

/// An unknown name, or what is no file, says whose value it is; what is wrong in a file, the file says.
fn of_option<T>(option: &'static str, found: Result<T, TomlFileError>) -> anyhow::Result<T> {
    match found {
        Err(error @ (TomlFileError::Name { .. } | TomlFileError::Io { .. })) => Err(error).context(option),
        found => Ok(found?),
    }
}

/// Unit description from a file, or the default one, with other noise or another rate where asked for.
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

impl MethodArguments {
    pub fn setup(&self, unit: &UnitConfig) -> Setup {
        let options = self.options.options();
        Setup { options, ..Setup::new(unit, rate_hz(unit), self.method(), self.precision) }
    }
}

fn rate(text: &str) -> Result<f64, String> {
    number_in(text, 10.0, 10_000.0)
}

fn seconds(text: &str) -> Result<f64, String> {
    number_in(text, 0.1, 1e6)
}

fn positive(text: &str) -> Result<f64, String> {
    number_in(text, 1e-6, 1e9)
}

fn at_least_one(text: &str) -> Result<f64, String> {
    number_in(text, 1.0, 1e3)
}

fn walk(text: &str) -> Result<f64, String> {
    number_in(text, 0.0, 1e6)
}

fn number_in(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_string())?;
    if (low..=high).contains(&number) { Ok(number) } else { Err(format!("not between {low} and {high}")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn every_command_has_examples_that_are_commands() {
        for command in Arguments::command().get_subcommands() {
            let name = command.get_name();
            let help = command.get_after_help().unwrap_or_else(|| panic!("{name} has no example")).to_string();
            let examples =
                help.lines().filter_map(|line| line.trim_start_matches("Example: ").trim().strip_prefix("rins "));
            let mut own = 0;
            for example in examples {
                let words = example.split(" > ").next().unwrap_or_default().split_whitespace();
                let parsed = Arguments::try_parse_from(std::iter::once("rins").chain(words));
                assert!(parsed.is_ok(), "{example}: {}", parsed.unwrap_err());
                own += usize::from(example.split_whitespace().next() == Some(name));
            }
            assert!(own > 0, "{name}");
        }
    }
}
