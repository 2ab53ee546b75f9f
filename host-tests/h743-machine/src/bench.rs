//! The pipes to the host, which simulates everything outside the chip.

use anyhow::{Context, Result};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;

/// Numbers of the chips on the host's bench: `host-tests/src/bench/bus.rs`.
mod chip {
    pub const IMU: u8 = 0;
    pub const ENCODERS: [u8; 2] = [1, 2];
    pub const PERIOD: u8 = 3;
    pub const IMU_ANSWER: u8 = 5;
}

/// Length of the transfer of a control period and of an encoder's frame, bytes.
const PERIOD_BYTES: usize = 25;
const FRAME_BYTES: usize = 12;
/// Most bytes of a serial IMU in one transfer.
const SERIAL_BYTES: usize = 31;

/// State of a bridge's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BridgePins {
    /// Part of the time for which the PWM is high, in 8000 steps.
    pub duty: u16,
    /// The direction pin is high.
    pub direction: bool,
    /// The enable pin is high.
    pub enable: bool,
}

/// What the chip sees of the bench at the end of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// The instrument is switched on.
    pub powered: bool,
    /// The data-ready line had an edge, or bytes of a serial IMU have come.
    pub imu: bool,
    /// The fault lines of the outer and the inner bridge are high.
    pub fault_lines: [bool; 2],
}

/// The host's ends of the pipes.
pub struct Bench {
    requests: File,
    answers: File,
    telemetry: File,
    log: File,
}

impl Bench {
    /// Opens the pipes in a folder.
    pub fn open(directory: &Path) -> Result<Self> {
        let open = |name: &str, write: bool| {
            let path = directory.join(name);
            OpenOptions::new().read(!write).write(write).open(&path).with_context(|| path.display().to_string())
        };
        Ok(Self {
            requests: open("requests", true)?,
            answers: open("answers", false)?,
            telemetry: open("telemetry", true)?,
            log: open("log", true)?,
        })
    }

    fn transfer(&mut self, chip: u8, frame: &mut [u8]) -> Result<()> {
        let request = [&[chip, frame.len() as u8], &*frame].concat();
        self.requests.write_all(&request).and_then(|()| self.answers.read_exact(frame)).context("the bench has ended")
    }

    /// Lets the plant advance by a control period with these outputs.
    pub fn period(&mut self, bridges: [BridgePins; 2]) -> Result<Inputs> {
        let mut frame = [0; PERIOD_BYTES];
        for (place, pins) in frame.as_chunks_mut::<3>().0.iter_mut().zip(bridges) {
            let [low, high] = pins.duty.to_le_bytes();
            *place = [low, high, u8::from(pins.direction) | u8::from(pins.enable) << 1];
        }
        self.transfer(chip::PERIOD, &mut frame)?;
        let bit = |bit: u8| frame[0] >> bit & 1 == 1;
        Ok(Inputs { powered: bit(0), imu: bit(1), fault_lines: [bit(2), bit(3)] })
    }

    /// The bits of an encoder's line, for a request this time after the last period.
    pub fn encoder(&mut self, axis: usize, late_ns: u32) -> Result<[u8; FRAME_BYTES]> {
        let mut frame = [0; FRAME_BYTES];
        frame[..4].copy_from_slice(&late_ns.to_le_bytes());
        self.transfer(chip::ENCODERS[axis], &mut frame)?;
        Ok(frame)
    }

    /// The word that the IMU sends while it receives its next word.
    pub fn imu_answer(&mut self) -> Result<[u8; 2]> {
        let mut answer = [0; 2];
        self.transfer(chip::IMU_ANSWER, &mut answer)?;
        Ok(answer)
    }

    /// Words to the IMU, which are replaced by its answers.
    pub fn imu(&mut self, words: &mut [u8]) -> Result<()> {
        self.transfer(chip::IMU, words)
    }

    /// Bytes that a serial IMU has sent in the last period: value, and age at the end of the period in us.
    pub fn imu_bytes(&mut self) -> Result<Vec<(u8, u16)>> {
        let mut all = Vec::new();
        loop {
            let mut frame = [0; 1 + 3 * SERIAL_BYTES];
            self.transfer(chip::IMU, &mut frame)?;
            let (count, places) = frame.split_first().expect("a frame");
            let came = places.as_chunks::<3>().0.iter().take((*count).into());
            all.extend(came.map(|[low, high, byte]| (*byte, u16::from_le_bytes([*low, *high]))));
            if usize::from(*count) < SERIAL_BYTES {
                return Ok(all);
            }
        }
    }

    /// Bytes that the chip has sent on its serial line.
    pub fn telemetry(&mut self, bytes: &[u8]) -> Result<()> {
        self.telemetry.write_all(bytes).context("nobody reads the serial line")
    }

    /// Bytes of the log.
    pub fn log(&mut self, bytes: &[u8]) -> Result<()> {
        self.log.write_all(bytes).context("nobody reads the log")
    }
}
