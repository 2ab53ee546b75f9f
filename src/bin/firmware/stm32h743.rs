//! The board NUCLEO-H743ZI2: an STM32H743ZI at 480 MHz, a Cortex-M7 with double precision. The chapter `board` of the
//! guide lists the pins.
//!
//! ```text
//! TIM6 control period   priority 1   encoders on SPI3 and SPI4 -> gimbal -> bridges on TIM1, which is armed again
//! USART2                priority 2   with the feature `kvh1750`: KVH 1750 -> sample queue
//! USART3                priority 2   the serial line; priority 3 with the feature `kvh1750`
//! TIM2 data-ready       priority 3   ADIS16495 on SPI1 -> sample queue
//! SysTick               lowest       wakes the main loop, feeds the watchdog
//! ```
//! Each IMU has a file with its interrupt handler. The stack is in the data TCM. Both caches are on. Only the processor
//! accesses memory (no DMA).
#![allow(unsafe_code)]

#[cfg(not(feature = "kvh1750"))]
mod adis16495;
mod checked_flash;
mod clock;
#[cfg(feature = "kvh1750")]
mod kvh1750;
mod motors;
mod protection;
mod serial;

use crate::board::{Board, Parts};
use crate::work::{Span, Work, count, loads};
use crate::{Scalar, recorder, stack, watchdog};
#[cfg(not(feature = "kvh1750"))]
use adis16495::{Imu, Wiring};
use checked_flash::CheckedFlash;
use clock::{CORE_HZ, Delay};
use core::cell::{Cell, RefCell};
use core::mem::MaybeUninit;
use core::ops::Range;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DWT, SCB};
use critical_section::Mutex;
use defmt_rtt as _;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::peripherals::{PC6, TIM3, TIM6};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::usart::Uart;
use embassy_stm32::{interrupt as handler, pac};
use embedded_hal::delay::DelayNs;
use embedded_hal_bus::spi::ExclusiveDevice;
#[cfg(feature = "kvh1750")]
use kvh1750::{Imu, Wiring};
use motors::MotorPwm;
use rins_selfcal::acquisition::GimbalView;
use rins_selfcal::acquisition::queue::SampleQueue;
use rins_selfcal::base::clock_check::ClockFault;
use rins_selfcal::base::loss::LossReason;
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::restart::Task;
use rins_selfcal::drivers::biss::{BissEncoder, Mounting, Resolution};
use rins_selfcal::drivers::bridge::{Bridge, NoPin};
use rins_selfcal::drivers::stm32h743::{allows_480_mhz, cleaner};
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::control::Control;
use rins_selfcal::gimbal::servo::PERIOD_US;
use rins_selfcal::instrument::UnitMemory;
use rins_selfcal::keep::black_box::Event;
use rins_selfcal::keep::medium;
use rins_selfcal::keep::partition::{Layout, Partition};
use rins_selfcal::link::Link;

/// Depth of the sample queue plus one: 5 s at 200 Hz. The main loop needs up to 4 s to erase a sector of the flash.
const QUEUE_LENGTH: usize = 1024;
// Not initialized at the start, which would take time.
#[unsafe(link_section = ".axi")]
static mut QUEUE: MaybeUninit<SampleQueue<Scalar, QUEUE_LENGTH>> = MaybeUninit::uninit();

/// The last six sectors of the flash's second bank. The program runs on from the first bank while a sector is erased.
const RECORDS: Range<u32> = 2 * 1024 * 1024 - sectors(0, 6).end..2 * 1024 * 1024;
/// Two sectors for each kind of record. The calibrations have the last two.
const LAYOUT: Layout = Layout { marks: sectors(0, 2), configuration: sectors(2, 2), calibrations: sectors(4, 2) };
type RecordFlash = medium::Flash<CheckedFlash>;
type Memory = Partition<'static, RecordFlash>;

/// The addresses of this many sectors of 128 KiB, from the first one on.
const fn sectors(first: u32, count: u32) -> Range<u32> {
    first * 128 * 1024..(first + count) * 128 * 1024
}

/// Clock of the encoders, Hz.
const ENCODER_HZ: u32 = 3_750_000;
/// The two ways to sample the encoders' line. They sample half a bit apart; the delay of the line decides which is right.
const ENCODER_MODES: [spi::Mode; 2] = [spi::MODE_3, spi::MODE_2];
/// Number of frames by which the two ways are compared.
const ENCODER_TRIES: u32 = 64;
/// Time after a frame until the encoder is ready again, us.
const ENCODER_PAUSE_US: u32 = 40;

type Bus = Spi<'static, Blocking, Master>;
/// An encoder has no chip-select line.
type EncoderSpi = ExclusiveDevice<Bus, NoPin, Delay>;

