//! The SPI ports: RM0433, serial peripheral interface. Frames of 8 bits, and the devices at the ports.

use super::registers::Registers;
use crate::bench::Bench;
use anyhow::Result;
use std::collections::VecDeque;

/// Register blocks of the ports: IMU, outer encoder, inner encoder.
pub const PORTS: [u32; 3] = [0x4001_3000, 0x4000_3c00, 0x4001_3400];

const CR1: u32 = 0x00;
const CFG1: u32 = 0x08;
const CFG2: u32 = 0x0c;
const SR: u32 = 0x14;
const TXDR: u32 = 0x20;
const RXDR: u32 = 0x30;

const RECEIVED: u32 = 1;
const SPACE: u32 = 1 << 1;
const COMPLETE: u32 = 1 << 12;
/// Cycles of the processor in one of the ports' clock of 120 MHz.
const CLOCK: u64 = 4;
const CYCLES_PER_US: u64 = 480;
/// Least time between two words: ADIS16495 data sheet, t_STALL.
const STALL_CYCLES: u64 = 5 * CYCLES_PER_US;
/// Time from a reset command until the IMU answers: ADIS16495 data sheet, reset recovery.
const RESET_CYCLES: u64 = 210_000 * CYCLES_PER_US;
const BURST: u8 = 0x7c;
const BURST_BYTES: usize = 40;
/// An encoder's data must not change this short a time before or after its clock samples it, ns.
const UNSURE_NS: f64 = 12.0;

#[derive(Default)]
struct Port {
    received: VecDeque<u8>,
    done_at: u64,
    /// Bytes that the device has ready.
    answer: VecDeque<u8>,
}

/// The ports and their devices.
pub struct Ports {
    ports: [Port; 3],
    imu: ImuLine,
    /// Delay of the encoders' data against their clock, ns.
    pub encoder_delay_ns: f64,
    /// Time of the last period of the bench.
    pub period_at: u64,
    random: u64,
}

/// The state of the line to the IMU.
struct ImuLine {
    selected: bool,
    word: Vec<u8>,
    ready_at: u64,
    released_at: u64,
    page: u8,
    /// The word that is being sent, and the burst.
    answer: [u8; 2],
    burst: [u8; BURST_BYTES],
}

impl Ports {
    /// The ports after power-on.
    pub fn new(imu_ready_at: u64, encoder_delay_ns: f64) -> Self {
        let imu = ImuLine {
            selected: false,
            word: Vec::new(),
            ready_at: imu_ready_at,
            released_at: 0,
            page: 0,
            answer: [0; 2],
            burst: [0; BURST_BYTES],
        };
        Self { ports: Default::default(), imu, encoder_delay_ns, period_at: 0, random: 1 }
    }

    /// The chip was reset. The devices go on.
    pub fn reset(&mut self) {
        self.ports = Default::default();
        self.imu.selected = false;
    }

    /// The port of a register.
    pub fn port(address: u32) -> Option<usize> {
        PORTS.iter().position(|base| *base == address & !0x3ff)
    }

    /// Time when the transfer of a port ends.
    pub fn done_at(&self, port: usize) -> u64 {
        self.ports[port].done_at
    }

    pub fn read(&mut self, registers: &Registers, port: usize, address: u32, now: u64) -> u32 {
        let line = &mut self.ports[port];
        match address & 0x3ff {
            SR if now >= line.done_at => SPACE | COMPLETE | if line.received.is_empty() { 0 } else { RECEIVED },
            SR => SPACE,
            RXDR => line.received.pop_front().unwrap_or(0).into(),
            _ => registers.get(address),
        }
    }

    pub fn write(
        &mut self,
        (registers, bench): (&mut Registers, &mut Bench),
        port: usize,
        (address, value, size): (u32, u32, usize),
        now: u64,
    ) -> Result<()> {
        match address & 0x3ff {
            CR1 => {
                if registers.get(address) & 1 == 0 && value & 1 == 1 {
                    self.ports[port].received.clear();
                    self.ports[port].answer.clear();
                }
                registers.set(address, value);
            }
            TXDR if size == 1 => {
                // A byte that is written before the transfer is started waits for the start, which follows at once.
                if registers.get(PORTS[port] + CR1) & 1 == 0 {
                    registers.violate("a byte was written to an SPI port that was not enabled".into());
                }
                self.clock(registers, bench, port, value as u8, now)?;
            }
            TXDR => registers.violate("an SPI port was written by other frames than bytes".into()),
            _ => registers.set(address, value),
        }
        Ok(())
    }

