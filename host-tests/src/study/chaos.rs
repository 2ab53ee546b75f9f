//! An instrument in chaos: random samples, clocks, faults, resets and commands, in any order. Whatever happens, nothing
//! moves without authority, and nothing wrong is accepted.
//!
//! The axes of the board follow every command, but the gyros do not feel it. So every result is wrong, and none may be
//! accepted.

use crate::bench::power_up::Memory;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rins_selfcal::acquisition::queue::SampleWithGimbal;
use rins_selfcal::base::angle::{Angle, rad_to_ticks};
use rins_selfcal::base::linear::{Real, Vector3, real};
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::sample::{CorrectedSample, RawSample, SampleStatus};
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::travel::LocateError;
use rins_selfcal::gimbal::{EncoderFault, Fault, FaultKind, GimbalStatus, MotionCommand};
use rins_selfcal::instrument::{
    Archive, Axes, CorrectedSink, Events, Instrument, SerialLine, Startup, Surroundings, Telemetry,
};
use rins_selfcal::link::{Answer, Command, Decoder, Item, Link, MAX_FRAME_BYTES, Setting, UNLOCK_WORD, encode};
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::collections::{BTreeMap, VecDeque};

/// Interval of the samples, us.
const INTERVAL_US: u64 = 5000;
/// Step of an axis in one interval, rad.
const STEP_RAD: f64 = 1e-2;

/// What happened in a number of steps.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chaos {
    /// Number of power-ups.
    pub power_ups: u32,
    /// Number of moves that the instrument commanded.
    pub moves: u32,
    /// Number of runs that were judged.
    pub judged: u32,
    /// Number of steps in each state.
    pub states: BTreeMap<String, u64>,
    /// Every breach of a promise, in words.
    pub breaches: Vec<String>,
}

/// Runs an instrument with numbers of type `T` for this number of steps. A step is a sample and a turn of the main
/// loop.
pub fn chaos<T: Real>(seed: u64, steps: u64) -> Chaos {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let (mut told, mut left) = (Chaos::default(), steps);
    let mut memory = Memory::default();
    while left > 0 {
        let until_reset = left.min(1 + random.below(16_000));
        power_up::<T>(&mut random, until_reset, &mut memory, &mut told);
        left -= until_reset;
    }
    told
}

struct Random(Xoshiro256PlusPlus);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }

    fn one_in(&mut self, many: u64) -> bool {
        self.below(many) == 0
    }

    /// From -1 to 1.
    fn part(&mut self) -> f64 {
        self.below(2001) as f64 * 1e-3 - 1.0
    }

    fn pick<'a, V>(&mut self, all: &'a [V]) -> &'a V {
        &all[self.below(all.len() as u64) as usize]
    }
}

/// One start of the software, for this number of steps.
fn power_up<T: Real>(random: &mut Random, steps: u64, memory: &mut Memory, told: &mut Chaos) {
    told.power_ups += 1;
    let restarts = [
        Restart::PowerOn,
        Restart::PowerOn,
        Restart::Pin,
        Restart::Pin,
        Restart::Watchdog,
        Restart::BrownOut,
        Restart::Unexplained,
    ];
    let restart = random.pick(&restarts).clone();
    let config = config(random);
    let locked = !matches!(restart, Restart::PowerOn | Restart::Pin);
    let may_move = !locked && config.policy == PowerUpPolicy::Always;
    let mut board = Board::<T>::new(memory, told, (locked, may_move), random.one_in(3));
    let (mut link, mut calibrator) = (Link::new(), Box::new(Calibrator::<T, MAX_SEGMENTS>::UNCONFIGURED));
    let mut startup = Startup::assigned(config, restart);
    let mut instrument =
        Instrument::power_up(&mut startup, &mut link, &mut calibrator, &mut board).expect("a valid configuration");
    for _ in 0..steps {
        board.disturb(random);
        instrument.turn(&mut board);
        board.follow();
        *board.told.states.entry(name(&format!("{:?}", instrument.run().state()))).or_default() += 1;
    }
}

fn name(state: &str) -> String {
    state.chars().take_while(char::is_ascii_alphabetic).collect()
}

fn config(random: &mut Random) -> SelfCalibrationConfig {
    let Assignment::SelfCalibrate(mut config) = Assignment::default() else { unreachable!("the default calibrates") };
    config.scheme = Scheme::bai(0.6, 1);
    config.pace.early_finish = random.one_in(2);
    config.policy = if random.one_in(2) { PowerUpPolicy::Always } else { PowerUpPolicy::OnCommand };
    if random.one_in(3) {
        config.calibrator.estimator.noise.margin = 1e3;
        config.pace.longest_s = Some(60.0);
    }
    config
}

