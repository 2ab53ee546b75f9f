//! The core on a Cortex-M7 with RTIC and drivers of your own: tasks share the gimbal by priority, not by locks that wait.
//!
//! `cargo build --profile firmware --example rtic --features stm32h743 --target thumbv7em-none-eabihf`
#![no_std]
#![no_main]

mod sensor_board;

use defmt_rtt as _;

#[rtic::app(device = embassy_stm32::pac, peripherals = false)]
mod app {
    use crate::sensor_board::SensorBoard;
    use cortex_m::peripheral::syst::SystClkSource;
    use rins_selfcal::assignment::Assignment;
    use rins_selfcal::calibrator::Calibrator;
    use rins_selfcal::estimator::MAX_SEGMENTS;
    use rins_selfcal::gimbal::Gimbal;
    use rins_selfcal::queue::{Observed, SampleConsumer, SampleProducer, SampleQueue};
    use rins_selfcal::self_calibration::SelfCalibration;
    use rins_selfcal::servo::PERIOD_US;
    use rins_selfcal::store::medium::Eeprom;
    use rins_selfcal::store::{CalibrationStore, Loaded};

    /// Of the processor as your start-up code sets it; after reset.
    const CORE_HZ: u32 = 64_000_000;

    /// Line of the data-ready edge.
    const DATA_READY_LINE: usize = 15;

    /// Between control, at the higher priority, and the main loop.
    #[shared]
    struct Shared {
        gimbal: Gimbal<f64>,
        now_us: u64,
    }

    #[local]
    struct Local {
        producer: SampleProducer<'static, f64>,
        samples: SampleConsumer<'static, f64>,
        store: CalibrationStore<Eeprom<SensorBoard>>,
        run: SelfCalibration<'static, f64>,
    }

    #[init(local = [queue: SampleQueue<f64, 64> = SampleQueue::new(),
                    calibrator: Calibrator<f64, MAX_SEGMENTS> = Calibrator::UNCONFIGURED])]
    fn init(context: init::Context) -> (Shared, Local) {
        // Your start-up code: clocks, pins, external memory, the line of the data-ready edge.
        let mut timer = context.core.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(CORE_HZ / 1_000_000 * PERIOD_US as u32 - 1);
        timer.clear_current();
        timer.enable_counter();
        timer.enable_interrupt();
        let (producer, samples) = context.local.queue.split();
        let mut store = CalibrationStore::new(Eeprom(SensorBoard::at_external_memory()));
        let stored = if let Ok(Loaded::Found { record, .. }) = store.load() { Some(record) } else { None };
        // Site, noise, scheme, axes, motors: yours in place of the default.
        let Assignment::SelfCalibrate(config) = Assignment::default() else { refuse() };
        let gimbal = Gimbal::new(&config.axes, &config.motors);
        let Ok(run) = SelfCalibration::new(config, stored.as_ref(), context.local.calibrator) else { refuse() };
        (Shared { gimbal, now_us: 0 }, Local { producer, samples, store, run })
    }

    /// A configuration that contradicts itself is found on the bench.
    fn refuse() -> ! {
        loop {
            cortex_m::asm::bkpt();
        }
    }

    /// Data-ready: 200 Hz.
    #[task(binds = EXTI15_10, priority = 1, local = [producer], shared = [gimbal])]
    fn data_ready(context: data_ready::Context) {
        // The edge has been seen.
        embassy_stm32::pac::EXTI.pr(0).write(|lines| lines.set_line(DATA_READY_LINE, true));
        let mut shared = context.shared;
        let gimbal = shared.gimbal.lock(|gimbal| gimbal.status());
        // A sample that finds the queue full is counted by it.
        let _ = context.local.producer.push(Observed { sample: SensorBoard::at_external_memory().sample(), gimbal });
    }

    /// Control: 1 kHz.
    #[task(binds = SysTick, priority = 2, shared = [gimbal, now_us])]
    fn control(context: control::Context) {
        let control::SharedResources { gimbal, now_us, .. } = context.shared;
        (gimbal, now_us).lock(|gimbal, now_us| {
            *now_us += PERIOD_US;
            let mut board = SensorBoard::at_external_memory();
            let drives = gimbal.control(*now_us, &board.sensed());
            board.drive(drives);
        });
    }

    #[idle(local = [samples, store, run], shared = [gimbal, now_us])]
    fn idle(context: idle::Context) -> ! {
        let idle::LocalResources { samples, store, run, .. } = context.local;
        let idle::SharedResources { mut gimbal, mut now_us, .. } = context.shared;
        loop {
            while let Some(Observed { sample, gimbal: seen }) = samples.pop() {
                let step = run.step(&sample, &seen, &mut |_message| { /* To your telemetry. */ });
                if let Some(motion) = step.motion {
                    gimbal.lock(|gimbal| gimbal.command_seen(motion, seen.time_us));
                }
                if step.save {
                    // A calibration that cannot be stored still corrects.
                    let _ = run.record().map(|record| store.save(&record));
                    run.saved();
                }
                if let Some(corrected) = step.corrected {
                    defmt::trace!("{=f64} m/s^2 up", corrected.force_s.z);
                }
            }
            let (status, board_us) = (gimbal.lock(|gimbal| gimbal.status()), now_us.lock(|now_us| *now_us));
            if let Some(motion) = run.tick(board_us, &status, &mut |_message| ()) {
                gimbal.lock(|gimbal| gimbal.command_seen(motion, status.time_us));
            }
            cortex_m::asm::wfi();
        }
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    sensor_board::SensorBoard::at_external_memory().drive([rins_selfcal::servo::Drive::Off; 2]);
    loop {
        cortex_m::asm::bkpt();
    }
}
