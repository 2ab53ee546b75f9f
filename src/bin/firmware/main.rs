//! The firmware: samples in, motion commands out, records in the store.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod board;
mod fault;
mod inbox;
#[cfg(any(feature = "mps2-an500", feature = "mps2-an386"))]
mod mps2;
mod recorder;
mod stack;
#[cfg(feature = "stm32h743")]
mod stm32h743;
mod watchdog;
mod work;

use board::{Board, ThisBoard};
use cortex_m::singleton;
use cortex_m_rt::entry;
use rins_selfcal::acquisition::queue::SampleAndStatus;
use rins_selfcal::base::restart::Task;
#[cfg(not(feature = "optional-states"))]
use rins_selfcal::estimator::BASIC_STATES;
use rins_selfcal::estimator::{FULL_STATES, MAX_SEGMENTS};
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::{Gimbal, MotionCommand};
use rins_selfcal::keep::black_box::Event;
use rins_selfcal::keep::store::Loaded;
use rins_selfcal::link::{Hello, Link, MAX_FRAME_BYTES, Memories, Moment};
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::calibrator::{Calibrator, CalibratorConfig};
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::policy::Decision;
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::self_calibration::SelfCalibration;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::verdict::VerdictLimits;
use work::{Span, Work, count};

/// The scalar of this image.
#[cfg(not(feature = "single-precision"))]
pub type Scalar = f64;
/// The scalar of this image.
#[cfg(feature = "single-precision")]
pub type Scalar = f32;

/// States of the filter of this image.
#[cfg(not(feature = "optional-states"))]
const STATES: usize = BASIC_STATES;
/// States of the filter of this image.
#[cfg(feature = "optional-states")]
const STATES: usize = FULL_STATES;

type ImageCalibrator = Calibrator<Scalar, MAX_SEGMENTS, STATES>;

#[entry]
fn main() -> ! {
    let mut board = ThisBoard::start();
    let calibrator = singleton!(: ImageCalibrator = Calibrator::UNCONFIGURED);
    let status = match calibrator.zip(singleton!(: Link = Link::new())) {
        Some((calibrator, link)) => run(&mut board, link, calibrator),
        None => Err(()),
    };
    board.finish(status)
}

fn run(board: &mut impl Board, link: &mut Link, calibrator: &mut ImageCalibrator) -> Result<(), ()> {
    link.greet(Hello::new::<Scalar>(STATES));
    match &assignment(board) {
        Assignment::SelfCalibrate(config) => self_calibrate(board, link, config, calibrator),
        Assignment::Replay(config) => replay(board, link, config, calibrator),
    }
}

/// What the host assigns; without a word from it, the default. Not inlined, as others below: what they need on the stack
/// is free again when the run begins.
#[inline(never)]
fn assignment(board: &mut impl Board) -> Assignment {
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let assigned = board.configuration(&mut buffer).map(postcard::from_bytes);
    match assigned {
        Some(Ok(assignment)) => assignment,
        Some(Err(_)) => {
            defmt::error!("the assignment cannot be read; the default is used");
            Assignment::default()
        }
        None => Assignment::default(),
    }
}

#[inline(never)]
fn self_calibrate(
    board: &mut impl Board,
    link: &mut Link,
    config: &SelfCalibrationConfig,
    calibrator: &mut ImageCalibrator,
) -> Result<(), ()> {
    // Borrowed where it is: moved out, it would be on the stack twice.
    match &mut prepare(board, link, config, calibrator) {
        Ok(run) => {
            begin(board, &config.axes, &config.motors);
            follow(board, link, run)
        }
        Err(error) => refuse(board, link, *error),
    }
}

#[inline(never)]
fn prepare<'c>(
    board: &mut impl Board,
    link: &mut Link,
    config: &SelfCalibrationConfig,
    calibrator: &'c mut ImageCalibrator,
) -> Result<SelfCalibration<'c, Scalar, STATES>, ConfigError> {
    let stored = load(board, link);
    tell_restart(board, link);
    defmt::info!("scheme {=str}", config.scheme.name.as_str());
    SelfCalibration::new(config.clone(), stored.as_ref(), calibrator)
}

