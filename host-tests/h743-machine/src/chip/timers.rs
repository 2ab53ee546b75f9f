//! The timers: RM0433, advanced-control, general-purpose and basic timers. Their clock is half the processor's.

use super::registers::Registers;
use crate::bench::BridgePins;

pub const TIM1: u32 = 0x4001_0000;
pub const TIM2: u32 = 0x4000_0000;
pub const TIM3: u32 = 0x4000_0400;
pub const TIM6: u32 = 0x4000_1000;
pub const TIM16: u32 = 0x4001_4400;

/// Offsets of the registers.
const CR1: u32 = 0x00;
const DIER: u32 = 0x0c;
pub const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2c;
const RCR: u32 = 0x30;
const CCR1: u32 = 0x34;
const CCR4: u32 = 0x40;
const BDTR: u32 = 0x44;
const TISEL: u32 = 0x68;

/// Cycles of the processor in a cycle of a timer's clock.
const CLOCK: u64 = 2;
const UPDATE: u32 = 1;
const CAPTURE_1: u32 = 1 << 1;
const CAPTURE_4: u32 = 1 << 4;
/// Frequency of the crystal that TIM16 can capture, Hz.
const CRYSTAL_HZ: f64 = 32_768.0;
const CORE_HZ: f64 = 480e6;

/// A timer that counts up.
#[derive(Clone, Copy)]
struct Counter {
    base: u32,
    /// Time when the count was last zero; `None` while it stands.
    from: Option<u64>,
}

impl Counter {
    const fn new(base: u32) -> Self {
        Self { base, from: None }
    }

    /// Cycles of a count.
    fn step(self, registers: &Registers) -> u64 {
        CLOCK * (u64::from(registers.get(self.base + PSC) & 0xffff) + 1)
    }

    /// Cycles from zero to zero.
    fn period(self, registers: &Registers) -> u64 {
        self.step(registers) * (u64::from(registers.get(self.base + ARR)) + 1)
    }

    fn count(self, registers: &Registers, now: u64) -> u32 {
        self.from.map_or(0, |from| ((now - from) % self.period(registers) / self.step(registers)) as u32)
    }

    fn switch(&mut self, on: bool, now: u64) {
        self.from = on.then(|| self.from.unwrap_or(now));
    }
}

/// The timers that the board uses.
pub struct Timers {
    motors: Counter,
    clock: Counter,
    pulses: Counter,
    control: Counter,
    reference: Counter,
    /// Time of the next update of TIM6.
    pub control_at: u64,
    /// Time when TIM1 stops unless it is armed again.
    motors_until: u64,
    /// Error of the processor's clock, as a factor.
    pub clock_factor: f64,
    /// Time since when the crystal runs; `None` while it stands.
    pub crystal_from: Option<u64>,
    /// Edges of the crystal that TIM16 has captured.
    captured: u64,
    /// Longest time from an update of TIM6 to the next in which its flag was not cleared.
    pub late_periods: u64,
}

impl Timers {
    /// The timers after a reset.
    pub fn new(clock_factor: f64) -> Self {
        Self {
            motors: Counter::new(TIM1),
            clock: Counter::new(TIM2),
            pulses: Counter::new(TIM3),
            control: Counter::new(TIM6),
            reference: Counter::new(TIM16),
            control_at: u64::MAX,
            motors_until: 0,
            clock_factor,
            crystal_from: None,
            captured: 0,
            late_periods: 0,
        }
    }

    fn counter(&mut self, base: u32) -> &mut Counter {
        match base {
            TIM1 => &mut self.motors,
            TIM2 => &mut self.clock,
            TIM3 => &mut self.pulses,
            TIM6 => &mut self.control,
            _ => &mut self.reference,
        }
    }

    /// Whether a timer has this register block.
    pub fn has(address: u32) -> bool {
        [TIM1, TIM2, TIM3, TIM6, TIM16].contains(&(address & !0x3ff))
    }

    /// Whether the pulses for the IMU run.
    pub fn pulses_run(&self) -> bool {
        self.pulses.from.is_some()
    }

    pub fn read(&mut self, registers: &mut Registers, address: u32, now: u64) -> u32 {
        let (base, offset) = (address & !0x3ff, address & 0x3ff);
        if base == TIM16 {
            self.capture_crystal(registers, now);
        }
        match offset {
            CNT => self.counter(base).count(registers, now),
            CCR4 if base == TIM2 => {
                registers.set_bits(TIM2 + SR, CAPTURE_4, false);
                registers.get(address)
            }
            CCR1 if base == TIM16 => {
                registers.set_bits(TIM16 + SR, CAPTURE_1, false);
                registers.get(address)
            }
            _ => registers.get(address),
        }
    }

