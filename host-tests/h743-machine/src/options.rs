//! The command line: the image, the files, and what is wrong with the board.

use anyhow::{Context, Result};
use clap::{Parser, ValueEnum};
use std::path::PathBuf;

/// Runs an image until the bench switches the instrument off.
#[derive(Debug, Parser)]
pub struct Options {
    /// ELF file of the firmware
    pub image: PathBuf,
    /// Folder with the pipes requests, answers, telemetry and log; machine.json is written into it
    pub directory: PathBuf,
    /// File with the flash's sectors of records, kept from run to run [default: blank]
    #[arg(long)]
    pub flash: Option<PathBuf>,
    /// Unix socket at which the serial line is offered
    #[arg(long)]
    pub serial: Option<PathBuf>,
    /// Bytes that arrive on the serial line, as HEX@TIME_US
    #[arg(long, value_parser = parse_received)]
    pub receive: Vec<Received>,
    /// Continue after a reset
    #[arg(long)]
    pub reboots: bool,
    /// End after this time, s
    #[arg(long, default_value_t = f64::INFINITY)]
    pub longest_s: f64,

    /// The external clock
    #[arg(long, value_enum, default_value_t)]
    pub hse: Oscillator,
    /// The crystal of 32.768 kHz
    #[arg(long, value_enum, default_value_t)]
    pub lse: Oscillator,
    /// Error of the processor's clock against real time, ppm: positive if the clock is fast
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub clock_ppm: f64,
    /// Revision of the chip
    #[arg(long, value_enum, default_value_t)]
    pub revision: Revision,
    /// Time that the IMU needs from power-on, ms (ADIS16495 data sheet: 250)
    #[arg(long, default_value_t = 250)]
    pub imu_start_ms: u64,
    /// Delay of the encoders' data against their clock, ns
    #[arg(long, default_value_t = 40.0)]
    pub encoder_delay_ns: f64,

    /// Time by which the IMU's samples are later than they would be, us: moves them against the control periods
    #[arg(long, default_value_t = 0)]
    pub sample_phase_us: u64,

    /// Set RDSERR at the end of each erase, as revision V does (Zephyr #60449)
    #[arg(long)]
    pub rdserr: bool,
    /// Make the flash word at this address unreadable
    #[arg(long, value_parser = parse_number)]
    pub broken: Vec<u32>,
    /// Cut the power in the programming of the flash word with this number, counted from 0
    #[arg(long)]
    pub cut_word: Option<u64>,
    /// Cut the power in the erase with this number, counted from 0
    #[arg(long)]
    pub cut_erase: Option<u64>,
    /// The probe that reads the log has gone away: nothing reads the log, which is in blocking mode
    #[arg(long)]
    pub log_unread: bool,

    /// Continue at TO in place of FROM, at time US after power-on, as FROM:TO:US; addresses or names of functions.
    /// `hang` as TO is an endless loop, `fault` an undefined instruction
    #[arg(long)]
    pub divert: Vec<String>,
    /// Write all accesses to registers into registers.json
    #[arg(long)]
    pub trace: bool,
}

/// An oscillator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Oscillator {
    /// It runs.
    #[default]
    Good,
    /// It never starts.
    Absent,
}

/// Revision of the chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Revision {
    /// Revision Y, which allows 400 MHz only.
    Y,
    /// Revision V.
    #[default]
    V,
}

/// Bytes that arrive at a time.
#[derive(Clone, Debug)]
pub struct Received {
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Time of the first byte after power-on, us.
    pub time_us: u64,
}

fn parse_received(text: &str) -> Result<Received> {
    let (bytes, time) = text.split_once('@').context("not HEX@TIME_US")?;
    let byte = |at: usize| bytes.get(at..at + 2).and_then(|byte| u8::from_str_radix(byte, 16).ok());
    let bytes =
        (0..bytes.len()).step_by(2).map(byte).collect::<Option<_>>().context("not a row of hexadecimal bytes")?;
    Ok(Received { bytes, time_us: time.parse()? })
}

/// A number, hexadecimal with the prefix 0x.
pub fn parse_number(text: &str) -> Result<u32> {
    Ok(match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16)?,
        None => text.parse()?,
    })
}
