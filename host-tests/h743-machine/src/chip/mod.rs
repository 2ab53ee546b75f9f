//! The chip: its registers, its clock, and what happens at which time.

pub mod core;
pub mod flash;
pub mod registers;
mod spi;
mod timers;
mod usart;

use crate::bench::{Bench, Inputs};
use crate::options::{Options, Oscillator, Revision};
use anyhow::Result;
use core::Core;
use flash::Flash;
use registers::Registers;
use spi::Ports;
use timers::Timers;
use usart::Usart;

/// Clock of the processor, Hz.
pub const CORE_HZ: u64 = 480_000_000;
const CYCLES_PER_US: u64 = CORE_HZ / 1_000_000;
/// Time that an access to a register takes, cycles: the bus runs at a half and a quarter of the processor's clock.
const ACCESS_CYCLES: u64 = 10;
/// Time that the bench advances at once.
const PERIOD_US: u64 = 1000;
/// Bytes of a serial IMU are delivered this much later than they come, because the bench tells them only then.
const IMU_LATENCY_US: u64 = PERIOD_US;

/// Interrupts of the chip: RM0433, NVIC.
mod interrupt {
    pub const TIM2: usize = 28;
    pub const USART2: usize = 38;
    pub const USART3: usize = 39;
    pub const TIM6: usize = 54;
}

/// Names of the interrupts for the report.
pub const INTERRUPTS: [(&str, usize); 5] = [
    ("TIM6, control", core::EXCEPTIONS + interrupt::TIM6),
    ("TIM2, ADIS16495", core::EXCEPTIONS + interrupt::TIM2),
    ("USART2, KVH 1750", core::EXCEPTIONS + interrupt::USART2),
    ("USART3, serial line", core::EXCEPTIONS + interrupt::USART3),
    ("SysTick", core::SYSTICK),
];

const RCC_CR: u32 = 0x5802_4400;
const RCC_CFGR: u32 = 0x5802_4410;
const RCC_BDCR: u32 = 0x5802_4470;
const RCC_CSR: u32 = 0x5802_4474;
const RCC_RSR: u32 = 0x5802_44d0;
const PWR_CR1: u32 = 0x5802_4800;
const PWR_CSR1: u32 = 0x5802_4804;
const PWR_D3CR: u32 = 0x5802_4818;
const IWDG_KR: u32 = 0x5800_4800;
const IWDG_PR: u32 = 0x5800_4804;
const IWDG_RLR: u32 = 0x5800_4808;
const DBGMCU_IDCODE: u32 = 0x5c00_1000;
const GPIO: std::ops::Range<u32> = 0x5802_0000..0x5802_2c00;
const GPIOD: u32 = 0x5802_0c00;
const GPIOE: u32 = 0x5802_1000;
const MODER: u32 = 0x00;
const IDR: u32 = 0x10;
const ODR: u32 = 0x14;
const BSRR: u32 = 0x18;

/// Flags of RCC_RSR after power-on, a reset by software, and one by the watchdog.
const AFTER_POWER_ON: u32 = 0x00fa_0000;
const AFTER_SOFTWARE: u32 = 0x0142_0000;
const AFTER_WATCHDOG: u32 = 0x0442_0000;
/// Time that the oscillators need to start.
const HSE_START_US: u64 = 500;
const LSE_START_US: u64 = 300_000;
/// Clock of the watchdog, Hz.
const LSI_HZ: u64 = 32_000;

/// Why the chip was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// By software.
    Software,
    /// By the independent watchdog.
    Watchdog,
}

/// The chip and the lines to the bench.
pub struct Chip {
    /// Time since power-on, cycles of the processor.
    pub now: u64,
    /// Time of the next event.
    pub next: u64,
    /// Time during which the processor slept.
    pub idle: u64,
    pub registers: Registers,
    pub core: Core,
    pub flash: Flash,
    pub serial: Usart,
    pub imu_line: Usart,
    timers: Timers,
    ports: Ports,
    bench: Bench,
    /// When the bench's time began, and when it advances next.
    bench_from: u64,
    bench_at: u64,
    period_cycles: f64,
    sample_phase: u64,
    periods: u64,
    hse: Oscillator,
    lse: Oscillator,
    hse_from: Option<u64>,
    lse_from: Option<u64>,
    watchdog_at: u64,
    watchdog_started_at: Option<u64>,
    keyed: bool,
    pub reset: Option<Reset>,
    /// The instrument is switched on.
    pub powered: bool,
    /// An access that the processor must not have: its address, and whether it is the MPU's.
    pub fault: Option<(u32, bool)>,
    /// The bench does not answer any more.
    pub failure: Option<anyhow::Error>,
    pub resets: u32,
}

