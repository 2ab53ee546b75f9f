//! What a run has shown, as a file for the host.

use crate::chip::flash::Change;
use crate::chip::registers::Written;
use anyhow::{Context, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
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
#[derive(Clone, Debug, Serialize)]
pub struct Interrupt {
    /// What asks for it.
    pub name: &'static str,
    /// Number of times that it was taken.
    pub taken: u64,
    /// Longest time from the request to the handler, us.
    pub longest_wait_us: f64,
    /// Longest time in the handler, with the handlers that interrupted it, us.
    pub longest_run_us: f64,
}

/// Figures of a run.
#[derive(Debug, Serialize)]
pub struct Report {
    /// How it ended.
    pub ended: Ended,
    /// Time since power-on, us.
    pub elapsed_us: f64,
    /// Part of that time in which the processor slept.
    pub idle: f64,
    /// Instructions executed.
    pub instructions: u64,
    /// Largest use of the stack, and its size, bytes.
    pub stack_used_bytes: u64,
    pub stack_bytes: u64,
    /// Number of resets.
    pub resets: u32,
    /// Control periods that began before the one before had been seen.
    pub late_periods: u64,
    /// Time from the last reset to the start of the watchdog, us.
    pub watchdog_started_us: Option<f64>,
    /// The interrupts.
    pub interrupts: Vec<Interrupt>,
    /// Largest number of handlers that ran at once.
    pub deepest_nesting: usize,
    /// Longest time with interrupts masked, us, and the address where that ended.
    pub longest_masked_us: f64,
    pub masked_until: u32,
    /// Bytes lost by overruns of USART3 and of USART2.
    pub overruns: [u64; 2],
    /// Address ranges that the MPU closes.
    pub closed: Vec<[u64; 2]>,
    /// Accesses that the chip forbids, or that would have no effect, and how often.
    pub violations: BTreeMap<String, u64>,
    /// Changes of the flash.
    pub flash_changes: Vec<Change>,
    /// The registers that were written; only with --trace.
    pub registers: Vec<Written>,
    /// The pins that were set up; only with --trace.
    pub pins: Vec<String>,
}

impl Report {
    /// Writes the file `machine.json`.
    pub fn write(&self, directory: &Path) -> Result<()> {
        let path = directory.join("machine.json");
        let file = std::fs::File::create(&path).with_context(|| path.display().to_string())?;
        Ok(serde_json::to_writer(std::io::BufWriter::new(file), self)?)
    }
}
