//! The link of an instrument in this process: commands in every state, damaged bytes and hostile bytes.

use host_tests::bench::line::Line;
use host_tests::bench::power_up::{Memory, PIECES, Switched, self_calibrate, shared};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::VirtualUnit;
use proptest::collection::vec;
use proptest::prelude::*;
use rins_selfcal::base::method::Method;
use rins_selfcal::gimbal::servo::PERIOD_US;
use rins_selfcal::link::{
    Answer, Command, Decoder, Item, MAX_FRAME_BYTES, Payload, Refusal, Setting, SettingName, Status, UNLOCK_WORD,
    UNLOCKED_US, encode,
};
use rins_selfcal::run::abort::{Abort, AbortReason};
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::sequencer::Pace;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::VerdictLimits;
use std::collections::VecDeque;

/// A message or an answer of the instrument.
#[derive(Clone, Debug, PartialEq)]
enum Told {
    Message(Message),
    Answer(u16, Answer),
}

/// The other end of the line: receives what the instrument sends, and decides what to send.
struct Partner<F> {
    to_instrument: VecDeque<u8>,
    decoder: Decoder,
    on_told: F,
}

/// Commands and bytes on their way to the instrument.
#[derive(Default)]
struct Sender(Vec<u8>);

impl Sender {
    fn command(&mut self, number: u16, command: &Command) {
        self.0.extend(framed(number, command));
    }
}

fn framed<P: Payload>(number: u16, payload: &P) -> Vec<u8> {
    encode(number, payload, &mut [0; MAX_FRAME_BYTES]).expect("it fits").to_vec()
}

impl<F: FnMut(Told, &mut Sender)> Line for Partner<F> {
    fn receive(&mut self) -> Option<u8> {
        self.to_instrument.pop_front()
    }

    fn transmit(&mut self, next: &mut dyn FnMut() -> Option<u8>) {
        for byte in std::iter::from_fn(next) {
            let Some(frame) = self.decoder.push(byte) else { continue };
            let frame = frame.expect("the instrument sends whole frames");
            let told = match frame.read() {
                Some(answer) => Told::Answer(frame.number, answer),
                None => Told::Message(frame.read().expect("an answer or a message")),
            };
            let mut sender = Sender::default();
            (self.on_told)(told, &mut sender);
            self.to_instrument.extend(sender.0);
        }
    }
}

fn unit() -> VirtualUnit {
    VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() }
}

fn config(policy: PowerUpPolicy) -> SelfCalibrationConfig {
    let unit = unit();
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    SelfCalibrationConfig { policy, ..SelfCalibrationConfig::new(calibrator, Scheme::bai(1.0, 1)) }
}

/// Powers an instrument up with the bytes `first` waiting on its line, and runs it until `on_told` returns true.
fn power_up(
    policy: PowerUpPolicy,
    memory: &mut Memory,
    first: &[u8],
    mut on_told: impl FnMut(&Told, &mut Sender) -> bool,
) -> Vec<Told> {
    let config = config(policy);
    let mut rins = DrivenRins::new(&unit(), 5);
    rins.expect_moves(&move_durations_s(&config.scheme, unit().rate_hz));
    let (plant, off) = Switched::new(rins);
    let mut all = Vec::new();
    let on_told = |told: Told, sender: &mut Sender| {
        if on_told(&told, sender) {
            off.set(true);
        }
        all.push(told);
    };
    let to_instrument = first.iter().copied().collect();
    let mut partner = Partner { to_instrument, decoder: Decoder::new(), on_told };
    self_calibrate::<f64, _>(&config, memory, &shared(plant), &mut partner, &mut |_: &Message| ())
        .expect("a good configuration");
    all
}

fn state(told: &Told) -> Option<State> {
    match told {
        Told::Message(Message::State { state, .. }) => Some(*state),
        _ => None,
    }
}

fn status(told: &Told) -> Option<&Status> {
    match told {
        Told::Answer(_, Answer::Status(status)) => Some(status),
        _ => None,
    }
}