/// A board whose samples, clock, gimbal and line are random.
struct Board<'a, T: Real> {
    memory: &'a mut Memory,
    told: &'a mut Chaos,
    sample: Option<RawSample<T>>,
    now_us: u64,
    time_us: u64,
    at_rad: [f64; 2],
    target_rad: [f64; 2],
    fault: Option<Fault>,
    commands: u16,
    to_instrument: VecDeque<u8>,
    decoder: Decoder,
    /// The commands under way, by their numbers.
    asked: BTreeMap<u16, Command>,
    number: u16,
    locked: bool,
    may_move: bool,
    /// Whether commands, faults and jumps of the clock are left out, so that a run comes to its end.
    quiet: bool,
}

impl<'a, T: Real> Board<'a, T> {
    fn new(memory: &'a mut Memory, told: &'a mut Chaos, (locked, may_move): (bool, bool), quiet: bool) -> Self {
        Self {
            memory,
            told,
            sample: None,
            now_us: 0,
            time_us: 0,
            at_rad: [0.0; 2],
            target_rad: [0.0; 2],
            fault: None,
            commands: 0,
            to_instrument: VecDeque::new(),
            decoder: Decoder::new(),
            asked: BTreeMap::new(),
            number: 0,
            locked,
            may_move,
            quiet,
        }
    }

    /// What happens before a turn of the main loop.
    fn disturb(&mut self, random: &mut Random) {
        self.now_us += INTERVAL_US;
        self.time_us += INTERVAL_US;
        if !self.quiet && random.one_in(20_000) {
            self.time_us += random.below(50_000_000);
        }
        if !self.quiet && random.one_in(50_000) {
            self.time_us = self.time_us.saturating_sub(random.below(100_000_000));
        }
        if !self.quiet && random.one_in(200_000) {
            self.time_us = *random.pick(&[0, u64::MAX / 2, 1]);
        }
        if !self.quiet && random.one_in(4_000) {
            self.fail(random);
        }
        if random.one_in(700) {
            self.command_something(random);
        }
        if random.one_in(5_000) {
            self.to_instrument.extend((0..random.below(3000)).map(|_| random.below(256) as u8));
        }
        self.sample = (!random.one_in(3_000)).then(|| self.measure(random));
        if random.one_in(100_000) {
            // Samples stop for a while.
            self.sample = None;
            self.now_us += random.below(3_000_000);
        }
    }

    fn fail(&mut self, random: &mut Random) {
        let following = FaultKind::Following { error_rad: 1.0 };
        let kind = *random.pick(&[following, FaultKind::Encoder(EncoderFault::Silent)]);
        self.fault = Some(Fault { axis: random.below(2) as u8, angle_rad: 0.0, kind });
        self.target_rad = self.at_rad;
    }

    /// Sends a command. A run that nobody disturbs takes some thousand steps.
    fn command_something(&mut self, random: &mut Random) {
        if self.quiet {
            return;
        }
        let pace =
            |stop_repeats| Setting::Pace(rins_selfcal::run::sequencer::Pace { stop_repeats, ..Default::default() });
        let commands = [
            Command::Hello,
            Command::Status,
            Command::Start,
            Command::Start,
            Command::Abort,
            Command::Stop,
            Command::Unlock(UNLOCK_WORD),
            Command::Unlock(UNLOCK_WORD),
            Command::Unlock(1),
            Command::Stream(random.one_in(2)),
            Command::Set(pace(random.below(5) as u8)),
            Command::Set(Setting::PowerUpUtc(Some(1_790_000_000))),
            Command::Read(Item::Estimate),
            Command::Read(Item::Calibration),
            Command::Read(Item::Covariance { row: random.below(40) as u8 }),
            Command::Erase,
        ];
        let command = random.pick(&commands).clone();
        self.number = self.number % 60_000 + 1;
        let mut frame = [0; MAX_FRAME_BYTES];
        let mut bytes = vec![0];
        bytes.extend(encode(self.number, &command, &mut frame).expect("it fits"));
        if random.one_in(10) {
            let place = random.below(bytes.len() as u64) as usize;
            bytes[place] ^= 1 << random.below(8);
        }
        self.asked.insert(self.number, command);
        self.to_instrument.extend(bytes);
    }

