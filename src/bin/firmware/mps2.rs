//! The boards of the emulator: QEMU's `mps2-an500`, a Cortex-M7 with double precision, and `mps2-an386`, a Cortex-M4F with
//! single precision. Their memory and peripherals are the same.
//!
//! The devices on SPI are played by the host. The emulator's auto-reload timers run at half rate while the processor
//! sleeps (QEMU 7.2). Data-ready edges therefore come from a one-shot timer, armed anew in its handler against a
//! free-running one.
#![allow(unsafe_code)]

mod bit_bang_i2c;
mod eeprom;
mod log;
mod pipe_spi;
mod register;
mod semihosting;

use crate::board::Board;
use crate::work::{Span, Work, count, loads};
use crate::{Scalar, stack};
use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SYST};
use critical_section::Mutex;
use eeprom::{Delay, Eeprom, eeprom};
use pipe_spi::{Chip, POWERED, PipeBus, PipeSpi};
use register::Timer;
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::device::{RateDrive, command_rates};
use rins_selfcal::drivers::adis16495::{Adis16495, Settings};
use rins_selfcal::drivers::biss::{BissEncoder, Mounting, Resolution};
use rins_selfcal::queue::{SampleConsumer, SampleQueue};
use rins_selfcal::store::CalibrationStore;
use semihosting::{File, exit};

/// Ticks of the system clock per second.
const TICKS_PER_S: u32 = 25_000_000;
/// Ticks from one data-ready edge to the next: 200 Hz.
const TICKS_PER_EDGE: u32 = TICKS_PER_S / 200;
/// The same in microseconds.
const US_PER_EDGE: u64 = TICKS_PER_EDGE as u64 * 1_000_000 / TICKS_PER_S as u64;
/// Depth of the sample queue plus one: 0.31 s at 200 Hz. The main loop is busy longest when it writes a record to the
/// EEPROM, for 0.21 s; no more than 42 samples were seen to wait.
const QUEUE_LENGTH: usize = 64;

const EDGE_TIMER: Timer = Timer::at(0x4000_0000);
const CLOCK_TIMER: Timer = Timer::at(0x4000_1000);

/// The interrupt of `EDGE_TIMER`.
#[derive(Clone, Copy)]
struct DataReady;

// Safety: 8 is the timer's line on this board.
unsafe impl InterruptNumber for DataReady {
    fn number(self) -> u16 {
        8
    }
}

// --------------------------------------------------------------------------------------------------------------- time

/// Time at the last look, ticks. Looked at 200 times a second, so that the 32-bit timer never wraps unseen.
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

defmt::timestamp!("{=u64:us}", ticks() / 25);

// ---------------------------------------------------------------------------------------------------- data-ready edges

type BoardAcquisition = Acquisition<'static, Scalar, PipeSpi, PipeSpi, PipeSpi>;

/// Filled once at power-up, used by the interrupt only.
static ACQUISITION: Mutex<RefCell<Option<(PipeBus, BoardAcquisition)>>> = Mutex::new(RefCell::new(None));
/// Time of the next edge on the free-running timer. Written at the start, then by the interrupt only.
static NEXT_EDGE: AtomicU32 = AtomicU32::new(0);
/// Edges so far, which are the clock of the samples: it does not depend on what the processor is doing.
static EDGES: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));
/// Edges that came after their time because the processor was busy. Written by the interrupt.
static LATE_EDGES: AtomicU32 = AtomicU32::new(0);

fn start_edges() {
    EDGE_TIMER.reload.write(0);
    EDGE_TIMER.control.write(Timer::ENABLE | Timer::ENABLE_INTERRUPT);
    NEXT_EDGE.store(timer_ticks(), Ordering::Relaxed);
    arm_next_edge();
    // Safety: everything the interrupt uses is in place.
    unsafe { NVIC::unmask(DataReady) };
}

