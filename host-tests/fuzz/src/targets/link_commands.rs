//! A complete instrument that receives commands, damaged commands and commands with wrong numbers over a line.

use super::samples;
use super::{bytes_of, stable_bytes};
use crate::reference::{self, Found};
use crate::source::Source;
use crate::target::{Claim, Outcome, Target};
use host_tests::bench::power_up::Memory;
use host_tests::calibration::raw_sample;
use host_tests::virtual_unit::plant::Reading;
use rins_selfcal::acquisition::queue::SampleWithGimbal;
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::sample::{CorrectedSample, RawSample, SampleStatus};
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::travel::LocateError;
use rins_selfcal::gimbal::{GimbalStatus, MotionCommand};
use rins_selfcal::instrument::{
    Archive, Axes, CorrectedSink, Events, Instrument, SerialLine, Startup, Surroundings, Telemetry,
};
use rins_selfcal::link::{Answer, Command, Decoder, Link, PROTOCOL_VERSION, Payload, UNLOCK_WORD};
use rins_selfcal::run::calibrator::Calibrator;
use std::cell::RefCell;
use std::collections::VecDeque;

/// An instrument at rest and level.
const AT_REST: Reading = Reading {
    time_us: 0,
    omega_g: [0.0; 3],
    force_a: [0.0, 0.0, 9.8],
    outer_rad: 0.0,
    inner_rad: 0.0,
    temperature_c: 25.0,
};

type Memories = Calibrator<f64, MAX_SEGMENTS>;

thread_local! {
    static CALIBRATOR: RefCell<Box<Memories>> = RefCell::new(Box::new(Memories::UNCONFIGURED));
}

/// Streams of commands.
pub struct LinkCommands {
    payloads: Vec<Vec<u8>>,
    unlock: Vec<u8>,
}

impl LinkCommands {
    /// Makes streams from the sample commands.
    pub fn new() -> Self {
        let samples = samples::all();
        let unlock = reference::frame(PROTOCOL_VERSION, b'C', 1, &bytes_of(&Command::Unlock(UNLOCK_WORD)));
        Self { payloads: samples.of(b'C'), unlock }
    }
}

impl Target for LinkCommands {
    fn name(&self) -> &'static str {
        "link-commands"
    }

    fn moment(&self) -> u64 {
        40
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        if source.one_in(2) {
            input.extend(&self.unlock);
        }
        for _ in 0..=source.below(6) {
            let mut payload = source.pick(&self.payloads).clone();
            if source.one_in(2) {
                source.damage(&mut payload);
            }
            let mut frame = reference::frame(PROTOCOL_VERSION, b'C', 1 + source.bits() as u16 % 999, &payload);
            if source.one_in(8) {
                source.damage(&mut frame);
            }
            input.extend(frame);
        }
        Claim::Nothing
    }

    /// Every complete frame is answered under its number. The configuration stays valid. Without an unlock the
    /// configuration and the memory stay the same.
    fn judge(&self, input: &[u8]) -> Outcome {
        CALIBRATOR.with_borrow_mut(|calibrator| serve(input, calibrator))
    }
}

/// Turns in which all commands of an input are answered: seven commands that each read a slot of 3 KiB in pieces of 32
/// bytes.
const TURNS_TO_ANSWER: u32 = 7 * 3072 / 32 + 7;