/// Answers to commands with numbers from 1, in order.
fn answers(all: &[Told]) -> Vec<(u16, &Answer)> {
    let answer = |told| match told {
        &Told::Answer(number, ref answer) if number > 0 => Some((number, answer)),
        _ => None,
    };
    all.iter().filter_map(answer).collect()
}

fn refused(refusal: Refusal) -> Answer {
    Answer::Refused(refusal)
}

/// A state's name, without its leg.
fn name(state: State) -> String {
    format!("{state:?}").chars().take_while(char::is_ascii_alphabetic).collect()
}

#[test]
fn commands_that_make_no_sense_in_a_state_are_refused_there() {
    let batch = [
        Command::Unlock(UNLOCK_WORD),
        Command::Start,
        Command::Set(Setting::Pace(Pace { stop_repeats: 2, ..Pace::default() })),
        Command::Erase,
    ];
    let mut seen = Vec::new();
    let mut memory = Memory::default();
    let all = power_up(PowerUpPolicy::Always, &mut memory, &[], |told, sender| {
        let Some(state) = state(told) else { return false };
        // A turn of the main loop answers one command, so the last ones may be answered in the next state.
        if seen.iter().all(|(_, before)| *before != name(state)) && !state.is_idle() {
            let first = 10 * (seen.len() as u16 + 1);
            (first..).zip(&batch).for_each(|(number, command)| sender.command(number, command));
            seen.push((first, name(state)));
        }
        state.is_idle()
    });
    let expected = ["AwaitStill", "Turn", "Settle", "Dwell", "Compute", "Verdict", "Store", "Stopping", "Parking"];
    assert_eq!(seen.iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>(), expected);
    let answers = answers(&all);
    for (number, answer) in &answers {
        match number % 10 {
            0 => assert_eq!(**answer, Answer::Done),
            _ => assert!(matches!(answer, Answer::Refused(Refusal::NotNow(state)) if !state.is_idle()), "{answer:?}"),
        }
    }
    assert_eq!(answers.len(), expected.len() * batch.len());
    assert_eq!(answers.last().map(|last| last.1), Some(&refused(Refusal::NotNow(State::Parking))));
    assert!(memory.saved && memory.stored.is_some());
}

#[test]
fn idle_instruments_start_on_command_are_not_aborted_and_can_be_given_up_once_they_turn() {
    let mut memory = Memory::default();
    let mut aborts = 0;
    let first = [framed(1, &Command::Abort), framed(2, &Command::Start)].concat();
    let all = power_up(PowerUpPolicy::OnCommand, &mut memory, &first, |told, sender| {
        match state(told) {
            Some(State::StandBy) => {
                sender.command(3, &Command::Abort);
                sender.command(4, &Command::Start);
                sender.command(5, &Command::Unlock(UNLOCK_WORD));
                sender.command(6, &Command::Start);
            }
            Some(State::Turn(2)) => sender.command(7, &Command::Abort),
            Some(State::Parking) => sender.command(8, &Command::Abort),
            Some(State::Parked) => aborts += 1,
            _ => {}
        }
        aborts > 0
    });
    let (standing_by, locked) = (refused(Refusal::NotNow(State::StandBy)), refused(Refusal::Locked));
    let done = Answer::Done;
    // The first two came before the first sample decided what to do, or just after it.
    let answers: Vec<_> = answers(&all).into_iter().filter(|(number, _)| *number > 2).collect();
    assert_eq!(answers, [(3, &standing_by), (4, &locked), (5, &done), (6, &done), (7, &done), (8, &done)]);
    let aborted = Abort { reason: AbortReason::Commanded, during: State::Turn(2) };
    assert!(all.contains(&Told::Message(Message::Aborted(aborted))));
    assert!(memory.stored.is_none());
}