fn arm_next_edge() {
    let edge = NEXT_EDGE.load(Ordering::Relaxed).wrapping_add(TICKS_PER_EDGE);
    NEXT_EDGE.store(edge, Ordering::Relaxed);
    let remaining = edge.wrapping_sub(timer_ticks());
    let late = remaining.cast_signed() <= 0;
    if late {
        LATE_EDGES.store(LATE_EDGES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
    EDGE_TIMER.value.write(if late { 1 } else { remaining });
}

fn on_data_ready() {
    let span = Span::start();
    acquire();
    count(Work::Interrupt, &span);
    span.put_aside();
}

fn acquire() {
    EDGE_TIMER.interrupt_clear.write(1);
    if !POWERED.load(Ordering::Relaxed) {
        return;
    }
    arm_next_edge();
    ticks();
    critical_section::with(|cs| {
        if let Ok(mut place) = ACQUISITION.borrow(cs).try_borrow_mut()
            && let Some((bus, acquisition)) = place.as_mut()
            && bus.data_ready()
        {
            let edges = EDGES.borrow(cs);
            edges.set(edges.get() + 1);
            // A sample that is lost has been counted.
            let _ = acquisition.on_data_ready(edges.get() * US_PER_EDGE);
        }
    });
}

/// Every interrupt comes here; only one is enabled.
#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) {
    if number == 8 {
        on_data_ready();
    } else {
        Mps2::stop("unexpected interrupt", &[number as u32]);
    }
}

/// Wakes the main loop where no data-ready edge does.
#[cortex_m_rt::exception]
fn SysTick() {}

/// Lets [`SysTick`] come ten times a second.
fn start_waking(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(TICKS_PER_S / 10 - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

// -------------------------------------------------------------------------------------------------------------- board

/// The board.
pub struct Mps2 {
    samples: SampleConsumer<'static, Scalar>,
    drives: [RateDrive<PipeSpi>; 2],
    store: CalibrationStore<Eeprom>,
    telemetry: File,
    idle_ticks: u64,
}

impl Mps2 {
    fn new() -> Option<Self> {
        let mut core = cortex_m::Peripherals::take()?;
        stack::guard(&core.MPU);
        CLOCK_TIMER.reload.write(u32::MAX);
        CLOCK_TIMER.control.write(Timer::ENABLE);
        let bus = PipeBus::open()?;
        let telemetry = File::open(c"telemetry", File::WRITE)?;
        let queue = cortex_m::singleton!(: SampleQueue<Scalar, QUEUE_LENGTH> = SampleQueue::new())?;
        let (producer, samples) = queue.split();
        let Ok(imu) = Adis16495::start(bus.device(Chip::Imu), &mut Delay, &Settings::default()) else {
            Self::stop("the IMU does not start", &[])
        };
        let encoder = |chip| BissEncoder::new(bus.device(chip), Resolution::Bits32, Mounting::STRAIGHT);
        let (outer, inner) = (encoder(Chip::OuterEncoder), encoder(Chip::InnerEncoder));
        let acquisition = Acquisition::new(imu, outer, inner, producer);
        critical_section::with(|cs| {
            ACQUISITION.borrow(cs).try_borrow_mut().ok().map(|mut place| *place = Some((bus, acquisition)))
        })?;
        start_edges();
        start_waking(&mut core.SYST);
        Some(Self {
            samples,
            drives: [Chip::OuterDrive, Chip::InnerDrive].map(|chip| RateDrive::new(bus.device(chip))),
            store: CalibrationStore::new(eeprom()),
            telemetry,
            idle_ticks: 0,
        })
    }

    /// What the host's file `run` holds, in words.
    fn report(&self, file: File, elapsed: u64, stack_used: usize) {
        let whole = [
            elapsed,
            self.idle_ticks,
            stack_used as u64,
            stack::bytes() as u64,
            LATE_EDGES.load(Ordering::Relaxed).into(),
            self.samples.deepest().into(),
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
    type Memory = Eeprom;

    fn start() -> Self {
        match Self::new() {
            Some(board) => board,
            None => Self::stop("the host offers no pipes, or the board was started twice", &[]),
        }
    }

    fn samples(&mut self) -> &mut SampleConsumer<'static, Scalar> {
        &mut self.samples
    }

    fn command_rates(&mut self, rates_rad_s: [Scalar; 2]) -> [bool; 2] {
        command_rates(&mut self.drives, rates_rad_s)
    }

    fn store(&mut self) -> &mut CalibrationStore<Eeprom> {
        &mut self.store
    }

    fn send(&mut self, frame: &[u8]) {
        // The host may have closed the pipe; the run goes on without.
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
        ticks() / u64::from(TICKS_PER_S / 1_000_000)
    }

    fn powered(&self) -> bool {
        POWERED.load(Ordering::Relaxed)
    }

    fn wait(&mut self) {
        // An interrupt between look and sleep stays pending and ends the sleep.
        critical_section::with(|_| {
            if self.samples.is_empty() && self.powered() {
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

    fn stop(what: &str, numbers: &[u32]) -> ! {
        if let Some(file) = File::open(c"fault", File::WRITE) {
            file.write(what.as_bytes());
            for number in numbers {
                let digits = [28, 24, 20, 16, 12, 8, 4, 0].map(|shift| {
                    let digit = (number >> shift & 0xf) as u8;
                    digit + if digit < 10 { b'0' } else { b'a' - 10 }
                });
                file.write(b" 0x");
                file.write(&digits);
            }
        }
        exit(Err(()))
    }
}
