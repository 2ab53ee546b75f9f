//! The image of the board STM32H743 on the register model of its chip: what it does with sound and with faulty hardware.

use host_tests::bench::emulator::MachineSetup;
use host_tests::bench::emulator::h743::{
    Change, Ended, RECORDS, RecordFlash, Report, calibrations, commission, read_flash, run_frames, write_flash,
};
use host_tests::bench::emulator::image::{Board, Variant, build};
use host_tests::bench::power_up::Switched;
use host_tests::bench::{Bench, Imu, Trouble};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::clock_check::ClockFault;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::restart::{FatalError, Registers, Restart, Task};
use rins_selfcal::estimator::Estimate;
use rins_selfcal::link::{Answer, Command, Item, MAX_FRAME_BYTES, Refusal, UNLOCK_WORD, encode};
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS};
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::{CalibratorConfig, SelfCalibrationConfig};
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::unit::UnitName;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::Reason;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A unit with an empty flash, and how its next power-up is to be.
struct PowerUp {
    imu: Imu,
    directory: TempDir,
    policy: PowerUpPolicy,
    reboots: bool,
    /// Longest time of the run, s.
    longest_s: u32,
    machine: Vec<String>,
    /// The trouble that the outer axis gets in the first move.
    trouble: Option<Trouble>,
}

/// What a power-up has shown.
struct Outcome {
    report: Report,
    log: Vec<String>,
    messages: Vec<Message>,
    answers: Vec<(u16, Answer)>,
}

/// A time in the first move of the scheme, counted from the start of the IMU's pulses.
const IN_FIRST_MOVE_US: u64 = 6_500_000;
const WHEN_DUE: PowerUpPolicy = PowerUpPolicy::WhenDue { age_s: None, temperature_k: None };

fn unit() -> VirtualUnit {
    VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() }
}

impl PowerUp {
    fn new(machine: &str) -> Self {
        Self {
            imu: Imu::Adis16495,
            directory: tempfile::tempdir().expect("a directory"),
            policy: WHEN_DUE,
            reboots: false,
            longest_s: 120,
            machine: machine.split_whitespace().map(str::to_owned).collect(),
            trouble: None,
        }
    }

    fn flash(&self) -> PathBuf {
        self.directory.path().join("flash")
    }

    fn assignment(&self) -> Vec<u8> {
        let unit = unit();
        let scheme = Scheme::named("fast-60").expect("in the library");
        let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
        let config = SelfCalibrationConfig { policy: self.policy, ..SelfCalibrationConfig::new(calibrator, scheme) };
        let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
        postcard::to_slice(&Assignment::SelfCalibrate(config), &mut buffer).expect("it fits").to_vec()
    }

    /// Runs until `ends` is true for a message.
    fn until(&self, ends: impl Fn(&Message) -> bool) -> Outcome {
        let image =
            build(Variant { board: Board::Stm32h743, imu: self.imu }).unwrap_or_else(|error| panic!("{error:#}"));
        let scheme = Scheme::named("fast-60").expect("in the library");
        let unit = unit();
        let mut rins = DrivenRins::new(&unit, 5);
        rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
        let (plant, off) = Switched::new(rins);
        let mut bench = Bench::with_imu(plant, self.imu);
        if let Some(trouble) = self.trouble {
            bench.plan_trouble(IN_FIRST_MOVE_US, 0, trouble);
        }
        let (assignment, flash) = (self.assignment(), self.flash());
        let longest = format!("--longest-s={}", self.longest_s);
        let arguments: Vec<&str> =
            [longest.as_str()].into_iter().chain(self.machine.iter().map(String::as_str)).collect();
        let setup = MachineSetup {
            eeprom: Some(&flash),
            configuration: &assignment,
            reboots: self.reboots,
            arguments: &arguments,
            ..MachineSetup::new(&image)
        };
        let (mut log, mut messages, mut answers) = (Vec::new(), Vec::new(), Vec::new());
        let report = run_frames(
            &setup,
            &mut bench,
            |line| log.push(line.to_owned()),
            |frame| {
                if frame.is::<Message>() {
                    let message = frame.read()?;
                    off.set(off.get() || ends(&message));
                    messages.push(message);
                } else {
                    answers.push((frame.number, frame.read()?));
                }
                Some(())
            },
        );
        let report = report.unwrap_or_else(|error| panic!("{error:#}; {log:#?}"));
        assert!(report.violations.is_empty(), "{:?}", report.violations);
        Outcome { report, log, messages, answers }
    }

