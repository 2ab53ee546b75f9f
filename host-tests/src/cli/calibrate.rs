//! `rins calibrate`

use super::arguments::axes::AxisArguments;
use super::arguments::method::MethodArguments;
use super::arguments::scheme::{SchemeArguments, UnobservedArguments};
use super::arguments::unit::UnitArguments;
use super::arguments::value::{at_least_one, positive};
use super::ending::Ending;
use super::output::{is_quiet, must_sayln, say, sayln};
use super::progress::Progress;
use super::{files, progress, replay};
use crate::base::quantity;
use crate::bench::Imu;
use crate::bench::emulator::Run;
use crate::bench::emulator::image::Board;
use crate::bench::memory::eeprom_at_rest;
use crate::calibration::virtual_run::VirtualRun;
use crate::files::truth::Truth;
use crate::page::Content;
use crate::result::saved::Saved;
use crate::study::closed_loop::{Ended, PowerUp, Terms};
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::estimator::BaiTuning;
use rins_selfcal::model::error_model::block;
use rins_selfcal::run::policy::{Decision, PowerUpPolicy};
use rins_selfcal::run::sequencer::Pace;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::telemetry::Progress as Segmented;
use rins_selfcal::verdict::VerdictLimits;
use std::cell::RefCell;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

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
    /// Interface of the IMU; --noise sets the noise of the IMU
    #[arg(long, value_enum, default_value_t)]
    pub imu: Imu,
    /// Run the firmware in the emulator twice: the first boot calibrates, the second boot finds the stored calibration
    #[arg(long)]
    pub firmware: bool,
    /// Board of the firmware [default: mps2-an500, or mps2-an386 with --precision f32]
    #[arg(long, value_enum, requires = "firmware")]
    pub board: Option<Board>,
    /// File with the content of the firmware's EEPROM or flash, kept from run to run [default: a blank memory]
    #[arg(long, value_name = "FILE", requires = "firmware")]
    pub eeprom: Option<PathBuf>,
    /// Run the firmware in real time until it is interrupted; its serial line is at this Unix socket, for
    /// `rins monitor --port SOCKET`
    #[arg(long, value_name = "SOCKET", requires = "firmware")]
    pub serial: Option<PathBuf>,
    /// Write the result to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
    /// Write the report to this file
    #[arg(long, value_name = "OUT.html", default_value = "rins-report.html")]
    pub report: PathBuf,
    /// Compare with the result of an earlier calibration, in the report
    #[arg(long, value_name = "CAL.json")]
    pub previous: Option<PathBuf>,
}

/// When a run begins and ends, and which sigma it must reach.
#[derive(Debug, Args)]
pub struct TermsArguments {
    /// When a calibration begins at power-up
    #[arg(long, value_enum, default_value_t)]
    policy: PolicyArgument,
    /// With --policy when-due: greatest age of the stored calibration, h [default: no limit]
    #[arg(long, value_name = "H", value_parser = positive)]
    longest_age: Option<f64>,
    /// With --policy when-due: greatest temperature difference to the stored calibration, K [default: no limit]
    #[arg(long, value_name = "K", value_parser = positive)]
    temperature_change: Option<f64>,
    /// Required sigma of the 12 installation errors, arcsec [default: none]
    #[arg(long, value_name = "ARCSEC", value_parser = positive)]
    required_sigma: Option<f64>,
    /// End the run as soon as it reaches the required sigma with a good fit
    #[arg(long, requires = "required_sigma")]
    early_finish: bool,
    /// End the run after this time, s, at the end of the stop that is under way
    #[arg(long, value_name = "S", value_parser = positive)]
    longest_run: Option<f64>,
    /// Lengthen a noisy stop in proportion to its noise variance over the configured one, up to this factor
    #[arg(long, value_name = "RATIO", default_value_t = 1.0, value_parser = at_least_one)]
    noise_margin: f64,
    #[command(flatten)]
    unobserved: UnobservedArguments,
}

/// When a calibration begins at power-up.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum PolicyArgument {
    /// At every power-up
    Always,
    /// When no calibration is stored, or the stored one is too old or was made at another temperature
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