// --------------------------------------------------------------------------------------------------------- interrupts

type BoardBridge = Bridge<MotorPwm, Output<'static>, Output<'static>, Input<'static>>;
type BoardControl = Control<Scalar, EncoderSpi, BoardBridge>;

/// The devices that control needs at its start.
type Devices = ([BissEncoder<EncoderSpi>; 2], [BoardBridge; 2], Peri<'static, TIM6>);

/// Filled once at power-up. [`rins_selfcal::gimbal::control`] lists its users.
static CONTROL: Mutex<RefCell<Option<BoardControl>>> = Mutex::new(RefCell::new(None));

fn with_control<R>(act: impl FnOnce(&mut BoardControl) -> R) -> Option<R> {
    critical_section::with(|cs| Some(act(CONTROL.borrow(cs).try_borrow_mut().ok()?.as_mut()?)))
}

/// The data of the IMU's interrupt. Filled once at power-up and then used by that interrupt only. The interrupt takes
/// the data out while it runs, because the control interrupt may preempt it.
type OfImu<T> = Mutex<Cell<Option<T>>>;

/// The handler of the IMU's interrupt: `act` processes the new data.
fn on_imu<T>(of_imu: &OfImu<T>, act: impl FnOnce(&mut T)) {
    let span = Span::start();
    if let Some(mut imu) = critical_section::with(|cs| of_imu.borrow(cs).take()) {
        act(&mut imu);
        critical_section::with(|cs| of_imu.borrow(cs).set(Some(imu)));
    }
    watchdog::report(Task::Sampling, clock::now_us());
    count(Work::Acquire, &span);
    span.put_aside();
}

fn view(time_us: u64) -> GimbalView {
    with_control(|control| control.view(time_us)).unwrap_or(Err(LossReason::Status))
}

#[handler]
fn TIM6_DAC() {
    let span = Span::start();
    pac::TIM6.sr().write(|status| status.set_uif(false));
    if with_control(|control| control.on_period(clock::now_us)).is_some() {
        motors::arm();
    }
    watchdog::report(Task::Control, clock::now_us());
    count(Work::Control, &span);
    span.put_aside();
}

/// Wakes the main loop when the IMU does not, and feeds the watchdog.
#[cortex_m_rt::exception]
fn SysTick() {
    watchdog::check(clock::now_us());
}

// -------------------------------------------------------------------------------------------------------------- board

/// Set by the first stop.
static STOPPED: AtomicBool = AtomicBool::new(false);

/// The board.
pub struct Stm32h743 {
    parts: Parts<Memory>,
    /// Encoders, bridges and the timer of the control periods. They are moved out when control begins.
    devices: Option<Devices>,
    imu: Imu,
    _motors: motors::Kept,
    _serial: Uart<'static, Blocking>,
}

fn spi_config(mode: spi::Mode, hz: u32) -> spi::Config {
    let mut config = spi::Config::default();
    (config.mode, config.frequency) = (mode, Hertz(hz));
    config
}

fn output(pin: Peri<'static, impl embassy_stm32::gpio::Pin>) -> Output<'static> {
    Output::new(pin, Level::Low, Speed::Low)
}

fn encoder(bus: Bus) -> Option<BissEncoder<EncoderSpi>> {
    let spi = ExclusiveDevice::new(bus, NoPin, Delay).ok()?;
    let mut encoder = BissEncoder::new(spi, Resolution::Bits26, Mounting::STRAIGHT);
    let good = ENCODER_MODES.map(|mode| {
        set_mode(&mut encoder, mode);
        encoder.good_frames(ENCODER_TRIES, || Delay.delay_us(ENCODER_PAUSE_US))
    });
    let best = cleaner(good);
    set_mode(&mut encoder, if best == 0 { ENCODER_MODES[0] } else { ENCODER_MODES[1] });
    encoder.forget();
    defmt::info!("encoder: {} of {=u32} frames are good in SPI modes 3 and 2", good, ENCODER_TRIES);
    Some(encoder)
}

fn set_mode(encoder: &mut BissEncoder<EncoderSpi>, mode: spi::Mode) {
    // The bus accepts every mode at this frequency.
    let _ = encoder.bus().bus_mut().set_config(&spi_config(mode, ENCODER_HZ));
}

impl Stm32h743 {
    fn new() -> Option<Self> {
        Self::start_watchdog();
        let source = clock::Source::find();
        let fits = allows_480_mhz(pac::DBGMCU.idc().read().0);
        // A chip that does not allow 480 MHz stays at the 64 MHz of its start.
        let p = embassy_stm32::init(if fits { clock::configuration(source) } else { Default::default() });
        clock::start(p.TIM2);
        start_core()?;
        let restart = recorder::start(Some(reset_flags()));
        if !fits {
            Self::stop(&FatalError::board("this revision of the chip is too slow"));
        }
        clock::start_crystal();

        // Safety: the peripherals can be taken only once, so this statement runs only once.
        let queue = unsafe { (&raw mut QUEUE).as_mut() }?.write(SampleQueue::new());
        let (producer, samples) = queue.split();
        #[cfg(not(feature = "kvh1750"))]
        let wiring = Wiring {
            timer: p.TIM3,
            clock: p.PC6,
            bus: p.SPI1,
            sclk: p.PA5,
            din: p.PB5,
            dout: p.PA6,
            select: p.PD14,
            data_ready: p.PB11,
        };
        #[cfg(feature = "kvh1750")]
        let wiring = Wiring { timer: p.TIM3, request: p.PC6, port: p.USART2, rx: p.PD6 };
        let Some(imu) = Imu::start(wiring, producer) else { Self::stop(&FatalError::board("the IMU does not start")) };
        let line = spi_config(ENCODER_MODES[0], ENCODER_HZ);
        let outer = encoder(Spi::new_blocking(p.SPI3, p.PC10, p.PC12, p.PC11, line))?;
        let inner = encoder(Spi::new_blocking(p.SPI4, p.PE2, p.PE6, p.PE5, line))?;

        let (motors, [pwm_outer, pwm_inner]) = motors::start(p.TIM1, p.PE9, p.PE11);
        let bridges = [
            Bridge::with_pins(pwm_outer, output(p.PE8), output(p.PE13), Input::new(p.PE14, Pull::Up)),
            Bridge::with_pins(pwm_inner, output(p.PE10), output(p.PE12), Input::new(p.PE15, Pull::Up)),
        ];
        let serial = serial::start(p.USART3, p.PD9, p.PD8)?;
        let clock = match source {
            clock::Source::External => clock::check(p.TIM16),
            clock::Source::Internal => Some(ClockFault::Absent),
        };
        if let Some(fault) = clock {
            defmt::warn!("{}", defmt::Display2Format(&fault));
        }
        let flash = medium::Flash::new(CheckedFlash::new(p.FLASH), RECORDS);
        let flash = cortex_m::singleton!(: RefCell<RecordFlash> = RefCell::new(flash))?;
        Some(Self {
            parts: Parts { samples, memory: UnitMemory::new(flash, LAYOUT), restart, imu: imu.identity, clock },
            devices: Some(([outer, inner], bridges, p.TIM6)),
            imu,
            _motors: motors,
            _serial: serial,
        })
    }
}

/// The cause of the last reset, from the hardware. The flags are cleared, so that they show only the next reset.
fn reset_flags() -> Restart {
    let flags = pac::RCC.rsr().read();
    pac::RCC.rsr().modify(|flags| flags.set_rmvf(true));
    match flags {
        flags if flags.porrstf() => Restart::PowerOn,
        // Power-on sets this flag too: RM0433, RCC_RSR.
        flags if flags.borrstf() => Restart::BrownOut,
        flags if flags.iwdg1rstf() => Restart::Watchdog,
        flags if flags.sftrstf() => Restart::Unexplained,
        _ => Restart::Pin,
    }
}

/// Starts caches, stack guard and cycle counter, and a wake-up ten times a second.
fn start_core() -> Option<()> {
    let mut core = cortex_m::Peripherals::take()?;
    stack::guard(&core.MPU);
    protection::start();
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
    core.DCB.enable_trace();
    // Without a debugger, the Cortex-M7 keeps the cycle counter locked.
    DWT::unlock();
    core.DWT.enable_cycle_counter();
    // An eighth of the core's clock, so that the reload value fits into 24 bits.
    core.SYST.set_clock_source(SystClkSource::External);
    core.SYST.set_reload(CORE_HZ / 8 / 10 - 1);
    core.SYST.clear_current();
    // Safety: no critical section depends on priorities.
    unsafe { core.SCB.set_priority(SystemHandler::SysTick, 0xf0) };
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();
    Some(())
}

/// Trigger pulses for the IMU: `hz` pulses a second, each high for `thousandths` thousandths of its period.
fn pulses(timer: Peri<'static, TIM3>, pin: Peri<'static, PC6>, hz: u32, thousandths: u32) -> SimplePwm<'static, TIM3> {
    let pin = PwmPin::new(pin, OutputType::PushPull);
    let mut pwm = SimplePwm::new(timer, Some(pin), None, None, None, Hertz(hz), CountingMode::EdgeAlignedUp);
    pwm.ch1().set_duty_cycle_fraction(thousandths, 1000);
    pwm.ch1().enable();
    pwm
}

fn start_periods(_control_timer: Peri<'static, TIM6>) {
    embassy_stm32::rcc::enable_and_reset::<TIM6>();
    // One tick is 1 us. The update event ends a control period.
    pac::TIM6.psc().write_value((clock::TIMER_HZ / 1_000_000 - 1) as u16);
    pac::TIM6.arr().write(|reload| reload.set_arr(PERIOD_US as u16 - 1));
    pac::TIM6.egr().write(|event| event.set_ug(true));
    pac::TIM6.sr().write(|status| status.set_uif(false));
    pac::TIM6.dier().modify(|enabled| enabled.set_uie(true));
    interrupt::TIM6_DAC.set_priority(Priority::P1);
    // Safety: all data of the interrupt is in place.
    unsafe { interrupt::TIM6_DAC.enable() };
    pac::TIM6.cr1().modify(|control| control.set_cen(true));
}

/// Sets PE13 and PE12 low, which disables both bridges.
fn motors_off() {
    pac::GPIOE.bsrr().write(|bits| {
        bits.set_br(13, true);
        bits.set_br(12, true);
    });
}

impl Board for Stm32h743 {
    type Memory = Memory;
    type Spi = EncoderSpi;
    type Bridge = BoardBridge;

    /// The main loop needs its longest time to erase a sector.
    const DEADLINES_US: [Option<u32>; 3] = [Some(1_000_000), Some(20_000), Some(5_000_000)];
    /// An IMU that needs 5 s, a crystal that needs 2 s, and the sectors of the flash that are prepared.
    const POWER_UP_US: Option<u64> = Some(30_000_000);

    fn start() -> Self {
        match Self::new() {
            Some(board) => board,
            None => Self::stop(&FatalError::board("a device of the board does not start")),
        }
    }

    fn parts(&mut self) -> &mut Parts<Memory> {
        &mut self.parts
    }

    fn begin(&mut self, gimbal: Gimbal<Scalar>) {
        let Some((encoders, bridges, timer)) = self.devices.take() else { return };
        let control = Control::new(encoders, bridges, gimbal);
        critical_section::with(|cs| {
            CONTROL.borrow(cs).try_borrow_mut().map(|mut place| *place = Some(control)).unwrap_or(())
        });
        start_periods(timer);
        self.imu.begin();
    }

    fn with_control<R>(&mut self, act: impl FnOnce(&mut BoardControl) -> R) -> Option<R> {
        with_control(act)
    }

    fn transmit(&mut self, link: &mut Link) {
        serial::transmit(|| link.transmit());
    }

    /// Returns `None`, so that the default configuration is used: this board stores no configuration.
    fn configuration<'a>(&mut self, _buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        None
    }

    fn now_us(&self) -> u64 {
        clock::now_us()
    }

    /// Always true: the board runs only while it is powered.
    fn powered(&self) -> bool {
        true
    }

    fn wait(&mut self) {
        // An interrupt between the check and the sleep stays pending and ends the sleep.
        critical_section::with(|_| {
            if self.parts.samples.is_empty() {
                cortex_m::asm::wfi();
            }
        });
    }

    fn finish(self, _status: Result<(), ()>) -> ! {
        // Nothing is left to do. Without this, control would switch the motors on again.
        cortex_m::interrupt::disable();
        motors_off();
        defmt::info!("motors off; stack used: {=usize} bytes of {=usize}", stack::used(), stack::bytes());
        for load in loads() {
            defmt::info!("{=u32} spans, {=u64} cycles, {=u32} of the longest", load.spans, load.ticks, load.longest);
        }
        loop {
            Self::feed_watchdog();
        }
    }

    fn ticks() -> u32 {
        DWT::cycle_count()
    }

    /// The independent watchdog. It has its own clock of 32 kHz and resets after 1 s.
    fn start_watchdog() {
        pac::IWDG1.kr().write(|w| w.set_key(Key::START));
        pac::IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
        pac::IWDG1.pr().write(|w| w.set_pr(Pr::DIVIDE_BY16));
        pac::IWDG1.rlr().write(|w| w.set_rl(2000 - 1));
        Self::feed_watchdog();
    }

    fn feed_watchdog() {
        pac::IWDG1.kr().write(|w| w.set_key(Key::RESET));
    }

    fn stop(stop: &FatalError) -> ! {
        // Without this, control would switch the motors on again.
        cortex_m::interrupt::disable();
        motors_off();
        // A fault in this function, such as in a log that was being written, is a second stop. The first one is recorded.
        if STOPPED.swap(true, Ordering::Relaxed) {
            SCB::sys_reset();
        }
        recorder::record(clock::now_us(), Event::Stopped(stop.clone()));
        defmt::error!("{}", defmt::Display2Format(stop));
        SCB::sys_reset()
    }
}