impl Chip {
    /// The chip at power-on.
    pub fn new(options: &Options, flash: Flash, bench: Bench) -> Self {
        let clock_factor = 1.0 + options.clock_ppm * 1e-6;
        let mut chip = Self {
            now: 0,
            next: 0,
            idle: 0,
            registers: Registers::new(),
            core: Core::new(),
            flash,
            serial: Usart::new(usart::USART3),
            imu_line: Usart::new(usart::USART2),
            timers: Timers::new(clock_factor),
            ports: Ports::new(options.imu_start_ms * 1000 * CYCLES_PER_US, options.encoder_delay_ns),
            bench,
            bench_from: 0,
            bench_at: u64::MAX,
            period_cycles: (PERIOD_US * CYCLES_PER_US) as f64 * clock_factor,
            sample_phase: options.sample_phase_us * CYCLES_PER_US,
            periods: 0,
            hse: options.hse,
            lse: options.lse,
            hse_from: None,
            lse_from: None,
            watchdog_at: u64::MAX,
            watchdog_started_at: None,
            keyed: false,
            reset: None,
            powered: true,
            fault: None,
            failure: None,
            resets: 0,
        };
        let revision = match options.revision {
            Revision::Y => 0x1003_6450,
            Revision::V => 0x2003_6450,
        };
        chip.registers.set_after_reset(DBGMCU_IDCODE, revision);
        // The inputs of the bridges' fault lines, with no fault.
        chip.registers.set_after_reset(GPIOE + IDR, 0xc000);
        chip.registers.set(RCC_RSR, AFTER_POWER_ON);
        chip
    }

    /// Resets the chip. What is outside goes on.
    pub fn reset_by(&mut self, cause: Reset) {
        let clock_factor = self.timers.clock_factor;
        self.registers.reset();
        self.registers.set(RCC_RSR, if cause == Reset::Watchdog { AFTER_WATCHDOG } else { AFTER_SOFTWARE });
        let before = std::mem::replace(&mut self.core, Core::new());
        (self.core.statistics, self.core.deepest) = (before.statistics, before.deepest);
        let late_periods = self.timers.late_periods;
        self.timers = Timers::new(clock_factor);
        self.timers.late_periods = late_periods;
        self.ports.reset();
        self.serial.reset();
        self.imu_line.reset();
        self.flash.reset();
        (self.hse_from, self.lse_from, self.keyed) = (None, None, false);
        (self.watchdog_at, self.watchdog_started_at, self.reset) = (u64::MAX, None, None);
        self.resets += 1;
        self.reschedule();
    }

    /// Time after power-on, us.
    pub fn us(&self) -> f64 {
        self.now as f64 / CYCLES_PER_US as f64
    }

    /// When the watchdog was started after the last reset, us; `None` if it was not.
    pub fn watchdog_started_us(&self) -> Option<f64> {
        self.watchdog_started_at.map(|at| at as f64 / CYCLES_PER_US as f64)
    }

    /// Control periods that began before the one before had been seen.
    pub fn late_periods(&self) -> u64 {
        self.timers.late_periods
    }

    fn reschedule(&mut self) {
        let serial = [&self.serial, &self.imu_line].map(|port| port.next(&self.registers, self.now));
        let times = [self.core.systick_at, self.timers.control_at, self.bench_at, self.watchdog_at];
        self.next = times.into_iter().chain(serial).min().unwrap_or(u64::MAX);
    }

