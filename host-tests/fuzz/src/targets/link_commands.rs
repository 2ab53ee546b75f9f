//! A whole instrument at the end of a line that brings commands, damaged commands and commands with wrong numbers.

use super::samples;
use super::{bytes_of, stable_bytes};
use crate::reference::{self, Found};
use crate::source::Source;
use crate::target::{Claim, Outcome, Target};
use host_tests::calibration::raw_sample;
use host_tests::plant::Reading;
use host_tests::power_up::Memory;
use rins_selfcal::calibrator::Calibrator;
use rins_selfcal::estimator::{BASIC_STATES, MAX_SEGMENTS};
use rins_selfcal::gimbal::GimbalStatus;
use rins_selfcal::link::{Answer, Command, Decoder, Link, Moment, PROTOCOL_VERSION, UNLOCK_WORD};
use rins_selfcal::self_calibration::SelfCalibration;
use std::cell::RefCell;

/// An instrument at rest and level.
const STANDING: Reading = Reading {
    time_us: 0,
    omega_g: [0.0; 3],
    force_a: [0.0, 0.0, 9.8],
    outer_rad: 0.0,
    inner_rad: 0.0,
    temperature_c: 25.0,
};

type Memories = Calibrator<f64, MAX_SEGMENTS, BASIC_STATES>;

thread_local! {
    static CALIBRATOR: RefCell<Box<Memories>> = RefCell::new(Box::new(Memories::UNCONFIGURED));
}

/// Streams of commands.
pub struct LinkCommands {
    payloads: Vec<Vec<u8>>,
    unlock: Vec<u8>,
}

impl LinkCommands {
    /// Damage to these.
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

    /// Every whole frame is answered under its number. The configuration stays good, and without an unlock what it was, as
    /// does the memory.
    fn judge(&self, input: &[u8]) -> Outcome {
        CALIBRATOR.with_borrow_mut(|calibrator| serve(input, calibrator))
    }
}

fn serve(input: &[u8], calibrator: &mut Memories) -> Outcome {
    let config = samples::config();
    let mut memory = Memory { stored: Some(samples::record(1)), ..Memory::default() };
    let mut run = SelfCalibration::new(config.clone(), memory.stored.as_ref(), calibrator).expect("it is good");
    let mut link = Link::new();
    let mut answers = Vec::new();
    for (index, byte) in input.iter().enumerate() {
        let moment = Moment { now_us: 1000 * index as u64, missing: 0 };
        if index == 0 || *byte == 0 {
            let sample = raw_sample(&Reading { time_us: 5000 * (1 + index as u64), ..STANDING });
            let _ = run.step(&sample, &GimbalStatus::default(), &mut |_| ());
        }
        link.serve(std::iter::once(*byte), moment, &mut run, &mut memory);
        let sent: Vec<u8> = std::iter::from_fn(|| link.transmit()).collect();
        answers.extend(answers_in(&sent));
    }
    let numbers: Vec<_> = answers.iter().map(|(number, _)| *number).collect();
    let frames = reference::stream(input);
    let expected =
        frames.iter().filter_map(|found| if let Found::Frame(_, number, _) = found { Some(*number) } else { None });
    assert_eq!(numbers, expected.collect::<Vec<_>>());
    assert_eq!(run.config().check(), Ok(()));
    let same = bytes_of(run.config()) == bytes_of(&config);
    if !frames.iter().any(unlocks) {
        assert!(same && memory.stored.is_some(), "changed without an unlock");
    }
    match (same, memory.stored.is_some()) {
        (true, true) if answers.is_empty() => Outcome::refused("nothing"),
        (true, true) => Outcome::accepted("answered", numbers),
        (false, true) => Outcome::accepted("set", numbers),
        (true, false) => Outcome::accepted("erased", numbers),
        (false, false) => Outcome::accepted("set-and-erased", numbers),
    }
}

fn unlocks(found: &Found) -> bool {
    let Found::Frame(b'C', _, payload) = found else { return false };
    matches!(postcard::from_bytes(payload), Ok(Command::Unlock(UNLOCK_WORD)))
}

fn answers_in(bytes: &[u8]) -> Vec<(u16, Answer)> {
    let mut decoder = Decoder::new();
    let answer = |byte: &u8| {
        let frame = decoder.push(*byte)?.expect("the instrument sends whole frames");
        let answer: Answer = frame.read().expect("an answer");
        stable_bytes(&answer);
        Some((frame.number, answer))
    };
    bytes.iter().filter_map(answer).collect()
}
