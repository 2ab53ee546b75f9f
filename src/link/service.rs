//! Carries out commands: what each means to the run and the store, and when it makes no sense.

use super::lock::Lock;
use super::protocol::{Answer, Command, Hello, Item, Refusal, Setting, Status};
use super::{Link, LinkCounts};
use crate::base::linear::Real;
use crate::keep::black_box::Entry;
use crate::keep::medium::Medium;
use crate::keep::store::CalibrationStore;
use crate::model::error_model::PARAMETERS;
use crate::run::result::StoredCalibration;
use crate::run::self_calibration::SelfCalibration;
use crate::run::state::State;

/// The memories of an instrument, as commands see them.
pub trait Archive {
    /// The calibration that would be used at the next power-up.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work.
    fn newest(&mut self) -> Result<Option<StoredCalibration>, Refusal>;

    /// An entry of the history of calibrations, 0 the newest, rejected ones included; `None` beyond the last.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work.
    fn entry(&mut self, back: u16) -> Result<Option<StoredCalibration>, Refusal>;

    /// An event of the black box, 0 the newest; `None` beyond the last.
    fn event(&mut self, back: u16) -> Option<Entry>;

    /// Erases all that is stored.
    ///
    /// # Errors
    /// [`Refusal::Memory`]: the memory does not work.
    fn erase(&mut self) -> Result<(), Refusal>;
}

/// A store and a black box, of which `event` gives an event, 0 the newest.
#[derive(Debug)]
pub struct Memories<'s, M, E> {
    /// The store.
    pub store: &'s mut CalibrationStore<M>,
    /// The black box.
    pub event: E,
}

impl<M: Medium, E: FnMut(u16) -> Option<Entry>> Archive for Memories<'_, M, E> {
    fn newest(&mut self) -> Result<Option<StoredCalibration>, Refusal> {
        self.store.newest_record().map_err(|_| Refusal::Memory)
    }

    fn entry(&mut self, back: u16) -> Result<Option<StoredCalibration>, Refusal> {
        let entry = self.store.entry(back.into()).map_err(|_| Refusal::Memory)?;
        Ok(entry.map(|(_, record)| record))
    }

    fn event(&mut self, back: u16) -> Option<Entry> {
        (self.event)(back)
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        self.store.erase().map_err(|_| Refusal::Memory)
    }
}

/// What a board tells at the time of a command.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Time since power-up, us.
    pub now_us: u64,
    /// Samples that never came.
    pub missing: u32,
}

impl Link {
    /// Answers the commands in the bytes that came in, as far as `bytes` gives them.
    pub fn serve<T: Real, const STATES: usize>(
        &mut self,
        bytes: impl Iterator<Item = u8>,
        moment: Moment,
        run: &mut SelfCalibration<'_, T, STATES>,
        archive: &mut impl Archive,
    ) {
        for byte in bytes {
            if let Some((number, command)) = self.receive(byte) {
                self.answer(number, &command, moment, run, archive);
            }
        }
    }

    /// Carries out and replies.
    #[inline(never)]
    fn answer<T: Real, const STATES: usize>(
        &mut self,
        number: u16,
        command: &Command,
        moment: Moment,
        run: &mut SelfCalibration<'_, T, STATES>,
        archive: &mut impl Archive,
    ) {
        match self.carry_out(command, moment, run, archive) {
            Ok(answer) => self.reply(number, &answer),
            Err(refusal) => self.reply(number, &Answer::Refused(refusal)),
        }
    }

    /// Tells the status where it is due: twice a second.
    pub fn tell_status<T: Real, const STATES: usize>(&mut self, moment: Moment, run: &SelfCalibration<'_, T, STATES>) {
        if self.is_status_due(moment.now_us) {
            self.volunteer(&Answer::Status(status(moment, run, self.counts(), &self.lock)));
        }
    }