    /// Lets everything happen that is due.
    pub fn advance(&mut self) {
        self.core.advance(self.now);
        self.timers.advance(&mut self.registers, self.now);
        self.serial.advance(&self.registers, self.now);
        self.imu_line.advance(&self.registers, self.now);
        if self.now >= self.watchdog_at {
            self.reset = Some(Reset::Watchdog);
            self.watchdog_at = u64::MAX;
        }
        if self.now >= self.bench_at
            && let Err(error) = self.period()
        {
            self.failure = Some(error);
        }
        self.lines();
        self.reschedule();
    }

    /// Sleeps until an interrupt is due. The result is whether one is.
    pub fn sleep(&mut self) -> bool {
        while self.core.next().is_none() && self.reset.is_none() && self.failure.is_none() && self.powered {
            if self.next == u64::MAX {
                return false;
            }
            self.idle += self.next.saturating_sub(self.now);
            self.now = self.now.max(self.next);
            self.advance();
        }
        true
    }

    /// The interrupt lines.
    pub fn lines(&mut self) {
        let [control, capture] = self.timers.lines(&self.registers);
        self.core.line(interrupt::TIM6, control, self.now);
        self.core.line(interrupt::TIM2, capture, self.now);
        self.core.line(interrupt::USART3, self.serial.line(&self.registers, self.now), self.now);
        self.core.line(interrupt::USART2, self.imu_line.line(&self.registers, self.now), self.now);
    }

    /// Lets the bench advance by a period.
    fn period(&mut self) -> Result<()> {
        let mut bridges = self.timers.motors(&self.registers, self.now);
        let [modes, outputs] = [MODER, ODR].map(|register| self.registers.get(GPIOE + register));
        let high = |pin: u32| modes >> (2 * pin) & 3 == 1 && outputs >> pin & 1 == 1;
        for (pins, (direction, enable)) in bridges.iter_mut().zip([(8, 13), (10, 12)]) {
            (pins.direction, pins.enable) = (high(direction), high(enable));
        }
        let Inputs { powered, imu, fault_lines } = self.bench.period(bridges)?;
        self.ports.period_at = self.bench_at;
        self.powered = powered;
        for (pin, high) in [14, 15].into_iter().zip(fault_lines) {
            self.registers.set_bits(GPIOE + IDR, 1 << pin, high);
        }
        if imu {
            self.timers.data_ready(&mut self.registers, self.now);
        }
        if imu && self.registers.get(usart::USART2) & 1 == 1 {
            for (byte, age_us) in self.bench.imu_bytes()? {
                let at = self.bench_at + (IMU_LATENCY_US.saturating_sub(age_us.into())) * CYCLES_PER_US;
                self.imu_line.arrive(byte, at);
            }
        }
        self.periods += 1;
        self.bench_at = self.bench_from + (self.period_cycles * (self.periods + 1) as f64) as u64;
        Ok(())
    }

    /// The processor reads a register, 1, 2 or 4 bytes of it.
    pub fn read(&mut self, address: u32, size: usize) -> u32 {
        self.now += ACCESS_CYCLES;
        let register = address & !3;
        self.registers.note(register, None);
        let value = self.read_word(register) >> (8 * (address & 3));
        if size < 4 { value & !(u32::MAX << (8 * size)) } else { value }
    }

    fn read_word(&mut self, address: u32) -> u32 {
        let stored = self.registers.get(address);
        if let Some(port) = Ports::port(address) {
            // Polling until a transfer ends takes no steps of its own.
            self.now = self.now.max(self.ports.done_at(port).min(self.next));
            return self.ports.read(&self.registers, port, address, self.now);
        }
        if Timers::has(address) {
            // Polling until the next edge of the crystal takes no steps of its own.
            if address == timers::TIM16 + timers::SR {
                let capture = self.timers.next_capture(&self.registers).unwrap_or(self.now);
                self.now = self.now.max(capture.min(self.next));
            }
            let value = self.timers.read(&mut self.registers, address, self.now);
            self.lines();
            return value;
        }
        let copied = |from: u32, to: u32| (stored >> from & 1) << to;
        match address & !0x3ff {
            usart::USART3 => return self.serial.read(&self.registers, address, self.now),
            usart::USART2 => return self.imu_line.read(&self.registers, address, self.now),
            _ => {}
        }
        match address {
            // HSI, CSI, HSI48, both clock domains and the PLLs follow their enable bits at once.
            RCC_CR => {
                let ready =
                    copied(0, 2) | copied(7, 8) | copied(12, 13) | copied(24, 25) | copied(26, 27) | copied(28, 29);
                stored | ready | 3 << 14 | u32::from(self.runs(self.hse, self.hse_from, HSE_START_US)) << 17
            }
            RCC_CFGR => stored & !0x38 | (stored & 7) << 3,
            RCC_BDCR => stored | u32::from(self.runs(self.lse, self.lse_from, LSE_START_US)) << 1,
            RCC_CSR => stored | copied(0, 1),
            PWR_CSR1 | PWR_D3CR => stored | 1 << 13,
            flash::SR => {
                self.now = self.now.max(self.flash.busy_until().min(self.next));
                self.flash.settle(&mut self.registers, self.now);
                self.flash.status(self.registers.get(address), self.now)
            }
            core::START.. => self.core.read(address, stored, self.now),
            _ => stored,
        }
    }

