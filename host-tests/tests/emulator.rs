//! The firmware image in the emulator.

use anyhow::Result;
use host_tests::bench::emulator::image::{Board, Image, Variant, build};
use host_tests::bench::emulator::{MachineSetup, Run, run};
use host_tests::bench::power_up::{MessageDigest, Switched, in_emulator, in_process, share, shared};
use host_tests::bench::{Bench, Chip, Imu};
use host_tests::files::unit_file::UnitConfig;
use host_tests::log::{LogPlayer, LogReader};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::plant::{Output, Plant, Recording, at_rest};
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::site::EARTH_RATE_RAD_S;
use rins_selfcal::drivers::kvh1750::{HEADER, MESSAGE_BYTES};
use rins_selfcal::estimator::Estimate;
use rins_selfcal::gimbal::{Travel, TurnSource};
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS};
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::{Scheme, SchemeError};
use std::f64::consts::TAU;
use std::path::Path;
use std::time::Duration;

struct Outcome {
    run: Run,
    log: Vec<String>,
    messages: Vec<Message>,
}

impl Outcome {
    fn queue(&self) -> (u64, LossCounts) {
        match self.messages.last() {
            Some(Message::Queue { samples, losses }) => (*samples, *losses),
            other => panic!("{other:?}, {:?}", self.log),
        }
    }

    fn states(&self) -> Vec<State> {
        let state = |message: &Message| match message {
            Message::State { state, .. } => Some(*state),
            _ => None,
        };
        self.messages.iter().filter_map(state).collect()
    }

    fn record(&self) -> Option<Estimate> {
        self.messages.iter().find_map(|message| match message {
            Message::Solved { solution, .. } => Some(solution.estimate),
            _ => None,
        })
    }
}

fn image(variant: impl Into<Variant>) -> Image {
    build(variant).unwrap_or_else(|error| panic!("{error:#}"))
}

fn try_run<P: Plant>(setup: &MachineSetup<'_>, bench: &mut Bench<P>) -> Result<Outcome> {
    let (mut log, mut messages) = (Vec::new(), Vec::new());
    let run = run(setup, bench, |line| log.push(line.to_owned()), |message| messages.push(message.clone()))?;
    Ok(Outcome { run, log, messages })
}

fn outcome(setup: &MachineSetup<'_>, bench: &mut Bench<impl Plant>) -> Outcome {
    try_run(setup, bench).unwrap_or_else(|error| panic!("{error:#}"))
}

#[test]
fn every_sample_is_delivered() {
    for board in [Board::Mps2An500, Board::Mps2An386] {
        let image = image(board);
        let mut bench = Bench::new(at_rest(2000));
        let outcome = outcome(&MachineSetup::new(&image), &mut bench);
        assert!(outcome.run.success);
        assert_eq!(outcome.queue(), (2000, LossCounts::default()));
        assert_eq!(outcome.run.late_periods, 0);
        assert!(outcome.log.iter().any(|line| line.contains("2000 samples, 0 missing")), "{:?}", outcome.log);
        assert_eq!(bench.samples(), 2000);
        assert_eq!(bench.outputs(), [Output::Shorted; 2]);
        assert_eq!((outcome.run.late_periods, outcome.run.late_commands), (0, 0));
    }
}

#[test]
fn edges_come_at_200_hz() {
    let image = image(Board::Mps2An500);
    let run = |samples| outcome(&MachineSetup::new(&image), &mut Bench::new(at_rest(samples))).run.elapsed_s;
    assert!((run(3000) - run(1000) - 10.0).abs() < 1e-4);
}

#[test]
fn a_run_repeats_to_the_tick() {
    let image = image(Board::Mps2An500);
    let run = || outcome(&MachineSetup::new(&image), &mut Bench::new(at_rest(1000))).run;
    let (first, second) = (run(), run());
    assert_eq!((first.elapsed_s, first.instructions), (second.elapsed_s, second.instructions));
}