    /// Sends these commands, the first one 2 s after power-on.
    fn send(&mut self, commands: &[(u16, Command)]) {
        for (number, asked) in commands {
            self.machine.push("--receive".into());
            self.machine.push(format!("{}@{}", command(*number, asked), 1_900_000 + 100_000 * u32::from(*number)));
        }
    }

    /// Runs until the first move to the scheme's second stop.
    fn until_it_turns(&self) -> Outcome {
        self.until(|message| matches!(message, Message::State { state: State::Turn(1), .. }))
    }

    /// Runs a whole calibration, until samples are corrected or the gimbals are parked.
    fn whole(&self) -> Outcome {
        self.until(|message| matches!(message, Message::State { state: State::Correcting | State::Parked, .. }))
    }
}

fn state(message: &Message) -> Option<State> {
    match message {
        Message::State { state, .. } => Some(*state),
        _ => None,
    }
}

impl Outcome {
    fn has_logged(&self, part: &str) -> bool {
        self.log.iter().any(|line| line.contains(part))
    }

    fn states(&self) -> Vec<State> {
        self.messages.iter().filter_map(state).collect()
    }

    fn restarts(&self) -> Vec<Restart> {
        let restart = |message: &Message| match message {
            Message::Restarted(restart) => Some(restart.clone()),
            _ => None,
        };
        self.messages.iter().filter_map(restart).collect()
    }

    fn found(&self) -> (bool, bool, bool) {
        let found = |message: &Message| match message {
            Message::Store { found, damaged, fault, .. } => Some((*found, *damaged, *fault)),
            _ => None,
        };
        self.messages.iter().find_map(found).unwrap_or_else(|| panic!("{:?}", self.log))
    }

    fn solution(&self) -> Estimate {
        let solved = |message: &Message| match message {
            Message::Solved { solution, .. } => Some(solution.estimate),
            _ => None,
        };
        self.messages.iter().find_map(solved).unwrap_or_else(|| panic!("{:?}", self.log))
    }

    fn judged(&self) -> (bool, Vec<Reason>) {
        let judged = |message: &Message| match message {
            Message::Judged(verdict) => {
                Some((verdict.accepted(), verdict.reasons.iter().chain(&verdict.changes).copied().collect()))
            }
            _ => None,
        };
        self.messages.iter().find_map(judged).unwrap_or_else(|| panic!("{:?}", self.log))
    }
}

/// All parameters are within 4.5 sigma of the truth.
fn within_sigmas(estimate: &Estimate) {
    let difference = estimate.errors.to_vector() - unit().errors.to_vector();
    for (index, (difference, sigma)) in difference.iter().zip(&estimate.sigmas).enumerate() {
        let turns = if index == PARAMETERS - 1 { (difference / TAU).round() } else { 0.0 };
        let error = difference - turns * TAU;
        assert!(error.abs() < 4.5 * sigma, "{}: {:.1} sigma", PARAMETER_INFO[index].name, error / sigma);
    }
}

// ------------------------------------------------------------------------------------------------- calibrate and store

