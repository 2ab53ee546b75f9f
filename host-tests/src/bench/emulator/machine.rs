//! The firmware image in QEMU, with the host as its bench.
//!
//! The host starts the emulator on an image and serves the pipes that `src/bin/firmware/mps2.rs` opens. `requests` and
//! `answers` carry the transfers on SPI. `telemetry` carries frames of `rins_selfcal::link`. `log` carries defmt
//! frames. The firmware reads the file `configuration` and writes the files `run` and `fault`.

use super::image::Image;
use crate::base::apt::ensure_installed;
use crate::bench::bus::{Chip, IMU_ANSWER};
use crate::bench::devices::Bench;
use crate::bench::wire;
use crate::virtual_unit::plant::Plant;
use anyhow::{Context, Result, bail, ensure};
use defmt_decoder::{DecodeError, Table};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::Mode;
use rins_selfcal::keep::partition::Layout;
use rins_selfcal::link::{Decoder, Frame};
use rins_selfcal::run::telemetry::Message;
use std::cell::Cell;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Size of the emulated EEPROM, bytes.
pub const EEPROM_BYTES: usize = Layout::EEPROM_16_KIB.marks.end as usize;
const EMULATOR: &str = "qemu-system-arm";
/// Virtual time of one instruction, ns: `-icount shift=1`.
const NS_PER_INSTRUCTION: f64 = 2.0;
const TICKS_PER_S: f64 = wire::TICKS_PER_S as f64;

// ----------------------------------------------------------------------------------------------------------------- run

/// One run of an image.
#[derive(Clone, Copy, Debug)]
pub struct MachineSetup<'a> {
    /// The image.
    pub image: &'a Image,
    /// File with the content of the EEPROM, which is kept from run to run. What is missing of the file is blank. `None`: the
    /// EEPROM is blank and is not kept. For the board STM32H743 it is the file of the flash's records.
    pub eeprom: Option<&'a Path>,
    /// Bytes that the firmware reads as its configuration. The board STM32H743 has the configuration in its flash: it is
    /// written there before the run.
    pub configuration: &'a [u8],
    /// Longest silence of the firmware before it is reported as hung.
    pub patience: Duration,
    /// Whether the machine continues after a reset. If not, a reset is an error that gives the cause.
    pub reboots: bool,
    /// Cuts the power when it becomes true: the emulator is killed.
    pub cut: Option<&'a Cell<bool>>,
    /// Unix socket at which the emulator offers the firmware's serial line.
    pub serial: Option<&'a Path>,
    /// Unix socket at which the emulator listens to a debugger. Not for the board STM32H743.
    pub debugger: Option<&'a Path>,
    /// Arguments for the machine of the board STM32H743: what is wrong with the board.
    pub arguments: &'a [&'a str],
}

impl<'a> MachineSetup<'a> {
    /// A run with a blank EEPROM, no configuration and a patience of a minute.
    pub fn new(image: &'a Image) -> Self {
        let patience = Duration::from_secs(60);
        Self {
            image,
            eeprom: None,
            configuration: &[],
            patience,
            reboots: false,
            cut: None,
            serial: None,
            debugger: None,
            arguments: &[],
        }
    }
}

/// Figures of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Whether the firmware ended with success.
    pub success: bool,
    /// Number of transfers on SPI.
    pub transfers: u64,
    /// Duration on the host, s.
    pub wall_s: f64,
    /// Virtual time of the firmware since power-up, s.
    pub elapsed_s: f64,
    /// Instructions executed: the emulator's exact count, in multiples of 20.
    pub instructions: f64,
    /// Largest use of the stack, bytes.
    pub stack_used_bytes: u64,
    /// Size of the stack, bytes.
    pub stack_bytes: u64,
    /// Control periods that began later than the next period was due, because the processor was busy.
    pub late_periods: u64,
    /// Commands to the gimbal that came too late to take effect on time.
    pub late_commands: u64,
    /// Most instructions from the beginning of a control period until its interrupt runs, to 20.
    pub control_latency: f64,
    /// Most instructions from the request of the IMU's interrupt until it runs, while the control interrupt runs, to
    /// 20.
    pub data_ready_latency: f64,
    /// Largest number of samples in the queue.
    pub queue_deepest: u64,
    /// Capacity of the queue, samples.
    pub queue_length: u64,
    /// Instructions by kind of work, in the order of [`WORKS`]. Transfers and telemetry are left out.
    pub loads: [Load; WORKS.len()],
}

/// Kinds of work that the firmware counts.
pub const WORKS: [&str; 8] = [
    "control interrupt",
    "IMU's interrupt",
    "sample of a stop",
    "sample of a move",
    "end of a segment",
    "piece of the solution",
    "corrected sample",
    "anything else",
];