#[test]
fn damaged_frames_are_counted() {
    let image = image(Board::Mps2An500);
    let mut bench = Bench::new(at_rest(1000));
    let mut transfers = 0;
    bench.damage(move |chip, frame| {
        transfers += u32::from(chip == Chip::Imu);
        if chip == Chip::Imu && transfers % 100 == 0 {
            frame[30] ^= 4;
        }
    });
    let outcome = outcome(&MachineSetup::new(&image), &mut bench);
    assert_eq!(outcome.queue(), (990, LossCounts { crc: 10, ..LossCounts::default() }));
}

/// A unit with the errors `real` and noise of navigation grade, and a scheme with short stops.
fn unit() -> (VirtualUnit, Scheme) {
    (VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() }, Scheme::bai(2.0, 1))
}

fn assignment(unit: &VirtualUnit, scheme: &Scheme) -> Assignment {
    let noise = unit.noise.psd();
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, noise, unit.rate_hz);
    let policy = PowerUpPolicy::WhenDue { age_s: None, temperature_k: None };
    Assignment::SelfCalibrate(SelfCalibrationConfig {
        policy,
        ..SelfCalibrationConfig::new(calibrator, scheme.clone())
    })
}

/// The unit with a switch.
type Unit = Switched<DrivenRins>;

/// Makes a bench with the unit on it.
type Put = fn(Unit) -> Bench<Unit>;

/// Powers the unit up with this EEPROM. Switches it off after it has reported three corrected samples at the end of the
/// run.
fn boot(image: &Image, eeprom: &Path) -> Outcome {
    boot_on(image, Some(eeprom), &unit().1, Bench::new).0
}

/// As [`boot`], with any scheme and bench. Also returns the number of samples that the IMU has given.
fn boot_on(image: &Image, eeprom: Option<&Path>, scheme: &Scheme, put: Put) -> (Outcome, u32) {
    let (unit, _) = unit();
    let mut rins = DrivenRins::new(&unit, 5);
    rins.expect_moves(&move_durations_s(scheme, unit.rate_hz));
    let (plant, off) = Switched::new(rins);
    let (mut log, mut messages, mut ended, mut corrected) = (Vec::new(), Vec::new(), false, 0);
    let on_message = |message: &Message| {
        ended |= matches!(message, Message::State { state: State::Correcting, .. });
        corrected += u32::from(ended && matches!(message, Message::Corrected { .. }));
        off.set(corrected >= 3);
        messages.push(message.clone());
    };
    let assignment = assignment(&unit, scheme);
    let mut bench = put(plant);
    let run = in_emulator(&assignment, image, eeprom, &mut bench, |line| log.push(line.to_owned()), on_message);
    (Outcome { run: run.unwrap_or_else(|error| panic!("{error:#}")), log, messages }, bench.samples())
}

#[test]
fn a_unit_calibrates_at_power_up_and_finds_its_record_at_the_next() {
    powers_up_twice(Board::Mps2An500);
}

#[test]
fn so_does_one_of_single_precision() {
    powers_up_twice(Board::Mps2An386);
}

fn store_at_power_up(found: bool, damaged: bool) -> Message {
    Message::Store { found, damaged, fault: false, other_version: None }
}

fn powers_up_twice(board: Board) {
    let image = image(board);
    let directory = tempfile::tempdir().expect("a directory");
    let eeprom = directory.path().join("eeprom.bin");
    let first = boot(&image, &eeprom);
    assert_eq!(first.messages.first(), Some(&store_at_power_up(false, false)));
    assert_eq!(first.states().last(), Some(&State::Correcting), "{:?}", first.log);
    assert!(first.messages.contains(&Message::Saved(true)));
    assert_eq!(first.queue().1, LossCounts::default());
    within_sigmas(&first.record().expect("a solution"), &unit().0);
    assert_eq!((first.run.late_periods, first.run.late_commands), (0, 0));
    assert_eq!(
        told(&first.messages),
        told(&booted_in_process(board, &unit().1, Bench::new)),
        "every bit of every message"
    );
    let second = boot(&image, &eeprom);
    assert_eq!(second.messages.first(), Some(&store_at_power_up(true, false)));
    assert_eq!(second.states(), [State::Correcting]);
    assert_eq!(second.record(), None);
    corrected_as_felt(&second);
    // The only record is damaged now. The unit reports the damage and calibrates itself again.
    flip(&eeprom, 100);
    let third = boot(&image, &eeprom);
    assert_eq!(third.messages.first(), Some(&store_at_power_up(false, true)));
    assert!(third.log.iter().any(|line| line.contains("a slot damaged: true")), "{:?}", third.log);
    assert_eq!(third.record(), first.record(), "the same unit, the same noise");
    assert!(third.messages.contains(&Message::Saved(true)));
}

