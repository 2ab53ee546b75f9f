//! Power-up of an instrument on the bench: in this process, or as the firmware image in the emulator. Both run the same
//! drivers, queue and assembly, and tell the same messages.

use super::devices::{Bench, BenchControl, BenchImu, SharedBench, control};
use super::emulator::image::Image;
use super::emulator::{Run, Setup, run};
use super::line::{Line, Unconnected};
use crate::calibration::refusal::refused;
use crate::virtual_unit::plant::{Output, Plant, Tick};
use anyhow::{Context, Result};
use rins_selfcal::acquisition::queue::{Observed, SampleProducer, SampleQueue};
use rins_selfcal::base::linear::Real;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::keep::black_box::{Entry, Event};
use rins_selfcal::link::{Archive, Hello, Link, MAX_FRAME_BYTES, Moment, Refusal};
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::calibrator::{Calibrator, CalibratorConfig};
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::self_calibration::SelfCalibration;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::verdict::VerdictLimits;
use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

/// Depth of the queue: here every sample is taken at once.
const QUEUE: usize = 4;
/// Time of a turn of the main loop, us.
const TURN_US: u64 = 5000;

/// Runs an instrument until its plant is exhausted. `stored` is the calibration in store at power-up; returns the one
/// that the run stored.
///
/// # Errors
/// The configuration is refused.
pub fn in_process<T: Real, const STATES: usize, P: Plant>(
    assignment: &Assignment,
    stored: Option<&StoredCalibration>,
    bench: &SharedBench<P>,
    mut on_message: impl FnMut(&Message),
) -> Result<Option<StoredCalibration>> {
    match assignment {
        Assignment::SelfCalibrate(config) => {
            let mut memory = Memory { stored: stored.cloned(), ..Memory::default() };
            self_calibrate::<T, STATES, P>(config, &mut memory, bench, &mut Unconnected, &mut on_message)?;
            Ok(memory.stored.filter(|_| memory.saved))
        }
        Assignment::Replay(config) => {
            replay::<T, STATES, P>(config, bench, &mut on_message);
            Ok(None)
        }
    }
}

/// The memory of an instrument in this process.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// The calibration in store.
    pub stored: Option<StoredCalibration>,
    /// Whether the run has stored one.
    pub saved: bool,
    /// All results, rejected ones included, oldest first.
    pub history: Vec<StoredCalibration>,
    /// All events, oldest first.
    pub events: Vec<Entry>,
}

impl Memory {
    fn note(&mut self, time_us: u64, message: &Message) {
        if let Some(event) = Event::of(message) {
            self.events.push(Entry { sequence: self.events.len() as u32, time_us, event, repeats: 0 });
        }
    }
}

impl Archive for Memory {
    fn newest(&mut self) -> Result<Option<StoredCalibration>, Refusal> {
        Ok(self.stored.clone())
    }

    fn entry(&mut self, back: u16) -> Result<Option<StoredCalibration>, Refusal> {
        Ok(self.history.iter().rev().nth(back.into()).cloned())
    }

    fn event(&mut self, back: u16) -> Option<Entry> {
        self.events.iter().rev().nth(back.into()).cloned()
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        (self.stored, self.history) = (None, Vec::new());
        Ok(())
    }
}

/// As [`in_process`], at the end of a serial line, which brings commands and takes messages. `memory` is what the instrument keeps
/// from one power-up to the next.
///
/// # Errors
/// The configuration is refused.
pub fn self_calibrate<T: Real, const STATES: usize, P: Plant>(
    config: &SelfCalibrationConfig,
    memory: &mut Memory,
    bench: &SharedBench<P>,
    line: &mut impl Line,
    on_message: &mut impl FnMut(&Message),
) -> Result<()> {
    let mut link = Link::new();
    link.greet(Hello::new::<T>(STATES));
    let clock_us = Cell::new(0);
    let mut tell = |link: &mut Link, memory: &mut Memory, message: &Message| {
        on_message(message);
        memory.note(clock_us.get(), message);
        link.tell(message, &mut [0; MAX_FRAME_BYTES]);
    };
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let (producer, mut consumer) = queue.split();
    let gimbal = Gimbal::<T>::new(&config.axes, &config.motors);
    let mut interrupts = Interrupts::new(bench, config.calibrator.rate_hz, gimbal, producer);
    let found = memory.stored.is_some();
    tell(&mut link, memory, &Message::Store { found, damaged: false, fault: false });
    tell(&mut link, memory, &Message::Restarted(Restart::PowerOn));
    let refused = |error| refused(error, &config.scheme, &config.axes);
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS, STATES>::UNCONFIGURED);
    let mut run = SelfCalibration::new(config.clone(), memory.stored.as_ref(), &mut calibrator).map_err(refused)?;
    let mut samples = 0;
    while interrupts.period(bench) {
        while let Some(Observed { sample, gimbal }) = consumer.pop() {
            samples += 1;
            let step = run.step(&sample, &gimbal, &mut |message| tell(&mut link, memory, message));
            step.motion.into_iter().for_each(|motion| interrupts.control.command(motion, gimbal.time_us));
            if step.note {
                memory.history.extend(run.record());
            }
            if step.save {
                let record = run.record();
                tell(&mut link, memory, &Message::Saved(record.is_some()));
                memory.saved |= record.is_some();
                memory.history.extend(record.clone());
                memory.stored = record.or(memory.stored.take());
                run.saved();
            }
        }
        let moment = Moment { now_us: bench.borrow().now_us(), missing: consumer.losses().total() };
        clock_us.set(moment.now_us);
        if !moment.now_us.is_multiple_of(TURN_US) {
            continue;
        }
        let gimbal = interrupts.control.status();
        let motion = run.tick(moment.now_us, &gimbal, &mut |message| tell(&mut link, memory, message));
        motion.into_iter().for_each(|motion| interrupts.control.command(motion, gimbal.time_us));
        let before = mechanics(run.config());
        link.serve(std::iter::from_fn(|| line.receive()), moment, &mut run, memory);
        let (axes, motors) = mechanics(run.config());
        if (axes, motors) != before {
            interrupts.control.reconfigure(&axes, &motors);
        }
        link.tell_status(moment, &run);
        line.transmit(&mut || link.transmit());
    }
    tell(&mut link, memory, &Message::Queue { samples, losses: consumer.losses() });
    Ok(())
}

