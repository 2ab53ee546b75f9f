//! The boards of the emulator: QEMU's `mps2-an500`, a Cortex-M7 with double precision, and `mps2-an386`, a Cortex-M4F
//! with single precision. Their memory and peripherals are the same.
//!
//! The host simulates the devices and the pins. The emulator's auto-reload timers run at half rate while the processor
//! sleeps (QEMU 7.2). Therefore the control periods come from a one-shot timer. Its handler arms it again, by the time
//! of a free-running timer.
//!
//! ```text
//! control interrupt   priority 0x00   the host simulates one period; encoders -> gimbal -> bridges
//! IMU interrupt       priority 0x40   after a period in which the IMU measured or sent; IMU -> sample queue
//! serial line         priority 0x80   bytes -> inbox
//! SysTick             lowest          wakes the main loop, feeds the watchdog
//! ```
//! The IMU is an ADIS16495, or a KVH 1750 with the feature `kvh1750`. Each has a file with its interrupt handler.
#![allow(unsafe_code)]

#[cfg(not(feature = "kvh1750"))]
mod adis16495;
mod bit_bang_i2c;
mod bridge_pins;
mod eeprom;
#[cfg(feature = "kvh1750")]
mod kvh1750;
mod log;
mod pipe_pins;
mod pipe_spi;
mod register;
mod semihosting;
mod serial;
mod wire;

use crate::board::{Board, Parts};
use crate::work::{Span, Work, count, loads};
use crate::{Scalar, recorder, stack, watchdog};
#[cfg(not(feature = "kvh1750"))]
use adis16495::Imu;
use bridge_pins::{PinBridge, bridge};
use core::cell::{Cell, RefCell};
use core::fmt::Write;
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use critical_section::Mutex;
use eeprom::{Eeprom, eeprom};
#[cfg(feature = "kvh1750")]
use kvh1750::Imu;
use pipe_pins::{EncoderSpi, LatchedLines};
use pipe_spi::{POWERED, PipeBus};
use register::{Register, Timer};
use rins_selfcal::acquisition::GimbalView;
use rins_selfcal::acquisition::queue::SampleQueue;
use rins_selfcal::base::loss::LossReason;
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Task;
use rins_selfcal::drivers::biss::{BissEncoder, Mounting, Resolution};
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::control::Control;
use rins_selfcal::gimbal::servo::PERIOD_US;
use rins_selfcal::instrument::UnitMemory;
use rins_selfcal::keep::black_box::Event;
use rins_selfcal::keep::partition::{Layout, Partition};
use rins_selfcal::link::Link;
use semihosting::{File, exit};
use wire::{TICKS_PER_S, input};

/// Ticks of a control period: 1 kHz.
const TICKS_PER_PERIOD: u32 = (TICKS_PER_S / 1_000_000) * PERIOD_US as u32;
/// Depth of the sample queue plus one: 0.31 s at 200 Hz. The main loop needs up to 0.23 s to write a record to the
/// EEPROM. At most 46 samples were seen to wait.
const QUEUE_LENGTH: usize = 64;

const PERIOD_TIMER: Timer = Timer::at(0x4000_0000);
const CLOCK_TIMER: Timer = Timer::at(0x4000_1000);

/// The CMSDK watchdog counts down. At zero it raises the NMI, and at the next zero it resets.
const WATCHDOG_LOAD: Register = Register::at(0x4000_8000);
const WATCHDOG_CONTROL: Register = Register::at(0x4000_8008);
const WATCHDOG_CLEAR: Register = Register::at(0x4000_800c);
const WATCHDOG_LOCK: Register = Register::at(0x4000_8c00);
const WATCHDOG_UNLOCK: u32 = 0x1acc_e551;

/// Interrupts of this board.
#[derive(Clone, Copy, PartialEq)]
enum Line {
    /// A byte arrived on the serial line.
    Received = 0,
    /// The interrupt of `PERIOD_TIMER`.
    Control = 8,
    /// The interrupt of the IMU. It has no source in the machine: the control interrupt sets it pending when the host
    /// reports that the IMU asks for it.
    Imu = 30,
}

// Safety: the values are interrupt lines of this board.
unsafe impl InterruptNumber for Line {
    fn number(self) -> u16 {
        self as u16
    }
}

// --------------------------------------------------------------------------------------------------------------- time

/// Time at the last call of [`ticks`], ticks. It is called a thousand times a second, so no wrap of the 32-bit timer is
/// missed.
static CLOCK: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

