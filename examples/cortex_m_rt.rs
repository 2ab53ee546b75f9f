//! The core on a Cortex-M7 with cortex-m-rt and drivers of your own: two interrupts and a main loop.
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
use rins_selfcal::assignment::Assignment;
use rins_selfcal::calibrator::Calibrator;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::queue::{Observed, SampleProducer, SampleQueue};
use rins_selfcal::sample::CorrectedSample;
use rins_selfcal::self_calibration::SelfCalibration;
use rins_selfcal::servo::{Drive, PERIOD_US};
use rins_selfcal::store::CalibrationStore;
use rins_selfcal::store::Loaded;
use rins_selfcal::store::medium::Eeprom;
use sensor_board::SensorBoard;

/// Of the processor as your start-up code sets it; after reset.
const CORE_HZ: u32 = 64_000_000;

/// Line of the data-ready edge.
const DATA_READY_LINE: usize = 15;

static PRODUCER: Mutex<RefCell<Option<SampleProducer<'static, f64>>>> = Mutex::new(RefCell::new(None));
static GIMBAL: Mutex<RefCell<Option<Gimbal<f64>>>> = Mutex::new(RefCell::new(None));
/// Control periods since power-up: the clock of the main loop and of the gimbal. It wraps after 49 days.
static PERIODS: AtomicU32 = AtomicU32::new(0);

fn now_us() -> u64 {
    u64::from(PERIODS.load(Ordering::Relaxed)) * PERIOD_US
}

/// Data-ready: 200 Hz.
#[interrupt]
fn EXTI15_10() {
    // The edge has been seen.
    pac::EXTI.pr(0).write(|lines| lines.set_line(DATA_READY_LINE, true));
    critical_section::with(|cs| {
        let gimbal = GIMBAL.borrow_ref(cs).as_ref().map(Gimbal::status);
        if let (Some(producer), Some(gimbal)) = (PRODUCER.borrow_ref_mut(cs).as_mut(), gimbal) {
            // A sample that finds the queue full is counted by it.
            let _ = producer.push(Observed { sample: SensorBoard::at_external_memory().sample(), gimbal });
        }
    });
}

/// Control: 1 kHz.
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

/// What to do with the gimbal, if there is one.
fn with_gimbal<R>(act: impl FnOnce(&mut Gimbal<f64>) -> R) -> Option<R> {
    critical_section::with(|cs| GIMBAL.borrow_ref_mut(cs).as_mut().map(act))
}

#[entry]
fn main() -> ! {
    // Your start-up code: clocks, pins, external memory, the line of the data-ready edge.
    // It ends only where something is missing: found on the bench.
    let _ = run();
    loop {
        cortex_m::asm::bkpt();
    }
}

fn run() -> Option<()> {
    let queue = singleton!(: SampleQueue<f64, 64> = SampleQueue::new())?;
    let calibrator = singleton!(: Calibrator<f64, MAX_SEGMENTS> = Calibrator::UNCONFIGURED)?;
    let (producer, mut samples) = queue.split();
    // Site, noise, scheme, axes, motors: yours in place of the default.
    let Assignment::SelfCalibrate(config) = Assignment::default() else { return None };
    let mut store = CalibrationStore::new(Eeprom(SensorBoard::at_external_memory()));
    let stored = if let Ok(Loaded::Found { record, .. }) = store.load() { Some(record) } else { None };
    critical_section::with(|cs| {
        PRODUCER.replace(cs, Some(producer));
        GIMBAL.replace(cs, Some(Gimbal::new(&config.axes, &config.motors)));
    });
    let mut run = SelfCalibration::new(config, stored.as_ref(), calibrator).ok()?;
    start_interrupts()?;
    loop {
        while let Some(Observed { sample, gimbal }) = samples.pop() {
            let step = run.step(&sample, &gimbal, &mut |_message| { /* To your telemetry. */ });
            step.motion.map(|motion| with_gimbal(|now| now.command_seen(motion, gimbal.time_us)));
            if step.save {
                // A calibration that cannot be stored still corrects.
                let _ = run.record().map(|record| store.save(&record));
                run.saved();
            }
            if let Some(corrected) = step.corrected {
                navigate(&corrected);
            }
        }
        let status = with_gimbal(|gimbal| gimbal.status())?;
        let motion = run.tick(now_us(), &status, &mut |_message| ());
        motion.map(|motion| with_gimbal(|gimbal| gimbal.command_seen(motion, status.time_us)));
        cortex_m::asm::wfi();
    }
}

fn start_interrupts() -> Option<()> {
    let mut core = cortex_m::Peripherals::take()?;
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(CORE_HZ / 1_000_000 * PERIOD_US as u32 - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    // SAFETY: everything that the interrupt uses is in place.
    unsafe { NVIC::unmask(Interrupt::EXTI15_10) };
    Some(())
}

/// Your navigation.
fn navigate(sample: &CorrectedSample<f64>) {
    defmt::trace!("{=f64} m/s^2 up", sample.force_s.z);
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    SensorBoard::at_external_memory().drive([Drive::Off; 2]);
    loop {
        cortex_m::asm::bkpt();
    }
}