fn replay<T: Real, const STATES: usize, P: Plant>(
    config: &CalibratorConfig,
    bench: &SharedBench<P>,
    on_message: &mut impl FnMut(&Message),
) {
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let (producer, mut consumer) = queue.split();
    let gimbal = Gimbal::<T>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
    let mut interrupts = Interrupts::new(bench, config.rate_hz, gimbal, producer);
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS, STATES>::new(config));
    let mut samples = 0;
    while interrupts.period(bench) {
        while let Some(Observed { sample, .. }) = consumer.pop() {
            samples += 1;
            if let Some(progress) = calibrator.step(&sample) {
                on_message(&Message::Segment(progress));
            }
        }
    }
    let solution = calibrator.conclude(on_message);
    let verdict = calibrator.judge(&solution, None, &VerdictLimits::default());
    on_message(&Message::Judged(verdict));
    on_message(&Message::Queue { samples, losses: consumer.losses() });
}

/// What of a configuration the gimbal must know.
fn mechanics(config: &SelfCalibrationConfig) -> ([AxisLimits; 2], [MotorAndLoad; 2]) {
    (config.axes, config.motors)
}

/// What the interrupts of a board have.
pub struct Interrupts<'q, T: Real, P> {
    imu: BenchImu<'q, T, P>,
    /// What the control interrupt has, for the main loop.
    pub control: BenchControl<T, P>,
}

impl<'q, T: Real, P: Plant> Interrupts<'q, T, P> {
    /// On a bench whose plant samples `rate_hz` times a second.
    pub fn new(bench: &SharedBench<P>, rate_hz: f64, gimbal: Gimbal<T>, producer: SampleProducer<'q, T>) -> Self {
        Self { imu: BenchImu::new(bench, rate_hz, producer), control: control(bench, gimbal) }
    }

    /// Lets a control period go by; whether the instrument is still switched on.
    pub fn period(&mut self, bench: &SharedBench<P>) -> bool {
        if !bench.borrow_mut().period() {
            return false;
        }
        let now_us = bench.borrow().now_us();
        self.control.on_period(|| now_us);
        self.imu.on_period(bench, |time_us| self.control.view(time_us));
        true
    }
}

/// Runs an instrument as the firmware `image` in the emulator; `eeprom` is its store from boot to boot.
///
/// # Errors
/// The emulator is missing or the firmware failed; one line says how.
pub fn in_emulator<P: Plant>(
    assignment: &Assignment,
    image: &Image,
    eeprom: Option<&Path>,
    bench: &mut Bench<P>,
    on_log: impl FnMut(&str),
    on_message: impl FnMut(&Message),
) -> Result<Run> {
    let mut buffer = [0; MAX_ASSIGNMENT_BYTES];
    let configuration = postcard::to_slice(assignment, &mut buffer).context("the scheme is too long for the board")?;
    let setup = Setup { eeprom, configuration, ..Setup::new(image) };
    run(&setup, bench, on_log, on_message)
}

/// A plant with a switch: turned off, it does not go on.
pub struct Switched<P> {
    plant: P,
    off: Rc<Cell<bool>>,
}

impl<P> Switched<P> {
    /// The plant, switched on, and its switch.
    pub fn new(plant: P) -> (Self, Rc<Cell<bool>>) {
        let off = Rc::new(Cell::new(false));
        (Self { plant, off: Rc::clone(&off) }, off)
    }
}

impl<P: Plant> Plant for Switched<P> {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        if self.off.get() { None } else { self.plant.advance(outputs) }
    }
}

/// A bench that drivers in this process share.
pub fn shared<P: Plant>(plant: P) -> SharedBench<P> {
    share(Bench::new(plant))
}

/// Lets drivers in this process share a bench.
pub fn share<P>(bench: Bench<P>) -> SharedBench<P> {
    Rc::new(RefCell::new(bench))
}

/// Digest of all messages of a run: two runs with the same digest agree in every bit of every result.
#[derive(Clone)]
pub struct MessageDigest(crc::Digest<'static, u64, crc::Table<16>>);

static CRC_64: crc::Crc<u64, crc::Table<16>> = crc::Crc::<u64, crc::Table<16>>::new(&crc::CRC_64_XZ);

impl Default for MessageDigest {
    fn default() -> Self {
        Self(CRC_64.digest())
    }
}

impl MessageDigest {
    /// Takes in a message.
    pub fn add(&mut self, message: &Message) {
        let bytes = postcard::to_stdvec(message).expect("messages serialize");
        self.0.update(&bytes);
    }

    /// The digest.
    pub fn finish(self) -> u64 {
        self.0.finalize()
    }
}