/// A whole run over an older calibration, and then the power cut in each word that it has written to store the result.
#[test]
fn it_calibrates_and_stores_and_corrects_and_no_cut_loses_a_calibration() {
    let mut unit = PowerUp::new("");
    let first = unit.whole();
    assert!(first.messages.contains(&Message::Saved(true)), "{:?}", first.log);
    assert_eq!(first.states().last(), Some(&State::Correcting));
    within_sigmas(&first.solution());
    assert_eq!((first.report.late_periods, first.report.overruns, first.report.resets), (0, [0, 0], 0));
    println!(
        "a whole run: {:.1} s of instrument time, {:.1} s wall",
        first.report.elapsed_us * 1e-6,
        first.report.wall_s
    );

    // The second power-up corrects with what the first one has stored.
    let second = unit.until(|message| matches!(message, Message::Corrected { .. }));
    assert_eq!((second.found(), second.states()), ((true, false, false), vec![State::Correcting]));

    // The power is cut in each word of the second calibration of the same unit.
    unit.policy = PowerUpPolicy::Always;
    commission(&unit.flash(), &unit.assignment()).expect("a configuration");
    let before = read_flash(&unit.flash()).expect("the flash");
    let old = calibrations(&before);
    let again = unit.whole();
    let new = calibrations(&read_flash(&unit.flash()).expect("the flash"));
    assert_eq!((old.len(), new.len()), (1, 2));
    let is_of_calibrations = |change: &Change| match change {
        Change::Erased(at) | Change::Programmed(at, _) => *at >= RECORDS + 4 * 128 * 1024,
    };
    let changes: Vec<Change> =
        again.report.flash_changes.iter().filter(|change| is_of_calibrations(change)).cloned().collect();
    assert!(changes.len() > 10, "{} words", changes.len());
    let mut with_new = 0;
    for cut in 0..=changes.len() {
        for torn in [false, true] {
            let Some(flash) = cut_flash(&before, &changes, cut, torn) else { continue };
            let kept = calibrations(&flash);
            assert!(kept == old || kept == new, "cut after {cut} words, torn: {torn}: a calibration is lost");
            with_new += u32::from(kept == new);
            // The firmware sees the same as the host.
            let after = PowerUp { policy: WHEN_DUE, ..PowerUp::new("") };
            write_flash(&after.flash(), &flash).expect("the flash");
            let booted = after.until(|message| matches!(message, Message::Corrected { .. }));
            assert!(booted.found().0 && !booted.found().2, "cut after {cut} words: {:?}", booted.log);
        }
    }
    assert_eq!(with_new, 1, "only the last word makes the record whole");
    println!("the power was cut at {} words of a save, each done or torn; no calibration was lost", changes.len());
}

/// The flash after some changes, and with the next word torn.
fn cut_flash(before: &RecordFlash, changes: &[Change], cut: usize, torn: bool) -> Option<RecordFlash> {
    let mut flash = before.clone();
    for change in &changes[..cut] {
        apply(&mut flash, change);
    }
    if torn {
        let Change::Programmed(address, _) = changes.get(cut)? else { return None };
        flash.set_readable((address - RECORDS) as usize, false);
    }
    Some(flash)
}

fn apply(flash: &mut RecordFlash, change: &Change) {
    match change {
        Change::Erased(address) => {
            let start = (address - RECORDS) as usize;
            flash.bytes[start..start + 128 * 1024].fill(0xff);
        }
        Change::Programmed(address, word) => {
            let start = (address - RECORDS) as usize;
            flash.bytes[start..start + word.len()].copy_from_slice(word);
        }
    }
}

#[test]
fn a_unit_with_a_kvh_1750_calibrates_and_tells_that_its_clock_was_not_checked() {
    let outcome = PowerUp { imu: Imu::Kvh1750, ..PowerUp::new("--lse absent") }.whole();
    let (accepted, told) = outcome.judged();
    assert!(accepted && outcome.messages.contains(&Message::Saved(true)), "{:?}", outcome.log);
    assert!(told.contains(&Reason::Clock(ClockFault::Unchecked)), "{told:?}");
    within_sigmas(&outcome.solution());
    assert_eq!((outcome.report.late_periods, outcome.report.overruns), (0, [0, 0]));
}

// --------------------------------------------------------------------------------------------------------------- clock

#[test]
fn a_result_on_a_wrong_clock_is_rejected() {
    // The RC oscillator of the ST-LINK was reported to be off by 0.4 %.
    let outcome = PowerUp::new("--clock-ppm 4000").whole();
    let (accepted, told) = outcome.judged();
    assert!(!accepted && !outcome.messages.contains(&Message::Saved(true)));
    let off = |reason: &Reason| matches!(reason, Reason::Clock(ClockFault::Off(ppm)) if (ppm - 4000.0).abs() < 1.0);
    assert!(told.iter().any(off), "{told:?}");
}

#[test]
fn without_the_external_clock_it_starts_on_the_internal_one_and_says_so() {
    let outcome = PowerUp::new("--hse absent").until_it_turns();
    assert_eq!(outcome.report.ended, Ended::SwitchedOff);
    assert!(outcome.has_logged("the external clock does not run"), "{:?}", outcome.log);
}

