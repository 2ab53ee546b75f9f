//! The board NUCLEO-H743ZI2: an STM32H743ZI at 480 MHz, a Cortex-M7 with double precision. Pins: README.
//!
//! ```text
//! EXTI15 data-ready   priority 1   ADIS16495 on SPI1, encoders on SPI3 and SPI4 -> sample queue
//! USART3              priority 2   telemetry out of its buffer
//! SysTick             lowest       wakes the main loop
//! ```
//! The stack lies in the data TCM; both caches are on, and nothing but the processor touches memory.
#![allow(unsafe_code)]

mod clock;

use crate::board::Board;
use crate::work::{Span, Work, count, loads};
use crate::{Scalar, stack};
use clock::{CORE_HZ, Delay};
use core::cell::RefCell;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DWT, SCB};
use critical_section::Mutex;
use defmt_rtt as _;
use embassy_stm32::exti::{ExtiInput, TriggerEdge};
use embassy_stm32::flash::{self, Flash};
use embassy_stm32::gpio::{Level, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{TIM3, USART3};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::usart::{self, BufferedInterruptHandler, BufferedUart};
use embassy_stm32::{bind_interrupts, interrupt as handler, pac};
use embedded_hal_bus::spi::{ExclusiveDevice, RefCellDevice};
use embedded_io::Write;
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::device::{RateDrive, command_rates};
use rins_selfcal::drivers::adis16495::{Adis16495, Settings};
use rins_selfcal::drivers::biss::{BissEncoder, Mounting, Resolution};
use rins_selfcal::drivers::bridge::NoPin;
use rins_selfcal::queue::{SampleConsumer, SampleQueue};
use rins_selfcal::store::CalibrationStore;
use rins_selfcal::store::medium;

/// Depth of the sample queue plus one: 5 s at 200 Hz. Erasing a sector of the flash takes the main loop 4 s at most.
const QUEUE_LENGTH: usize = 1024;
/// Bytes of telemetry that wait for the port: more than the results of a run.
const TELEMETRY_BYTES: usize = 16 * 1024;
const TELEMETRY_BAUD: u32 = 921_600;

/// The last two sectors of the flash's second bank. The program runs on from the first bank while one is erased.
const CALIBRATIONS: core::ops::Range<u32> = (2048 - 2 * 128) * 1024..2048 * 1024;
type CalibrationFlash = medium::Flash<Flash<'static, flash::Blocking>>;

type Bus = Spi<'static, Blocking, Master>;
type ImuSpi = ExclusiveDevice<Bus, Output<'static>, Delay>;
/// An encoder has no chip select.
type EncoderSpi = ExclusiveDevice<Bus, NoPin, Delay>;
type DriveSpi = RefCellDevice<'static, Bus, Output<'static>, Delay>;

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<USART3>;
});

// ---------------------------------------------------------------------------------------------------- data-ready edges

/// What the interrupt has.
struct Sampling {
    edge: ExtiInput<'static, Blocking>,
    acquisition: Acquisition<'static, Scalar, ImuSpi, EncoderSpi, EncoderSpi>,
}

/// Filled once at power-up, used by the interrupt only.
static SAMPLING: Mutex<RefCell<Option<Sampling>>> = Mutex::new(RefCell::new(None));

#[handler]
fn EXTI15_10() {
    let (span, edge_us) = (Span::start(), clock::now_us());
    critical_section::with(|cs| {
        if let Ok(mut place) = SAMPLING.borrow(cs).try_borrow_mut()
            && let Some(sampling) = place.as_mut()
        {
            sampling.edge.clear_pending();
            // A sample that is lost has been counted.
            let _ = sampling.acquisition.on_data_ready(edge_us);
        }
    });
    count(Work::Interrupt, &span);
    span.put_aside();
}

/// Wakes the main loop where no data-ready edge does.
#[cortex_m_rt::exception]
fn SysTick() {}

// -------------------------------------------------------------------------------------------------------------- board

