//! `rins monitor` on a pseudo-terminal with an instrument in this process at the other end, and on the serial port of
//! the firmware in the emulator.

use host_tests::bench::Bench;
use host_tests::bench::emulator::image::{Board, build};
use host_tests::bench::emulator::{MachineSetup, Run, run};
use host_tests::bench::line::{Terminal, Unconnected};
use host_tests::bench::memory::VirtualEeprom;
use host_tests::bench::power_up::{Listener, Memory, self_calibrate, shared};
use host_tests::virtual_unit::drive::move_durations_s;
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::plant::{self, Paced, Plant, Tick};
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::VirtualUnit;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::{Pid, ttyname};
use rins_selfcal::base::method::Method;
use rins_selfcal::base::sample::RawSample;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::keep::medium::Eeprom;
use rins_selfcal::keep::store::CalibrationStore;
use rins_selfcal::link::PROTOCOL_VERSION;
use rins_selfcal::model::correction::Calibration;
use rins_selfcal::model::error_model::PARAMETERS;
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::{Cause, Decision, PowerUpPolicy};
use rins_selfcal::run::result::{StoredCalibration, StoredVerdict};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::{Reason, Verdict};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// What the unit is commissioned with.
const UNIT: &str = r#"
unit = { name = "RINS 7", serial = "0007" }
site = { latitude_deg = 52.0 }
[outer]
travel_deg = [-365.0, 5.0]
turn = "stored"
motor = { inertia_kg_m2 = 0.06, coulomb_nm = 0.05, viscous_nm_s = 0.02, torque_constant_nm_a = 0.3, resistance_ohm = 6.0, inductance_h = 0.003, supply_v = 24.0, highest_current_a = 2.0, encoder_bits = 26 }
[inner]
travel_deg = "continuous"
motor = { inertia_kg_m2 = 0.06, coulomb_nm = 0.05, viscous_nm_s = 0.02, torque_constant_nm_a = 0.3, resistance_ohm = 6.0, inductance_h = 0.003, supply_v = 24.0, highest_current_a = 2.0, encoder_bits = 26 }
"#;

/// A unit that is switched off from another thread.
struct Unit(DrivenRins, Arc<AtomicBool>);

impl Plant for Unit {
    fn advance(&mut self, outputs: [plant::Output; 2]) -> Option<Tick> {
        if self.1.load(Ordering::Relaxed) { None } else { self.0.advance(outputs) }
    }
}

/// A configuration to wait for commands with, and its unit.
fn assignment() -> (SelfCalibrationConfig, DrivenRins) {
    let unit = VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() };
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let usual = SelfCalibrationConfig::new(calibrator, Scheme::bai(1.0, 1));
    let config = SelfCalibrationConfig { policy: PowerUpPolicy::OnCommand, ..usual };
    let mut rins = DrivenRins::new(&unit, 5);
    rins.expect_moves(&move_durations_s(&config.scheme, unit.rate_hz));
    (config, rins)
}

/// An instrument in this process at its end of a line.
fn instrument(line: File, off: &Arc<AtomicBool>, mut memory: Memory) -> Memory {
    let (config, rins) = assignment();
    let bench = shared(Unit(rins, Arc::clone(off)));
    let mut line = Terminal::new(line);
    self_calibrate::<f64, _>(&config, &mut memory, &bench, &mut line, &mut |_: &Message| ()).expect("it powers up");
    memory
}

fn monitor(port: &Path, options: &[&str]) -> Output {
    command(port, options).output().expect("it runs")
}