#[test]
fn a_good_clock_is_not_mentioned() {
    for ppm in ["-40", "40"] {
        let outcome = PowerUp::new(&format!("--clock-ppm {ppm}")).until_it_turns();
        assert_eq!(
            (outcome.report.ended, outcome.has_logged("clock")),
            (Ended::SwitchedOff, false),
            "{:?}",
            outcome.log
        );
    }
}

#[test]
fn a_revision_that_does_not_allow_480_mhz_stops() {
    let outcome = PowerUp::new("--revision y").until_it_turns();
    assert_eq!(outcome.report.ended, Ended::Reset);
    assert!(outcome.has_logged("this revision of the chip is too slow"), "{:?}", outcome.log);
}

// ------------------------------------------------------------------------------------------------------------- devices

#[test]
fn an_imu_that_starts_late_is_waited_for() {
    // The data sheet's 250 ms; a slow supply; an IMU that is not there.
    for (start_ms, turns) in [(250, true), (700, true), (20_000, false)] {
        let outcome = PowerUp::new(&format!("--imu-start-ms {start_ms}")).until_it_turns();
        assert_eq!(outcome.report.ended == Ended::SwitchedOff, turns, "{start_ms} ms: {:?}", outcome.log);
        assert_eq!(outcome.has_logged("the IMU does not start"), !turns);
    }
}

/// At 262 ns, the encoders' bits change when SPI mode 3 samples; at 133 ns, when mode 2 samples.
#[test]
fn the_encoders_are_sampled_when_their_line_is_stable() {
    for delay_ns in [5, 133, 262] {
        let outcome = PowerUp::new(&format!("--encoder-delay-ns {delay_ns}")).until_it_turns();
        assert_eq!(outcome.report.ended, Ended::SwitchedOff);
        let faults = outcome.messages.iter().filter(|message| matches!(message, Message::Fault(_)));
        assert_eq!(faults.count(), 0, "{delay_ns} ns: {:?}", outcome.log);
    }
}

#[test]
fn an_encoder_or_a_bridge_that_fails_stops_the_run() {
    for trouble in [Trouble::EncoderSilent, Trouble::Overcurrent, Trouble::BridgeDead] {
        let ends = |message: &Message| matches!(message, Message::Fault(_) | Message::Aborted(_));
        let outcome = PowerUp { trouble: Some(trouble), ..PowerUp::new("") }.until(ends);
        assert_eq!(outcome.report.ended, Ended::SwitchedOff, "{trouble:?}: {:?}", outcome.log);
        assert!(outcome.report.elapsed_us < 15e6, "{trouble:?}: noticed after {} us", outcome.report.elapsed_us);
    }
}

// --------------------------------------------------------------------------------------------------------------- flash

/// A unit whose sectors must be erased before a record fits: they are full of remains.
fn full_of_remains(machine: &str) -> PowerUp {
    let unit = PowerUp::new(machine);
    commission(&unit.flash(), &unit.assignment()).expect("a configuration");
    let mut flash = read_flash(&unit.flash()).expect("the flash");
    flash.bytes[4 * 128 * 1024..].fill(0x5a);
    write_flash(&unit.flash(), &flash).expect("the flash");
    unit
}

/// At power-up the store would notice that the sector is blank all the same. The command to erase everything fails with
/// the first sector that the flash reports as failed.
#[test]
fn the_spurious_read_error_of_revision_v_is_no_failed_erase() {
    let mut unit = PowerUp { policy: PowerUpPolicy::OnCommand, longest_s: 10, ..full_of_remains("--rdserr") };
    commission(&unit.flash(), &unit.assignment()).expect("a configuration");
    unit.send(&[(1, Command::Unlock(UNLOCK_WORD)), (2, Command::Erase)]);
    let outcome = unit.until(|_| false);
    let erases = outcome.report.flash_changes.iter().filter(|change| matches!(change, Change::Erased(_)));
    assert!(erases.count() >= 2, "no sector was erased");
    assert_eq!(outcome.answers.iter().find(|(number, _)| *number == 2), Some(&(2, Answer::Done)), "{:?}", outcome.log);
    assert!(!outcome.has_logged("cannot take a record") && !outcome.has_logged("the flash:"), "{:?}", outcome.log);
}