    fn runs(&self, oscillator: Oscillator, from: Option<u64>, start_us: u64) -> bool {
        oscillator == Oscillator::Good && from.is_some_and(|from| self.now >= from + start_us * CYCLES_PER_US)
    }

    /// The processor writes a register, 1, 2 or 4 bytes of it.
    pub fn write(&mut self, address: u32, size: usize, value: u32) {
        self.now += ACCESS_CYCLES;
        let register = address & !3;
        self.registers.note(register, Some(value));
        if let Some(port) = Ports::port(address) {
            let written =
                self.ports.write((&mut self.registers, &mut self.bench), port, (register, value, size), self.now);
            self.failure = self.failure.take().or(written.err());
            return;
        }
        if matches!(address, 0xe000_e400..0xe000_e4f0 | 0xe000_ed18..0xe000_ed24) {
            return self.core.write_priority(address, &value.to_le_bytes()[..size]);
        }
        let value = if size < 4 {
            let (shift, mask) = (8 * (address & 3), !(u32::MAX << (8 * size)));
            self.registers.get(register) & !(mask << shift) | (value & mask) << shift
        } else {
            value
        };
        self.write_word(register, value);
        self.lines();
        self.reschedule();
    }

    fn write_word(&mut self, address: u32, value: u32) {
        if Timers::has(address) {
            self.timers.write(&mut self.registers, address, value, self.now);
            if self.bench_at == u64::MAX && self.timers.pulses_run() {
                // The IMU samples by these pulses, so the bench's time begins with them.
                let from = self.now + self.sample_phase;
                (self.bench_from, self.ports.period_at) = (from, from);
                self.bench_at = from + self.period_cycles as u64;
            }
            return;
        }
        match address & !0x3ff {
            usart::USART3 => return self.serial.write(&mut self.registers, address, value, self.now),
            usart::USART2 => return self.imu_line.write(&mut self.registers, address, value, self.now),
            block if GPIO.contains(&block) && address & 0x3ff == BSRR => return self.write_pins(block, value),
            _ => {}
        }
        match address {
            RCC_CR => {
                self.hse_from = (value >> 16 & 1 == 1).then(|| self.hse_from.unwrap_or(self.now));
                self.registers.set(address, value);
            }
            RCC_BDCR if self.registers.get(PWR_CR1) >> 8 & 1 == 0 => {
                self.registers.violate("the backup domain was written while protected".into());
            }
            RCC_BDCR => {
                self.lse_from = (value & 1 == 1).then(|| self.lse_from.unwrap_or(self.now));
                let runs = self.lse == Oscillator::Good;
                self.timers.crystal_from = self.lse_from.filter(|_| runs).map(|at| at + LSE_START_US * CYCLES_PER_US);
                self.registers.set(address, value);
            }
            RCC_RSR if value >> 16 & 1 == 1 => self.registers.set(address, 0),
            flash::KEYR..=flash::CCR => self.flash.write_register(&mut self.registers, address, value, self.now),
            IWDG_KR => self.write_watchdog(value),
            IWDG_PR | IWDG_RLR => {
                if !self.keyed {
                    self.registers.violate("a register of the watchdog was written while locked".into());
                }
                self.registers.set(address, value);
            }
            core::START.. => {
                self.registers.set(address, value);
                self.core.write(address, value, self.now);
                if std::mem::take(&mut self.core.reset_requested) {
                    self.reset = Some(Reset::Software);
                }
            }
            _ => self.registers.set(address, value),
        }
    }

