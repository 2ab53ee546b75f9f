//! The registers of the processor: system control, interrupts, MPU, SysTick and cycle counter, from Arm's ARMv7-M manual
//! (DDI 0403) and the Cortex-M7's manual.

/// Addresses from here on belong to the processor.
pub const START: u32 = 0xe000_0000;

/// CPUID of the Cortex-M7 r1p1.
const CPUID: u32 = 0x411f_c271;
/// The interrupt controller, SysTick and system control.
pub const SYST_CSR: u32 = 0xe000_e010;
const SYST_RVR: u32 = 0xe000_e014;
const SYST_CVR: u32 = 0xe000_e018;
pub const CCR: u32 = 0xe000_ed14;
pub const CFSR: u32 = 0xe000_ed28;
pub const MMFAR: u32 = 0xe000_ed34;
pub const BFAR: u32 = 0xe000_ed38;
const MPU_CTRL: u32 = 0xe000_ed94;
const DEMCR: u32 = 0xe000_edfc;
const DWT_CTRL: u32 = 0xe000_1000;
const DWT_CYCCNT: u32 = 0xe000_1004;
const DWT_LAR: u32 = 0xe000_1fb0;
const DWT_UNLOCK: u32 = 0xc5ac_ce55;

/// Name of a register of the processor.
pub fn name(address: u32) -> String {
    let known = match address {
        DWT_CTRL => "DWT.CTRL",
        DWT_CYCCNT => "DWT.CYCCNT",
        DWT_LAR => "DWT.LAR",
        SYST_CSR => "SYST.CSR",
        SYST_RVR => "SYST.RVR",
        SYST_CVR => "SYST.CVR",
        0xe000_ed04 => "SCB.ICSR",
        0xe000_ed08 => "SCB.VTOR",
        0xe000_ed0c => "SCB.AIRCR",
        CCR => "SCB.CCR",
        0xe000_ed24 => "SCB.SHCSR",
        CFSR => "SCB.CFSR",
        0xe000_ed84 => "SCB.CSSELR",
        0xe000_ed88 => "SCB.CPACR",
        0xe000_ed90 => "MPU.TYPE",
        MPU_CTRL => "MPU.CTRL",
        0xe000_ed98 => "MPU.RNR",
        0xe000_ed9c => "MPU.RBAR",
        0xe000_eda0 => "MPU.RASR",
        DEMCR => "DCB.DEMCR",
        0xe000_ef34 => "FPU.FPCCR",
        0xe000_ef50..=0xe000_ef78 => "SCB cache maintenance",
        _ => "",
    };
    match address {
        _ if !known.is_empty() => known.to_owned(),
        0xe000_e100..=0xe000_e13f => format!("NVIC.ISER{}", (address - 0xe000_e100) / 4),
        0xe000_e180..=0xe000_e1bf => format!("NVIC.ICER{}", (address - 0xe000_e180) / 4),
        0xe000_e200..=0xe000_e23f => format!("NVIC.ISPR{}", (address - 0xe000_e200) / 4),
        0xe000_e280..=0xe000_e2bf => format!("NVIC.ICPR{}", (address - 0xe000_e280) / 4),
        0xe000_e400..=0xe000_e4ef => format!("NVIC.IPR{}", (address - 0xe000_e400) / 4),
        0xe000_ed18..=0xe000_ed23 => format!("SCB.SHPR{}", 1 + (address - 0xe000_ed18) / 4),
        _ => format!("{address:#010x}"),
    }
}

/// Number of the exceptions of the processor before those of the chip.
pub const EXCEPTIONS: usize = 16;
/// Number of SysTick's exception, and that of a fault.
pub const SYSTICK: usize = 15;
pub const HARD_FAULT: usize = 3;
const LINES: usize = EXCEPTIONS + 150;

/// A memory protection region.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Region {
    base: u32,
    attributes: u32,
}

impl Region {
    /// Address range of an enabled region; `None` of a disabled one.
    fn range(self) -> Option<std::ops::Range<u64>> {
        let size = 1_u64 << ((self.attributes >> 1 & 0x1f) + 1);
        let base = u64::from(self.base & !0x1f) & !(size - 1);
        (self.attributes & 1 == 1).then_some(base..base + size)
    }

    /// Whether the disabled sub-regions leave this address to the region.
    fn has(self, address: u64) -> bool {
        self.range().is_some_and(|range| {
            let eighth = (range.end - range.start) / 8;
            let disabled = |part: u64| range.end - range.start >= 256 && self.attributes >> (8 + part) & 1 == 1;
            range.contains(&address) && !disabled((address - range.start) / eighth.max(1))
        })
    }

    /// Whether privileged code may read and write here.
    fn allows(self, writes: bool) -> bool {
        match self.attributes >> 24 & 7 {
            0 => false,
            5..=7 => !writes,
            _ => true,
        }
    }
}

