//! The machine of the board STM32H743, `host-tests/h743-machine`: a program of its own, which this module builds and
//! runs. It serves the same pipes as QEMU.

use super::image::{cargo, places};
use super::machine::{Host, Load, MachineSetup, Run, WORKS, ensure_fits};
use crate::base::apt::{ensure_installed, ensure_library};
use crate::bench::devices::Bench;
use crate::bench::memory::VirtualFlash;
use crate::virtual_unit::plant::Plant;
use anyhow::{Context, Result, bail, ensure};
use rins_selfcal::instrument::{Archive, UnitMemory};
use rins_selfcal::keep::mark::Mark;
use rins_selfcal::keep::medium::Flash;
use rins_selfcal::keep::partition::Layout;
use rins_selfcal::keep::store::{Piece, Wanted};
use rins_selfcal::link::Frame;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::unit::{UnitConfiguration, UnitName};
use serde::Deserialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Length of a sector of the flash, bytes.
const SECTOR: usize = 128 * 1024;
/// Number of sectors for records.
const SECTORS: usize = 6;
/// First address of the sectors for records.
pub const RECORDS: u32 = 0x0814_0000;
/// Where the firmware keeps which records: `LAYOUT` of `src/bin/firmware/stm32h743.rs`.
const LAYOUT: Layout = Layout {
    marks: 0..2 * SECTOR as u32,
    configuration: 2 * SECTOR as u32..4 * SECTOR as u32,
    calibrations: 4 * SECTOR as u32..6 * SECTOR as u32,
};

/// The flash's sectors for records.
pub type RecordFlash = VirtualFlash<32, SECTOR>;

/// Builds the machine and returns its program. Installs what the build needs.
///
/// # Errors
/// One line that names what is missing, or the output of cargo.
pub fn program() -> Result<PathBuf> {
    // The emulator of the processor is C, built by cmake, and its header is translated by libclang.
    ensure_installed("cmake", "cmake")?;
    ensure_library("libclang.so", "libclang-dev")?;
    let (root, targets) = places()?;
    // A folder of its own, because a running `cargo test` locks the usual one.
    let directory = targets.join("h743-machine");
    fs::create_dir_all(&directory).with_context(|| format!("cannot make {}", directory.display()))?;
    let lock = File::create(directory.join(".lock"))?;
    lock.lock()?;
    let output = cargo()
        .current_dir(root)
        .args(["build", "--release", "--quiet", "--package", "h743-machine", "--target-dir"])
        .arg(&directory)
        .output()
        .context("cannot run cargo")?;
    ensure!(output.status.success(), "the machine does not build:\n{}", String::from_utf8_lossy(&output.stderr));
    Ok(directory.join("release").join("h743-machine"))
}

/// The content of a file of the flash: the bytes, then the addresses of the words that cannot be read. A file that is
/// missing is a blank flash.
///
/// # Errors
/// The file cannot be read.
pub fn read_flash(path: &Path) -> Result<RecordFlash> {
    let content = if path.exists() { fs::read(path).with_context(|| path.display().to_string())? } else { Vec::new() };
    let (bytes, broken) = content.split_at(content.len().min(SECTORS * SECTOR));
    let broken = broken.as_chunks::<4>().0.iter().map(|address| u32::from_le_bytes(*address) - RECORDS);
    Ok(RecordFlash::with_content(SECTORS, bytes, broken.map(|address| address as usize)))
}

/// Writes a file of the flash.
///
/// # Errors
/// The file cannot be written.
pub fn write_flash(path: &Path, flash: &RecordFlash) -> Result<()> {
    let broken = flash.unreadable().flat_map(|address| (RECORDS + address as u32).to_le_bytes());
    let content: Vec<u8> = flash.bytes.iter().copied().chain(broken).collect();
    fs::write(path, content).with_context(|| path.display().to_string())
}