#[test]
fn a_word_that_cannot_be_read_is_damage_and_no_fault() {
    let unit = PowerUp::new(&format!("--broken {:#x}", RECORDS + 4 * 128 * 1024));
    let outcome = unit.until_it_turns();
    assert_eq!(outcome.found(), (false, true, false));
}

#[test]
fn a_power_cut_in_an_erase_leaves_a_unit_that_starts() {
    let mut unit = full_of_remains("--cut-erase 0");
    let outcome = unit.until_it_turns();
    assert_eq!(outcome.report.ended, Ended::PowerCut, "{:?}", outcome.log);
    unit.machine.clear();
    assert_eq!(unit.until_it_turns().report.ended, Ended::SwitchedOff);
}

/// The power is cut while the unit stores its configuration with another name. It has the old name or the new one.
#[test]
fn a_power_cut_in_a_word_of_the_configuration_leaves_a_commissioned_unit() {
    let name = UnitName { name: "renamed".try_into().expect("short"), ..UnitName::default() };
    let asks = [(1, Command::Unlock(UNLOCK_WORD)), (2, Command::Commission(name.clone()))];
    for word in [0, 1, 7] {
        let mut unit = PowerUp { policy: PowerUpPolicy::OnCommand, ..PowerUp::new(&format!("--cut-word {word}")) };
        unit.send(&asks);
        assert_eq!(unit.until(|_| false).report.ended, Ended::PowerCut, "word {word}");
        unit.machine.clear();
        unit.longest_s = 3;
        unit.send(&[(1, Command::Read(Item::Unit))]);
        let next = unit.until(|_| false);
        assert!(next.found() == (false, false, false), "word {word}: {:?}", next.log);
        let named = next.answers.iter().find_map(|(_, answer)| match answer {
            Answer::Unit(unit) => Some(unit.clone()),
            _ => None,
        });
        assert!([Some(UnitName::default()), Some(name.clone())].contains(&named), "word {word}: {named:?}");
    }
}

#[test]
fn what_must_not_be_read_ahead_is_closed() {
    let report = PowerUp::new("").until_it_turns().report;
    for closed in [[0x6000_0000, 0xe000_0000], [0x1ff0_0000, 0x1ff2_0000]] {
        assert!(report.closed.contains(&closed), "{:x?}", report.closed);
    }
}

// ------------------------------------------------------------------------------------------------- watchdog and faults

#[test]
fn the_watchdog_is_started_first() {
    let mut unit = PowerUp::new("--trace");
    let report = unit.until_it_turns().report;
    assert!(report.watchdog_started_us.is_some_and(|at| at < 1000.0), "{:?}", report.watchdog_started_us);
    // The cycle counter is unlocked before it is switched on.
    let first =
        |name: &str| report.registers.iter().find(|written| written.name == name).map(|written| written.values[0]);
    assert_eq!(first("DWT.LAR"), Some(0xc5ac_ce55));
    // A hang while the clocks are set up ends by the watchdog.
    unit.machine = ["--divert", "8init_pll17:hang:0"].map(str::to_owned).to_vec();
    unit.reboots = true;
    let restarted = unit.until(|message| matches!(message, Message::Restarted(_)));
    assert_eq!(restarted.restarts(), [Restart::Watchdog]);
}

/// Diverts the firmware 3 s after power-on. Returns the reason of the second start.
fn restart_after(divert: &str) -> Restart {
    let unit = PowerUp { reboots: true, ..PowerUp::new(&format!("--divert {divert}:3000000")) };
    let ends = |message: &Message| matches!(message, Message::State { state: State::StandBy, .. });
    let outcome = unit.until(ends);
    assert_eq!(outcome.restarts().first(), Some(&Restart::PowerOn), "{:?}", outcome.log);
    assert_eq!((outcome.report.ended, outcome.report.resets), (Ended::SwitchedOff, 1), "{:?}", outcome.log);
    outcome.restarts().pop().expect("a restart")
}

#[test]
fn a_main_loop_that_hangs_is_missed() {
    let restart = restart_after("SelfCalibration$LT$T$GT$4step:hang");
    assert_eq!(restart, Restart::Stopped(FatalError::Overdue(Task::Main)));
}