    /// Cycles of the processor in a bit.
    fn bit(registers: &Registers, port: usize) -> u64 {
        CLOCK << ((registers.get(PORTS[port] + CFG1) >> 28 & 7) + 1)
    }

    fn clock(&mut self, registers: &mut Registers, bench: &mut Bench, port: usize, sent: u8, now: u64) -> Result<()> {
        let bit = Self::bit(registers, port);
        let start = now.max(self.ports[port].done_at);
        let received = match port.checked_sub(1) {
            None => self.imu.clock(registers, bench, sent, start)?,
            Some(axis) => self.clock_encoder(registers, bench, axis, start)?,
        };
        let line = &mut self.ports[port];
        line.received.push_back(received);
        line.done_at = start + 8 * bit;
        Ok(())
    }

    fn clock_encoder(&mut self, registers: &Registers, bench: &mut Bench, axis: usize, start: u64) -> Result<u8> {
        if self.ports[1 + axis].answer.is_empty() {
            let late_ns = (start.saturating_sub(self.period_at) * 1000 / CYCLES_PER_US) as u32;
            let mut frame = bench.encoder(axis, late_ns)?;
            if self.is_unsure(registers, 1 + axis) {
                self.blur(&mut frame);
            }
            self.ports[1 + axis].answer.extend(frame);
        }
        Ok(self.ports[1 + axis].answer.pop_front().unwrap_or(0xff))
    }

    /// Whether the port samples while the encoder's data change. They change at a rising edge of the clock and after the
    /// delay of the line. The clock idles high: mode 3 samples at its rising edge and mode 2 at its falling edge.
    fn is_unsure(&self, registers: &Registers, port: usize) -> bool {
        let bit_ns = Self::bit(registers, port) as f64 * 1000.0 / CYCLES_PER_US as f64;
        let samples_ns = if registers.get(PORTS[port] + CFG2) >> 24 & 1 == 1 { 0.0 } else { 0.5 * bit_ns };
        let apart = (samples_ns - self.encoder_delay_ns).rem_euclid(bit_ns);
        apart.min(bit_ns - apart) < UNSURE_NS
    }

    /// Where a bit differs from the one before, either may be sampled.
    fn blur(&mut self, frame: &mut [u8; 12]) {
        let bits = |at: usize, frame: &[u8; 12]| frame[at / 8] >> (7 - at % 8) & 1;
        let clean = *frame;
        for at in 1..96 {
            self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            if bits(at, &clean) != bits(at - 1, &clean) && self.random >> 63 == 1 {
                frame[at / 8] ^= 1 << (7 - at % 8);
            }
        }
    }

    /// The line that selects the IMU changes.
    pub fn select(&mut self, registers: &mut Registers, low: bool, now: u64) {
        if low && !self.imu.selected {
            if self.imu.released_at > 0 && now - self.imu.released_at < STALL_CYCLES {
                registers.violate("the IMU was selected again before its stall time".into());
            }
            self.imu.word.clear();
            self.ports[0].answer.clear();
        }
        if !low && self.imu.selected {
            self.imu.released_at = now;
        }
        self.imu.selected = low;
    }
}

impl ImuLine {
    /// A byte to the IMU, and the byte that it sends meanwhile.
    fn clock(&mut self, registers: &mut Registers, bench: &mut Bench, sent: u8, now: u64) -> Result<u8> {
        if !self.selected {
            registers.violate("the IMU was clocked without being selected".into());
        }
        if now < self.ready_at {
            return Ok(0);
        }
        self.word.push(sent);
        let place = self.word.len() - 1;
        if self.word[0] == BURST {
            // The whole burst is known once it has begun.
            if place == 0 {
                let mut burst = [0; BURST_BYTES];
                burst[0] = BURST;
                bench.imu(&mut burst)?;
                self.burst = burst;
            }
            return Ok(self.burst.get(place).copied().unwrap_or(0));
        }
        if place.is_multiple_of(2) {
            self.answer = bench.imu_answer()?;
            return Ok(self.answer[0]);
        }
        let mut word = [self.word[place - 1], sent];
        self.obey(word, now);
        bench.imu(&mut word)?;
        Ok(self.answer[1])
    }

    /// Follows the page, and a reset by GLOB_CMD in page 3.
    fn obey(&mut self, word: [u8; 2], now: u64) {
        match word {
            [0x80, page] => self.page = page,
            [0x82, command] if self.page == 3 && command & 0x80 != 0 => {
                (self.ready_at, self.page) = (now + RESET_CYCLES, 0)
            }
            _ => {}
        }
    }
}
