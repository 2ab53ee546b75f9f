//! A serial port with its FIFOs of 16 bytes: RM0433, universal synchronous asynchronous receiver.

use super::registers::Registers;
use std::collections::VecDeque;

/// USART3, the serial line, and USART2, the line of a serial IMU.
pub const USART3: u32 = 0x4000_4800;
pub const USART2: u32 = 0x4000_4400;

const CR1: u32 = 0x00;
const BRR: u32 = 0x0c;
const RQR: u32 = 0x18;
const ISR: u32 = 0x1c;
const ICR: u32 = 0x20;
const RDR: u32 = 0x24;
const TDR: u32 = 0x28;

const OVERRUN: u32 = 1 << 3;
const RECEIVED: u32 = 1 << 5;
const TRANSMITTED: u32 = 1 << 6;
const SPACE: u32 = 1 << 7;
/// Acknowledgements of the transmitter's and the receiver's enable bits.
const ENABLED: u32 = 3 << 21;
const FIFO: u32 = 1 << 29;
/// Cycles of the processor in one of the ports' clock of 120 MHz.
const CLOCK: u64 = 4;

/// A port.
pub struct Usart {
    base: u32,
    received: VecDeque<u8>,
    overrun: bool,
    sent_until: u64,
    /// Bytes that the port has sent.
    pub sent: Vec<u8>,
    /// Bytes on their way to the port, and when they are complete.
    arriving: VecDeque<(u8, u64)>,
    /// Number of bytes lost by overruns.
    pub lost: u64,
}

impl Usart {
    /// The port with these registers.
    pub fn new(base: u32) -> Self {
        Self {
            base,
            received: VecDeque::new(),
            overrun: false,
            sent_until: 0,
            sent: Vec::new(),
            arriving: VecDeque::new(),
            lost: 0,
        }
    }

    /// The chip was reset.
    pub fn reset(&mut self) {
        (self.overrun, self.sent_until) = (false, 0);
        self.received.clear();
    }

    /// Cycles of a byte with its start and stop bit.
    fn byte(&self, registers: &Registers) -> u64 {
        10 * CLOCK * u64::from(registers.get(self.base + BRR).max(16))
    }

    fn depth(&self, registers: &Registers) -> u64 {
        if registers.get(self.base + CR1) & FIFO != 0 { 16 } else { 1 }
    }

    fn has_space(&self, registers: &Registers, now: u64) -> bool {
        self.sent_until <= now + (self.depth(registers) - 1) * self.byte(registers)
    }

    /// Whether the interrupt line is high.
    pub fn line(&self, registers: &Registers, now: u64) -> bool {
        let control = registers.get(self.base + CR1);
        control & SPACE != 0 && self.has_space(registers, now)
            || control & RECEIVED != 0 && (self.overrun || !self.received.is_empty())
    }

    /// Time of the next change of the line by itself.
    pub fn next(&self, registers: &Registers, now: u64) -> u64 {
        let waits = registers.get(self.base + CR1) & SPACE != 0 && !self.has_space(registers, now);
        let space = self.sent_until.saturating_sub((self.depth(registers) - 1) * self.byte(registers));
        let arrival = self.arriving.front().map_or(u64::MAX, |(_, at)| *at);
        if waits { space.min(arrival) } else { arrival }
    }

    /// A byte arrives at this time.
    pub fn arrive(&mut self, byte: u8, at: u64) {
        self.arriving.push_back((byte, at));
    }

    /// Bytes arrive one after the other from this time on.
    pub fn arrive_all(&mut self, registers: &Registers, bytes: &[u8], from: u64) {
        let mut at = self.arriving.back().map_or(from, |(_, at)| from.max(*at));
        for byte in bytes {
            at += self.byte(registers);
            self.arriving.push_back((*byte, at));
        }
    }

    /// Takes the bytes that are complete.
    pub fn advance(&mut self, registers: &Registers, now: u64) {
        while let Some((byte, at)) = self.arriving.front().copied()
            && at <= now
        {
            let _ = self.arriving.pop_front();
            if registers.get(self.base + CR1) & 5 != 5 {
                continue;
            }
            if self.received.len() as u64 >= self.depth(registers) {
                self.overrun = true;
                // Before its interrupt is enabled, nobody reads the port.
                self.lost += u64::from(registers.get(self.base + CR1) & RECEIVED != 0);
            } else {
                self.received.push_back(byte);
            }
        }
    }

    pub fn read(&mut self, registers: &Registers, address: u32, now: u64) -> u32 {
        match address & 0x3ff {
            ISR => {
                let flag = |bit: u32, on: bool| if on { bit } else { 0 };
                ENABLED
                    | flag(OVERRUN, self.overrun)
                    | flag(RECEIVED, !self.received.is_empty())
                    | flag(TRANSMITTED, self.sent_until <= now)
                    | flag(SPACE, self.has_space(registers, now))
            }
            RDR => self.received.pop_front().unwrap_or(0).into(),
            _ => registers.get(address),
        }
    }

    pub fn write(&mut self, registers: &mut Registers, address: u32, value: u32, now: u64) {
        match address & 0x3ff {
            TDR => {
                if !self.has_space(registers, now) {
                    registers.violate("a byte was written to a full transmitter".into());
                }
                self.sent.push(value as u8);
                self.sent_until = self.sent_until.max(now) + self.byte(registers);
            }
            ICR => self.overrun &= value & OVERRUN == 0,
            RQR if value & 1 << 3 != 0 => self.received.clear(),
            _ => registers.set(address, value),
        }
    }
}