fn command(port: &Path, options: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rins"));
    // An emulator on a busy machine is slow.
    command.arg("monitor").arg("--port").arg(port).args(["--wait", "60"]).args(options);
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Commands to an instrument with an empty store over its line, and their expected effects.
fn commanded_followed_read_and_erased(port: &Path) {
    let directory = tempfile::tempdir().expect("a directory");
    let json = directory.path().join("stored.json");
    let read = ["--read", "calibration", "--json", json.to_str().expect("a name")];

    // The instrument stands by after its first samples, and it gets some samples for each request.
    let stands_by = |_: u32| text(&monitor(port, &["--read", "status"]).stdout).contains("StandBy");
    assert!((0..100).any(stands_by), "it does not come to stand by");
    let nothing = monitor(port, &read);
    let (abort, locked) = (monitor(port, &["--abort"]), monitor(port, &["--erase"]));
    let run = monitor(port, &["--unlock", "--start"]);
    let found = monitor(port, &read);
    let stored = std::fs::read_to_string(&json).unwrap_or_default();
    let history = monitor(port, &["--read", "history"]);
    let configuration = monitor(port, &["--read", "configuration"]);
    let black_box = monitor(port, &["--read", "black-box"]);
    let erased = monitor(port, &["--unlock", "--erase"]);
    let again = monitor(port, &read);
    let unit = directory.path().join("unit.toml");
    std::fs::write(&unit, UNIT).expect("written");
    let unit = unit.to_str().expect("a name");
    let no_unit = monitor(port, &["--read", "unit"]);
    let commissioned = monitor(port, &["--unlock", "--configure", unit]);
    let name = monitor(port, &["--read", "unit"]);
    let stopped = monitor(port, &["--stop"]);

    assert!(text(&no_unit.stderr).contains("[nothing-there]"), "{}", text(&no_unit.stderr));
    assert!(commissioned.status.success(), "{}", text(&commissioned.stderr));
    assert!(text(&name.stdout).contains("name = \"RINS 7\""), "{}", text(&name.stdout));
    assert!(stopped.status.success(), "{}", text(&stopped.stderr));
    assert!(
        text(&nothing.stderr).contains("[nothing-there] the instrument does not have the requested item"),
        "{}",
        text(&nothing.stderr)
    );
    assert!(text(&abort.stderr).contains("[not-now] the command is not allowed now"), "{}", text(&abort.stderr));
    assert!(text(&abort.stderr).contains("`rins explain not-now` explains"), "{}", text(&abort.stderr));
    assert!(text(&locked.stderr).contains("--unlock"), "{}", text(&locked.stderr));
    let said = text(&run.stdout);
    assert_eq!(run.status.code(), Some(0), "{said}{}", text(&run.stderr));
    let protocol = format!("protocol {PROTOCOL_VERSION}");
    for part in [protocol.as_str(), "turning, leg 18 of 18", "segment 37: worst", "verdict  accepted", "stored   yes"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(found.status.success(), "{}", text(&found.stderr));
    assert!(stored.contains("\"force_matrix_sa\"") && stored.contains("\"Sgxy\""), "{stored}");
    assert!(history.status.success(), "{}", text(&history.stderr));
    assert!(text(&history.stdout).contains("entry 1") && text(&history.stdout).contains("accepted"));
    assert!(text(&configuration.stdout).contains("OnCommand"), "{}", text(&configuration.stdout));
    let events = text(&black_box.stdout);
    for part in ["started: power on", "standing by", "turning, leg 18", "accepted", "stored"] {
        assert!(events.contains(part), "{part}: {events}");
    }
    assert!(erased.status.success(), "{}", text(&erased.stderr));
    assert_eq!(again.status.code(), Some(1));
}

/// A raw pseudo-terminal: the instrument's end, the host's end and the name of the host's end.
fn line() -> (File, OwnedFd, PathBuf) {
    let pair = openpty(None, None).expect("a pseudo-terminal");
    let mut settings = tcgetattr(&pair.slave).expect("settings");
    cfmakeraw(&mut settings);
    tcsetattr(&pair.slave, SetArg::TCSANOW, &settings).expect("raw");
    fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).expect("not blocking");
    let port = ttyname(&pair.slave).expect("a name");
    (File::from(pair.master), pair.slave, port)
}

#[test]
fn an_instrument_is_commanded_followed_read_and_erased_over_a_line() {
    let (line, slave, port) = line();
    let off = Arc::new(AtomicBool::new(false));
    let switch = Arc::clone(&off);
    let instrument = thread::spawn(move || instrument(line, &switch, Memory::default()));
    commanded_followed_read_and_erased(&port);
    off.store(true, Ordering::Relaxed);
    // The instrument must not wait for a reader of its last messages.
    drop(slave);
    let memory = instrument.join().expect("the instrument ends");
    assert!(memory.saved && memory.stored.is_none());
}

/// Runs the firmware twenty times as fast as real time. An unlock lasts half a minute, which is 1.5 s then.
fn firmware(serial: &Path, eeprom: Option<&Path>, off: &Arc<AtomicBool>) -> Run {
    let image = build(Board::Mps2An500).unwrap_or_else(|error| panic!("{error:#}"));
    let (config, rins) = assignment();
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = postcard::to_slice(&Assignment::SelfCalibrate(config), &mut buffer).expect("it fits");
    let setup = MachineSetup { configuration, serial: Some(serial), eeprom, ..MachineSetup::new(&image) };
    let mut bench = Bench::new(Paced::new(Unit(rins, Arc::clone(off)), Duration::from_micros(50)));
    run(&setup, &mut bench, |_| (), |_| ()).unwrap_or_else(|error| panic!("{error:#}"))
}

#[test]
fn so_is_the_firmware_over_its_serial_port() {
    let directory = tempfile::tempdir().expect("a directory");
    let serial = directory.path().join("serial");
    let off = Arc::new(AtomicBool::new(false));
    let (socket, switch) = (serial.clone(), Arc::clone(&off));
    let instrument = thread::spawn(move || firmware(&socket, None, &switch));
    while !serial.exists() && !instrument.is_finished() {
        thread::sleep(Duration::from_millis(10));
    }
    commanded_followed_read_and_erased(&serial);
    off.store(true, Ordering::Relaxed);
    let run = instrument.join().expect("the instrument ends");
    assert!(run.success);
    assert_eq!(run.late_periods, 0);
}

/// The description with which an operator commissions a unit with a scheme of one minute.
fn unit_file(directory: &Path) -> PathBuf {
    let path = directory.join("unit.toml");
    let noise = "[noise]\naccel_vrw_ug_sqrt_hz = 10.0\n[hardware]\nprofile = \"ideal\"\n[run]\nscheme = \"fast-60\"\n";
    std::fs::write(&path, UNIT.replace("52.0", "30.93041") + noise).expect("written");
    path
}

/// Powers up a board without an assigned configuration, with a unit whose mounting angle gamma has changed by
/// `shock_rad`. Runs it until samples are corrected, and returns its messages.
fn powered_up(eeprom: &Path, shock_rad: f64, seed: u64) -> Vec<Message> {
    let image = build(Board::Mps2An500).unwrap_or_else(|error| panic!("{error:#}"));
    let mut unit = VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() };
    unit.errors.mounting[2] += shock_rad;
    let scheme = Scheme::named("fast-60").expect("in the library");
    let mut rins = DrivenRins::new(&unit, seed);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let off = Arc::new(AtomicBool::new(false));
    let mut bench = Bench::new(Unit(rins, Arc::clone(&off)));
    let setup = MachineSetup { eeprom: Some(eeprom), ..MachineSetup::new(&image) };
    let mut messages = Vec::new();
    let on_message = |message: &Message| {
        let over =
            matches!(message, Message::State { state: State::Correcting | State::Stopped | State::Stranded, .. });
        off.fetch_or(over, Ordering::Relaxed);
        messages.push(message.clone());
    };
    run(&setup, &mut bench, |_| (), on_message).unwrap_or_else(|error| panic!("{error:#}"));
    messages
}