/// Cost of one kind of work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Number of times that the work was done.
    pub spans: u64,
    /// Mean instructions. The total is exact to 20.
    pub mean_instructions: f64,
    /// Most instructions, to 20.
    pub most_instructions: f64,
}

impl Load {
    fn new(&[spans, ticks, longest]: &[u64; 3]) -> Self {
        let mean_instructions = instructions(ticks) / spans.max(1) as f64;
        Self { spans, mean_instructions, most_instructions: instructions(longest) }
    }
}

fn instructions(ticks: u64) -> f64 {
    ticks as f64 / TICKS_PER_S / (NS_PER_INSTRUCTION * 1e-9)
}

/// Runs an image in QEMU, as [`super::run`].
pub(super) fn run_in_qemu<P: Plant>(
    setup: &MachineSetup<'_>,
    bench: &mut Bench<P>,
    mut on_log: impl FnMut(&str),
    mut on_message: impl FnMut(&Message),
) -> Result<Run> {
    ensure_fits(setup, bench)?;
    ensure_installed(EMULATOR, EMULATOR)?;
    let start = Instant::now();
    let directory = tempfile::Builder::new().prefix("rins-").tempdir()?;
    let mut host = Host::start(emulator(setup, directory.path())?, directory.path())?;
    let served = host.serve_all(setup, bench, &mut on_log, &mut |frame| {
        let message = frame.read()?;
        on_message(&message);
        Some(())
    });
    let fault = fs::read(directory.path().join("fault")).unwrap_or_default();
    if !fault.is_empty() && !setup.reboots && !setup.cut.is_some_and(Cell::get) {
        bail!("the firmware stopped: {}", String::from_utf8_lossy(&fault));
    }
    let status = served?;
    let report = fs::read(directory.path().join("run")).ok().and_then(|bytes| words(&bytes));
    let Some((whole, loads)) = report else {
        bail!("the firmware ended without a report, {status}: {}", host.complaints(directory.path()));
    };
    let [
        elapsed,
        idle,
        stack_used_bytes,
        stack_bytes,
        late_periods,
        late_commands,
        latencies @ ..,
        queue_deepest,
        queue_length,
    ] = whole;
    let [control_latency, data_ready_latency] = latencies.map(instructions);
    let elapsed_s = elapsed as f64 / TICKS_PER_S;
    Ok(Run {
        success: status.success(),
        transfers: host.transfers,
        wall_s: start.elapsed().as_secs_f64(),
        elapsed_s,
        instructions: instructions(elapsed - idle),
        stack_used_bytes,
        stack_bytes,
        late_periods,
        late_commands,
        control_latency,
        data_ready_latency,
        queue_deepest,
        queue_length,
        loads: loads.each_ref().map(Load::new),
    })
}

pub(super) fn ensure_fits<P: Plant>(setup: &MachineSetup<'_>, bench: &Bench<P>) -> Result<()> {
    let (expected, found) = (setup.image.imu, bench.imu());
    ensure!(expected == found, "the image is for the IMU {expected}, the bench has the IMU {found}");
    Ok(())
}

/// The numbers of the file `run`: those of the whole run, then three for each kind of work.
fn words(bytes: &[u8]) -> Option<([u64; 10], [[u64; 3]; WORKS.len()])> {
    let (words, rest) = bytes.as_chunks::<8>();
    let words: Vec<u64> = words.iter().map(|word| u64::from_le_bytes(*word)).collect();
    let (whole, loads) = words.split_first_chunk()?;
    let (loads, more) = loads.as_chunks();
    (rest.is_empty() && more.is_empty()).then_some((*whole, loads.try_into().ok()?))
}

/// The emulator and the host's ends of its pipes. Dropping it ends the emulator.
pub(super) struct Host {
    child: Child,
    requests: File,
    answers: File,
    /// Keeps the answers' pipe open until the firmware has opened its end.
    placeholder: Option<File>,
    telemetry: File,
    log: File,
    pub(super) transfers: u64,
    partial: Vec<u8>,
}

