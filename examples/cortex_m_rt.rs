//! The core on a Cortex-M7 with cortex-m-rt and your own drivers: two interrupts and a main loop.
//!
//! `cargo build --profile firmware --example cortex_m_rt --features stm32h743 --target thumbv7em-none-eabihf`
#![no_std]
#![no_main]

mod sensor_board;

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::peripheral::NVIC;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::singleton;
use cortex_m_rt::{entry, exception};
use critical_section::Mutex;
use defmt_rtt as _;
use embassy_stm32::pac::Interrupt;
use embassy_stm32::{interrupt, pac};
use rins_selfcal::acquisition::queue::{SampleConsumer, SampleProducer, SampleQueue, SampleWithGimbal};
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::sample::{CorrectedSample, SampleStatus};
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::{Drive, MotorAndLoad, PERIOD_US};
use rins_selfcal::gimbal::travel::LocateError;
use rins_selfcal::gimbal::{Gimbal, GimbalStatus, MotionCommand};
use rins_selfcal::instrument::{
    Archive, Axes, CorrectedSink, Events, Instrument, SerialLine, Startup, Surroundings, Telemetry,
};
use rins_selfcal::keep::medium::Eeprom;
use rins_selfcal::keep::store::CalibrationStore;
use rins_selfcal::link::Link;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::calibrator::Calibrator;
use sensor_board::SensorBoard;

/// Clock of the processor as your start-up code sets it; here its value after reset, Hz.
const CORE_HZ: u32 = 64_000_000;

/// EXTI line of the data-ready edge.
const DATA_READY_LINE: usize = 15;

static PRODUCER: Mutex<RefCell<Option<SampleProducer<'static, f64>>>> = Mutex::new(RefCell::new(None));
static GIMBAL: Mutex<RefCell<Option<Gimbal<f64>>>> = Mutex::new(RefCell::new(None));
/// Number of control periods since power-up: the clock of the main loop and of the gimbal. It wraps after 49 days.
static PERIODS: AtomicU32 = AtomicU32::new(0);

fn now_us() -> u64 {
    u64::from(PERIODS.load(Ordering::Relaxed)) * PERIOD_US
}

/// The data-ready interrupt: 200 Hz.
#[interrupt]
fn EXTI15_10() {
    // Acknowledges the edge.
    pac::EXTI.pr(0).write(|lines| lines.set_line(DATA_READY_LINE, true));
    critical_section::with(|cs| {
        let gimbal = GIMBAL.borrow_ref(cs).as_ref().map(Gimbal::status);
        if let (Some(producer), Some(gimbal)) = (PRODUCER.borrow_ref_mut(cs).as_mut(), gimbal) {
            // The queue counts a sample that finds it full.
            let _ = producer.push(SampleWithGimbal { sample: SensorBoard::at_external_memory().sample(), gimbal });
        }
    });
}

/// The control interrupt: 1 kHz.
#[exception]
fn SysTick() {
    PERIODS.fetch_add(1, Ordering::Relaxed);
    critical_section::with(|cs| {
        if let Some(gimbal) = GIMBAL.borrow_ref_mut(cs).as_mut() {
            let mut board = SensorBoard::at_external_memory();
            let drives = gimbal.control(now_us(), &board.sensed());
            board.drive(drives);
        }
    });
}

/// Calls `act` with the gimbal; `None` before the gimbal is set up.
fn with_gimbal<R>(act: impl FnOnce(&mut Gimbal<f64>) -> R) -> Option<R> {
    critical_section::with(|cs| GIMBAL.borrow_ref_mut(cs).as_mut().map(act))
}

#[entry]
fn main() -> ! {
    // Your start-up code: clocks, pins, external memory, the EXTI line of the data-ready edge.
    // `run` returns only if something is missing, which you will find on the bench.
    let _ = run();
    loop {
        cortex_m::asm::bkpt();
    }
}

fn run() -> Option<()> {
    let queue = singleton!(: SampleQueue<f64, 64> = SampleQueue::new())?;
    let calibrator = singleton!(: Calibrator<f64, MAX_SEGMENTS> = Calibrator::UNCONFIGURED)?;
    let link = singleton!(: Link = Link::new())?;
    let (producer, samples) = queue.split();
    // The default has site, noise, scheme, axes and motors. Replace them with yours.
    let Assignment::SelfCalibrate(config) = Assignment::default() else { return None };
    critical_section::with(|cs| {
        PRODUCER.replace(cs, Some(producer));
        GIMBAL.replace(cs, Some(Gimbal::new(&config.axes, &config.motors)));
    });
    let store = CalibrationStore::new(Eeprom(SensorBoard::at_external_memory()));
    let mut devices = Devices { samples, store };
    // Your start-up code knows why the software has started. Replace `PowerOn` with that reason.
    let mut startup = Startup::assigned(config, Restart::PowerOn);
    let mut instrument = Instrument::power_up(&mut startup, link, calibrator, &mut devices).ok()?;
    start_interrupts()?;
    loop {
        instrument.turn(&mut devices);
        cortex_m::asm::wfi();
    }
}

/// The board as the instrument sees it. This board has neither a serial line nor a black box.
struct Devices {
    samples: SampleConsumer<'static, f64>,
    store: CalibrationStore<Eeprom<SensorBoard>>,
}

impl Surroundings<f64> for Devices {
    fn now_us(&self) -> u64 {
        now_us()
    }

    fn next_sample(&mut self) -> Option<SampleWithGimbal<f64>> {
        self.samples.pop()
    }

    fn losses(&mut self) -> LossCounts {
        self.samples.losses()
    }

    fn archive(&mut self) -> &mut impl Archive {
        &mut self.store
    }
}

impl Axes for Devices {
    fn status(&mut self) -> GimbalStatus {
        with_gimbal(|gimbal| gimbal.status()).unwrap_or_default()
    }

    fn command(&mut self, motion: MotionCommand, seen_us: u64) {
        with_gimbal(|gimbal| gimbal.command_seen(motion, seen_us));
    }

    fn reconfigure(&mut self, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        with_gimbal(|gimbal| gimbal.reconfigure(axes, motors));
    }

    fn angles_rad(&mut self) -> [Option<f64>; 2] {
        with_gimbal(|gimbal| gimbal.angles_rad()).unwrap_or_default()
    }

    fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
        with_gimbal(|gimbal| gimbal.locate(angles_rad, tolerance_rad)).unwrap_or(Ok(()))
    }
}

impl CorrectedSink<f64> for Devices {
    /// Your navigation software takes the corrected samples here.
    fn take(&mut self, sample: &CorrectedSample<f64>, _angles: [Angle; 2], _status: SampleStatus) {
        defmt::trace!("{=f64} m/s^2 up", sample.force_s.z);
    }
}

impl Events for Devices {}
impl SerialLine for Devices {}
impl Telemetry for Devices {}

fn start_interrupts() -> Option<()> {
    let mut core = cortex_m::Peripherals::take()?;
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(CORE_HZ / 1_000_000 * PERIOD_US as u32 - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    // SAFETY: all data of the interrupt is in place.
    unsafe { NVIC::unmask(Interrupt::EXTI15_10) };
    Some(())
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    SensorBoard::at_external_memory().drive([Drive::Off; 2]);
    loop {
        cortex_m::asm::bkpt();
    }
}