#[test]
fn an_interrupt_that_hangs_ends_by_the_watchdog() {
    assert_eq!(restart_after("TIM6_DAC:hang"), Restart::Watchdog);
}

#[test]
fn a_fault_is_told_with_its_status() {
    let restart = restart_after("SelfCalibration$LT$T$GT$4step:fault");
    let Restart::Stopped(FatalError::Fault(Registers { status, .. })) = restart else { panic!("{restart:?}") };
    assert_eq!(status, 1 << 16, "undefined instruction");
}

/// The report of such a fault would write to the log again, which panics, and so on.
#[test]
fn a_fault_in_a_frame_of_the_log_resets_once() {
    let restart = restart_after("_defmt_write:fault");
    assert!(matches!(restart, Restart::Stopped(FatalError::Fault(_))), "{restart:?}");
}

#[test]
fn a_probe_that_goes_away_does_not_stop_the_firmware() {
    let outcome = PowerUp::new("--log-unread").until_it_turns();
    assert_eq!((outcome.report.ended, outcome.report.resets), (Ended::SwitchedOff, 0));
}

// --------------------------------------------------------------------------------------------------------- serial line

fn command(number: u16, command: &Command) -> String {
    let mut frame = [0; MAX_FRAME_BYTES];
    let frame = encode(number, command, &mut frame).expect("a command fits into a frame");
    frame.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[test]
fn it_answers_commands() {
    let commands = [(1, Command::Hello), (2, Command::Status), (3, Command::Erase), (4, Command::Read(Item::Unit))];
    let mut unit = PowerUp::new("");
    unit.send(&commands);
    let outcome = unit.until_it_turns();
    let answer = |number: u16| outcome.answers.iter().find(|(of, _)| *of == number).map(|(_, answer)| answer);
    assert!(matches!(answer(1), Some(Answer::Hello(_))), "{:?}", outcome.answers);
    assert!(matches!(answer(2), Some(Answer::Status(_))));
    assert_eq!(answer(3), Some(&Answer::Refused(Refusal::Locked)));
    assert!(matches!(answer(4), Some(Answer::Unit(_))));
}

/// Bytes without a pause arrive while the IMU is read at different phases of the control period. None is lost, and the FIFO
/// of 16 bytes is never near its end: it is full after 174 us. The ADIS16495 alone is read in 98 us.
#[test]
fn no_received_byte_is_lost_while_the_imu_is_read() {
    let stream = "55".repeat(20_000);
    for phase_us in [0, 300, 350, 400, 800] {
        let unit = PowerUp::new(&format!("--sample-phase-us {phase_us} --receive {stream}@2000000"));
        let report = unit.until_it_turns().report;
        assert_eq!((report.ended, report.overruns), (Ended::SwitchedOff, [0, 0]), "phase {phase_us} us");
        let wait_us = report.interrupt("USART3").longest_wait_us;
        assert!((1.0..90.0).contains(&wait_us), "phase {phase_us} us: {wait_us} us");
    }
}

/// The figures of the guide's table.
#[test]
fn times_and_stack_are_within_their_limits() {
    for phase_us in [0, 350] {
        let report = PowerUp::new(&format!("--sample-phase-us {phase_us}")).until_it_turns().report;
        let longest = |name: &str| report.interrupt(name).longest_run_us;
        assert!(
            longest("TIM6") < 200.0 && longest("TIM2") < 300.0 && longest("USART3") < 100.0,
            "{:?}",
            report.interrupts
        );
        assert!(report.longest_masked_us < 200.0, "{} us", report.longest_masked_us);
        assert!(report.stack_used_bytes < report.stack_bytes / 2, "{} bytes", report.stack_used_bytes);
        assert_eq!(report.late_periods, 0);
    }
}

#[test]
fn an_image_that_is_none_is_an_error() {
    let image = build(Board::Stm32h743).unwrap_or_else(|error| panic!("{error:#}"));
    let image = host_tests::bench::emulator::image::Image { path: Path::new("/dev/null").into(), ..image };
    let mut bench = Bench::new(DrivenRins::new(&unit(), 1));
    assert!(run_frames(&MachineSetup::new(&image), &mut bench, |_| (), |_| Some(())).is_err());
}