/// The messages of a run until samples are corrected.
fn told(messages: &[Message]) -> Vec<Vec<u8>> {
    let run = messages.iter().take_while(|message| !matches!(message, Message::Corrected { .. }));
    run.map(|message| postcard::to_stdvec(message).expect("messages serialize")).collect()
}

/// Messages of the same unit with an empty store, run in this process.
fn booted_in_process(board: Board, scheme: &Scheme, put: Put) -> Vec<Message> {
    let (unit, _) = unit();
    let mut rins = DrivenRins::new(&unit, 5);
    rins.expect_moves(&move_durations_s(scheme, unit.rate_hz));
    let (plant, off) = Switched::new(rins);
    let mut messages = Vec::new();
    let on_message = |message: &Message| {
        off.set(matches!(message, Message::Corrected { .. }));
        messages.push(message.clone());
    };
    let (assignment, bench) = (assignment(&unit, scheme), share(put(plant)));
    let ended = match board {
        Board::Mps2An500 | Board::Stm32h743 => in_process::<f64, _>(&assignment, None, &bench, on_message),
        Board::Mps2An386 => in_process::<f32, _>(&assignment, None, &bench, on_message),
    };
    ended.unwrap_or_else(|error| panic!("{error:#}"));
    messages
}

#[test]
fn a_unit_with_a_kvh_1750_calibrates() {
    let (losses, _) = calibrates_with_kvh_1750(|plant| Bench::with_imu(plant, Imu::Kvh1750));
    assert_eq!(losses, LossCounts::default());
}

/// Every fiftieth message has a wrong bit or lacks a byte, in turn, each time at the next place. The driver loses and
/// counts these messages and no others, and the unit calibrates. A message with a sound header fails by its CRC; any
/// other one counts as missing.
#[test]
fn so_does_one_whose_line_is_bad() {
    let (losses, messages) = calibrates_with_kvh_1750(|plant| {
        let mut bench = Bench::with_imu(plant, Imu::Kvh1750);
        let mut messages = 0..;
        bench.damage(move |chip, bytes| {
            if chip == Chip::Imu
                && let Some(Harm::WrongBit(place)) = messages.next().and_then(harm)
            {
                bytes[place] ^= 1 << (place % 8);
            }
        });
        bench.lose(|byte| harm(byte / MESSAGE_BYTES as u64) == Some(Harm::LostByte(byte as usize % MESSAGE_BYTES)));
        bench
    });
    let (mut crc, mut unread) = (0, 0);
    for Harm::WrongBit(place) | Harm::LostByte(place) in (0..messages).filter_map(harm) {
        *(if place < HEADER.len() { &mut unread } else { &mut crc }) += 1;
    }
    assert!(crc + unread > 2 * MESSAGE_BYTES as u32, "both at every place");
    assert_eq!(losses, LossCounts { crc, unread, ..LossCounts::default() });
}

/// Damage of a message on the line, and the byte at which it occurs.
#[derive(PartialEq)]
enum Harm {
    WrongBit(usize),
    LostByte(usize),
}

fn harm(message: u64) -> Option<Harm> {
    let (turn, rest) = (message / 50, message % 50);
    let place = (turn / 2) as usize % MESSAGE_BYTES;
    let harm = if turn.is_multiple_of(2) { Harm::WrongBit(place) } else { Harm::LostByte(place) };
    // The very first message is spared: its loss could not be noticed.
    (rest == 25).then_some(harm)
}