fn verdict(messages: &[Message]) -> &Verdict {
    let mut judged = messages.iter().filter_map(|message| match message {
        Message::Judged(verdict) => Some(verdict),
        _ => None,
    });
    judged.next().unwrap_or_else(|| panic!("{messages:?}"))
}

/// From the first power-up of a new board to a shock years later.
#[test]
fn a_new_board_moves_once_it_is_commissioned_and_learns_a_shock() {
    let directory = tempfile::tempdir().expect("a directory");
    let [serial, eeprom] = ["serial", "eeprom"].map(|name| directory.path().join(name));
    let unit = unit_file(directory.path());
    let off = Arc::new(AtomicBool::new(false));
    let (socket, memory, switch) = (serial.clone(), eeprom.clone(), Arc::clone(&off));
    let instrument = thread::spawn(move || new_board(&socket, &memory, &switch));
    while !serial.exists() && !instrument.is_finished() {
        thread::sleep(Duration::from_millis(10));
    }
    let stands_by = |_: u32| text(&monitor(&serial, &["--read", "status"]).stdout).contains("StandBy");
    assert!((0..100).any(stands_by), "it does not come to stand by");
    let status = text(&monitor(&serial, &["--read", "status"]).stdout);
    let refused = text(&monitor(&serial, &["--unlock", "--start"]).stderr);
    let configured = monitor(&serial, &["--unlock", "--configure", unit.to_str().expect("UTF-8")]);
    let confirmed = monitor(&serial, &["--unlock", "--confirm=0,0"]);
    let still_refused = text(&monitor(&serial, &["--unlock", "--start"]).stderr);
    off.store(true, Ordering::Relaxed);
    instrument.join().expect("the instrument ends");
    assert!(status.contains("NotCommissioned"), "{status}");
    assert!(refused.contains("[not-commissioned]") && still_refused.contains("[not-commissioned]"), "{refused}");
    assert!(configured.status.success(), "{}", text(&configured.stderr));
    assert!(confirmed.status.success(), "{}", text(&confirmed.stderr));

    let first = powered_up(&eeprom, 0.0, 6);
    assert!(first.contains(&Message::Decided(Decision::Calibrate(Cause::Policy))), "{first:?}");
    assert!(verdict(&first).accepted() && verdict(&first).changes.is_empty(), "{:?}", verdict(&first));
    let shaken = powered_up(&eeprom, 10.0 * ARCSEC, 7);
    assert!(verdict(&shaken).accepted(), "{:?}", verdict(&shaken).reasons);
    let gamma = |reason: &Reason| matches!(reason, Reason::Changed { parameter: 11, .. });
    assert!(verdict(&shaken).changes.iter().any(gamma), "{:?}", verdict(&shaken).changes);
    assert!(shaken.contains(&Message::Saved(true)));
}

