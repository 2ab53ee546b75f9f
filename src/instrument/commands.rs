//! The commands of the serial line: what each command does, and when it is refused.

use super::motion_log::MotionLog;
use super::surroundings::{Archive, Surroundings};
use super::tell::tell;
use crate::base::linear::Real;
use crate::keep::store::Wanted;
use crate::link::{Answer, CONFIRM_TOLERANCE_RAD, Command, Hello, Item, Link, Refusal, Setting, Status};
use crate::model::error_model::PARAMETERS;
use crate::run::config::SelfCalibrationConfig;
use crate::run::policy::Cause;
use crate::run::self_calibration::SelfCalibration;
use crate::run::state::State;
use crate::run::unit::{UnitConfiguration, UnitName};

type Run<'m, T> = SelfCalibration<'m, T>;

/// How a command is answered.
#[expect(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub(super) enum Reply {
    /// Now.
    Now(Answer),
    /// With this record, once it is read.
    Record(Wanted),
}

/// Carries out one command. Not inlined, as the functions below, so that their stack is free for the other functions.
///
/// # Errors
/// Why the command is refused.
#[inline(never)]
pub(super) fn carry_out<T: Real>(
    command: &Command,
    run: &mut Run<'_, T>,
    (motion_log, unit): (&mut MotionLog, &mut Option<UnitName>),
    link: &mut Link,
    outside: &mut impl Surroundings<T>,
) -> Result<Reply, Refusal> {
    let now_us = outside.now_us();
    let answer = match command {
        Command::Read(Item::Calibration) => return Ok(Reply::Record(Wanted::Newest)),
        Command::Read(Item::History { back }) => return Ok(Reply::Record(Wanted::Entry { back: *back })),
        Command::Read(Item::Event { back }) => outside.event(*back).map(Answer::Event).ok_or(Refusal::Nothing),
        Command::Read(Item::Unit) => unit.clone().map(Answer::Unit).ok_or(Refusal::Nothing),
        Command::Read(Item::Setting(name)) => Ok(Answer::Setting(Setting::of(run.config(), *name))),
        Command::Read(Item::Estimate) => estimate(run),
        Command::Read(Item::Covariance { row }) => covariance(*row, run),
        Command::Hello => Ok(Answer::Hello(Hello::new::<T>())),
        Command::Status => Ok(Answer::Status(status(run, link, outside))),
        Command::Stop => stop(run, link, outside),
        Command::Abort => abort(run),
        Command::Stream(on) => {
            link.stream(*on);
            Ok(Answer::Done)
        }
        Command::Unlock(word) if link.unlock(*word, now_us) => Ok(Answer::Done),
        Command::Unlock(_) => Err(Refusal::WrongWord),
        Command::Set(Setting::PowerUpUtc(utc_s)) => {
            run.set_power_up_utc(*utc_s);
            Ok(Answer::Done)
        }
        Command::Start
        | Command::Set(_)
        | Command::Erase
        | Command::Commission(_)
        | Command::Decommission
        | Command::ConfirmAngles(_)
            if !link.is_unlocked(now_us) =>
        {
            Err(Refusal::Locked)
        }
        Command::Start => start(run),
        Command::Set(setting) => set(setting, run, outside),
        Command::Erase => erase(run.state(), outside),
        Command::Commission(name) => {
            commission(name, run, outside)?;
            *unit = Some(name.clone());
            Ok(Answer::Done)
        }
        Command::Decommission => {
            idle(run.state())?;
            outside.archive().erase_configuration()?;
            *unit = None;
            Ok(Answer::Done)
        }
        Command::ConfirmAngles(angles_rad) => confirm(*angles_rad, run.state(), motion_log, outside),
    };
    answer.map(Reply::Now)
}

/// The state of the instrument now.
pub(super) fn status<T: Real>(run: &Run<'_, T>, link: &Link, outside: &mut impl Surroundings<T>) -> Status {
    let time_us = outside.now_us();
    Status {
        time_us,
        state: run.state(),
        legs: run.legs(),
        segments: run.calibrator().estimator().segments().len() as u16,
        left_s: run.left_s() as f32,
        angles_rad: run.angles_rad().map_or([f32::NAN; 2], |angles| angles.map(|angle| angle as f32)),
        correcting: run.is_correcting(),
        unlocked: link.is_unlocked(time_us),
        motion_lock: run.motion_lock(),
        missing: outside.losses().total(),
        link: link.counts(),
    }
}

