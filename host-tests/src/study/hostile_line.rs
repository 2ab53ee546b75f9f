//! The firmware in the emulator with a hostile host at the other end of its serial line: floods, echo, noise, damaged
//! frames, and commands in wrong states. Whatever comes, the firmware is not reset, it loses no urgent message, it still
//! answers afterwards, nothing moves without authority, and nothing wrong is accepted.
//!
//! The host is a part of the plant: it sends and listens once in every control period of emulated time. So its pace
//! does not depend on the machine. How many bytes the emulated port takes in a period does.

mod attack;
mod host;

use self::attack::Random;
use self::host::{Besieger, Heard, Target, is_awaited};
use crate::bench::Bench;
use crate::bench::emulator::image::{Board, Image, build};
use crate::bench::emulator::{MachineSetup, Run, run};
use crate::bench::memory::VirtualEeprom;
use crate::study::fault_campaign::compare;
use crate::study::fault_table::good_calibration;
use crate::virtual_unit::drive::move_durations_s;
use crate::virtual_unit::driven::DrivenRins;
use crate::virtual_unit::presets;
use crate::virtual_unit::unit::VirtualUnit;
use anyhow::{Context, Result};
use rins_selfcal::base::method::Method;
use rins_selfcal::base::restart::{FatalError, Restart};
use rins_selfcal::estimator::Solution;
use rins_selfcal::gimbal::servo::PERIOD_S;
use rins_selfcal::instrument::{Archive, UnitMemory};
use rins_selfcal::keep::mark::Mark;
use rins_selfcal::keep::medium::Eeprom;
use rins_selfcal::keep::partition::Layout;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::{CalibratorConfig, SelfCalibrationConfig};
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::cell::RefCell;

pub use self::attack::Attack;

/// What became of a hostile host's time at the line.
#[derive(Clone, Debug, Default)]
pub struct Siege {
    /// Emulated time, s.
    pub emulated_s: f64,
    /// Duration on the host, s.
    pub wall_s: f64,
    /// Number of bytes that the instrument's port took.
    pub bytes: u64,
    /// Number of frames, whole or damaged, that were sent.
    pub frames: u64,
    /// Number of answers to commands.
    pub answers: u64,
    /// Number of attacks of each kind, in the order of [`Attack::ALL`].
    pub attacks: [u32; Attack::ALL.len()],
    /// Number of urgent messages that the instrument told.
    pub urgent: u64,
    /// Number of these that did not arrive.
    pub lost: u64,
    /// Number of resets, those by a panic included.
    pub resets: u32,
    /// Number of panics.
    pub panics: u32,
    /// Number of runs that were judged, and how many of them were accepted.
    pub judged: [u32; 2],
    /// The largest movement of an axis while nobody had the authority to move it, deg.
    pub moved_deg: f64,
    /// Longest time from the end of an attack to the answer of a command, s.
    pub answer_s: f64,
    /// Every broken promise, in words.
    pub breaches: Vec<String>,
}

/// Lays siege to the firmware for this emulated time: a quarter of it on a board that is not commissioned, a quarter on a
/// commissioned board that nobody unlocks, and half of it on one that a confused host may unlock.
///
/// # Errors
/// The emulator is missing, or the firmware hangs.
pub fn hostile_line(seed: u64, minutes: f64) -> Result<Siege> {
    let image = build(Board::Mps2An500)?;
    let mut siege = Siege::default();
    for (number, target) in (0..).zip(Target::ALL) {
        let periods = (minutes * 60.0 * target.part() / PERIOD_S) as u64;
        besiege(&image, target, Random::new(seed.wrapping_mul(3).wrapping_add(number)), periods, &mut siege)
            .with_context(|| format!("{} board", target.name()))?;
    }
    Ok(siege)
}

fn unit() -> VirtualUnit {
    VirtualUnit { errors: presets::real(1), ..VirtualUnit::default() }
}

/// A memory with some calibrations, whose axes stand at (0, 0).
fn eeprom() -> Result<Vec<u8>> {
    let memory = RefCell::new(Eeprom(VirtualEeprom::blank(Layout::EEPROM_16_KIB.marks.end as usize)));
    let mut archive = UnitMemory::new(&memory, Layout::EEPROM_16_KIB);
    let record = good_calibration();
    let stored = (0..3).all(|_| archive.save(&record)) && archive.mark(Mark::AtRest { angles_rad: [0.0; 2] });
    stored.then_some(()).context("a virtual memory works")?;
    drop(archive);
    Ok(memory.into_inner().0.bytes)
}