#[test]
fn a_policy_of_never_holds_against_commands() {
    let all = power_up(PowerUpPolicy::Never, &mut Memory::default(), &[], |told, sender| {
        if state(told) == Some(State::StandBy) {
            sender.command(1, &Command::Unlock(UNLOCK_WORD));
            sender.command(2, &Command::Start);
        }
        matches!(told, Told::Answer(2, _))
    });
    assert_eq!(answers(&all)[1], (2, &refused(Refusal::Policy)));
}

/// A stored calibration, made by a run.
fn calibrated() -> Memory {
    let mut memory = Memory::default();
    power_up(PowerUpPolicy::Always, &mut memory, &[], |told, _| state(told) == Some(State::Correcting));
    assert!(memory.stored.is_some());
    memory
}

#[test]
fn erasing_and_setting_need_an_unlock_which_times_out() {
    let mut memory = calibrated();
    // The virtual unit has no temperature sensor, and the comparison below would fail, because NaN differs from NaN.
    let stored = memory.stored.as_mut().expect("one");
    stored.temperature_c = 25.0;
    let stored = stored.clone();
    let pace = Setting::Pace(Pace { stop_repeats: 7, ..Pace::default() });
    let mut unlocked_us = 0;
    let mut erased = false;
    let all = power_up(PowerUpPolicy::OnCommand, &mut memory, &[], |told, sender| {
        match told {
            told if state(told) == Some(State::Correcting) => {
                sender.command(1, &Command::Read(Item::Calibration));
                sender.command(2, &Command::Erase);
                sender.command(3, &Command::Unlock(UNLOCK_WORD + 1));
                sender.command(4, &Command::Set(pace.clone()));
                sender.command(5, &Command::Unlock(UNLOCK_WORD));
                sender.command(6, &Command::Set(pace.clone()));
                sender.command(7, &Command::Read(Item::Setting(SettingName::Pace)));
                sender.command(8, &Command::Status);
            }
            Told::Answer(8, Answer::Status(status)) => unlocked_us = status.time_us,
            told if unlocked_us > 0 && !erased && status(told).is_some_and(|status| !status.unlocked) => {
                let after_us = status(told).expect("one").time_us - unlocked_us;
                // The instrument sends its status twice a second.
                assert!((UNLOCKED_US..=UNLOCKED_US + 600_000).contains(&after_us), "{after_us}");
                sender.command(9, &Command::Erase);
                sender.command(10, &Command::Unlock(UNLOCK_WORD));
                sender.command(11, &Command::Erase);
                sender.command(12, &Command::Read(Item::Calibration));
                erased = true;
            }
            _ => {}
        }
        matches!(told, Told::Answer(12, _))
    });
    let answers: Vec<_> = answers(&all).into_iter().filter(|(number, _)| *number != 8).collect();
    let [locked, wrong, nothing] = [Refusal::Locked, Refusal::WrongWord, Refusal::Nothing].map(Answer::Refused);
    let (read, now_set, done) = (Answer::Calibration(stored), Answer::Setting(pace), Answer::Done);
    let expected = [
        (1, &read),
        (2, &locked),
        (3, &wrong),
        (4, &locked),
        (5, &done),
        (6, &done),
        (7, &now_set),
        (9, &locked),
        (10, &done),
        (11, &done),
        (12, &nothing),
    ];
    assert_eq!(answers, expected);
    assert!(memory.stored.is_none());
}

/// A record takes many turns of the main loop, and the next command waits for it. Samples do not.
#[test]
fn a_record_is_read_in_pieces() {
    let mut memory = calibrated();
    let all = power_up(PowerUpPolicy::OnCommand, &mut memory, &[], |told, sender| {
        if state(told) == Some(State::Correcting) {
            sender.command(1, &Command::Status);
            sender.command(2, &Command::Read(Item::History { back: 0 }));
            sender.command(3, &Command::Read(Item::History { back: 9 }));
            sender.command(4, &Command::Status);
        }
        matches!(told, Told::Answer(4, _))
    });
    let answers = answers(&all);
    assert_eq!(answers.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [1, 2, 3, 4]);
    let [Answer::Status(before), Answer::Calibration(_), nothing, Answer::Status(after)] =
        [answers[0].1, answers[1].1, answers[2].1, answers[3].1]
    else {
        panic!("{answers:?}")
    };
    assert_eq!(nothing, &refused(Refusal::Nothing));
    // A turn of the main loop a control period.
    let pieces_us = 2 * u64::from(PIECES) * PERIOD_US;
    assert!((pieces_us..pieces_us + 10 * PERIOD_US).contains(&(after.time_us - before.time_us)), "{after:?}");
    assert_eq!(after.missing, 0);
}

