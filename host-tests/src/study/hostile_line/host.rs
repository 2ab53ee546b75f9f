//! The hostile host, as a part of the plant.

use super::attack::{self, Attack, Random, framed};
use crate::virtual_unit::driven::DrivenRins;
use crate::virtual_unit::plant::{Output, Plant, Tick};
use nix::libc;
use rins_selfcal::gimbal::servo::PERIOD_S;
use rins_selfcal::link::{Answer, Command, Decoder, Lane, Setting, UNLOCK_WORD, lane};
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

/// A board under attack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Nobody has assigned or stored a configuration. The host may unlock it.
    NotCommissioned,
    /// A commissioned board that nobody unlocks.
    Locked,
    /// A commissioned board that the host may unlock.
    Unlocked,
}

impl Target {
    /// All boards.
    pub const ALL: [Self; 3] = [Self::NotCommissioned, Self::Locked, Self::Unlocked];

    /// The part of the time that is spent on this board. Runs take long.
    pub const fn part(self) -> f64 {
        if matches!(self, Self::Unlocked) { 0.5 } else { 0.25 }
    }

    /// Name for tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotCommissioned => "not commissioned",
            Self::Locked => "locked",
            Self::Unlocked => "unlocked",
        }
    }
}

/// Paces of the attacks, bytes in a control period. The last one is as many as the port takes.
const PACES: [f64; 4] = [0.25, 1.0, 4.0, 1e9];
/// Bytes that the host prepares ahead.
const AHEAD_BYTES: usize = 256;
/// Largest number of bytes of an echo that wait. A host that echoes faster than it may send loses bytes.
const ECHO_BYTES: usize = 4096;
/// Longest time of a run under attack, control periods.
const RUN: u64 = 120_000;
/// Interval of the commands of a confused host, control periods.
const CONFUSED: u64 = 400;
/// Interval at which the host asks for an answer after an attack, and the longest time until it comes, control periods.
const ASK: u64 = 2_000;
const ANSWER: u64 = 60_000;
/// Time at the end without an attack, control periods.
const QUIET: u64 = 3_000;
/// Largest movement of an axis that is held, deg.
const HELD_DEG: f64 = 0.01;
/// Rate above which an axis moves, rad/s, and time after a run until its axes are at rest, control periods.
const MOVES_RAD_S: f64 = 0.002;
const COMING_TO_REST: u64 = 3_000;

/// What the host has seen.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// Control periods.
    pub periods: u64,
    /// Bytes that the port took.
    pub bytes: u64,
    /// Frames sent.
    pub frames: u64,
    /// Answers to commands.
    pub answers: u64,
    /// Attacks of each kind.
    pub attacks: [u32; Attack::ALL.len()],
    /// Urgent messages, in order.
    pub urgent: Vec<Message>,
    /// Largest movement without authority, deg.
    pub moved_deg: f64,
    /// Longest time from the end of an attack to an answer, s.
    pub answer_s: f64,
    /// Broken promises.
    pub breaches: Vec<String>,
}

/// What the host does.
#[derive(Clone, Copy, Debug)]
enum Phase {
    Attack(Attack, u64),
    /// The attack has ended at this period; the host waits for the answer to the command of this number, 0 before it has
    /// asked.
    Ask {
        since: u64,
        number: u16,
    },
    Quiet,
}

/// The unit, and the host at its line.
pub struct Besieger {
    rins: DrivenRins,
    serial: PathBuf,
    line: Option<UnixStream>,
    target: Target,
    random: Random,
    config: SelfCalibrationConfig,
    end: u64,
    phase: Phase,
    /// Bytes that may be sent in a control period, and until now.
    pace: f64,
    allowed: f64,
    outgoing: VecDeque<u8>,
    decoder: Decoder,
    number: u16,
    /// The commands under way, by their numbers.
    asked: BTreeMap<u16, Command>,
    /// The state, and the period in which the host learnt of it.
    state: (State, u64),
    heard: Heard,
}

impl Besieger {
    /// The host at the emulator's port `serial`, for this number of control periods.
    pub fn new(
        rins: DrivenRins,
        serial: &Path,
        target: Target,
        random: Random,
        config: &SelfCalibrationConfig,
        periods: u64,
    ) -> Self {
        Self {
            rins,
            serial: serial.into(),
            line: None,
            target,
            random,
            config: config.clone(),
            end: periods,
            phase: Phase::Ask { since: 0, number: 0 },
            pace: f64::INFINITY,
            allowed: 0.0,
            outgoing: VecDeque::new(),
            decoder: Decoder::new(),
            number: 0,
            asked: BTreeMap::new(),
            state: (State::PowerUp, 0),
            heard: Heard::default(),
        }
    }

    /// What the host has seen.
    pub fn heard(&self) -> &Heard {
        &self.heard
    }

    fn breach(&mut self, text: &str) {
        // One kind of breach may last for many periods.
        if self.heard.breaches.len() < 20 {
            self.heard.breaches.push(format!("at {:.3} s: {text}", self.heard.periods as f64 * PERIOD_S));
        }
    }