pub fn run(arguments: &CalibrateArguments) -> anyhow::Result<Ending> {
    let [errors, noise, config, hardware] = arguments.unit.inputs();
    // The EEPROM file is an input too, so no output may overwrite the file.
    let inputs = [
        arguments.scheme.input(),
        errors,
        noise,
        config,
        hardware,
        ("--eeprom", arguments.eeprom.as_deref()),
        ("--previous", arguments.previous.as_deref()),
    ];
    files::check(&inputs, &[("--json", arguments.json.as_deref()), ("--report", Some(&arguments.report))])?;
    let config = arguments.unit.config()?;
    let method = arguments.method.method;
    let scheme = arguments.scheme.scheme(method)?;
    let setup = arguments.method.setup(&config).on_scheme(&scheme);
    let run = arguments.unit.run(&config, scheme)?;
    let place = if arguments.firmware { "firmware in the emulator" } else { "in process" };
    sayln!("virtual RINS: scheme {}, {:.0} s, closed loop, {place}", run.scheme.name, run.duration_s());
    say!("{}", arguments.unit.described(&config)?);
    let terms = Terms { axes: arguments.axes.axes(), ..arguments.terms.terms() };
    let power_up = PowerUp::new(&run, &setup).on_terms(terms).with_imu(arguments.imu).on_board(arguments.board);
    if arguments.firmware {
        if setup.tuning != BaiTuning::STATED {
            bail!("the firmware has the P0 and Q that rins documents, not those of [bai] in --config");
        }
        return firmware(arguments, &run, &power_up);
    }
    let live = Live::new(&run, &power_up);
    let started = Instant::now();
    let ended = power_up.in_process(|message| live.show(message))?;
    drop(live);
    let wall = started.elapsed();
    let ending = conclude(arguments, &power_up, &run, &ended)?;
    progress::wall_time(wall);
    Ok(ending)
}

/// Boots twice with the same EEPROM: the second boot finds what the first one stored.
fn firmware(arguments: &CalibrateArguments, run: &VirtualRun, power_up: &PowerUp) -> anyhow::Result<Ending> {
    sayln!("building the ARM image");
    let blank = tempfile::tempdir()?;
    let eeprom = arguments.eeprom.clone().unwrap_or_else(|| blank.path().join("eeprom.bin"));
    let has_eeprom = arguments.board != Some(Board::Stm32h743);
    if has_eeprom && !eeprom.exists() {
        std::fs::write(&eeprom, eeprom_at_rest()).with_context(|| eeprom.display().to_string())?;
    }
    if let Some(serial) = &arguments.serial {
        sayln!("serial line: rins monitor --port {}", serial.display());
        power_up.on_line(serial, &eeprom, |line| sayln!("firmware: {line}"))?;
        return Ok(Ending::Done);
    }
    let ended = boot(1, run, power_up, &eeprom)?;
    let ending = conclude(arguments, power_up, run, &ended)?;
    if ending != Ending::Done || matches!(ended, Ended::NoRun(_)) {
        return Ok(ending);
    }
    let ended = boot(2, run, power_up, &eeprom)?;
    conclude(arguments, power_up, run, &ended)
}

fn boot(number: u32, run: &VirtualRun, power_up: &PowerUp, eeprom: &Path) -> anyhow::Result<Ended> {
    let live = Live::new(run, power_up);
    live.progress.warn(&format!("boot {number}"));
    let on_log = |line: &str| live.progress.suspend(|| sayln!("firmware: {line}"));
    let (ended, run) =
        power_up.in_emulator(eeprom, on_log, |message| live.show(message)).with_context(|| format!("boot {number}"))?;
    drop(live);
    sayln!("boot {number}: {}", figures(&run));
    Ok(ended)
}

fn figures(run: &Run) -> String {
    let mut figures = format!(
        "{:.1} s of instrument time, {:.1} s wall time, {:.0} million instructions, stack {} of {} bytes",
        run.elapsed_s,
        run.wall_s,
        run.instructions * 1e-6,
        run.stack_used_bytes,
        run.stack_bytes
    );
    if run.queue_length > 0 {
        let _ = write!(figures, ", at most {} of {} samples waiting", run.queue_deepest, run.queue_length);
    }
    figures
}