/// The board.
pub struct Stm32h743 {
    samples: SampleConsumer<'static, Scalar>,
    drives: [RateDrive<DriveSpi>; 2],
    store: CalibrationStore<CalibrationFlash>,
    telemetry: BufferedUart<'static>,
    _clock_of_imu: SimplePwm<'static, TIM3>,
    _drives_enabled: Output<'static>,
}

fn spi_config(mode: spi::Mode, hz: u32) -> spi::Config {
    let mut config = spi::Config::default();
    (config.mode, config.frequency) = (mode, Hertz(hz));
    config
}

fn chip_select(pin: embassy_stm32::Peri<'static, impl embassy_stm32::gpio::Pin>) -> Output<'static> {
    Output::new(pin, Level::High, Speed::VeryHigh)
}

fn encoder(bus: Bus) -> Option<BissEncoder<EncoderSpi>> {
    let spi = ExclusiveDevice::new(bus, NoPin, Delay).ok()?;
    Some(BissEncoder::new(spi, Resolution::Bits32, Mounting::STRAIGHT))
}

impl Stm32h743 {
    fn new() -> Option<Self> {
        let p = embassy_stm32::init(clock::configuration());
        start_core()?;
        clock::start(p.TIM2);

        let queue = cortex_m::singleton!(: SampleQueue<Scalar, QUEUE_LENGTH> = SampleQueue::new())?;
        let (producer, samples) = queue.split();
        let imu_clock = imu_clock(p.TIM3, p.PC6);
        let imu = Spi::new_blocking(p.SPI1, p.PA5, p.PB5, p.PA6, spi_config(spi::MODE_3, 3_750_000));
        let imu = ExclusiveDevice::new(imu, chip_select(p.PD14), Delay).ok()?;
        let Ok(imu) = Adis16495::start(imu, &mut Delay, &Settings::default()) else {
            Self::stop("the IMU does not start", &[])
        };
        let line = spi_config(spi::MODE_3, 3_750_000);
        let outer = encoder(Spi::new_blocking(p.SPI3, p.PC10, p.PC12, p.PC11, line))?;
        let inner = encoder(Spi::new_blocking(p.SPI4, p.PE2, p.PE6, p.PE5, line))?;
        let acquisition = Acquisition::new(imu, outer, inner, producer);

        let bus = Spi::new_blocking(p.SPI5, p.PF7, p.PF9, p.PF8, spi_config(spi::MODE_0, 1_875_000));
        let bus = cortex_m::singleton!(: RefCell<Bus> = RefCell::new(bus))?;
        let outer = RefCellDevice::new(bus, chip_select(p.PG1), Delay).ok()?;
        let inner = RefCellDevice::new(bus, chip_select(p.PG0), Delay).ok()?;
        let telemetry = telemetry(p.USART3, p.PD9, p.PD8)?;
        let edge = ExtiInput::new_blocking(p.PD15, p.EXTI15, Pull::Down, TriggerEdge::Rising);
        start_edges(Sampling { edge, acquisition })?;
        Some(Self {
            samples,
            drives: [RateDrive::new(outer), RateDrive::new(inner)],
            store: CalibrationStore::new(medium::Flash::new(Flash::new_blocking(p.FLASH), CALIBRATIONS)),
            telemetry,
            _clock_of_imu: imu_clock,
            _drives_enabled: Output::new(p.PE13, Level::High, Speed::Low),
        })
    }
}

/// Caches, stack guard, cycle counter, and a wake-up ten times a second.
fn start_core() -> Option<()> {
    let mut core = cortex_m::Peripherals::take()?;
    stack::guard(&core.MPU);
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    // An eighth of the core's clock, for a reload of 24 bits.
    core.SYST.set_clock_source(SystClkSource::External);
    core.SYST.set_reload(CORE_HZ / 8 / 10 - 1);
    core.SYST.clear_current();
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();
    Some(())
}

/// The clock of the IMU's samples, 4000 Hz.
fn imu_clock(
    timer: embassy_stm32::Peri<'static, TIM3>,
    pin: embassy_stm32::Peri<'static, embassy_stm32::peripherals::PC6>,
) -> SimplePwm<'static, TIM3> {
    let pin = PwmPin::new(pin, OutputType::PushPull);
    let mut pwm = SimplePwm::new(timer, Some(pin), None, None, None, Hertz(4000), CountingMode::EdgeAlignedUp);
    pwm.ch1().set_duty_cycle_percent(50);
    pwm.ch1().enable();
    pwm
}

