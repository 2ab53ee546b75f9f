//! The firmware fails in the middle of a move: the motors stop, a reset follows, and the next start reports the cause.
//! A debugger injects the failure, so that the image is the one that ships.

use anyhow::Result;
use host_tests::bench::Bench;
use host_tests::bench::emulator::debugger::{Debugger, function};
use host_tests::bench::emulator::image::{Board, build};
use host_tests::bench::emulator::{MachineSetup, run};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::plant::{Output, Plant, Tick};
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::restart::Task;
use rins_selfcal::base::restart::{FatalError, Registers};
use rins_selfcal::base::units::DEG;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::{Cause, Decision};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::channel;
use std::thread;

/// Control periods between two checks for overdue tasks, and in the deadline of the main loop.
const LOOK: u32 = 100;
const MAIN_DEADLINE: u32 = 1000;
/// Most control periods until the firmware is harmed: a minute.
const MAX_RUN: u32 = 60_000;
/// Control periods from one sample to the next. The main loop is harmed at a sample.
const SAMPLE: u32 = 5;
/// An endless loop, in instructions of ARMv7-M.
const LOOP: [u8; 2] = [0xfe, 0xe7];
/// Disables interrupt 8, the control, for good: writes 1 << 8 to the register at 0xe000e180.
const MASK_CONTROL: [u8; 16] =
    [0x4e, 0xf2, 0x80, 0x10, 0xce, 0xf2, 0x00, 0x00, 0x01, 0x21, 0x09, 0x02, 0x01, 0x60, 0x70, 0x47];
/// Disables interrupt 30, the sampling, in the same way, keeps all registers, and continues at the address that
/// follows.
const MASK_SAMPLING: [u8; 24] = [
    0x03, 0xb4, 0x4e, 0xf2, 0x80, 0x10, 0xce, 0xf2, 0x00, 0x00, 0x4f, 0xf0, 0x80, 0x41, 0x01, 0x60, 0x03, 0xbc, 0x00,
    0xbf, 0xdf, 0xf8, 0x00, 0xf0,
];
const UNDEFINED: [u8; 2] = [0x00, 0xde];
const PUSH_FOREVER: [u8; 4] = [0xff, 0xb4, 0xfd, 0xe7];
/// Memory that the firmware does not use.
const SCRATCH: u32 = 0x2009_ff00;

/// A unit that counts for how many control periods its motors are still on after it was harmed.
struct Watched<'a> {
    rins: DrivenRins,
    harmed: &'a AtomicBool,
    off: &'a AtomicBool,
    driven: &'a AtomicU32,
    stopped: bool,
    /// Number of control periods in which a motor was driven after the restart.
    after_restart: &'a AtomicU32,
    restarted: &'a AtomicBool,
    /// Number of control periods after which the unit is switched off in any case.
    left: u32,
}

impl Plant for Watched<'_> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        if self.harmed.load(Ordering::Relaxed) && !self.stopped {
            self.stopped = outputs == [Output::Open; 2];
            self.driven.fetch_add(u32::from(!self.stopped), Ordering::Relaxed);
        }
        let drives = outputs.iter().any(|output| matches!(output, Output::Driven(_)));
        if self.restarted.load(Ordering::Relaxed) {
            self.after_restart.fetch_add(u32::from(drives), Ordering::Relaxed);
        }
        self.left = self.left.checked_sub(1)?;
        if self.off.load(Ordering::Relaxed) { None } else { self.rins.advance(outputs) }
    }
}

/// Harms the firmware in its first move. Returns the reason for the second start that the firmware reports, and the
/// number of control periods for which the motors were still on.
fn restart_after(harm: impl Fn(&[u8], &mut Debugger) -> Result<()> + Sync) -> (Restart, u32) {
    let image = build(Board::Mps2An500).unwrap_or_else(|error| panic!("{error:#}"));
    let elf = image.read().expect("the image");
    let unit = VirtualUnit::default();
    // The first turn is so slow that it takes 45 s, which is about half a second on the host.
    let scheme = Scheme { rate_rad_s: 2.0 * DEG, ..Scheme::bai(1.0, 1) };
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let mut rins = DrivenRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let assignment = Assignment::SelfCalibrate(SelfCalibrationConfig::new(calibrator, scheme));
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = postcard::to_slice(&assignment, &mut buffer).expect("it fits");
    let directory = tempfile::tempdir().expect("a directory");
    let socket = directory.path().join("debugger");
    let setup = MachineSetup { configuration, reboots: true, debugger: Some(&socket), ..MachineSetup::new(&image) };
    let (harmed, off, driven) = (AtomicBool::new(false), AtomicBool::new(false), AtomicU32::new(0));
    let (restarted, after_restart) = (AtomicBool::new(false), AtomicU32::new(0));
    let mut bench = Bench::new(Watched {
        rins,
        harmed: &harmed,
        off: &off,
        driven: &driven,
        stopped: false,
        after_restart: &after_restart,
        restarted: &restarted,
        left: 2 * MAX_RUN,
    });
    let (turning, turns) = channel();
    let (mut restarts, mut decisions) = (Vec::new(), Vec::new());
    thread::scope(|scope| {
        let (harm, socket, elf, harmed) = (&harm, &socket, &elf, &harmed);
        let debugger = scope.spawn(move || -> Result<()> {
            turns.recv()?;
            let mut debugger = Debugger::attach(socket)?;
            // The firmware is stopped at the beginning of a function. There it is not between a request to the bench
            // and the answer, which the restarted firmware would read first, and not in a block of conditional
            // instructions.
            debugger.run_to(function(elf, &MAIN_LOOP)?)?;
            harm(elf, &mut debugger)?;
            // The debugger has stopped the processor.
            harmed.store(true, Ordering::Relaxed);
            debugger.detach()
        });
        let on_message = |message: &Message| match message {
            Message::State { state: State::Turn(1), .. } => drop(turning.send(())),
            Message::Restarted(restart) => {
                restarts.push(restart.clone());
                restarted.store(restarts.len() > 1, Ordering::Relaxed);
            }
            Message::Decided(decision) => decisions.push(*decision),
            // After the restart the unit stands by, and is switched off.
            Message::State { state: State::StandBy, .. } => off.store(true, Ordering::Relaxed),
            _ => {}
        };
        let run = run(&setup, &mut bench, |_| (), on_message);
        debugger.join().expect("no panic").unwrap_or_else(|error| panic!("{error:#}"));
        run.unwrap_or_else(|error| panic!("{error:#}"));
    });
    assert_eq!(bench.switched_off(), 1);
    assert_eq!(restarts.len(), 2, "{restarts:?}");
    assert_eq!(restarts[0], Restart::PowerOn);
    let decided = [Decision::Calibrate(Cause::Policy), Decision::StandBy(Cause::AfterReset)];
    assert_eq!(decisions, decided, "a run never begins by itself after a reset");
    assert_eq!(after_restart.into_inner(), 0, "no motor is driven after the reset");
    (restarts.remove(1), driven.load(Ordering::Relaxed))
}