impl Drop for Host {
    fn drop(&mut self) {
        // The emulator may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Host {
    /// Makes the pipes in a folder and starts the emulator.
    pub(super) fn start(mut command: Command, directory: &Path) -> Result<Self> {
        for name in ["requests", "answers", "telemetry", "log"] {
            nix::unistd::mkfifo(&directory.join(name), Mode::S_IRUSR | Mode::S_IWUSR)?;
        }
        let open = |name: &str, read: bool, write: bool| {
            let mut options = OpenOptions::new();
            options.read(read).write(write).custom_flags(nix::libc::O_NONBLOCK);
            options.open(directory.join(name)).with_context(|| format!("cannot open the pipe {name}"))
        };
        let placeholder = open("answers", true, true)?;
        Ok(Self {
            requests: open("requests", true, false)?,
            answers: open("answers", false, true)?,
            placeholder: Some(placeholder),
            telemetry: open("telemetry", true, false)?,
            log: open("log", true, false)?,
            transfers: 0,
            partial: Vec::new(),
            child: spawn(&mut command, directory)?,
        })
    }

    /// Serves the pipes until the emulator ends. `on_log` gets the lines of the log. `on_frame` gets the frames of the
    /// serial line and returns `None` for one that it cannot read.
    pub(super) fn serve_all<P: Plant>(
        &mut self,
        setup: &MachineSetup<'_>,
        bench: &mut Bench<P>,
        on_log: &mut dyn FnMut(&str),
        on_frame: &mut dyn FnMut(&Frame<'_>) -> Option<()>,
    ) -> Result<ExitStatus> {
        let elf = setup.image.read()?;
        let table = Table::parse(&elf)?.context("the image has no defmt table")?;
        let mut decoder = table.new_stream_decoder();
        let mut log = |bytes: &[u8]| {
            decoder.received(bytes);
            loop {
                match decoder.decode() {
                    Ok(frame) => on_log(&frame.display(false).to_string()),
                    Err(DecodeError::UnexpectedEof) => break,
                    Err(DecodeError::Malformed) => on_log("(a damaged line)"),
                }
            }
        };
        let mut frames = Decoder::new();
        let mut unread = 0;
        let mut telemetry = |bytes: &[u8]| {
            for byte in bytes {
                if let Some(frame) = frames.push(*byte) {
                    unread += u32::from(frame.ok().and_then(|frame| on_frame(&frame)).is_none());
                }
            }
        };
        let served = self.serve(setup, bench, &mut log, &mut telemetry);
        if setup.cut.is_some_and(Cell::get) {
            bail!("the power was cut");
        }
        let status = served?;
        ensure!(unread == 0, "{unread} messages of the firmware cannot be read");
        Ok(status)
    }

    /// Serves the pipes until the emulator ends.
    fn serve<P: Plant>(
        &mut self,
        setup: &MachineSetup<'_>,
        bench: &mut Bench<P>,
        log: &mut dyn FnMut(&[u8]),
        telemetry: &mut dyn FnMut(&[u8]),
    ) -> Result<ExitStatus> {
        let mut last_sign = Instant::now();
        loop {
            let mut busy = false;
            // The next request comes within microseconds, so polling is faster than sleeping.
            for poll in 1..=POLLS {
                if self.serve_requests(bench)? {
                    busy = true;
                    break;
                }
                if poll % POLLS_PER_YIELD == 0 {
                    std::thread::yield_now();
                }
            }
            if !busy || setup.cut.is_some() || self.transfers.is_multiple_of(1024) {
                busy |= drain(&mut self.log, log)?;
                busy |= drain(&mut self.telemetry, telemetry)?;
            }
            if setup.cut.is_some_and(Cell::get) {
                self.child.kill()?;
                return Ok(self.child.wait()?);
            }
            if busy {
                last_sign = Instant::now();
                continue;
            }
            if let Some(status) = self.child.try_wait()? {
                while drain(&mut self.log, log)? | drain(&mut self.telemetry, telemetry)? {}
                return Ok(status);
            }
            let silence = last_sign.elapsed();
            ensure!(silence < setup.patience, "the firmware hangs: no sign of it for {} s", setup.patience.as_secs());
            self.sleep()?;
        }
    }

    /// Waits until a pipe has data, at most for some milliseconds.
    fn sleep(&self) -> Result<()> {
        let mut pipes =
            [&self.requests, &self.log, &self.telemetry].map(|pipe| PollFd::new(pipe.as_fd(), PollFlags::POLLIN));
        poll(&mut pipes, PollTimeout::from(10_u8))?;
        if pipes.iter().all(|pipe| !pipe.revents().is_some_and(|events| events.contains(PollFlags::POLLIN))) {
            // All ready pipes have hung up, so the emulator is about to end.
            std::thread::sleep(Duration::from_micros(200));
        }
        Ok(())
    }

    /// Answers the requests that have come. Returns whether a request had come.
    fn serve_requests<P: Plant>(&mut self, bench: &mut Bench<P>) -> Result<bool> {
        let mut bytes = [0; 512];
        let count = read_some(&mut self.requests, &mut bytes)?;
        if count == 0 {
            return Ok(false);
        }
        self.placeholder = None;
        self.partial.extend_from_slice(&bytes[..count]);
        while let [chip, length, frame @ ..] = self.partial.as_mut_slice() {
            let Some(frame) = frame.get_mut(..usize::from(*length)) else { break };
            match (Chip::numbered(*chip), *chip) {
                (Some(chip @ (Chip::OuterEncoder | Chip::InnerEncoder)), _) => bench.clock_late(chip, frame),
                (Some(chip), _) => bench.transfer(chip, frame),
                (None, IMU_ANSWER) => bench.imu_answer(frame),
                (None, chip) => bail!("the firmware asks for chip {chip}"),
            }
            match self.answers.write_all(frame) {
                // The emulator has ended. Its exit status gives the cause.
                Err(error) if error.kind() == ErrorKind::BrokenPipe => {}
                result => result.context("cannot answer the firmware")?,
            }
            let taken = 2 + frame.len();
            self.partial.drain(..taken);
            self.transfers += 1;
        }
        Ok(true)
    }

    /// The emulator's own error output.
    pub(super) fn complaints(&self, directory: &Path) -> String {
        fs::read_to_string(directory.join("stderr")).unwrap_or_default().trim().to_owned()
    }
}

/// Number of polls for a request before the host sleeps, some tenths of a millisecond. Measured on two cores: a
/// transfer takes 48 us without polling and 14 us with polling.
const POLLS: u32 = 1000;
/// Number of polls before the host yields the processor. Yielding keeps two runs on two cores from starving each other.
const POLLS_PER_YIELD: u32 = 8;

/// Reads the available bytes without waiting. Returns zero if no bytes have come yet or the pipe has ended.
fn read_some(pipe: &mut File, bytes: &mut [u8]) -> Result<usize> {
    match pipe.read(bytes) {
        Ok(count) => Ok(count),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
        Err(error) => Err(error).context("cannot read from the firmware"),
    }
}

fn drain(pipe: &mut File, sink: &mut dyn FnMut(&[u8])) -> Result<bool> {
    let mut bytes = [0; 4096];
    let count = read_some(pipe, &mut bytes)?;
    sink(&bytes[..count]);
    Ok(count > 0)
}

/// The emulator's argument for listening at a Unix socket.
fn listening(socket: &Path) -> Result<String> {
    let socket = std::path::absolute(socket)?.display().to_string();
    Ok(format!("unix:{},server=on,wait=off", socket.replace(',', ",,")))
}

/// Appends blank bytes to the file of an EEPROM that is missing or too short, such as that of a smaller EEPROM.
fn fill_up(eeprom: &Path) -> Result<()> {
    let mut bytes = if eeprom.exists() { fs::read(eeprom)? } else { Vec::new() };
    if bytes.len() < EEPROM_BYTES {
        bytes.resize(EEPROM_BYTES, 0xff);
        fs::write(eeprom, bytes)?;
    }
    Ok(())
}

/// The emulator's command.
fn emulator(setup: &MachineSetup<'_>, directory: &Path) -> Result<Command> {
    if !setup.configuration.is_empty() {
        fs::write(directory.join("configuration"), setup.configuration)?;
    }
    let eeprom = match setup.eeprom {
        Some(path) => std::path::absolute(path)?,
        None => directory.join("eeprom"),
    };
    fill_up(&eeprom)?;
    let image = setup.image;
    let mut command = Command::new(EMULATOR);
    if !setup.reboots {
        command.arg("-no-reboot");
    }
    if let Some(socket) = setup.debugger {
        command.arg("-gdb").arg(listening(socket)?);
    }
    command
        .args(["-machine", image.board.name(), "-display", "none", "-monitor", "none", "-parallel", "none"])
        .arg("-serial")
        .arg(setup.serial.map_or_else(|| Ok("none".into()), listening)?)
        // Virtual time is the instruction count, and the firmware's sleep takes no time of the host.
        .args(["-icount", "shift=1,sleep=off", "-semihosting-config", "enable=on,target=native"])
        .args(["-device", &format!("at24c-eeprom,address=0x50,rom-size={EEPROM_BYTES},drive=ee")])
        .arg("-drive")
        .arg(format!("if=none,id=ee,format=raw,file={}", eeprom.display().to_string().replace(',', ",,")))
        .arg("-kernel")
        .arg(std::path::absolute(&image.path)?);
    Ok(command)
}

/// Starts an emulator in the folder of its pipes. It ends with this process.
fn spawn(command: &mut Command, directory: &Path) -> Result<Child> {
    command
        .current_dir(directory)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(directory.join("stderr"))?);
    #[cfg(target_os = "linux")]
    // Safety: the call between fork and exec sets an attribute of the child and does nothing else.
    unsafe {
        command.pre_exec(|| Ok(nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL)?));
    }
    command.spawn().with_context(|| format!("cannot start {}", command.get_program().display()))
}