#[test]
fn a_configuration_is_checked_as_at_power_up_and_runs_after_that() {
    let limits = VerdictLimits { scale: f64::NAN, ..VerdictLimits::default() };
    let blind = Scheme { legs: Scheme::bai(1.0, 1).legs.iter().take(2).copied().collect(), ..Scheme::bai(1.0, 1) };
    let slow = Scheme::bai(0.5, 1);
    let commands = [
        Command::Unlock(UNLOCK_WORD),
        Command::Set(Setting::Limits(limits)),
        Command::Set(Setting::Scheme(blind)),
        Command::Read(Item::Setting(SettingName::Scheme)),
        Command::Set(Setting::Scheme(slow.clone())),
        Command::Start,
    ];
    let all = power_up(PowerUpPolicy::OnCommand, &mut Memory::default(), &[], |told, sender| {
        if state(told) == Some(State::StandBy) {
            (1..).zip(&commands).for_each(|(number, command)| sender.command(number, command));
        }
        // The second stop under way: the first was the new scheme's.
        state(told) == Some(State::Turn(1))
    });
    let answers = answers(&all);
    assert_eq!(answers[1].1, &refused(Refusal::Config(ConfigError::Limits)));
    assert!(matches!(answers[2].1, Answer::Refused(Refusal::Config(ConfigError::Unobserved(_)))), "{:?}", answers[2]);
    assert_eq!(answers[3].1, &Answer::Setting(Setting::Scheme(Scheme::bai(1.0, 1))));
    assert_eq!((answers[4].1, answers[5].1), (&Answer::Done, &Answer::Done));
    let entered = |of: State| {
        all.iter().find_map(|told| match told {
            Told::Message(Message::State { time_us, state, .. }) if *state == of => Some(*time_us),
            _ => None,
        })
    };
    let stop_us = entered(State::Turn(1)).expect("it turned") - entered(State::Dwell(0)).expect("it stood");
    assert!(stop_us.abs_diff(500_000) <= 5_000, "{stop_us}");
}

#[test]
fn time_left_counts_down_to_the_end_of_measuring() {
    let mut left = Vec::new();
    let all = power_up(PowerUpPolicy::Always, &mut Memory::default(), &[], |told, _| {
        left.extend(status(told).filter(|status| status.state.is_under_way()).map(|s| (s.time_us, s.left_s, s.state)));
        state(told) == Some(State::Correcting)
    });
    let end_us = all.iter().find_map(|told| match told {
        Told::Message(Message::State { time_us, state: State::Compute, .. }) => Some(*time_us),
        _ => None,
    });
    let end_us = end_us.expect("it computed");
    assert!(left.len() > 100);
    for (time_us, left_s, state) in left.into_iter().filter(|(time_us, ..)| *time_us < end_us) {
        let true_s = (end_us - time_us) as f32 * 1e-6;
        // In each of 18 moves, the axis arrives up to 0.3 s after the end of its profile. The time at rest before the
        // run is not part of the prediction.
        assert!((true_s - left_s).abs() < 0.3 * 18.0 + 1.5, "{state:?}: {left_s} said, {true_s} true");
    }
}