    // --------------------------------------------------------------------------------------------------------- sending

    fn command(&mut self, command: Command) -> u16 {
        self.number = self.number % 60_000 + 1;
        self.frame(&framed(self.number, &command));
        self.asked.insert(self.number, command);
        self.number
    }

    fn frame(&mut self, bytes: &[u8]) {
        self.heard.frames += 1;
        self.outgoing.extend(bytes);
    }

    fn begin(&mut self) {
        let now = self.heard.periods;
        let is_first = self.heard.attacks.iter().all(|count| *count == 0);
        let runs = self.target == Target::Unlocked && self.state.0.is_idle() && (is_first || self.random.one_in(3));
        let (attack, periods) = if runs {
            self.command(Command::Unlock(UNLOCK_WORD));
            self.command(Command::Start);
            (*self.random.pick(&Attack::SPARING), RUN)
        } else {
            (*self.random.pick(&Attack::ALL), 500 + self.random.below(2500))
        };
        self.pace = *self.random.pick(&PACES);
        if attack == Attack::Echo {
            // So that there is something to echo.
            self.command(Command::Stream(true));
        }
        let kind = Attack::ALL.iter().position(|kind| *kind == attack).unwrap_or(0);
        self.heard.attacks[kind] += 1;
        self.phase = Phase::Attack(attack, now + periods);
    }

    /// Prepares the bytes of an attack.
    fn attack(&mut self, attack: Attack) {
        while self.outgoing.len() < AHEAD_BYTES {
            match attack {
                Attack::Reads => {
                    let read = attack::read(&mut self.random);
                    self.command(read);
                }
                Attack::Commands => {
                    let command = attack::command(&mut self.random, &self.config);
                    self.command(command);
                }
                Attack::Noise => {
                    let noise = match self.random.below(8) {
                        0 => vec![0; 64],
                        1 => vec![0xff; 64],
                        _ => (0..64).map(|_| self.random.byte()).collect(),
                    };
                    self.outgoing.extend(noise);
                }
                Attack::Damaged => {
                    let command = attack::command(&mut self.random, &self.config);
                    let mut frame = framed(self.random.below(60_000) as u16, &command);
                    attack::damage(&mut self.random, &mut frame);
                    self.frame(&frame);
                }
                Attack::Confused => return self.confuse(),
                Attack::Echo => return,
            }
        }
    }

    /// Now and then a command that nobody expects.
    fn confuse(&mut self) {
        if !self.random.one_in(CONFUSED) {
            return;
        }
        if self.target != Target::Locked && self.random.one_in(3) {
            self.command(Command::Unlock(UNLOCK_WORD));
        }
        let command = attack::command(&mut self.random, &self.config);
        if self.random.one_in(2) {
            self.command(command);
            return;
        }
        // Of a board that is unlocked, a changed setting could make a wrong result of a right run.
        let may_change = self.target != Target::Unlocked;
        let is_spared = |command: &Command| match command {
            Command::Set(Setting::Calibrator(_) | Setting::Axes(_) | Setting::Motors(_)) => !may_change,
            Command::Unlock(word) => *word == UNLOCK_WORD,
            _ => false,
        };
        let number = 60_001 + self.random.below(5000) as u16;
        if let Some(frame) = attack::changed(&mut self.random, number, &command, is_spared) {
            self.frame(&frame);
        }
    }

    fn act(&mut self) {
        let now = self.heard.periods;
        match self.phase {
            _ if now + QUIET >= self.end => {
                self.outgoing.clear();
                self.phase = Phase::Quiet;
            }
            Phase::Attack(attack, until) => {
                // The attack on a run ends with the run.
                let is_over = until > now + 5000 && until < now + RUN - 5000 && self.state.0.is_idle();
                if now >= until || is_over {
                    self.end_attack();
                } else {
                    self.attack(attack);
                }
            }
            Phase::Ask { since, .. } if now > since + ANSWER => {
                self.breach("the instrument does not answer after an attack");
                self.begin();
            }
            Phase::Ask { since, number } if number == 0 || (now - since).is_multiple_of(ASK) => {
                // The zero byte ends what the attack has begun.
                self.outgoing.push_back(0);
                let number = self.command(Command::Status);
                self.phase = Phase::Ask { since, number };
            }
            Phase::Ask { .. } | Phase::Quiet => {}
        }
    }

    fn end_attack(&mut self) {
        self.outgoing.clear();
        self.pace = f64::INFINITY;
        self.outgoing.push_back(0);
        self.command(Command::Stream(false));
        self.phase = Phase::Ask { since: self.heard.periods, number: 0 };
    }

