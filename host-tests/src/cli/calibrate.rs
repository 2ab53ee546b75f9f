//! `rins calibrate`

use super::arguments::CalibrateArguments;
use super::output::sayln;
use super::{Ending, files, progress, replay};
use crate::closed_loop::{Ended, PowerUp, Terms};
use crate::emulator::Run;
use crate::page::{Content, Previous};
use crate::quantity;
use crate::truth::Truth;
use crate::virtual_run::VirtualRun;
use anyhow::Context;
use indicatif::ProgressBar;
use rins_selfcal::calibrator::Progress;
use rins_selfcal::error_model::block;
use rins_selfcal::policy::Decision;
use rins_selfcal::sequencer::State;
use rins_selfcal::telemetry::Message;
use std::path::Path;
use std::time::Instant;

pub fn run(arguments: &CalibrateArguments) -> anyhow::Result<Ending> {
    let [errors, noise, config] = arguments.unit.inputs();
    // The EEPROM is read and written; nothing else may be written there.
    let inputs = [
        arguments.scheme.input(),
        errors,
        noise,
        config,
        ("--eeprom", arguments.eeprom.as_deref()),
        ("--previous", arguments.previous.as_deref()),
    ];
    files::check(&inputs, &[("--json", arguments.json.as_deref()), ("--report", Some(&arguments.report))])?;
    let config = arguments.unit.config()?;
    let method = arguments.method.method();
    let scheme = arguments.scheme.scheme(method)?;
    let setup = arguments.method.setup(&config).on_scheme(&scheme);
    let run = arguments.unit.run(&config, scheme)?;
    let place = if arguments.firmware { "firmware in the emulator" } else { "in process" };
    sayln!("virtual RINS: scheme {}, {:.0} s, closed loop, {place}", run.scheme.name, run.duration_s());
    let power_up =
        PowerUp::new(&run, &setup).on_terms(Terms { axes: arguments.axes.axes(), ..arguments.terms.terms() });
    if arguments.firmware {
        return firmware(arguments, &run, &power_up);
    }
    let bar = progress::bar(run.duration_s().ceil() as u64, "s");
    let started = Instant::now();
    let ended = power_up.in_process(|message| show(&bar, message))?;
    bar.finish_and_clear();
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
    let bar = progress::bar(run.duration_s().ceil() as u64, "s");
    bar.println(format!("boot {number}"));
    let on_log = |line: &str| bar.suspend(|| sayln!("firmware: {line}"));
    let (ended, run) = power_up
        .in_emulator(eeprom, on_log, |message| show(&bar, message))
        .with_context(|| format!("boot {number}"))?;
    bar.finish_and_clear();
    sayln!("boot {number}: {}", figures(&run));
    Ok(ended)
}

fn figures(run: &Run) -> String {
    format!(
        "{:.1} s of instrument time, {:.1} s wall time, {:.0} million instructions, stack {} of {} bytes, \
         at most {} of {} samples waiting",
        run.elapsed_s,
        run.wall_s,
        run.instructions * 1e-6,
        run.stack_used_bytes,
        run.stack_bytes,
        run.queue_deepest,
        run.queue_length
    )
}

fn conclude(
    arguments: &CalibrateArguments,
    power_up: &PowerUp,
    run: &VirtualRun,
    ended: &Ended,
) -> anyhow::Result<Ending> {
    match ended {
        Ended::Judged(outcome) => {
            let truth = Truth::new(&run.unit.errors);
            let previous = arguments.previous.as_deref().map(Previous::read).transpose()?;
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
            sayln!("verdict: aborted\n  - {abort}");
            Ok(Ending::NotAccepted)
        }
    }
}

fn show(bar: &ProgressBar, message: &Message) {
    match message {
        Message::State { time_us, state, legs } => {
            bar.set_position(time_us / 1_000_000);
            if let State::Turn(leg) = state {
                bar.set_prefix(format!("leg {leg} of {}", legs - 1));
            }
        }
        Message::Segment(progress) => bar.set_message(worst(progress)),
        Message::Decided(decision) => bar.suspend(|| sayln!("power-up: {decision}")),
        _ => {}
    }
}

fn worst(progress: &Progress) -> String {
    let sigmas = quantity::sigmas(&progress.estimate.sigmas);
    let worst = sigmas[..block::ACCEL_BIAS].iter().copied().fold(0.0, f64::max);
    format!("segment {}, worst of the 12: {} arcsec", progress.segments, quantity::significant(worst))
}