fn timer_ticks() -> u32 {
    !CLOCK_TIMER.value.read()
}

/// Ticks since power-up.
fn ticks() -> u64 {
    critical_section::with(|cs| {
        let clock = CLOCK.borrow(cs);
        let now = clock.get() + u64::from(timer_ticks().wrapping_sub(clock.get() as u32));
        clock.set(now);
        now
    })
}

/// Time since power-up, us.
fn uptime_us() -> u64 {
    ticks() / u64::from(TICKS_PER_S / 1_000_000)
}

defmt::timestamp!("{=u64:us}", uptime_us());

// --------------------------------------------------------------------------------------------------------- interrupts

type BoardBridge = PinBridge<LatchedLines>;
type BoardControl = Control<Scalar, EncoderSpi, BoardBridge>;

/// Filled once at power-up. [`rins_selfcal::gimbal::control`] lists its users.
static CONTROL: Mutex<RefCell<Option<BoardControl>>> = Mutex::new(RefCell::new(None));
/// Filled once at power-up and then used by the IMU's interrupt only. The interrupt takes the IMU out while it runs,
/// because the control interrupt may preempt it.
static IMU: Mutex<Cell<Option<Imu>>> = Mutex::new(Cell::new(None));
/// Written once at power-up.
static BUS: Mutex<Cell<Option<PipeBus>>> = Mutex::new(Cell::new(None));
/// Beginning of the next period on the free-running timer. Written at the start and then by the control interrupt only.
static NEXT_PERIOD: AtomicU32 = AtomicU32::new(0);
/// Number of periods so far. This is the clock of angles and samples, so they do not depend on the load of the
/// processor. Written by the control interrupt.
static PERIODS: AtomicU32 = AtomicU32::new(0);
/// Number of periods that began late, because the processor was busy at their time. Written by the control interrupt.
static LATE_PERIODS: AtomicU32 = AtomicU32::new(0);
/// Period and ticks at which the IMU's interrupt was last requested. Written by the control interrupt, and by the IMU's
/// interrupt when it requests another call of itself. Read by the IMU's interrupt.
static EDGE: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];
/// Longest delay of the control interrupt after the beginning of a period, and of the IMU's interrupt after its
/// request, ticks. Each interrupt writes its own delay.
static LATENCIES: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

fn with_control<R>(act: impl FnOnce(&mut BoardControl) -> R) -> Option<R> {
    critical_section::with(|cs| Some(act(CONTROL.borrow(cs).try_borrow_mut().ok()?.as_mut()?)))
}

fn view(time_us: u64) -> GimbalView {
    with_control(|control| control.view(time_us)).unwrap_or(Err(LossReason::Status))
}

fn now_us() -> u64 {
    u64::from(PERIODS.load(Ordering::Relaxed)) * PERIOD_US
}

fn note_latency(latency: &AtomicU32, since: u32) {
    latency.store(latency.load(Ordering::Relaxed).max(timer_ticks().wrapping_sub(since)), Ordering::Relaxed);
}

fn start_periods(nvic: &mut NVIC) {
    PERIOD_TIMER.reload.write(0);
    PERIOD_TIMER.control.write(Timer::ENABLE | Timer::ENABLE_INTERRUPT);
    NEXT_PERIOD.store(timer_ticks(), Ordering::Relaxed);
    arm_next_period();
    // Safety: all data of the interrupts is in place.
    unsafe {
        nvic.set_priority(Line::Control, 0x00);
        nvic.set_priority(Line::Imu, 0x40);
        nvic.set_priority(Line::Received, 0x80);
        NVIC::unmask(Line::Control);
        NVIC::unmask(Line::Imu);
        NVIC::unmask(Line::Received);
    }
}