/// Counts of lost samples, and the number of messages that were received or missed.
fn calibrates_with_kvh_1750(put: Put) -> (LossCounts, u64) {
    let image = image(Variant { imu: Imu::Kvh1750, ..Board::Mps2An500.into() });
    let scheme = Scheme::named("fast-60").expect("in the library");
    let (outcome, sent) = boot_on(&image, None, &scheme, put);
    assert_eq!(outcome.states().last(), Some(&State::Correcting), "{:?}", outcome.log);
    assert!(outcome.messages.contains(&Message::Saved(true)));
    within_sigmas(&outcome.record().expect("a solution"), &unit().0);
    assert_eq!((outcome.run.late_periods, outcome.run.late_commands), (0, 0));
    let in_process = booted_in_process(Board::Mps2An500, &scheme, put);
    assert_eq!(told(&outcome.messages), told(&in_process), "every bit of every message");
    let (taken, losses) = outcome.queue();
    let messages = taken + u64::from(losses.total());
    // When the unit is switched off, the last message may still be on the line, and the loss of the one before may not
    // have been noticed yet.
    assert!((messages..messages + 3).contains(&sent.into()), "{messages} of {sent}");
    (losses, messages)
}

#[test]
fn an_image_for_another_imu_is_refused() {
    let image = Image { imu: Imu::Kvh1750, ..image(Board::Mps2An500) };
    let error = try_run(&MachineSetup::new(&image), &mut Bench::new(at_rest(10))).err().expect("an error");
    assert!(error.to_string().contains("IMU"), "{error:#}");
}

#[test]
fn a_scheme_that_cannot_be_run_is_refused_by_its_reason() {
    let image = image(Board::Mps2An500);
    let changed = |change: &dyn Fn(&mut Scheme)| {
        let mut scheme = Scheme::bai(2.0, 1);
        change(&mut scheme);
        scheme
    };
    let cases = [
        (changed(&|scheme| scheme.legs[4].outer_rad = 13.0), ConfigError::Travel { leg: 5, axis: 0 }),
        (changed(&|scheme| scheme.rate_rad_s = 2.0), ConfigError::TooFast(0)),
        (changed(&|scheme| scheme.legs[2].stop_s = 0.0), ConfigError::Scheme(SchemeError::Stop(3))),
        (changed(&|scheme| scheme.legs[2].stop_s = -1.0), ConfigError::Scheme(SchemeError::Stop(3))),
        (changed(&|scheme| scheme.legs[2].stop_s = 0.3), ConfigError::ShortStop(3)),
        // The scheme has half turns from level only, so that gravity acts on accelerometer z alone. The first parameter
        // that is not observed is Sgxz.
        (Scheme::named("8-position").expect("in the library"), ConfigError::Unobserved(1)),
    ];
    for (scheme, error) in cases {
        let (unit, _) = unit();
        let mut bench = Bench::new(DrivenRins::new(&unit, 5));
        let mut messages = Vec::new();
        let told = |message: &Message| messages.push(message.clone());
        let Assignment::SelfCalibrate(mut config) = assignment(&unit, &scheme) else { unreachable!("it calibrates") };
        config.axes.iter_mut().for_each(|axis| axis.travel = Travel::around(-2.0 * TAU, 2.0 * TAU, TurnSource::Stored));
        // The firmware ends with an error. The messages have the reason.
        let _ = in_emulator(&Assignment::SelfCalibrate(config), &image, None, &mut bench, |_| (), told);
        assert_eq!(messages.last(), Some(&Message::Refused(error)), "{messages:?}");
    }
}

/// All parameters are within 4.5 sigma of the truth. Chance exceeds this for one of 28 with a probability of 2e-4.
fn within_sigmas(estimate: &Estimate, unit: &VirtualUnit) {
    let difference = estimate.errors.to_vector() - unit.errors.to_vector();
    for (index, (difference, sigma)) in difference.iter().zip(&estimate.sigmas).enumerate() {
        let turns = if index == PARAMETERS - 1 { (difference / TAU).round() } else { 0.0 };
        let error = difference - turns * TAU;
        assert!(error.abs() < 4.5 * sigma, "{}: {:.1} sigma", PARAMETER_INFO[index].name, error / sigma);
    }
}

