//! The core on a Cortex-M7 with RTIC and your own drivers. The tasks share the gimbal by their priorities, so no task
//! waits for a lock.
//!
//! `cargo build --profile firmware --example rtic --features stm32h743 --target thumbv7em-none-eabihf`
#![no_std]
#![no_main]

mod sensor_board;

use defmt_rtt as _;

#[rtic::app(device = embassy_stm32::pac, peripherals = false)]
mod app {
    use crate::sensor_board::SensorBoard;
    use cortex_m::peripheral::SYST;
    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m::singleton;
    use rins_selfcal::acquisition::queue::{SampleConsumer, SampleProducer, SampleQueue, SampleWithGimbal};
    use rins_selfcal::base::angle::Angle;
    use rins_selfcal::base::loss::LossCounts;
    use rins_selfcal::base::restart::Restart;
    use rins_selfcal::base::sample::{CorrectedSample, SampleStatus};
    use rins_selfcal::estimator::MAX_SEGMENTS;
    use rins_selfcal::gimbal::axis::AxisLimits;
    use rins_selfcal::gimbal::servo::{MotorAndLoad, PERIOD_US};
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
    use rtic::Mutex;

    /// Clock of the processor as your start-up code sets it; here its value after reset, Hz.
    const CORE_HZ: u32 = 64_000_000;

    /// EXTI line of the data-ready edge.
    const DATA_READY_LINE: usize = 15;

    /// Shared by control, which has the higher priority, and the main loop.
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
        instrument: Instrument<'static, f64>,
    }

    /// Runs with all interrupts off. So neither control nor sampling runs before the decision at power-up.
    #[init(local = [queue: SampleQueue<f64, 64> = SampleQueue::new(), link: Link = Link::new(),
                    calibrator: Calibrator<f64, MAX_SEGMENTS> = Calibrator::UNCONFIGURED])]
    fn init(context: init::Context) -> (Shared, Local) {
        // Your start-up code: clocks, pins, external memory, the EXTI line of the data-ready edge.
        let init::LocalResources { queue, link, calibrator, .. } = context.local;
        let (producer, mut samples) = queue.split();
        let mut store = CalibrationStore::new(Eeprom(SensorBoard::at_external_memory()));
        // The default has site, noise, scheme, axes and motors. Replace them with yours.
        let Assignment::SelfCalibrate(config) = Assignment::default() else { refuse() };
        let mut gimbal = Gimbal::new(&config.axes, &config.motors);
        let mut devices = Devices { samples: &mut samples, store: &mut store, gimbal: Alone(&mut gimbal), now_us: 0 };
        // Your start-up code knows why the software has started. Replace `PowerOn` with that reason.
        let startup = singleton!(: Startup = Startup::assigned(config, Restart::PowerOn));
        let Some(startup) = startup else { refuse() };
        let Ok(instrument) = Instrument::power_up(startup, link, calibrator, &mut devices) else { refuse() };
        start_periods(context.core.SYST);
        (Shared { gimbal, now_us: 0 }, Local { producer, samples, store, instrument })
    }

    /// Starts the control periods. The first one ends after `init`.
    fn start_periods(mut timer: SYST) {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(CORE_HZ / 1_000_000 * PERIOD_US as u32 - 1);
        timer.clear_current();
        timer.enable_counter();
        timer.enable_interrupt();
    }

    /// The gimbal during `init`, which needs no lock because no task runs yet.
    struct Alone<'a>(&'a mut Gimbal<f64>);

    impl Mutex for Alone<'_> {
        type T = Gimbal<f64>;

        fn lock<R>(&mut self, act: impl FnOnce(&mut Gimbal<f64>) -> R) -> R {
            act(self.0)
        }
    }

    /// Reached only if the configuration contradicts itself, which you will find on the bench.
    fn refuse() -> ! {
        loop {
            cortex_m::asm::bkpt();
        }
    }

    /// The data-ready interrupt: 200 Hz.
    #[task(binds = EXTI15_10, priority = 1, local = [producer], shared = [gimbal])]
    fn data_ready(context: data_ready::Context) {
        // Acknowledges the edge.
        embassy_stm32::pac::EXTI.pr(0).write(|lines| lines.set_line(DATA_READY_LINE, true));
        let mut shared = context.shared;
        let gimbal = shared.gimbal.lock(|gimbal| gimbal.status());
        // The queue counts a sample that finds it full.
        let _ = context
            .local
            .producer
            .push(SampleWithGimbal { sample: SensorBoard::at_external_memory().sample(), gimbal });
    }

    /// The control interrupt: 1 kHz.
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

    #[idle(local = [samples, store, instrument], shared = [gimbal, now_us])]
    fn idle(context: idle::Context) -> ! {
        let idle::LocalResources { samples, store, instrument, .. } = context.local;
        let idle::SharedResources { gimbal, mut now_us, .. } = context.shared;
        let mut devices = Devices { samples, store, gimbal, now_us: 0 };
        loop {
            devices.now_us = now_us.lock(|now_us| *now_us);
            instrument.turn(&mut devices);
            cortex_m::asm::wfi();
        }
    }

    /// The board as the instrument sees it. This board has neither a serial line nor a black box.
    struct Devices<'a, G> {
        samples: &'a mut SampleConsumer<'static, f64>,
        store: &'a mut CalibrationStore<Eeprom<SensorBoard>>,
        gimbal: G,
        /// Time at the start of this turn, us.
        now_us: u64,
    }

    impl<G: Mutex<T = Gimbal<f64>>> Surroundings<f64> for Devices<'_, G> {
        fn now_us(&self) -> u64 {
            self.now_us
        }

        fn next_sample(&mut self) -> Option<SampleWithGimbal<f64>> {
            self.samples.pop()
        }

        fn losses(&mut self) -> LossCounts {
            self.samples.losses()
        }

        fn archive(&mut self) -> &mut impl Archive {
            self.store
        }
    }

    impl<G: Mutex<T = Gimbal<f64>>> Axes for Devices<'_, G> {
        fn status(&mut self) -> GimbalStatus {
            self.gimbal.lock(|gimbal| gimbal.status())
        }

        fn command(&mut self, motion: MotionCommand, seen_us: u64) {
            self.gimbal.lock(|gimbal| gimbal.command_seen(motion, seen_us));
        }

        fn reconfigure(&mut self, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
            self.gimbal.lock(|gimbal| gimbal.reconfigure(axes, motors));
        }

        fn angles_rad(&mut self) -> [Option<f64>; 2] {
            self.gimbal.lock(|gimbal| gimbal.angles_rad())
        }

        fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
            self.gimbal.lock(|gimbal| gimbal.locate(angles_rad, tolerance_rad))
        }
    }

    impl<G> CorrectedSink<f64> for Devices<'_, G> {
        /// Your navigation software takes the corrected samples here.
        fn take(&mut self, sample: &CorrectedSample<f64>, _angles: [Angle; 2], _status: SampleStatus) {
            defmt::trace!("{=f64} m/s^2 up", sample.force_s.z);
        }
    }

    impl<G> Events for Devices<'_, G> {}
    impl<G> SerialLine for Devices<'_, G> {}
    impl<G> Telemetry for Devices<'_, G> {}
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    sensor_board::SensorBoard::at_external_memory().drive([rins_selfcal::gimbal::servo::Drive::Off; 2]);
    loop {
        cortex_m::asm::bkpt();
    }
}