#[inline(never)]
fn tell_restart(board: &mut impl Board, link: &mut Link) {
    let restart = board.parts().restart.clone();
    send(board, link, &Message::Restarted(restart));
}

/// Lets control and sampling begin.
#[inline(never)]
fn begin(board: &mut impl Board, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
    board.begin(Gimbal::new(axes, motors));
}

/// Samples and commands in, motion commands and messages out, until the instrument is switched off.
fn follow(board: &mut impl Board, link: &mut Link, run: &mut SelfCalibration<'_, Scalar, STATES>) -> Result<(), ()> {
    let mut samples = 0;
    while board.powered() {
        watchdog::report(Task::Main, board.now_us());
        while let Some(SampleAndStatus { sample, gimbal }) = board.parts().samples.pop() {
            watchdog::progress(board.now_us());
            samples += 1;
            let (span, mut work) = (Span::start(), work_in(run.state()));
            let step = run.step(&sample, &gimbal, &mut |message| {
                work = if matches!(message, Message::Segment(_)) { Work::Segment } else { Work::Other };
                send(board, link, message);
            });
            command(board, step.motion, gimbal.time_us);
            count(work, &span);
            if step.note && !save(board, run) {
                defmt::warn!("the rejected run is not in the history");
            }
            if step.save {
                let saved = save(board, run);
                run.saved();
                send(board, link, &Message::Saved(saved));
            }
        }
        let (now_us, gimbal) = (board.now_us(), board.with_control(|control| control.status()).unwrap_or_default());
        let motion = run.tick(now_us, &gimbal, &mut |message| send(board, link, message));
        command(board, motion, gimbal.time_us);
        serve(board, link, run);
        board.wait();
    }
    report_queue(board, link, samples);
    Ok(())
}

/// Gives the gimbal a command that was computed from its status of a time, us.
fn command(board: &mut impl Board, motion: Option<MotionCommand>, seen_us: u64) {
    if let Some(motion) = motion {
        board.with_control(|control| control.command(motion, seen_us));
    }
}

/// Answers the commands that have come in, and tells the status.
#[inline(never)]
fn serve(board: &mut impl Board, link: &mut Link, run: &mut SelfCalibration<'_, Scalar, STATES>) {
    let moment = Moment { now_us: board.now_us(), missing: board.parts().samples.losses().total() };
    let before = (run.config().axes, run.config().motors);
    link.note_overrun(inbox::lost());
    let bytes = core::iter::from_fn(inbox::pop);
    link.serve(bytes, moment, run, &mut Memories { store: &mut board.parts().store, event: recorder::event });
    let (axes, motors) = (run.config().axes, run.config().motors);
    if (axes, motors) != before {
        board.with_control(|control| control.reconfigure(&axes, &motors));
    }
    link.tell_status(moment, run);
    board.transmit(link);
}

#[inline(never)]
fn refuse(board: &mut impl Board, link: &mut Link, error: ConfigError) -> Result<(), ()> {
    defmt::error!("the configuration is refused: {}", defmt::Display2Format(&error));
    send(board, link, &Message::Refused(error));
    Err(())
}

/// What a sample is for in this state, unless there is something to tell.
fn work_in(state: State) -> Work {
    match state {
        State::Dwell(_) => Work::Stop,
        State::Turn(_) => Work::Move,
        State::Compute => Work::Solve,
        State::Correcting => Work::Correct,
        _ => Work::Other,
    }
}