/// Commissions the unit whose flash is in this file: its configuration is that of the assignment. A new unit is marked as
/// standing at (0, 0).
///
/// # Errors
/// The assignment is not that of a self-calibration, or the file cannot be read or written.
pub fn commission(path: &Path, assignment: &[u8]) -> Result<()> {
    let assignment = postcard::from_bytes(assignment).context("the assignment cannot be read")?;
    let Assignment::SelfCalibrate(run) = assignment else { bail!("the board STM32H743 does not replay samples") };
    let flash = RefCell::new(Flash::new(read_flash(path)?, 0..(SECTORS * SECTOR) as u32));
    let mut memory = UnitMemory::new(&flash, LAYOUT);
    let unit = UnitConfiguration { unit: UnitName::default(), run };
    if memory.configuration().configuration.as_ref() != Some(&unit) {
        memory.configure(&unit).map_err(|refusal| anyhow::anyhow!("the configuration cannot be stored: {refusal}"))?;
    }
    if memory.last_mark().is_none() {
        ensure!(memory.mark(Mark::AtRest { angles_rad: [0.0; 2] }), "the mark of motion cannot be stored");
    }
    write_flash(path, flash.into_inner().flash())
}

/// All intact calibrations in a flash, newest first, as the store reads them. They are encoded, because NaN differs from
/// NaN.
///
/// # Panics
/// The memory does not work.
pub fn calibrations(flash: &RecordFlash) -> Vec<Vec<u8>> {
    let memory = RefCell::new(Flash::new(flash.clone(), 0..(SECTORS * SECTOR) as u32));
    let mut memory = UnitMemory::new(&memory, LAYOUT);
    let mut read = |back: u16| loop {
        match Archive::read_piece(&mut memory, Wanted::Entry { back }).expect("a virtual memory works") {
            Piece::More => {}
            Piece::Whole(record) => return Some(postcard::to_stdvec(&record).expect("it serializes")),
            Piece::Nothing => return None,
        }
    };
    (0..).map_while(&mut read).collect()
}

/// How a run of the machine ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// The bench switched the instrument off.
    SwitchedOff,
    /// The chip was reset, and the run ends with the first reset.
    Reset,
    /// The power was cut while the flash was written or erased.
    PowerCut,
    /// The longest time is over.
    TimeOver,
    /// The processor sleeps, and nothing will wake it.
    SleepsForEver,
}

/// Figures of an interrupt.
#[derive(Clone, Debug, Deserialize)]
pub struct Interrupt {
    /// What asks for it.
    pub name: String,
    /// Number of times that it was taken.
    pub taken: u64,
    /// Longest time from the request to the handler, us.
    pub longest_wait_us: f64,
    /// Longest time in the handler, with the handlers that interrupted it, us.
    pub longest_run_us: f64,
}

/// A change of the flash.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub enum Change {
    /// A sector was erased; its first address.
    Erased(u32),
    /// A word was programmed: address and bytes.
    Programmed(u32, Vec<u8>),
}

/// A register that was written.
#[derive(Clone, Debug, Deserialize)]
pub struct Written {
    /// Address.
    pub address: u32,
    /// Peripheral and register.
    pub name: String,
    /// Number of reads.
    pub reads: u64,
    /// Number of writes.
    pub writes: u64,
    /// The first different values that were written, in order.
    pub values: Vec<u32>,
    /// Fields of the last different value.
    pub meaning: String,
}

/// What a run of the machine has shown. An instruction is taken to take one cycle of 480 MHz.
#[derive(Clone, Debug, Deserialize)]
pub struct Report {
    /// How it ended.
    pub ended: Ended,
    /// Time since power-on, us.
    pub elapsed_us: f64,
    /// Part of that time in which the processor slept.
    pub idle: f64,
    /// Instructions executed.
    pub instructions: u64,
    /// Largest use of the stack, bytes.
    pub stack_used_bytes: u64,
    /// Size of the stack, bytes.
    pub stack_bytes: u64,
    /// Number of resets.
    pub resets: u32,
    /// Control periods that began before the one before had been seen.
    pub late_periods: u64,
    /// Time after power-on when the watchdog was started, us.
    pub watchdog_started_us: Option<f64>,
    /// The interrupts.
    pub interrupts: Vec<Interrupt>,
    /// Largest number of handlers that ran at once.
    pub deepest_nesting: usize,
    /// Longest time with interrupts masked, us.
    pub longest_masked_us: f64,
    /// Address where that ended.
    pub masked_until: u32,
    /// Bytes lost by overruns of USART3 and of USART2.
    pub overruns: [u64; 2],
    /// Address ranges that the MPU closes.
    pub closed: Vec<[u64; 2]>,
    /// Accesses that the chip forbids, or that would have no effect, and how often.
    pub violations: BTreeMap<String, u64>,
    /// Changes of the flash.
    pub flash_changes: Vec<Change>,
    /// The registers that were written; only with `--trace`.
    pub registers: Vec<Written>,
    /// The pins that were set up; only with `--trace`.
    pub pins: Vec<String>,
    /// Number of transfers with the bench.
    #[serde(skip)]
    pub transfers: u64,
    /// Duration on the host, s.
    #[serde(skip)]
    pub wall_s: f64,
}