fn conclude(
    arguments: &CalibrateArguments,
    power_up: &PowerUp,
    run: &VirtualRun,
    ended: &Ended,
) -> anyhow::Result<Ending> {
    match ended {
        Ended::Judged(outcome) => {
            let truth = Truth::new(outcome.truth.as_ref().unwrap_or(&run.unit.errors));
            let previous = arguments.previous.as_deref().map(Saved::read).transpose()?;
            let content = Content {
                outcome,
                truth: Some(&truth.parameters),
                signals: Some(&power_up.signals().borrow()),
                scheme: Some(&run.scheme),
                source: &format!("virtual RINS, seed {}", run.seed),
                previous: previous.as_ref(),
            };
            replay::report(&content, arguments.json.as_deref(), Some(&arguments.report), "")
        }
        Ended::NoRun(decision) => Ok(match decision {
            Decision::StandBy(_) => Ending::NotAccepted,
            Decision::UseStored(_) | Decision::Calibrate(_) => Ending::Done,
        }),
        Ended::Aborted(abort) => {
            if is_quiet() {
                must_sayln!("aborted; {abort}");
            }
            sayln!("verdict: aborted\n  - {abort}");
            Ok(Ending::NotAccepted)
        }
    }
}

/// Live view of a run in 80 columns: time, leg, angles of the axes, worst sigma of the twelve installation errors.
/// Faults and warnings are printed as lines that stay.
struct Live<'a> {
    progress: Progress,
    power_up: &'a PowerUp<'a>,
    doing: RefCell<String>,
    known: RefCell<String>,
}

impl<'a> Live<'a> {
    fn new(run: &VirtualRun, power_up: &'a PowerUp<'a>) -> Self {
        let progress = progress::bar(run.duration_s().ceil() as u64, "s");
        Self { progress, power_up, doing: RefCell::default(), known: RefCell::default() }
    }

    fn show(&self, message: &Message) {
        match message {
            Message::State { time_us, state, legs } => {
                *self.doing.borrow_mut() = in_words(*state, *legs);
                self.progress.set_position(time_us / 1_000_000);
            }
            Message::Segment(segment) => *self.known.borrow_mut() = worst(segment),
            Message::Decided(decision) => self.progress.suspend(|| sayln!("power-up: {decision}")),
            Message::Fault(fault) => self.progress.warn(&format!("fault: {fault}")),
            Message::Store { fault: true, .. } => self.progress.warn("store: the memory does not answer"),
            Message::Store { damaged: true, .. } => self.progress.warn("store: a record is damaged"),
            Message::Store { other_version: Some(version), .. } => {
                let format = char::from(*version);
                self.progress
                    .warn(&format!("store: there are records of format {format}, which this software does not read"));
            }
            Message::Saved(false) => self.progress.warn("store: the calibration could not be stored"),
            _ => return,
        }
        let angles = self.power_up.signals().borrow().points().last().map_or_else(String::new, |point| {
            // Adding zero turns -0 into 0.
            let [outer, inner] = point.angles_rad.map(|angle| (angle.to_degrees() * 10.0).round() / 10.0 + 0.0);
            format!("outer {outer:.1}, inner {inner:.1} deg")
        });
        let parts = [self.doing.borrow().clone(), angles, self.known.borrow().clone()];
        self.progress.set_message(parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; "));
    }
}

fn in_words(state: State, legs: u16) -> String {
    let of = state.leg().map_or_else(String::new, |_| format!(" of {}", legs.saturating_sub(1)));
    format!("{state}{of}")
}

fn worst(progress: &Segmented) -> String {
    let sigmas = quantity::sigmas(&progress.estimate.sigmas);
    let worst = sigmas[..block::ACCEL_BIAS].iter().copied().fold(0.0, f64::max);
    format!("worst sigma {} arcsec", quantity::significant(worst))
}