    pub fn write(&mut self, registers: &mut Registers, address: u32, value: u32, now: u64) {
        let (base, offset) = (address & !0x3ff, address & 0x3ff);
        match offset {
            // A flag is cleared by writing zero.
            SR => registers.set(address, registers.get(address) & value),
            EGR => {
                if value & UPDATE != 0 {
                    registers.set_bits(base + SR, UPDATE, true);
                    if self.counter(base).from.is_some() {
                        self.counter(base).from = Some(now);
                    }
                    if base == TIM1 {
                        let cycles = u64::from(registers.get(TIM1 + RCR) & 0xffff) + 1;
                        self.motors_until = now + cycles * self.motors.period(registers);
                    }
                }
            }
            CR1 => {
                registers.set(address, value);
                self.counter(base).switch(value & 1 == 1, now);
                if base == TIM6 {
                    let period = self.control.period(registers);
                    self.control_at = self.control.from.map_or(u64::MAX, |from| from + period);
                }
                if base == TIM16 {
                    self.captured = self.edges(now);
                }
            }
            _ => registers.set(address, value),
        }
    }

    /// Lets TIM6 run to this time.
    pub fn advance(&mut self, registers: &mut Registers, now: u64) {
        if now >= self.control_at {
            self.control_at += self.control.period(registers);
            self.late_periods += u64::from(registers.get(TIM6 + SR) & UPDATE);
            registers.set_bits(TIM6 + SR, UPDATE, true);
        }
    }

    /// Whether channel 4 of TIM2 is set up to capture edges.
    fn captures(&self, registers: &Registers) -> bool {
        registers.get(TIM2 + CCER) & 1 << 12 != 0
    }

    /// An edge on the data-ready line, which channel 4 of TIM2 captures.
    pub fn data_ready(&mut self, registers: &mut Registers, now: u64) {
        if self.captures(registers) {
            let count = self.clock.count(registers, now);
            registers.set(TIM2 + CCR4, count);
            registers.set_bits(TIM2 + SR, CAPTURE_4, true);
        }
    }

    /// Whether the interrupt line of TIM6 and of TIM2 is high.
    pub fn lines(&self, registers: &Registers) -> [bool; 2] {
        [TIM6, TIM2].map(|base| registers.get(base + SR) & registers.get(base + DIER) & 0xff != 0)
    }

    /// Rising edges of the crystal so far.
    fn edges(&self, now: u64) -> u64 {
        let cycles = CORE_HZ * self.clock_factor / CRYSTAL_HZ;
        self.crystal_from.map_or(0, |from| (now.saturating_sub(from) as f64 / cycles) as u64)
    }

    /// Time of the next capture of the crystal; `None` if none is to come.
    pub fn next_capture(&self, registers: &Registers) -> Option<u64> {
        let every = 1_u64 << (registers.get(TIM16 + CCMR1) >> 2 & 3);
        let cycles = CORE_HZ * self.clock_factor / CRYSTAL_HZ;
        let from = self.crystal_from.filter(|_| self.reference.from.is_some())?;
        Some(from + ((self.captured + every) as f64 * cycles) as u64 + 1)
    }

    /// TIM16 captures every n-th edge of the crystal on its channel 1.
    fn capture_crystal(&mut self, registers: &mut Registers, now: u64) {
        const OF_CRYSTAL: u32 = 2;
        let is_set_up = registers.get(TIM16 + CCER) & 1 == 1
            && registers.get(TIM16 + CCMR1) & 3 == 1
            && registers.get(TIM16 + TISEL) & 0xf == OF_CRYSTAL;
        let (Some(from), Some(since), true) = (self.crystal_from, self.reference.from, is_set_up) else { return };
        let every = 1_u64 << (registers.get(TIM16 + CCMR1) >> 2 & 3);
        if self.edges(now) >= self.captured + every {
            self.captured += every * ((self.edges(now) - self.captured) / every);
            let at = from + (self.captured as f64 * CORE_HZ * self.clock_factor / CRYSTAL_HZ) as u64;
            let count = Counter { from: Some(since), ..self.reference }.count(registers, at.max(since));
            registers.set(TIM16 + CCR1, count);
            registers.set_bits(TIM16 + SR, CAPTURE_1, true);
        }
    }

    /// The PWM of both motors. The pins of direction and enable are added by the caller.
    pub fn motors(&self, registers: &Registers, now: u64) -> [BridgePins; 2] {
        let runs = now < self.motors_until && self.motors.from.is_some() && registers.get(TIM1 + BDTR) >> 15 & 1 == 1;
        let counts = registers.get(TIM1 + ARR) + 1;
        [0, 1].map(|channel| {
            let compare = registers.get(TIM1 + CCR1 + 4 * channel).min(counts);
            let is_connected = registers.get(TIM1 + CCER) >> (4 * channel) & 1 == 1;
            let mode = registers.get(TIM1 + CCMR1) >> (8 * channel + 4) & 7;
            let high = match (mode, runs) {
                (6, true) => compare,
                (7, true) => counts - compare,
                // The count stands at zero, which is below the compare value.
                (6, false) if compare > 0 => counts,
                _ => 0,
            };
            let duty = if is_connected { (f64::from(high) / f64::from(counts) * 8000.0).round() as u16 } else { 0 };
            BridgePins { duty, ..BridgePins::default() }
        })
    }
}