/// Refuses a command that is allowed only while no run is under way.
fn idle(state: State) -> Result<(), Refusal> {
    if state.is_idle() { Ok(()) } else { Err(Refusal::NotNow(state)) }
}

fn start<T: Real>(run: &mut Run<'_, T>) -> Result<Answer, Refusal> {
    idle(run.state())?;
    match run.start() {
        Ok(()) => Ok(Answer::Done),
        Err(Cause::NotCommissioned) => Err(Refusal::NotCommissioned),
        Err(_) => Err(Refusal::Policy),
    }
}

/// Gives the command to the gimbal at once: no sample is needed.
#[inline(never)]
fn stop<T: Real>(run: &mut Run<'_, T>, link: &mut Link, outside: &mut impl Surroundings<T>) -> Result<Answer, Refusal> {
    let gimbal = outside.status();
    let motion = run.stop(&gimbal, &mut |message| tell(link, outside, message));
    if let Some(motion) = motion {
        outside.command(motion, gimbal.time_us);
    }
    Ok(Answer::Done)
}

fn abort<T: Real>(run: &mut Run<'_, T>) -> Result<Answer, Refusal> {
    match run.state() {
        state if state.is_under_way() => run.abort(),
        // The run has already ended, and the axes return.
        State::Stopping | State::Parking => {}
        state => return Err(Refusal::NotNow(state)),
    }
    Ok(Answer::Done)
}

#[inline(never)]
fn set<T: Real>(
    setting: &Setting,
    run: &mut Run<'_, T>,
    outside: &mut impl Surroundings<T>,
) -> Result<Answer, Refusal> {
    idle(run.state())?;
    let before = (run.config().axes, run.config().motors);
    run.reconfigure(|config| setting.put(config)).map_err(Refusal::Config)?;
    let (axes, motors) = (run.config().axes, run.config().motors);
    if (axes, motors) != before {
        outside.reconfigure(&axes, &motors);
    }
    Ok(Answer::Done)
}

/// Stores the configuration in force for the next power-up. The time of this power-up is no part of it.
#[inline(never)]
fn commission<T: Real>(unit: &UnitName, run: &Run<'_, T>, outside: &mut impl Surroundings<T>) -> Result<(), Refusal> {
    idle(run.state())?;
    let run = SelfCalibrationConfig { utc_s: None, ..run.config().clone() };
    outside.archive().configure(&UnitConfiguration { unit: unit.clone(), run })
}

fn confirm<T: Real>(
    angles_rad: [Option<f32>; 2],
    state: State,
    motion_log: &mut MotionLog,
    outside: &mut impl Surroundings<T>,
) -> Result<Answer, Refusal> {
    idle(state)?;
    outside.locate(angles_rad.map(|angle| angle.map(f64::from)), CONFIRM_TOLERANCE_RAD).map_err(Refusal::Locate)?;
    motion_log.confirm();
    Ok(Answer::Done)
}

fn erase<T: Real>(state: State, outside: &mut impl Surroundings<T>) -> Result<Answer, Refusal> {
    idle(state)?;
    outside.archive().erase()?;
    Ok(Answer::Done)
}

#[inline(never)]
fn estimate<T: Real>(run: &Run<'_, T>) -> Result<Answer, Refusal> {
    complete(run)?;
    let estimator = run.calibrator().estimator();
    Ok(Answer::Estimate { segments: estimator.segments().len() as u16, estimate: estimator.estimate() })
}

#[inline(never)]
fn covariance<T: Real>(row: u8, run: &Run<'_, T>) -> Result<Answer, Refusal> {
    complete(run)?;
    if usize::from(row) >= PARAMETERS {
        return Err(Refusal::Nothing);
    }
    let values = run.calibrator().estimator().covariance_row(row.into()).map(Real::widened).data.0[0];
    Ok(Answer::Covariance { row, values })
}

/// Refuses to read an estimate that has no segments or is not complete. Between two pieces of the pass after a stop it is
/// incomplete, and so it stays if the run ends there.
fn complete<T: Real>(run: &Run<'_, T>) -> Result<(), Refusal> {
    let estimator = run.calibrator().estimator();
    if estimator.segments().is_empty() {
        Err(Refusal::Nothing)
    } else if estimator.is_refreshing() {
        Err(idle(run.state()).err().unwrap_or(Refusal::Nothing))
    } else {
        Ok(())
    }
}