/// Statistics of an exception.
#[derive(Clone, Copy, Debug, Default)]
pub struct Statistics {
    /// Number of times that it was taken.
    pub taken: u64,
    /// Longest time from the request to the handler, cycles.
    pub longest_wait: u64,
    /// Longest time in the handler, with those that interrupted it, cycles.
    pub longest_run: u64,
}

/// The processor's own registers.
pub struct Core {
    pending: [bool; LINES],
    enabled: [bool; LINES],
    priority: [u8; LINES],
    requested_at: [u64; LINES],
    /// Exceptions whose handlers run, and when they began, the last one innermost.
    active: Vec<(usize, u64)>,
    pub statistics: Vec<Statistics>,
    /// Longest nesting of handlers.
    pub deepest: usize,
    /// Whether an exception may wait to be taken.
    pub check: bool,
    pub regions: [Region; 16],
    region: usize,
    pub mpu_control: u32,
    systick: (u32, u32),
    pub systick_at: u64,
    unlocked: bool,
    counts_from: Option<u64>,
    pub reset_requested: bool,
}

impl Core {
    /// The processor after a reset.
    pub fn new() -> Self {
        Self {
            pending: [false; LINES],
            enabled: [false; LINES],
            priority: [0; LINES],
            requested_at: [0; LINES],
            active: Vec::new(),
            statistics: vec![Statistics::default(); LINES],
            deepest: 0,
            check: false,
            regions: [Region::default(); 16],
            region: 0,
            mpu_control: 0,
            systick: (0, 0),
            systick_at: u64::MAX,
            unlocked: false,
            counts_from: None,
            reset_requested: false,
        }
    }

    /// Requests an exception.
    pub fn pend(&mut self, line: usize, now: u64) {
        if !self.pending[line] {
            (self.pending[line], self.requested_at[line]) = (true, now);
        }
        self.check = true;
    }

    /// Requests an interrupt of the chip as long as its line is high. A handler that runs sees the line when it ends.
    pub fn line(&mut self, interrupt: usize, high: bool, now: u64) {
        let line = EXCEPTIONS + interrupt;
        if high && !self.active.iter().any(|(active, _)| *active == line) {
            self.pend(line, now);
        }
    }

    fn rank(&self, line: usize) -> i32 {
        if line == HARD_FAULT { -1 } else { i32::from(self.priority[line] >> 4) }
    }

    /// The exception that is taken next, if exceptions are not masked.
    pub fn next(&self) -> Option<usize> {
        let running = self.active.iter().map(|(line, _)| self.rank(*line)).min().unwrap_or(i32::MAX);
        let ready = (0..LINES).filter(|line| self.pending[*line] && (*line < EXCEPTIONS || self.enabled[*line]));
        ready.min_by_key(|line| (self.rank(*line), *line)).filter(|line| self.rank(*line) < running)
    }

    /// Whether anything is pending at all.
    pub fn any_pending(&self) -> bool {
        self.pending.contains(&true)
    }

    /// The handler of an exception begins. Returns the value of LR, which tells the end of the handler.
    pub fn enter(&mut self, line: usize, now: u64) -> u32 {
        let link = if self.active.is_empty() { 0xffff_ffe9 } else { 0xffff_ffe1 };
        if std::mem::take(&mut self.pending[line]) {
            let wait = now - self.requested_at[line];
            self.statistics[line].longest_wait = self.statistics[line].longest_wait.max(wait);
        }
        self.statistics[line].taken += 1;
        self.active.push((line, now));
        self.deepest = self.deepest.max(self.active.len());
        link
    }

    /// The innermost handler ends.
    pub fn leave(&mut self, now: u64) {
        if let Some((line, since)) = self.active.pop() {
            self.statistics[line].longest_run = self.statistics[line].longest_run.max(now - since);
        }
        self.check = true;
    }

    /// The running exception, as IPSR has it.
    pub fn running(&self) -> usize {
        self.active.last().map_or(0, |(line, _)| *line)
    }

    /// Whether the MPU forbids an access.
    pub fn forbids(&self, address: u32, writes: bool) -> bool {
        let found = self.regions.iter().rev().find(|region| region.has(address.into()));
        self.mpu_control & 1 == 1 && found.is_some_and(|region| !region.allows(writes))
    }

    /// The address ranges to which the MPU forbids every access.
    pub fn forbidden(&self) -> impl Iterator<Item = std::ops::Range<u64>> {
        let closed = self.regions.iter().filter(|region| self.mpu_control & 1 == 1 && !region.allows(false));
        closed.filter_map(|region| {
            let range = region.range()?;
            let eighth = ((range.end - range.start) / 8).max(1) as usize;
            let first = range.clone().step_by(eighth).find(|part| region.has(*part))?;
            let last = range.step_by(eighth).filter(|part| region.has(*part)).last()?;
            Some(first..last + eighth as u64)
        })
    }