fn besiege(image: &Image, target: Target, random: Random, periods: u64, siege: &mut Siege) -> Result<()> {
    let directory = tempfile::tempdir()?;
    let [serial, memory] = ["serial", "eeprom"].map(|name| directory.path().join(name));
    std::fs::write(&memory, eeprom()?)?;
    let (unit, scheme) = (unit(), Scheme::named("fast-60").context("a scheme of the library")?);
    let mut rins = DrivenRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let usual = SelfCalibrationConfig::new(calibrator, scheme);
    let config = SelfCalibrationConfig { policy: PowerUpPolicy::OnCommand, ..usual };
    let mut bench = Bench::new(Besieger::new(rins, &serial, target, random, &config, periods));
    let assignment = Assignment::SelfCalibrate(config);
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = match target {
        Target::NotCommissioned => Default::default(),
        Target::Locked | Target::Unlocked => postcard::to_slice(&assignment, &mut buffer)?,
    };
    let usual = MachineSetup::new(image);
    let setup = MachineSetup { configuration, eeprom: Some(&memory), serial: Some(&serial), reboots: true, ..usual };
    let mut told = Told::default();
    let run = run(&setup, &mut bench, |_| (), |message| told.note(message, &unit))?;
    siege.add(target, &run, &told, bench.into_plant().heard());
    Ok(())
}

/// What the instrument told by the pipe of the bench, on which nothing is lost.
#[derive(Default)]
struct Told {
    urgent: Vec<Message>,
    restarts: Vec<Restart>,
    solution: Option<Solution>,
    judged: [u32; 2],
    wrong: Vec<String>,
}

impl Told {
    fn note(&mut self, message: &Message, unit: &VirtualUnit) {
        match message {
            Message::Restarted(restart) => self.restarts.push(restart.clone()),
            Message::Solved { solution, .. } => self.solution = Some(*solution),
            Message::Judged(verdict) => {
                self.judged[0] += 1;
                self.judged[1] += u32::from(verdict.accepted());
                let wrong = self.solution.and_then(|solution| compare(&solution, &unit.errors).1);
                if let Some(wrong) = wrong.filter(|_| verdict.accepted()) {
                    self.wrong.push(format!("a wrong result was accepted: {wrong:?}"));
                }
            }
            _ => {}
        }
        if is_awaited(message) {
            self.urgent.push(message.clone());
        }
    }
}

impl Siege {
    fn add(&mut self, target: Target, run: &Run, told: &Told, heard: &Heard) {
        let resets = told.restarts.get(1..).unwrap_or_default();
        let panics = resets.iter().filter(|restart| matches!(restart, Restart::Stopped(FatalError::Panic { .. })));
        self.emulated_s += heard.periods as f64 * PERIOD_S;
        self.wall_s += run.wall_s;
        self.bytes += heard.bytes;
        self.frames += heard.frames;
        self.answers += heard.answers;
        self.attacks.iter_mut().zip(heard.attacks).for_each(|(all, some)| *all += some);
        self.urgent += told.urgent.len() as u64;
        self.resets += resets.len() as u32;
        self.panics += panics.count() as u32;
        self.judged.iter_mut().zip(told.judged).for_each(|(all, some)| *all += some);
        self.moved_deg = self.moved_deg.max(heard.moved_deg);
        self.answer_s = self.answer_s.max(heard.answer_s);
        let lost = missing(&told.urgent, &heard.urgent);
        self.lost += lost.len() as u64;
        let lost = lost.into_iter().map(|message| format!("an urgent message was lost: {message:?}"));
        let reset = resets.iter().map(|restart| format!("reset: {restart}"));
        let late = (run.late_periods > 0).then(|| format!("{} control periods began late", run.late_periods));
        let ended = (!run.success).then(|| "the firmware ended with an error".into());
        let breaches =
            heard.breaches.iter().chain(&told.wrong).cloned().chain(reset).chain(lost).chain(late).chain(ended);
        self.breaches.extend(breaches.map(|breach| format!("{} board: {breach}", target.name())));
    }
}

/// The messages that were told and did not arrive. Those that arrive keep their order.
fn missing<'a>(told: &'a [Message], heard: &[Message]) -> Vec<&'a Message> {
    let bytes = |message: &Message| postcard::to_stdvec(message).unwrap_or_default();
    let mut heard = heard.iter().map(bytes).peekable();
    told.iter().filter(|message| heard.next_if_eq(&bytes(message)).is_none()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_that_does_not_arrive_is_missed() {
        let told = [Message::Saved(true), Message::Released, Message::Saved(true), Message::Saved(false)];
        assert_eq!(missing(&told, &told), [] as [&Message; 0]);
        assert_eq!(missing(&told, &told[1..]), [&told[0]]);
        assert_eq!(missing(&told, &told[..3]), [&told[3]]);
        assert_eq!(missing(&told, &[told[0].clone(), told[3].clone()]), [&told[1], &told[2]]);
    }
}