#[inline(never)]
fn replay(
    board: &mut impl Board,
    link: &mut Link,
    config: &CalibratorConfig,
    calibrator: &mut ImageCalibrator,
) -> Result<(), ()> {
    if config.estimator.options.needs_states() && STATES < FULL_STATES {
        return refuse(board, link, ConfigError::States);
    }
    calibrator.restart(config);
    begin(board, &[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
    let mut samples = 0;
    while board.powered() {
        watchdog::report(Task::Main, board.now_us());
        while let Some(SampleAndStatus { sample, .. }) = board.parts().samples.pop() {
            watchdog::progress(board.now_us());
            samples += 1;
            if let Some(progress) = calibrator.step(&sample) {
                send(board, link, &Message::Segment(progress));
            }
        }
        board.wait();
    }
    let solution = calibrator.conclude(&mut |message| send(board, link, message));
    let verdict = calibrator.judge(&solution, None, &VerdictLimits::default());
    send(board, link, &Message::Judged(verdict));
    report_queue(board, link, samples);
    Ok(())
}

/// Stores the run's result; whether that went well.
#[inline(never)]
fn save(board: &mut impl Board, run: &SelfCalibration<'_, Scalar, STATES>) -> bool {
    let Some(saved) = run.record().map(|record| board.parts().store.save(&record)) else { return false };
    if let Ok(failed @ 1..) = saved {
        defmt::warn!("{=usize} slots of the store did not take the record; the next one did", failed);
    }
    saved.is_ok()
}

/// The stored calibration, if there is a good one.
#[inline(never)]
fn load(board: &mut impl Board, link: &mut Link) -> Option<StoredCalibration> {
    let (record, damaged, fault) = match board.parts().store.load() {
        Ok(Loaded::Empty) => (None, false, false),
        Ok(Loaded::Found { record, damage }) => (Some(record), damage.is_some(), false),
        Ok(Loaded::Corrupt { .. }) => (None, true, false),
        Err(_) => (None, false, true),
    };
    // Where the next record needs an erase, it is done now, while nothing waits for it.
    if board.parts().store.prepare().is_err() {
        defmt::warn!("no record can be stored");
    }
    let found = record.is_some();
    defmt::info!(
        "calibration in store: {=bool}, a slot damaged: {=bool}, memory at fault: {=bool}",
        found,
        damaged,
        fault
    );
    send(board, link, &Message::Store { found, damaged, fault });
    record
}

fn report_queue(board: &mut impl Board, link: &mut Link, samples: u64) {
    let losses = board.parts().samples.losses();
    defmt::info!("{=u64} samples, {=u32} missing", samples, losses.total());
    send(board, link, &Message::Queue { samples, losses });
}

fn send(board: &mut impl Board, link: &mut Link, message: &Message) {
    let span = Span::start();
    log(message);
    if let Some(event) = Event::of(message) {
        recorder::record(board.now_us(), event);
    }
    let mut buffer = [0; MAX_FRAME_BYTES];
    if let Some(frame) = link.tell(message, &mut buffer) {
        board.show(frame);
    }
    board.transmit(link);
    span.put_aside();
}

/// The milestones of a run, for whoever reads the log and not the telemetry.
fn log(message: &Message) {
    match message {
        Message::State { time_us, legs, .. } => {
            defmt::debug!("{=u64} us: next state, {=u16} legs in all", *time_us, *legs);
        }
        Message::Decided(Decision::Calibrate(_)) => defmt::info!("a calibration begins"),
        Message::Decided(Decision::UseStored(_)) => defmt::info!("the stored calibration corrects"),
        Message::Decided(Decision::StandBy(_)) => defmt::info!("standing by without a calibration"),
        Message::Solved { solution, .. } => defmt::info!(
            "solved: chi-square {=f64} with {=u32} degrees of freedom",
            solution.fit.chi_square,
            solution.degrees_of_freedom
        ),
        Message::Judged(verdict) => defmt::info!("accepted: {=bool}", verdict.accepted()),
        Message::Aborted(_) => defmt::warn!("the run is aborted"),
        Message::Restarted(restart) => defmt::info!("{}", defmt::Display2Format(restart)),
        Message::Saved(saved) => defmt::info!("stored: {=bool}", *saved),
        _ => {}
    }
}