    pub fn read(&self, address: u32, stored: u32, now: u64) -> u32 {
        let bits = |from: usize, value: &dyn Fn(usize) -> bool| {
            (0..32).fold(0, |word, bit| word | u32::from(from + bit < LINES && value(from + bit)) << bit)
        };
        match address {
            DWT_CYCCNT => self.counts_from.map_or(0, |from| (now - from) as u32),
            SYST_CVR => (self.systick_at.saturating_sub(now) / 8) as u32,
            0xe000_ed00 => CPUID,
            0xe000_ed04 => self.running() as u32,
            0xe000_ed0c => 0xfa05_0000,
            // Cache level, cache type, and the size of the selected cache: 16 KiB each.
            0xe000_ed78 => 0x0900_0003,
            0xe000_ed7c => 0x8303_c003,
            0xe000_ed80 => 0xf003_e019,
            0xe000_ed90 => 0x1000,
            0xe000_ed98 => self.region as u32,
            0xe000_e100..=0xe000_e11c => {
                bits(EXCEPTIONS + 8 * (address - 0xe000_e100) as usize, &|line| self.enabled[line])
            }
            0xe000_e400..=0xe000_e4ef => self.priorities(EXCEPTIONS + (address - 0xe000_e400) as usize),
            0xe000_ed18..=0xe000_ed23 => self.priorities(4 + (address - 0xe000_ed18) as usize),
            _ => stored,
        }
    }

    fn priorities(&self, from: usize) -> u32 {
        (0..4)
            .fold(0, |word, byte| word | u32::from(self.priority.get(from + byte).copied().unwrap_or(0)) << (8 * byte))
    }

    fn each_bit(value: u32, from: usize, mut act: impl FnMut(usize)) {
        (0..32).filter(|bit| value >> bit & 1 == 1 && from + bit < LINES).for_each(|bit| act(from + bit));
    }

    /// A byte of a priority register is written.
    pub fn write_priority(&mut self, address: u32, bytes: &[u8]) {
        let from = match address {
            0xe000_e400.. if address < 0xe000_e4f0 => EXCEPTIONS + (address - 0xe000_e400) as usize,
            _ => 4 + (address - 0xe000_ed18) as usize,
        };
        for (line, byte) in (from..).zip(bytes).filter(|(line, _)| *line < LINES) {
            self.priority[line] = byte & 0xf0;
        }
    }

    pub fn write(&mut self, address: u32, value: u32, now: u64) {
        match address {
            0xe000_e100..=0xe000_e11c => {
                Self::each_bit(value, EXCEPTIONS + 8 * (address - 0xe000_e100) as usize, |line| {
                    self.enabled[line] = true
                });
                self.check = true;
            }
            0xe000_e180..=0xe000_e19c => {
                Self::each_bit(value, EXCEPTIONS + 8 * (address - 0xe000_e180) as usize, |line| {
                    self.enabled[line] = false
                });
            }
            0xe000_e280..=0xe000_e29c => {
                Self::each_bit(value, EXCEPTIONS + 8 * (address - 0xe000_e280) as usize, |line| {
                    self.pending[line] = false
                });
            }
            0xe000_ed0c => self.reset_requested |= value >> 16 == 0x05fa && value & 4 != 0,
            MPU_CTRL => self.mpu_control = value,
            0xe000_ed98 => self.region = value as usize & 15,
            0xe000_ed9c => {
                if value & 0x10 != 0 {
                    self.region = value as usize & 15;
                }
                self.regions[self.region].base = value;
            }
            0xe000_eda0 => self.regions[self.region].attributes = value,
            SYST_CSR | SYST_RVR | SYST_CVR => self.write_systick(address, value, now),
            DWT_LAR => self.unlocked = value == DWT_UNLOCK,
            // Without the key, the lock of the Cortex-M7 ignores writes.
            DWT_CTRL if self.unlocked => self.counts_from = (value & 1 == 1).then_some(now),
            _ => {}
        }
    }

    fn write_systick(&mut self, address: u32, value: u32, now: u64) {
        match address {
            SYST_CSR => self.systick.0 = value,
            SYST_RVR => self.systick.1 = value & 0x00ff_ffff,
            _ => {}
        }
        self.systick_at = if self.systick.0 & 1 == 1 { now + self.systick_cycles() } else { u64::MAX };
    }

    /// Cycles of a period of SysTick. The external clock is an eighth of the processor's.
    fn systick_cycles(&self) -> u64 {
        (u64::from(self.systick.1) + 1) * if self.systick.0 & 4 == 0 { 8 } else { 1 }
    }

    /// Lets SysTick run to this time.
    pub fn advance(&mut self, now: u64) {
        if now >= self.systick_at {
            self.systick_at += self.systick_cycles();
            if self.systick.0 & 2 != 0 {
                self.pend(SYSTICK, now);
            }
        }
    }
}