/// A unit whose motors must not be driven.
struct Undriven(Unit);

impl Plant for Undriven {
    fn advance(&mut self, outputs: [plant::Output; 2]) -> Option<Tick> {
        assert!(!outputs.iter().any(|output| matches!(output, plant::Output::Driven(_))), "{outputs:?}");
        self.0.advance(outputs)
    }
}

/// A board without an assigned configuration, at its serial port.
fn new_board(serial: &Path, eeprom: &Path, off: &Arc<AtomicBool>) {
    let image = build(Board::Mps2An500).unwrap_or_else(|error| panic!("{error:#}"));
    let (_, rins) = assignment();
    let setup = MachineSetup { serial: Some(serial), eeprom: Some(eeprom), ..MachineSetup::new(&image) };
    let undriven = Undriven(Unit(rins, Arc::clone(off)));
    let mut bench = Bench::new(Paced::new(undriven, Duration::from_micros(50)));
    run(&setup, &mut bench, |_| (), |_| ()).unwrap_or_else(|error| panic!("{error:#}"));
}

/// The samples of an instrument in this process, raw, until it is switched off.
struct Raw {
    samples: Vec<RawSample<f64>>,
    until_us: u64,
    off: Arc<AtomicBool>,
}

impl Listener<f64> for Raw {
    fn message(&mut self, _message: &Message) {}

    fn raw(&mut self, sample: &RawSample<f64>) {
        self.samples.push(*sample);
        if sample.time_us >= self.until_us {
            self.off.store(true, Ordering::Relaxed);
        }
    }
}