#[test]
fn only_frames_of_commands_are_answered_and_all_are_counted() {
    // A command number of no version, and an answer in place of a command.
    let unknown = [framed(4, &Answer::Done), framed(3, &Unknown(200))].concat();
    let all = power_up(PowerUpPolicy::OnCommand, &mut Memory::default(), &unknown, |told, sender| {
        if matches!(told, Told::Answer(3, _)) {
            sender.0.extend([1, 2, 3, 0]);
            sender.command(5, &Command::Status);
        }
        matches!(told, Told::Answer(5, _))
    });
    let answers = answers(&all);
    assert_eq!(answers[0], (3, &refused(Refusal::NotUnderstood)));
    let Answer::Status(status) = answers[1].1 else { panic!("{answers:?}") };
    assert_eq!((status.link.not_understood, status.link.dropped.corrupt), (2, 1));
}

/// A command that this version does not know.
#[derive(serde::Serialize, serde::Deserialize)]
struct Unknown(u8);

impl Payload for Unknown {
    const KIND: u8 = b'C';
}

/// Some commands, long and short.
fn any_command() -> impl Strategy<Value = Command> {
    prop_oneof![
        Just(Command::Hello),
        Just(Command::Start),
        any::<u32>().prop_map(Command::Unlock),
        any::<u8>().prop_map(|row| Command::Read(Item::Covariance { row })),
        (1_u8..48).prop_map(|legs| {
            let scheme = Scheme::bai(1.0, 1);
            let legs = scheme.legs.iter().cycle().take(legs.into()).copied().collect();
            Command::Set(Setting::Scheme(Scheme { legs, ..scheme }))
        }),
    ]
}

fn commands(decoder: &mut Decoder, bytes: &[u8]) -> Vec<(u16, Command)> {
    let mut all = Vec::new();
    for byte in bytes {
        if let Some(Ok(frame)) = decoder.push(*byte) {
            all.extend(frame.read().map(|command| (frame.number, command)));
        }
    }
    all
}

proptest! {
    /// Whatever came before, a frame that follows a zero byte is received.
    #[test]
    fn garbage_costs_nothing_after_the_next_zero(
        garbage in vec(any::<u8>(), 0..4000), command in any_command(), number in any::<u16>()
    ) {
        let mut decoder = Decoder::new();
        commands(&mut decoder, &garbage);
        let bytes = [vec![0], framed(number, &command)].concat();
        // Garbage may end in a whole frame that the zero byte completes; it cannot be one with a right CRC.
        prop_assert_eq!(commands(&mut decoder, &bytes), [(number, command)]);
    }

    /// A stream has one damaged byte. All frames are received except those to which the byte belongs.
    #[test]
    fn one_damaged_place_costs_the_frames_it_touches(
        all in vec(any_command(), 3..8), place in any::<prop::sample::Index>(), damage in 1_u8..
    ) {
        let frames: Vec<_> = (1..).zip(&all).map(|(number, command)| framed(number, command)).collect();
        let mut bytes = frames.concat();
        let place = place.index(bytes.len());
        bytes[place] ^= damage;
        let mut end = 0;
        let ends: Vec<_> = frames.iter().map(|frame| { end += frame.len(); end }).collect();
        let hit = ends.iter().position(|end| place < *end).expect("within");
        // If the damaged byte is a zero byte at the end of a frame, that frame and the next one become one.
        let joined = hit + usize::from(place + 1 == ends[hit]);
        let expected: Vec<_> = (1..).zip(all).enumerate()
            .filter(|(index, _)| !(hit..=joined).contains(index))
            .map(|(_, numbered)| numbered)
            .collect();
        prop_assert_eq!(commands(&mut Decoder::new(), &bytes), expected);
    }

    /// Every command is received as it was sent, and a command that is cut is not received.
    #[test]
    fn commands_come_whole_or_not_at_all(command in any_command(), number in any::<u16>(), cut in any::<prop::sample::Index>()) {
        let frame = framed(number, &command);
        prop_assert_eq!(commands(&mut Decoder::new(), &frame), [(number, command)]);
        let cut = cut.index(frame.len() - 1);
        prop_assert_eq!(commands(&mut Decoder::new(), &[&frame[..cut], &[0]].concat()), []);
    }
}