fn serve(input: &[u8], calibrator: &mut Memories) -> Outcome {
    let config = samples::config();
    let memory = Memory { stored: Some(samples::record(1)), ..Memory::default() };
    let mut board = Board { memory, ..Board::default() };
    let mut link = Link::new();
    let mut startup = Startup::assigned(config.clone(), Restart::PowerOn);
    let mut instrument =
        Instrument::power_up(&mut startup, &mut link, calibrator, &mut board).expect("a valid configuration");
    for (index, byte) in input.iter().enumerate() {
        board.now_us = 1000 * index as u64;
        if index == 0 || *byte == 0 {
            board.sample = Some(raw_sample(&Reading { time_us: 5000 * (1 + index as u64), ..AT_REST }));
        }
        board.received.push_back(*byte);
        instrument.turn(&mut board);
    }
    // Records are read in pieces, one in a turn, and bytes wait meanwhile. So the last answers come later.
    board.sample = None;
    for _ in 0..TURNS_TO_ANSWER {
        board.now_us += 1000;
        instrument.turn(&mut board);
    }
    let config_now = instrument.run().config().clone();
    let answers = answers_in(&board.sent);
    let numbers: Vec<_> = answers.iter().map(|(number, _)| *number).filter(|number| *number != 0).collect();
    let frames = reference::stream(input);
    let expected =
        frames.iter().filter_map(|found| if let Found::Frame(_, number, _) = found { Some(*number) } else { None });
    assert_eq!(numbers, expected.filter(|number| *number != 0).collect::<Vec<_>>());
    assert_eq!(config_now.check(), Ok(()));
    let same = bytes_of(&config_now) == bytes_of(&config);
    let stored = board.memory.stored.is_some();
    if !frames.iter().any(unlocks) {
        assert!(same && stored, "changed without an unlock");
    }
    match (same, stored) {
        (true, true) if numbers.is_empty() => Outcome::refused("nothing"),
        (true, true) => Outcome::accepted("answered", numbers),
        (false, true) => Outcome::accepted("set", numbers),
        (true, false) => Outcome::accepted("erased", numbers),
        (false, false) => Outcome::accepted("set-and-erased", numbers),
    }
}

/// A board with a memory, a serial line, and a gimbal that does not answer.
#[derive(Default)]
struct Board {
    now_us: u64,
    sample: Option<RawSample<f64>>,
    received: VecDeque<u8>,
    sent: Vec<u8>,
    memory: Memory,
}

impl Surroundings<f64> for Board {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn next_sample(&mut self) -> Option<SampleWithGimbal<f64>> {
        self.sample.take().map(|sample| SampleWithGimbal { sample, gimbal: GimbalStatus::default() })
    }

    fn losses(&mut self) -> LossCounts {
        LossCounts::default()
    }

    fn archive(&mut self) -> &mut impl Archive {
        &mut self.memory
    }
}

impl Axes for Board {
    fn status(&mut self) -> GimbalStatus {
        GimbalStatus::default()
    }

    fn command(&mut self, _motion: MotionCommand, _seen_us: u64) {}

    fn reconfigure(&mut self, _axes: &[AxisLimits; 2], _motors: &[MotorAndLoad; 2]) {}

    fn angles_rad(&mut self) -> [Option<f64>; 2] {
        [Some(0.0); 2]
    }

    fn locate(&mut self, _angles_rad: [Option<f64>; 2], _tolerance_rad: f64) -> Result<(), LocateError> {
        Ok(())
    }
}

impl SerialLine for Board {
    fn receive(&mut self) -> Option<u8> {
        self.received.pop_front()
    }

    fn transmit(&mut self, link: &mut Link) {
        self.sent.extend(std::iter::from_fn(|| link.transmit()));
    }
}

impl CorrectedSink<f64> for Board {
    fn take(&mut self, _sample: &CorrectedSample<f64>, _angles: [Angle; 2], _status: SampleStatus) {}
}

impl Events for Board {}
impl Telemetry for Board {}

fn unlocks(found: &Found) -> bool {
    let Found::Frame(b'C', _, payload) = found else { return false };
    matches!(postcard::from_bytes(payload), Ok(Command::Unlock(UNLOCK_WORD)))
}

/// The answers among the frames that the instrument sent.
fn answers_in(bytes: &[u8]) -> Vec<(u16, Answer)> {
    let mut decoder = Decoder::new();
    let answer = |byte: &u8| {
        let frame = decoder.push(*byte)?.expect("the instrument sends whole frames");
        if frame.kind != Answer::KIND {
            return None;
        }
        let answer: Answer = frame.read().expect("an answer");
        stable_bytes(&answer);
        Some((frame.number, answer))
    };
    bytes.iter().filter_map(answer).collect()
}