fn record() -> StoredCalibration {
    StoredCalibration {
        errors: presets::real(5),
        sigmas: [1e-6; PARAMETERS],
        method: Method::Joint,
        scheme: "fast-180".try_into().expect("it fits"),
        site: VirtualUnit::default().site,
        utc_s: None,
        temperature_c: 25.0,
        chi_square: 50.0,
        degrees_of_freedom: 50,
        software_version: "0".try_into().expect("it fits"),
        verdict: StoredVerdict::default(),
        imu: None,
    }
}

/// Every corrected sample that the firmware sends is the correction of the same sample on the host, bit by bit.
#[test]
fn recorded_samples_of_the_firmware_are_those_that_the_host_corrects() {
    let directory = tempfile::tempdir().expect("a directory");
    let [serial, eeprom, out] = ["serial", "eeprom", "corrected.csv"].map(|name| directory.path().join(name));
    let mut store = CalibrationStore::new(Eeprom(VirtualEeprom::blank(8192)));
    store.save(&record()).expect("it is stored");
    std::fs::write(&eeprom, store.release().0.bytes).expect("the memory is written");
    let off = Arc::new(AtomicBool::new(false));
    let (socket, switch) = (serial.clone(), Arc::clone(&off));
    let instrument = thread::spawn(move || firmware(&socket, Some(&eeprom), &switch));
    while !serial.exists() && !instrument.is_finished() {
        thread::sleep(Duration::from_millis(10));
    }
    let recorded = monitor(&serial, &["--record", out.to_str().expect("UTF-8"), "--seconds", "4"]);
    off.store(true, Ordering::Relaxed);
    instrument.join().expect("the instrument ends");
    let said = text(&recorded.stdout);
    assert!(recorded.status.success(), "{said}{}", text(&recorded.stderr));
    let csv = std::fs::read_to_string(&out).expect("the recording");
    let rows: Vec<Vec<f64>> =
        csv.lines().skip(1).map(|row| row.split(',').map(|field| field.parse().expect("a number")).collect()).collect();
    assert!(said.contains(&format!("corrected samples: {} recorded, 0 missing", rows.len())), "{said}");
    let numbers: Vec<_> = rows.iter().map(|row| row[10] as usize).collect();
    assert_eq!(numbers, (0..rows.len()).collect::<Vec<_>>());

    let until_us = (rows.last().expect("rows")[0] * 1e6).round() as u64;
    let off = Arc::new(AtomicBool::new(false));
    let mut raw = Raw { samples: Vec::new(), until_us, off: Arc::clone(&off) };
    let (config, rins) = assignment();
    let mut memory = Memory { stored: Some(record()), ..Memory::default() };
    self_calibrate::<f64, _>(&config, &mut memory, &shared(Unit(rins, off)), &mut Unconnected, &mut raw)
        .expect("it powers up");
    let calibration = Calibration::new(&record().errors);
    let first_us = (rows[0][0] * 1e6).round() as u64;
    let expected: Vec<Vec<u64>> = raw
        .samples
        .iter()
        .filter(|sample| (first_us..=until_us).contains(&sample.time_us))
        .map(|sample| {
            let corrected = calibration.correct(sample);
            let angles = [sample.outer, sample.inner].map(|angle| angle.rad::<f64>());
            corrected.omega_is_s.iter().chain(&corrected.force_s).chain(&angles).map(|x| x.to_bits()).collect()
        })
        .collect();
    let got: Vec<Vec<u64>> = rows.iter().map(|row| row[1..9].iter().map(|x| x.to_bits()).collect()).collect();
    // One second of the instrument has 200 samples, also if a busy machine makes the emulator slow.
    assert!(got.len() > 200, "{} samples", got.len());
    assert_eq!(got, expected);
}

/// The numbers of the samples in a recording.
fn numbers(out: &Path) -> Vec<usize> {
    let csv = std::fs::read_to_string(out).expect("the recording");
    csv.lines().skip(1).map(|row| row.rsplit(',').next().expect("a number").parse().expect("a whole row")).collect()
}