/// At rest the corrected force is gravity and the corrected rate the Earth's, to the noise of one sample (5 sigma).
fn corrected_as_felt(outcome: &Outcome) {
    let (unit, _) = unit();
    let corrected = outcome.messages.iter().filter_map(|message| match message {
        Message::Corrected { force_s, omega_is_s, .. } => Some((*force_s, *omega_is_s)),
        _ => None,
    });
    let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    for (force_s, omega_is_s) in corrected {
        let force = length(force_s) - unit.site.gravity_m_s2();
        assert!(force.abs() < 5.0 * unit.noise.sigma_force_m_s2(unit.rate_hz), "{force}");
        let rate = length(omega_is_s);
        assert!((rate - EARTH_RATE_RAD_S).abs() < 5.0 * 3.0_f64.sqrt() * unit.noise.sigma_omega_rad_s(unit.rate_hz));
    }
}

#[test]
fn host_and_target_agree_to_the_last_bit() {
    for (board, method) in [
        (Board::Mps2An500, Method::Joint),
        (Board::Mps2An386, Method::Joint),
        (Board::Mps2An500, Method::Bai),
        (Board::Mps2An386, Method::Bai),
    ] {
        let target = recorded(
            |assignment, bench, digest| {
                let image = image(board);
                let add = |message: &Message| digest.add(message);
                in_emulator(assignment, &image, None, bench, |_| (), add).map(|_| ())
            },
            method,
        );
        let host = recorded_in_process(board, method);
        assert_eq!(target, host, "{board:?} {method:?}");
        println!("{board:?} {method:?}: digest of all messages {host:016x}");
    }
}

/// Digest of the recorded log's messages.
fn recorded(
    run: impl FnOnce(&Assignment, &mut Bench<Recording<LogPlayer>>, &mut MessageDigest) -> Result<()>,
    method: Method,
) -> u64 {
    let (assignment, player) = recording(method);
    let mut digest = MessageDigest::default();
    run(&assignment, &mut Bench::new(player), &mut digest).unwrap_or_else(|error| panic!("{error:#}"));
    digest.finish()
}

fn recorded_in_process(board: Board, method: Method) -> u64 {
    let (assignment, player) = recording(method);
    let mut digest = MessageDigest::default();
    let add = |message: &Message| digest.add(message);
    let bench = shared(player);
    let outcome = match board {
        Board::Mps2An500 | Board::Stm32h743 => in_process::<f64, _>(&assignment, None, &bench, add),
        Board::Mps2An386 => in_process::<f32, _>(&assignment, None, &bench, add),
    };
    outcome.unwrap_or_else(|error| panic!("{error:#}"));
    digest.finish()
}

fn recording(method: Method) -> (Assignment, Recording<LogPlayer>) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let unit = UnitConfig::read(&data.join("sample.toml")).expect("the unit");
    let config = CalibratorConfig::new(method, unit.site(), unit.noise.psd(), 200.0);
    let log = LogReader::open(&data.join("sample.csv.gz")).expect("the log");
    (Assignment::Replay(config), Recording::new(LogPlayer::new(log)))
}

fn flip(path: &Path, offset: usize) {
    let mut bytes = std::fs::read(path).expect("the EEPROM");
    bytes[offset] ^= 0x20;
    std::fs::write(path, bytes).expect("the EEPROM");
}

#[test]
fn a_hang_is_an_error() {
    let image = image(Board::Mps2An500);
    let setup = MachineSetup { patience: Duration::ZERO, ..MachineSetup::new(&image) };
    // There are so many samples that the host waits for the firmware at least once, even on a busy machine.
    let error = try_run(&setup, &mut Bench::new(at_rest(1_000_000))).err().expect("an error");
    assert!(error.to_string().contains("hangs"), "{error:#}");
}

#[test]
fn an_image_that_is_none_is_an_error() {
    let image = Image { path: "/dev/null".into(), board: Board::Mps2An500, imu: Imu::Adis16495 };
    let setup = MachineSetup::new(&image);
    assert!(try_run(&setup, &mut Bench::new(at_rest(10))).is_err());
}