const MAIN_LOOP: [&str; 2] = ["SelfCalibration<", ">::step"];

#[test]
fn a_main_loop_that_hangs_is_missed() {
    let hang = |elf: &[u8], debugger: &mut Debugger| debugger.write(function(elf, &MAIN_LOOP)?, &LOOP);
    let (restart, driven) = restart_after(hang);
    assert_eq!(restart, Restart::Stopped(FatalError::Overdue(Task::Main)));
    assert!((MAIN_DEADLINE - SAMPLE..=MAIN_DEADLINE + LOOK + SAMPLE).contains(&driven), "{driven} periods");
}

#[test]
fn sampling_that_hangs_is_missed() {
    let hang = |_: &[u8], debugger: &mut Debugger| {
        let pc = debugger.register(15)?;
        debugger.write(SCRATCH, &MASK_SAMPLING)?;
        debugger.write(SCRATCH + MASK_SAMPLING.len() as u32, &(pc | 1).to_le_bytes())?;
        debugger.set(15, SCRATCH)
    };
    let (restart, driven) = restart_after(hang);
    assert_eq!(restart, Restart::Stopped(FatalError::Overdue(Task::Sampling)));
    assert!(driven <= 2 * LOOK + 1, "{driven} periods");
}

#[test]
fn control_that_hangs_is_missed() {
    let hang = |elf: &[u8], debugger: &mut Debugger| debugger.write(function(elf, &["DefaultHandler"])?, &MASK_CONTROL);
    let (restart, driven) = restart_after(hang);
    // In the emulator, the samples come with the control periods, so that either task may be found overdue first.
    let missed = [Task::Control, Task::Sampling].map(|task| Restart::Stopped(FatalError::Overdue(task)));
    assert!(missed.contains(&restart), "{restart:?}");
    assert!(driven <= 1, "{driven} periods");
}

#[test]
fn where_everything_hangs_the_watchdog_bites() {
    // An interrupt handler that does not return blocks the interrupt that feeds the watchdog.
    let hang = |elf: &[u8], debugger: &mut Debugger| debugger.write(function(elf, &["DefaultHandler"])?, &LOOP);
    let (restart, driven) = restart_after(hang);
    assert_eq!(restart, Restart::Stopped(FatalError::Unfed));
    assert!(driven <= 1, "{driven} periods");
}

#[test]
fn a_fault_is_told_with_its_registers() {
    let fault = |elf: &[u8], debugger: &mut Debugger| debugger.write(function(elf, &MAIN_LOOP)?, &UNDEFINED);
    let (restart, driven) = restart_after(fault);
    let Restart::Stopped(FatalError::Fault(Registers { pc, lr, status, .. })) = restart else { panic!("{restart:?}") };
    let elf = build(Board::Mps2An500).and_then(|image| image.read()).expect("the image");
    assert_eq!((pc, status), (function(&elf, &MAIN_LOOP).expect("the function"), 1 << 16), "undefined instruction");
    assert!(lr & 1 == 1 && lr < 0x20_0000, "{lr:#x}");
    assert!(driven <= SAMPLE + 1, "{driven} periods");
}

#[test]
fn a_stack_overflow_is_told() {
    let fault = |elf: &[u8], debugger: &mut Debugger| debugger.write(function(elf, &MAIN_LOOP)?, &PUSH_FOREVER);
    let (restart, driven) = restart_after(fault);
    assert!(matches!(restart, Restart::Stopped(FatalError::StackOverflow { .. })), "{restart:?}");
    assert!(driven <= SAMPLE + 1, "{driven} periods");
}

#[test]
fn a_panic_is_told_with_its_place() {
    let file = "src/somewhere.rs";
    let panic = |elf: &[u8], debugger: &mut Debugger| {
        debugger.write(SCRATCH, file.as_bytes())?;
        let called = [(0, SCRATCH), (1, file.len() as u32), (2, 1234), (15, function(elf, &["fault::panicked"])?)];
        called.into_iter().try_for_each(|(register, value)| debugger.set(register, value))
    };
    let (restart, driven) = restart_after(panic);
    assert_eq!(restart, Restart::Stopped(FatalError::panic(file, 1234)));
    assert!(driven <= 1, "{driven} periods");
}