fn arm_next_period() {
    let next = NEXT_PERIOD.load(Ordering::Relaxed).wrapping_add(TICKS_PER_PERIOD);
    NEXT_PERIOD.store(next, Ordering::Relaxed);
    let remaining = next.wrapping_sub(timer_ticks());
    let late = remaining.cast_signed() <= 0;
    if late {
        LATE_PERIODS.store(LATE_PERIODS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
    PERIOD_TIMER.value.write(if late { 1 } else { remaining });
}

fn on_period() {
    PERIOD_TIMER.interrupt_clear.write(1);
    if !POWERED.load(Ordering::Relaxed) {
        return;
    }
    note_latency(&LATENCIES[0], NEXT_PERIOD.load(Ordering::Relaxed));
    let span = Span::start();
    arm_next_period();
    ticks();
    if let Some(inputs) = critical_section::with(|cs| BUS.borrow(cs).get()).and_then(pipe_pins::period) {
        PERIODS.store(PERIODS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        if inputs & input::IMU != 0 {
            EDGE[0].store(PERIODS.load(Ordering::Relaxed), Ordering::Relaxed);
            ask_for_imu();
        }
        with_control(|control| control.on_period(now_us));
    }
    watchdog::report(Task::Control, uptime_us());
    count(Work::Control, &span);
    span.put_aside();
}

fn ask_for_imu() {
    EDGE[1].store(timer_ticks(), Ordering::Relaxed);
    NVIC::pend(Line::Imu);
}

fn on_imu() {
    note_latency(&LATENCIES[1], EDGE[1].load(Ordering::Relaxed));
    let span = Span::start();
    if let Some(mut imu) = critical_section::with(|cs| IMU.borrow(cs).take()) {
        let again = imu.on_interrupt();
        critical_section::with(|cs| IMU.borrow(cs).set(Some(imu)));
        if again {
            ask_for_imu();
        }
    }
    watchdog::report(Task::Sampling, uptime_us());
    count(Work::Acquire, &span);
    span.put_aside();
}

/// The handler of all interrupts. Three interrupts are enabled.
#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) {
    const RECEIVED: i16 = Line::Received as i16;
    const CONTROL: i16 = Line::Control as i16;
    const IMU: i16 = Line::Imu as i16;
    match number {
        RECEIVED => serial::on_received(),
        CONTROL => on_period(),
        IMU => on_imu(),
        _ => Mps2::stop(&FatalError::Interrupt(number as u32)),
    }
}

/// Wakes the main loop when the IMU does not, and feeds the watchdog. An instrument that is switched off is not
/// watched.
#[cortex_m_rt::exception]
fn SysTick() {
    if POWERED.load(Ordering::Relaxed) { watchdog::check(uptime_us()) } else { Mps2::feed_watchdog() }
}

/// The watchdog was not fed in time.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() -> ! {
    Mps2::stop(&FatalError::Unfed)
}

/// Starts [`SysTick`] at ten times a second.
fn start_waking(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(TICKS_PER_S / 10 - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

// -------------------------------------------------------------------------------------------------------------- board

/// A part of the EEPROM.
type Memory = Partition<'static, Eeprom>;

/// The board.
pub struct Mps2 {
    parts: Parts<Memory>,
    nvic: NVIC,
    telemetry: File,
    idle_ticks: u64,
}

impl Mps2 {
    fn new() -> Option<Self> {
        let mut core = cortex_m::Peripherals::take()?;
        stack::guard(&core.MPU);
        CLOCK_TIMER.reload.write(u32::MAX);
        CLOCK_TIMER.control.write(Timer::ENABLE);
        let restart = recorder::start(None);
        let bus = PipeBus::open()?;
        let telemetry = File::open(c"telemetry", File::WRITE)?;
        let queue = cortex_m::singleton!(: SampleQueue<Scalar, QUEUE_LENGTH> = SampleQueue::new())?;
        let (producer, samples) = queue.split();
        let Some(imu) = Imu::start(bus, producer) else { Self::stop(&FatalError::board("the IMU does not start")) };
        let identity = imu.identity();
        critical_section::with(|cs| {
            IMU.borrow(cs).set(Some(imu));
            BUS.borrow(cs).set(Some(bus));
        });
        serial::start();
        // Safety: no critical section depends on priorities.
        unsafe { core.SCB.set_priority(SystemHandler::SysTick, 0xf0) };
        start_waking(&mut core.SYST);
        let eeprom = cortex_m::singleton!(: RefCell<Eeprom> = RefCell::new(eeprom()))?;
        let parts = Parts {
            samples,
            memory: UnitMemory::new(eeprom, Layout::EEPROM_16_KIB),
            restart,
            imu: identity,
            clock: None,
        };
        Some(Self { parts, nvic: core.NVIC, telemetry, idle_ticks: 0 })
    }

    /// Writes the host's file `run`, in words.
    fn report(&self, file: File, elapsed: u64, stack_used: usize) {
        let whole = [
            elapsed,
            self.idle_ticks,
            stack_used as u64,
            stack::bytes() as u64,
            LATE_PERIODS.load(Ordering::Relaxed).into(),
            with_control(|control| control.late_commands()).unwrap_or(0).into(),
            LATENCIES[0].load(Ordering::Relaxed).into(),
            LATENCIES[1].load(Ordering::Relaxed).into(),
            self.parts.samples.most_waiting().into(),
            QUEUE_LENGTH as u64 - 1,
        ];
        let loads = loads();
        let loads = loads.iter().flat_map(|load| [load.spans.into(), load.ticks, load.longest.into()]);
        for word in whole.into_iter().chain(loads) {
            file.write(&word.to_le_bytes());
        }
    }
}

impl Board for Mps2 {
    type Memory = Memory;
    type Spi = EncoderSpi;
    type Bridge = BoardBridge;

    /// The main loop needs its longest time to write a record to the EEPROM.
    const DEADLINES_US: [Option<u32>; 3] = [Some(100_000), Some(20_000), Some(1_000_000)];
    /// The watchdog is started by the first turn of the main loop, because the emulator takes no part in power-up.
    const POWER_UP_US: Option<u64> = None;

    fn start() -> Self {
        match Self::new() {
            Some(board) => board,
            None => Self::stop(&FatalError::board("the host offers no pipes")),
        }
    }

    fn parts(&mut self) -> &mut Parts<Memory> {
        &mut self.parts
    }

    fn begin(&mut self, gimbal: Gimbal<Scalar>) {
        let encoder = |axis| BissEncoder::new(EncoderSpi { axis }, Resolution::Bits26, Mounting::STRAIGHT);
        let bridges = [0, 1].map(|axis| bridge(&LatchedLines, axis));
        let control = Control::new([0, 1].map(encoder), bridges, gimbal);
        critical_section::with(|cs| {
            CONTROL.borrow(cs).try_borrow_mut().map(|mut place| *place = Some(control)).unwrap_or(())
        });
        start_periods(&mut self.nvic);
    }

    fn with_control<R>(&mut self, act: impl FnOnce(&mut BoardControl) -> R) -> Option<R> {
        with_control(act)
    }

    fn transmit(&mut self, link: &mut Link) {
        serial::transmit(|| link.transmit());
    }

    fn show(&mut self, frame: &[u8]) {
        // The host may have closed the pipe. The run continues without it.
        let _ = self.telemetry.write(frame);
    }

    fn configuration<'a>(&mut self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        let file = File::open(c"configuration", File::READ)?;
        let mut length = 0;
        loop {
            match file.read(buffer.get_mut(length..)?) {
                0 => break,
                count => length += count,
            }
        }
        (0 < length && length < buffer.len()).then_some(buffer.get(..length)?)
    }

    fn now_us(&self) -> u64 {
        uptime_us()
    }

    fn powered(&self) -> bool {
        POWERED.load(Ordering::Relaxed)
    }

    fn wait(&mut self) {
        // An interrupt between the check and the sleep stays pending and ends the sleep.
        critical_section::with(|_| {
            if self.parts.samples.is_empty() && self.powered() {
                let start = ticks();
                cortex_m::asm::wfi();
                self.idle_ticks += ticks() - start;
            }
        });
    }

    fn finish(self, status: Result<(), ()>) -> ! {
        let (elapsed, stack_used) = (ticks(), stack::used());
        defmt::info!("stack used: {=usize} bytes of {=usize}", stack_used, stack::bytes());
        if let Some(file) = File::open(c"run", File::WRITE) {
            self.report(file, elapsed, stack_used);
        }
        exit(status)
    }

    fn ticks() -> u32 {
        timer_ticks()
    }

    fn start_watchdog() {
        WATCHDOG_LOCK.write(WATCHDOG_UNLOCK);
        WATCHDOG_LOAD.write(TICKS_PER_S);
        // Enables the watchdog's interrupt and its reset.
        WATCHDOG_CONTROL.write(0b11);
    }

    fn feed_watchdog() {
        WATCHDOG_CLEAR.write(1);
    }

    fn stop(stop: &FatalError) -> ! {
        // Without this, control would switch the motors on again.
        cortex_m::interrupt::disable();
        pipe_spi::motors_off();
        recorder::record(uptime_us(), Event::Stopped(stop.clone()));
        // The host reads the file if it does not start the board again.
        if let Some(file) = File::open(c"fault", File::WRITE) {
            let mut text = heapless::String::<128>::new();
            // A text that does not fit is cut.
            let _ = write!(text, "{stop}");
            file.write(text.as_bytes());
        }
        SCB::sys_reset()
    }
}