    #[inline(never)]
    fn carry_out<T: Real, const STATES: usize>(
        &mut self,
        command: &Command,
        moment: Moment,
        run: &mut SelfCalibration<'_, T, STATES>,
        archive: &mut impl Archive,
    ) -> Result<Answer, Refusal> {
        match command {
            Command::Hello => Ok(Answer::Hello(Hello::new::<T>(STATES))),
            Command::Status => Ok(Answer::Status(status(moment, run, self.counts(), &self.lock))),
            Command::Start => start(run),
            Command::Abort => abort(run),
            Command::Read(item) => read(*item, run, archive),
            Command::Unlock(word) if self.lock.unlock(*word, moment.now_us) => Ok(Answer::Done),
            Command::Unlock(_) => Err(Refusal::WrongWord),
            Command::Set(_) | Command::Erase if !self.lock.is_unlocked(moment.now_us) => Err(Refusal::Locked),
            Command::Set(setting) => set(setting, run),
            Command::Erase => erase(run.state(), archive),
        }
    }
}

fn status<T: Real, const STATES: usize>(
    moment: Moment,
    run: &SelfCalibration<'_, T, STATES>,
    link: LinkCounts,
    lock: &Lock,
) -> Status {
    Status {
        time_us: moment.now_us,
        state: run.state(),
        legs: run.legs(),
        segments: run.calibrator().estimator().segments().len() as u16,
        left_s: run.left_s() as f32,
        angles_rad: run.angles_rad().map_or([f32::NAN; 2], |angles| angles.map(|angle| angle as f32)),
        correcting: run.is_correcting(),
        unlocked: lock.is_unlocked(moment.now_us),
        missing: moment.missing,
        link,
    }
}

/// Done while no run is under way.
fn idle(state: State) -> Result<(), Refusal> {
    if state.is_idle() { Ok(()) } else { Err(Refusal::NotNow(state)) }
}

fn start<T: Real, const STATES: usize>(run: &mut SelfCalibration<'_, T, STATES>) -> Result<Answer, Refusal> {
    idle(run.state())?;
    if run.start() { Ok(Answer::Done) } else { Err(Refusal::Policy) }
}

fn abort<T: Real, const STATES: usize>(run: &mut SelfCalibration<'_, T, STATES>) -> Result<Answer, Refusal> {
    if !run.state().is_under_way() {
        return Err(Refusal::NotNow(run.state()));
    }
    run.abort();
    Ok(Answer::Done)
}

#[inline(never)]
fn set<T: Real, const STATES: usize>(
    setting: &Setting,
    run: &mut SelfCalibration<'_, T, STATES>,
) -> Result<Answer, Refusal> {
    idle(run.state())?;
    run.reconfigure(|config| setting.put(config)).map_err(Refusal::Config)?;
    Ok(Answer::Done)
}

fn erase(state: State, archive: &mut impl Archive) -> Result<Answer, Refusal> {
    idle(state)?;
    archive.erase()?;
    Ok(Answer::Done)
}

#[inline(never)]
fn read<T: Real, const STATES: usize>(
    item: Item,
    run: &SelfCalibration<'_, T, STATES>,
    archive: &mut impl Archive,
) -> Result<Answer, Refusal> {
    let estimator = run.calibrator().estimator();
    let segments = estimator.segments().len() as u16;
    match item {
        Item::Calibration => archive.newest()?.map(Answer::Calibration).ok_or(Refusal::Nothing),
        Item::History { back } => archive.entry(back)?.map(Answer::Calibration).ok_or(Refusal::Nothing),
        Item::Event { back } => archive.event(back).map(Answer::Event).ok_or(Refusal::Nothing),
        Item::Setting(name) => Ok(Answer::Setting(Setting::of(run.config(), name))),
        _ if segments == 0 => Err(Refusal::Nothing),
        Item::Estimate => Ok(Answer::Estimate { segments, estimate: estimator.estimate() }),
        Item::Covariance { row } if usize::from(row) < PARAMETERS => {
            let values = estimator.covariance_row(row.into()).map(Real::widened).data.0[0];
            Ok(Answer::Covariance { row, values })
        }
        Item::Covariance { .. } => Err(Refusal::Nothing),
    }
}