    /// Sends what the port takes.
    fn send(&mut self) {
        let Some(line) = &mut self.line else { return };
        // What the port has not taken is not made up for.
        self.allowed = self.allowed.min(1.0) + self.pace;
        loop {
            let ready = self.outgoing.as_slices().0;
            let ready = &ready[..ready.len().min(self.allowed as usize)];
            if ready.is_empty() {
                return;
            }
            match line.write(ready) {
                Ok(count) => {
                    self.outgoing.drain(..count);
                    self.allowed -= count as f64;
                    self.heard.bytes += count as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // The port is full, or the emulator has ended.
                Err(_) => return,
            }
        }
    }

    // -------------------------------------------------------------------------------------------------------- listening

    fn listen(&mut self) {
        let mut bytes = [0; 4096];
        while let Some(line) = &mut self.line
            && let Ok(count @ 1..) = line.read(&mut bytes)
        {
            if matches!(self.phase, Phase::Attack(Attack::Echo, _)) && self.outgoing.len() < ECHO_BYTES {
                self.outgoing.extend(&bytes[..count]);
            }
            bytes[..count].iter().for_each(|byte| self.receive(*byte));
        }
    }

    fn receive(&mut self, byte: u8) {
        let (answer, message) = match self.decoder.push(byte) {
            None => return,
            Some(Ok(frame)) => (frame.read::<Answer>().map(|answer| (frame.number, answer)), frame.read::<Message>()),
            Some(Err(damage)) => return self.breach(&format!("a damaged frame was received: {damage:?}")),
        };
        if let Some(message) = message {
            if let Message::State { state, .. } = message {
                self.state = (state, self.heard.periods);
            }
            if is_awaited(&message) {
                self.heard.urgent.push(message);
            }
        } else if let Some((number @ 1.., answer)) = answer {
            self.answered(number, &answer);
        }
    }

    fn answered(&mut self, number: u16, answer: &Answer) {
        self.heard.answers += 1;
        let asked = self.asked.remove(&number);
        let needs_unlock = matches!(
            asked,
            Some(
                Command::Start
                    | Command::Erase
                    | Command::Commission(_)
                    | Command::Decommission
                    | Command::ConfirmAngles(_)
            )
        ) || matches!(&asked, Some(Command::Set(setting)) if !matches!(setting, Setting::PowerUpUtc(_)));
        if self.target == Target::Locked && needs_unlock && *answer == Answer::Done {
            self.breach(&format!("a locked instrument carried out {asked:?}"));
        }
        if self.target == Target::NotCommissioned && asked == Some(Command::Start) && *answer == Answer::Done {
            self.breach("an instrument that is not commissioned began a run");
        }
        if let Phase::Ask { since, number: awaited } = self.phase
            && awaited == number
        {
            self.heard.answer_s = self.heard.answer_s.max((self.heard.periods - since) as f64 * PERIOD_S);
            // What was not answered by now was damaged or lost with the bytes of a flood.
            self.asked.clear();
            self.begin();
        }
    }

    // -------------------------------------------------------------------------------------------------------- the axes

    fn watch(&mut self, outputs: [Output; 2]) {
        let may_move = self.target == Target::Unlocked;
        if !may_move {
            let moved =
                self.rins.true_angles_rad().into_iter().map(|angle| angle.to_degrees().abs()).fold(0.0, f64::max);
            if moved > HELD_DEG && self.heard.moved_deg <= HELD_DEG {
                self.breach(&format!("an axis moved by {moved:.3} deg"));
            }
            self.heard.moved_deg = self.heard.moved_deg.max(moved);
        }
        let drives = outputs.iter().any(|output| matches!(output, Output::Driven(_)));
        if self.target == Target::NotCommissioned && drives {
            self.breach("a motor of a board that is not commissioned was driven");
        }
        let moves = self.rins.true_rates_rad_s().iter().any(|rate| rate.abs() > MOVES_RAD_S);
        let (state, since) = self.state;
        if may_move && moves && state.is_idle() && self.heard.periods > since + COMING_TO_REST {
            self.breach(&format!("an axis moved while the instrument was {state}"));
        }
    }
}

impl Plant for Besieger {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        if self.heard.periods >= self.end {
            return None;
        }
        if self.line.is_none() {
            self.line = connect(&self.serial).ok();
        }
        let tick = self.rins.advance(outputs);
        self.heard.periods += 1;
        self.watch(outputs);
        self.listen();
        self.act();
        self.send();
        tick
    }
}

/// Whether the host must receive this message. It connects to the emulator's port at the first control period, after the
/// messages of the power-up.
pub fn is_awaited(message: &Message) -> bool {
    lane(message) == Some(Lane::Urgent) && !matches!(message, Message::Store { .. } | Message::Restarted(_))
}

/// Connects to the emulator's port and keeps few bytes on their way, so that an attack ends soon after its last byte.
fn connect(serial: &Path) -> io::Result<UnixStream> {
    let stream = UnixStream::connect(serial)?;
    stream.set_nonblocking(true)?;
    let bytes: libc::c_int = 1;
    // Safety: the descriptor is open, and the option is an integer of the given size. The kernel raises the number to its
    // least one.
    unsafe {
        let value = (&raw const bytes).cast();
        libc::setsockopt(stream.as_raw_fd(), libc::SOL_SOCKET, libc::SO_SNDBUF, value, size_of_val(&bytes) as u32);
    }
    Ok(stream)
}
