//! The commands of the serial line: what each command does, and when it is refused.

use super::motion_log::MotionLog;
use super::surroundings::{Archive, Surroundings};
use super::tell::tell;
use crate::base::linear::Real;
use crate::link::{Answer, CONFIRM_TOLERANCE_RAD, Command, Hello, Item, Link, Refusal, Setting, Status};
use crate::model::error_model::PARAMETERS;
use crate::run::config::SelfCalibrationConfig;
use crate::run::policy::Cause;
use crate::run::self_calibration::SelfCalibration;
use crate::run::state::State;
use crate::run::unit::{UnitConfiguration, UnitName};

type Run<'m, T> = SelfCalibration<'m, T>;

/// Carries out one command. Not inlined, as the functions below, so that their stack is free for the other functions.
///
/// # Errors
/// Why the command is refused.
#[inline(never)]
pub(super) fn carry_out<T: Real>(
    command: &Command,
    run: &mut Run<'_, T>,
    motion_log: &mut MotionLog,
    link: &mut Link,
    outside: &mut impl Surroundings<T>,
) -> Result<Answer, Refusal> {
    let now_us = outside.now_us();
    match command {
        Command::Hello => Ok(Answer::Hello(Hello::new::<T>())),
        Command::Status => Ok(Answer::Status(status(run, link, outside))),
        Command::Stop => stop(run, link, outside),
        Command::Abort => abort(run),
        Command::Read(item) => read(*item, run, outside),
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
        Command::Commission(unit) => commission(unit, run, outside),
        Command::Decommission => {
            idle(run.state())?;
            outside.archive().erase_configuration().map(|()| Answer::Done)
        }
        Command::ConfirmAngles(angles_rad) => confirm(*angles_rad, run.state(), motion_log, outside),
    }
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
fn commission<T: Real>(
    unit: &UnitName,
    run: &Run<'_, T>,
    outside: &mut impl Surroundings<T>,
) -> Result<Answer, Refusal> {
    idle(run.state())?;
    let run = SelfCalibrationConfig { utc_s: None, ..run.config().clone() };
    outside.archive().configure(&UnitConfiguration { unit: unit.clone(), run })?;
    Ok(Answer::Done)
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
fn read<T: Real>(item: Item, run: &Run<'_, T>, outside: &mut impl Surroundings<T>) -> Result<Answer, Refusal> {
    let estimator = run.calibrator().estimator();
    let segments = estimator.segments().len() as u16;
    match item {
        Item::Calibration => outside.archive().newest()?.map(Answer::Calibration).ok_or(Refusal::Nothing),
        Item::History { back } => outside.archive().entry(back)?.map(Answer::Calibration).ok_or(Refusal::Nothing),
        Item::Event { back } => outside.event(back).map(Answer::Event).ok_or(Refusal::Nothing),
        Item::Unit => {
            let found = outside.archive().configuration().configuration;
            found.map(|found| Answer::Unit(found.unit)).ok_or(Refusal::Nothing)
        }
        Item::Setting(name) => Ok(Answer::Setting(Setting::of(run.config(), name))),
        Item::Estimate | Item::Covariance { .. } if segments == 0 => Err(Refusal::Nothing),
        // Between two pieces of the pass after a stop the estimate is incomplete, and so it stays if the run ends there.
        Item::Estimate | Item::Covariance { .. } if estimator.is_refreshing() => {
            Err(idle(run.state()).err().unwrap_or(Refusal::Nothing))
        }
        Item::Estimate => Ok(Answer::Estimate { segments, estimate: estimator.estimate() }),
        Item::Covariance { row } if usize::from(row) < PARAMETERS => {
            let values = estimator.covariance_row(row.into()).map(Real::widened).data.0[0];
            Ok(Answer::Covariance { row, values })
        }
        Item::Covariance { .. } => Err(Refusal::Nothing),
    }
}