/// A recording is complete: no sample is missing, and the summary counts its rows.
fn assert_complete(out: &Path, said: &str) {
    let numbers = numbers(out);
    assert!(said.contains(&format!("corrected samples: {} recorded, 0 missing", numbers.len())), "{said}");
    assert!(!said.contains("restarts") && !numbers.is_empty(), "{said}");
    assert_eq!(numbers, (0..numbers.len()).collect::<Vec<_>>());
}

/// Waits until a recording has rows.
fn wait_for_rows(out: &Path, recording: &mut Child) {
    while std::fs::metadata(out).map_or(0, |file| file.len()) < 1000 {
        assert!(recording.try_wait().expect("a process").is_none(), "the recording has ended");
        thread::sleep(Duration::from_millis(5));
    }
}

/// Records until the signal, and returns what is printed.
fn recorded_until(signal: Signal, port: &Path, out: &Path) -> Output {
    let _ = std::fs::remove_file(out);
    let options = ["--record", out.to_str().expect("UTF-8")];
    let mut recording = command(port, &options).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it runs");
    // Filling the pipe would block the program.
    let (mut stdout, mut said) = (recording.stdout.take().expect("a pipe"), Vec::new());
    let reader = thread::spawn(move || stdout.read_to_end(&mut said).map(|_| said));
    wait_for_rows(out, &mut recording);
    kill(Pid::from_raw(recording.id().try_into().expect("a number")), signal).expect("it is there");
    let ended = recording.wait_with_output().expect("it ends");
    Output { stdout: reader.join().expect("a thread").expect("text"), ..ended }
}

/// Records on a terminal until Ctrl-C is typed there, and returns what the terminal shows.
fn recorded_until_ctrl_c(port: &Path, out: &Path) -> String {
    let _ = std::fs::remove_file(out);
    let pair = openpty(None, None).expect("a pseudo-terminal");
    let end = || Stdio::from(pair.slave.try_clone().expect("a terminal"));
    let before = tcgetattr(&pair.slave).expect("settings");
    let options = ["--record", out.to_str().expect("UTF-8")];
    let mut recording = command(port, &options).stdin(end()).stdout(end()).stderr(end()).spawn().expect("it runs");
    let mut keyboard = File::from(pair.master);
    let mut screen = keyboard.try_clone().expect("a terminal");
    let reader = thread::spawn(move || {
        // Reading fails when the last program has closed the terminal.
        let (mut shown, mut bytes) = (Vec::new(), [0; 4096]);
        while let Ok(count @ 1..) = screen.read(&mut bytes) {
            shown.extend_from_slice(&bytes[..count]);
        }
        shown
    });
    wait_for_rows(out, &mut recording);
    keyboard.write_all(b"\x03").expect("a key");
    assert!(recording.wait().expect("it ends").success());
    assert_eq!(tcgetattr(&pair.slave).expect("settings").local_flags, before.local_flags);
    drop(pair.slave);
    text(&reader.join().expect("a thread"))
}

#[test]
fn a_recording_that_is_interrupted_is_complete_and_the_next_one_begins_with_its_own_samples() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("corrected.csv");
    let (line, slave, port) = line();
    let off = Arc::new(AtomicBool::new(false));
    let switch = Arc::clone(&off);
    let memory = Memory { stored: Some(record()), ..Memory::default() };
    let instrument = thread::spawn(move || instrument(line, &switch, memory));
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let ended = recorded_until(signal, &port, &out);
        assert_eq!(ended.status.code(), Some(0), "{}", text(&ended.stderr));
        assert_complete(&out, &text(&ended.stdout));
    }
    // A program that is killed leaves the stream on.
    assert_eq!(recorded_until(Signal::SIGKILL, &port, &out).status.code(), None);
    let ended = monitor(&port, &["--record", out.to_str().expect("UTF-8"), "--seconds", "0.2"]);
    assert_eq!(ended.status.code(), Some(0), "{}", text(&ended.stderr));
    assert_complete(&out, &text(&ended.stdout));
    assert_complete(&out, &recorded_until_ctrl_c(&port, &out));
    off.store(true, Ordering::Relaxed);
    drop(slave);
    instrument.join().expect("the instrument ends");
}