    fn write_pins(&mut self, block: u32, value: u32) {
        let before = self.registers.get(block + ODR);
        let after = before & !(value >> 16) | value & 0xffff;
        self.registers.set(block + ODR, after);
        if block == GPIOD {
            self.ports.select(&mut self.registers, after >> 14 & 1 == 0, self.now);
        }
    }

    fn write_watchdog(&mut self, key: u32) {
        match key {
            0xcccc => self.watchdog_started_at = Some(self.watchdog_started_at.unwrap_or(self.now)),
            0x5555 => self.keyed = true,
            _ => {}
        }
        if matches!(key, 0xcccc | 0xaaaa) {
            self.keyed = false;
            let [divider, reload] = [IWDG_PR, IWDG_RLR].map(|register| u64::from(self.registers.get(register)));
            let cycles = (reload + 1) * (4 << divider.min(6)) * CORE_HZ / LSI_HZ;
            self.watchdog_at = if self.watchdog_started_at.is_some() { self.now + cycles } else { u64::MAX };
        }
    }

    /// The processor reads the flash's sectors of records. It waits while the flash is busy.
    pub fn read_flash(&mut self, address: u32, size: usize) -> u64 {
        const IGNORE_BUS_FAULTS: u32 = 1 << 8;
        if self.core.forbids(address, false) {
            self.fault = Some((address, true));
            return 0;
        }
        self.now = self.now.max(self.flash.busy_until());
        self.flash.settle(&mut self.registers, self.now);
        let (value, good) = self.flash.read(&mut self.registers, address, size);
        if !good && self.registers.get(core::CCR) & IGNORE_BUS_FAULTS == 0 {
            self.fault = Some((address, false));
        }
        value
    }

    /// The processor writes into the flash's sectors of records.
    pub fn write_flash(&mut self, address: u32, size: usize, value: u64) {
        if self.core.forbids(address, true) {
            self.fault = Some((address, true));
            return;
        }
        self.flash.write(&mut self.registers, address, &value.to_le_bytes()[..size], self.now);
    }

    /// Sends what the chip has sent on its serial line to the host.
    pub fn drain_serial(&mut self) -> Result<Vec<u8>> {
        let sent = std::mem::take(&mut self.serial.sent);
        if !sent.is_empty() {
            self.bench.telemetry(&sent)?;
        }
        Ok(sent)
    }

    /// Sends bytes of the log to the host.
    pub fn log(&mut self, bytes: &[u8]) -> Result<()> {
        self.bench.log(bytes)
    }
}

impl Chip {
    /// The pins that were set up, with their functions.
    pub fn pins(&self) -> Vec<String> {
        use stm32_metapac::metadata::METADATA;
        const AFRL: u32 = 0x20;
        const PUPDR: u32 = 0x0c;
        let mut pins = Vec::new();
        for (port, block) in ('A'..='K').zip(GPIO.step_by(0x400)) {
            for pin in 0..16 {
                let [mode, pull] = [MODER, PUPDR].map(|register| self.registers.get(block + register) >> (2 * pin) & 3);
                let function = self.registers.get(block + AFRL + 4 * (pin / 8)) >> (4 * (pin % 8)) & 0xf;
                let name = format!("P{port}{pin}");
                let has = |candidate: &&stm32_metapac::metadata::PeripheralPin| {
                    candidate.pin == name && candidate.af.map(u32::from) == Some(function)
                };
                let signals = METADATA.peripherals.iter().flat_map(|peripheral| {
                    peripheral.pins.iter().filter(has).map(|pin| format!("{}_{}", peripheral.name, pin.signal))
                });
                match (mode, pull) {
                    (1, _) => pins.push(format!("{name} output")),
                    (2, _) => pins.push(format!("{name} {}", signals.collect::<Vec<_>>().join(" or "))),
                    (0, 1) => pins.push(format!("{name} input, pull-up")),
                    (0, 2) => pins.push(format!("{name} input, pull-down")),
                    _ => {}
                }
            }
        }
        pins
    }
}