    fn measure(&self, random: &mut Random) -> RawSample<T> {
        let mut noise = |size: f64| real::<T>(random.part() * size);
        let mut sample = RawSample {
            time_us: self.time_us,
            omega_g: Vector3::new(noise(1e-6), noise(1e-6), noise(1e-6)),
            force_a: Vector3::new(noise(1e-3), noise(1e-3), real::<T>(9.79) + noise(1e-3)),
            outer: Angle::from_ticks(rad_to_ticks(self.at_rad[0]) as u32),
            inner: Angle::from_ticks(rad_to_ticks(self.at_rad[1]) as u32),
            temperature_c: if random.one_in(7) { f32::NAN } else { 25.0 },
        };
        match random.below(3000) {
            0 => sample.omega_g.x = real(f64::NAN),
            1 => sample.force_a.z = real(1e30),
            2 => sample.omega_g.y = real(-1e37),
            3 => sample.force_a.x = real(f64::INFINITY),
            _ => {}
        }
        sample
    }

    /// The axes move on towards their targets.
    fn follow(&mut self) {
        for (at, target) in self.at_rad.iter_mut().zip(self.target_rad) {
            *at += (target - *at).clamp(-STEP_RAD, STEP_RAD);
        }
    }

    fn gimbal(&self) -> GimbalStatus {
        let at_rest = self.at_rad == self.target_rad;
        let Self { now_us, commands, fault, .. } = *self;
        GimbalStatus {
            time_us: now_us,
            commands,
            arrived: at_rest,
            at_rest,
            move_us: 5_000_000,
            fault,
            ..GimbalStatus::default()
        }
    }

    fn breach(&mut self, text: &str) {
        self.told.breaches.push(format!("power-up {}, {} us: {text}", self.told.power_ups, self.now_us));
    }

    /// An answer shows which command took effect.
    fn answered(&mut self, number: u16, answer: &Answer) {
        if *answer != Answer::Done {
            return;
        }
        match self.asked.get(&number) {
            Some(Command::Start) => (self.locked, self.may_move) = (false, true),
            Some(Command::Stop) => self.may_move = false,
            _ => {}
        }
    }
}

impl<T: Real> Surroundings<T> for Board<'_, T> {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn next_sample(&mut self) -> Option<SampleWithGimbal<T>> {
        let gimbal = self.gimbal();
        self.sample.take().map(|sample| SampleWithGimbal { sample, gimbal })
    }

    fn losses(&mut self) -> LossCounts {
        LossCounts::default()
    }

    fn archive(&mut self) -> &mut impl Archive {
        self.memory
    }
}

impl<T: Real> Axes for Board<'_, T> {
    fn status(&mut self) -> GimbalStatus {
        self.gimbal()
    }

    fn command(&mut self, motion: MotionCommand, _seen_us: u64) {
        if self.locked {
            self.breach(&format!("{motion:?} while motion is locked"));
        }
        self.commands = self.commands.wrapping_add(1);
        self.fault = None;
        match motion {
            MotionCommand::MoveTo { angles_rad, .. } => {
                self.told.moves += 1;
                if !self.may_move {
                    self.breach(&format!("{motion:?} that nobody asked for"));
                }
                self.target_rad = angles_rad;
            }
            MotionCommand::Hold | MotionCommand::Release => self.target_rad = self.at_rad,
        }
    }

    fn reconfigure(&mut self, _axes: &[AxisLimits; 2], _motors: &[MotorAndLoad; 2]) {}

    fn angles_rad(&mut self) -> [Option<f64>; 2] {
        self.at_rad.map(Some)
    }

    fn locate(&mut self, _angles_rad: [Option<f64>; 2], _tolerance_rad: f64) -> Result<(), LocateError> {
        Ok(())
    }
}

impl<T: Real> CorrectedSink<T> for Board<'_, T> {
    fn take(&mut self, _sample: &CorrectedSample<T>, _angles: [Angle; 2], _status: SampleStatus) {}
}

impl<T: Real> Events for Board<'_, T> {}

impl<T: Real> Telemetry for Board<'_, T> {
    fn tell(&mut self, message: &Message, _frame: Option<&[u8]>) {
        if let Message::Judged(verdict) = message {
            self.told.judged += 1;
            if verdict.accepted() {
                self.breach("a wrong result was accepted");
            }
        }
    }
}

impl<T: Real> SerialLine for Board<'_, T> {
    fn receive(&mut self) -> Option<u8> {
        self.to_instrument.pop_front()
    }

    fn transmit(&mut self, link: &mut Link) {
        while let Some(byte) = link.transmit() {
            let answer = match self.decoder.push(byte) {
                Some(Ok(frame)) => frame.read::<Answer>().map(|answer| (frame.number, answer)),
                Some(Err(damage)) => return self.breach(&format!("a damaged frame was sent: {damage:?}")),
                None => None,
            };
            if let Some((number, answer)) = answer {
                self.answered(number, &answer);
            }
        }
    }
}