impl Report {
    /// The figures of a run that are common to all boards. Work is not told apart by kinds, and the queue is not seen.
    ///
    /// # Errors
    /// The instrument was not switched off by its bench.
    pub fn run(&self) -> Result<Run> {
        match self.ended {
            Ended::SwitchedOff => {}
            Ended::Reset => bail!("the firmware stopped: the last line of its log has the reason"),
            Ended::PowerCut => bail!("the power was cut"),
            Ended::TimeOver | Ended::SleepsForEver => bail!("the firmware hangs: {:?}", self.ended),
        }
        Ok(Run {
            success: true,
            transfers: self.transfers,
            wall_s: self.wall_s,
            elapsed_s: self.elapsed_us * 1e-6,
            instructions: self.instructions as f64,
            stack_used_bytes: self.stack_used_bytes,
            stack_bytes: self.stack_bytes,
            late_periods: self.late_periods,
            late_commands: 0,
            control_latency: 0.0,
            data_ready_latency: 0.0,
            queue_deepest: 0,
            queue_length: 0,
            loads: [Load::default(); WORKS.len()],
        })
    }

    /// Figures of the interrupt whose name begins so.
    ///
    /// # Panics
    /// There is no such interrupt.
    pub fn interrupt(&self, name: &str) -> &Interrupt {
        self.interrupts.iter().find(|interrupt| interrupt.name.starts_with(name)).expect("an interrupt of the board")
    }
}

/// Runs an image of the board on a bench until the run ends. `on_log` gets each line of the firmware's log, and
/// `on_message` each message on its serial line.
///
/// # Errors
/// The machine cannot be built or started, or fails.
pub fn run<P: Plant>(
    setup: &MachineSetup<'_>,
    bench: &mut Bench<P>,
    on_log: impl FnMut(&str),
    mut on_message: impl FnMut(&Message),
) -> Result<Report> {
    run_frames(setup, bench, on_log, |frame| {
        if frame.is::<Message>() {
            on_message(&frame.read()?);
        }
        Some(())
    })
}

/// As [`run`], with all frames of the serial line, answers to commands included. `on_frame` returns `None` for a frame
/// that it cannot read.
///
/// # Errors
/// The machine cannot be built or started, or fails.
pub fn run_frames<P: Plant>(
    setup: &MachineSetup<'_>,
    bench: &mut Bench<P>,
    mut on_log: impl FnMut(&str),
    mut on_frame: impl FnMut(&Frame<'_>) -> Option<()>,
) -> Result<Report> {
    ensure_fits(setup, bench)?;
    let program = program()?;
    let start = Instant::now();
    let directory = tempfile::Builder::new().prefix("rins-").tempdir()?;
    let flash = setup.eeprom.map_or_else(|| directory.path().join("flash"), Path::to_owned);
    if !setup.configuration.is_empty() {
        commission(&flash, setup.configuration)?;
    }
    let mut command = Command::new(program);
    command.arg(std::path::absolute(&setup.image.path)?).arg(".").arg("--flash").arg(std::path::absolute(flash)?);
    if setup.reboots {
        command.arg("--reboots");
    }
    if let Some(socket) = setup.serial {
        command.arg("--serial").arg(std::path::absolute(socket)?);
    }
    command.args(setup.arguments);
    let mut host = Host::start(command, directory.path())?;
    let status = host.serve_all(setup, bench, &mut on_log, &mut on_frame)?;
    ensure!(status.success(), "the machine failed: {}", host.complaints(directory.path()));
    let report = fs::read(directory.path().join("machine.json")).context("the machine ended without a report")?;
    let report = serde_json::from_slice(&report).context("the report of the machine")?;
    Ok(Report { transfers: host.transfers, wall_s: start.elapsed().as_secs_f64(), ..report })
}
