//! `rins calibrate`

use super::arguments::CalibrateArguments;
use super::{Ending, progress, replay};
use crate::calibration::Setup;
use crate::closed_loop::{Ended, calibrate};
use crate::quantity;
use crate::truth::Truth;
use crate::virtual_run::VirtualRun;
use anyhow::anyhow;
use indicatif::ProgressBar;
use rins_selfcal::calibrator::Progress;
use rins_selfcal::error_model::block;
use rins_selfcal::sequencer::State;
use rins_selfcal::telemetry::Message;

pub fn run(arguments: &CalibrateArguments) -> anyhow::Result<Ending> {
    let config = arguments.unit.config()?;
    let method = arguments.method.method();
    let scheme = arguments.scheme.scheme(method)?;
    let setup = arguments.method.setup(&config).on_scheme(&scheme);
    let run = arguments.unit.run(&config, scheme)?;
    println!("virtual RINS: scheme {}, {:.0} s, closed loop", run.scheme.name, run.duration_s());
    match calibrate_with_bar(&run, &setup)? {
        Ended::Judged(outcome) => {
            let truth = Truth::new(&run.unit.errors);
            replay::report(&outcome, Some(&truth), arguments.json.as_deref())
        }
        Ended::Aborted(reason) => {
            println!("verdict: aborted\n  - {reason:?}");
            Ok(Ending::NotAccepted)
        }
    }
}

fn calibrate_with_bar(run: &VirtualRun, setup: &Setup) -> anyhow::Result<Ended> {
    let bar = progress::bar(run.duration_s().ceil() as u64, "s");
    let ended = calibrate(run, setup, |time_s, message| show(&bar, time_s, message));
    bar.finish_and_clear();
    ended.map_err(|error| anyhow!("the configuration is refused: {error:?}"))
}

fn show(bar: &ProgressBar, time_s: f64, message: &Message) {
    bar.set_position(time_s as u64);
    match message {
        Message::State { state: State::Turn(leg), legs, .. } => bar.set_prefix(format!("leg {leg} of {legs}")),
        Message::Segment(progress) => bar.set_message(worst(progress)),
        _ => {}
    }
}

fn worst(progress: &Progress) -> String {
    let sigmas = quantity::sigmas(&progress.estimate.sigmas);
    let worst = sigmas[..block::ACCEL_BIAS].iter().copied().fold(0.0, f64::max);
    format!("segment {}, worst of the 12: {} arcsec", progress.segments, quantity::significant(worst))
}