fn telemetry(
    port: embassy_stm32::Peri<'static, USART3>,
    rx: embassy_stm32::Peri<'static, embassy_stm32::peripherals::PD9>,
    tx: embassy_stm32::Peri<'static, embassy_stm32::peripherals::PD8>,
) -> Option<BufferedUart<'static>> {
    let out = cortex_m::singleton!(: [u8; TELEMETRY_BYTES] = [0; TELEMETRY_BYTES])?;
    let come = cortex_m::singleton!(: [u8; 256] = [0; 256])?;
    let mut config = usart::Config::default();
    config.baudrate = TELEMETRY_BAUD;
    let uart = BufferedUart::new(port, rx, tx, out, come, Interrupts, config).ok()?;
    interrupt::USART3.set_priority(Priority::P2);
    Some(uart)
}

fn start_edges(sampling: Sampling) -> Option<()> {
    critical_section::with(|cs| {
        let mut place = SAMPLING.borrow(cs).try_borrow_mut().ok()?;
        place.insert(sampling).edge.enable_interrupt();
        Some(())
    })?;
    interrupt::EXTI15_10.set_priority(Priority::P1);
    // Safety: everything the interrupt uses is in place.
    unsafe { interrupt::EXTI15_10.enable() };
    Some(())
}

impl Board for Stm32h743 {
    type Memory = CalibrationFlash;

    fn start() -> Self {
        match Self::new() {
            Some(board) => board,
            None => Self::stop("a device of the board does not start", &[]),
        }
    }

    fn samples(&mut self) -> &mut SampleConsumer<'static, Scalar> {
        &mut self.samples
    }

    fn command_rates(&mut self, rates_rad_s: [Scalar; 2]) -> [bool; 2] {
        command_rates(&mut self.drives, rates_rad_s)
    }

    fn store(&mut self) -> &mut CalibrationStore<CalibrationFlash> {
        &mut self.store
    }

    fn send(&mut self, frame: &[u8]) {
        // Waits for the port where the buffer is full: 11 ms at most for a frame.
        let mut rest = frame;
        while let Ok(sent) = self.telemetry.write(rest)
            && sent > 0
        {
            rest = rest.get(sent..).unwrap_or(&[]);
        }
    }

    /// The default: this board has no other.
    fn configuration<'a>(&mut self, _buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        None
    }

    fn now_us(&self) -> u64 {
        clock::now_us()
    }

    /// It is on while it runs.
    fn powered(&self) -> bool {
        true
    }

    fn wait(&mut self) {
        // An interrupt between look and sleep stays pending and ends the sleep.
        critical_section::with(|_| {
            if self.samples.is_empty() {
                cortex_m::asm::wfi();
            }
        });
    }

    fn finish(mut self, _status: Result<(), ()>) -> ! {
        self.command_rates([0.0, 0.0]);
        defmt::info!("at rest; stack used: {=usize} bytes of {=usize}", stack::used(), stack::bytes());
        for load in loads() {
            defmt::info!("{=u32} spans, {=u64} cycles, {=u32} of the longest", load.spans, load.ticks, load.longest);
        }
        loop {
            cortex_m::asm::wfi();
        }
    }

    fn ticks() -> u32 {
        DWT::cycle_count()
    }

    fn stop(what: &str, numbers: &[u32]) -> ! {
        // PE13, which enables the drives.
        pac::GPIOE.bsrr().write(|bits| bits.set_br(13, true));
        defmt::error!("{=str} {=[?]:x}", what, numbers);
        SCB::sys_reset()
    }
}
