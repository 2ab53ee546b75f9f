//! Power-up of an instrument on the bench, in this process or as the firmware image in the emulator. Both run the same
//! drivers, the same queue and the same [`Instrument`], and send the same messages.

use super::devices::{Bench, BenchControl, BenchImu, SharedBench, control};
use super::emulator::image::Image;
use super::emulator::{MachineSetup, Run, run};
use super::line::{Line, Unconnected};
use crate::calibration::refusal::refused;

use crate::virtual_unit::plant::{Output, Plant, Tick};
use anyhow::{Context, Result, anyhow};
use rins_selfcal::acquisition::queue::{SampleConsumer, SampleProducer, SampleQueue, SampleWithGimbal};
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::linear::Real;
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::sample::{CorrectedSample, RawSample, SampleStatus};
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::travel::LocateError;
use rins_selfcal::gimbal::{Gimbal, GimbalStatus, MotionCommand};
use rins_selfcal::instrument::{
    Archive, Axes, CorrectedSink, Events, FoundConfiguration, FoundRecord, Instrument, Recording, SerialLine, Startup,
    Surroundings, Telemetry,
};
use rins_selfcal::keep::black_box::{Entry, Event};
use rins_selfcal::keep::mark::Mark;
use rins_selfcal::keep::store::{Piece, Wanted};
use rins_selfcal::link::{Link, Refusal};
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::calibrator::Calibrator;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::run::unit::UnitConfiguration;
use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

/// Depth of the queue. In this process every sample is taken immediately.
const QUEUE: usize = 4;

/// Runs an instrument until its plant is exhausted. `stored` is the stored calibration at power-up. Returns the
/// calibration that the run stored.
///
/// # Errors
/// The configuration is refused.
pub fn in_process<T: Real, P: Plant>(
    assignment: &Assignment,
    stored: Option<&StoredCalibration>,
    bench: &SharedBench<P>,
    mut listener: impl Listener<T>,
) -> Result<Option<StoredCalibration>> {
    // Where a virtual unit stands at first is known.
    let mark = Some(Mark::AtRest { angles_rad: [0.0; 2] });
    let mut memory = Memory { stored: stored.cloned(), mark, ..Memory::default() };
    match assignment {
        Assignment::SelfCalibrate(config) => {
            self_calibrate::<T, P>(config, &mut memory, bench, &mut Unconnected, &mut listener)?;
            Ok(memory.stored.filter(|_| memory.saved))
        }
        Assignment::Replay(config) => {
            replay::<T, P>(config, &mut memory, bench, &mut listener)
                .map_err(|error| anyhow!("the configuration is refused: {error}"))?;
            Ok(None)
        }
    }
}

/// Receives the output of an instrument.
pub trait Listener<T: Real> {
    /// Takes a message.
    fn message(&mut self, message: &Message);

    /// Takes a raw sample of the IMU from the queue.
    fn raw(&mut self, _sample: &RawSample<T>) {}

    /// Takes a corrected sample.
    fn corrected(&mut self, _sample: &CorrectedSample<T>, _angles: [Angle; 2], _status: SampleStatus) {}
}

impl<T: Real, F: FnMut(&Message)> Listener<T> for F {
    fn message(&mut self, message: &Message) {
        self(message);
    }
}

/// The memory of an instrument in this process.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// The stored calibration.
    pub stored: Option<StoredCalibration>,
    /// Whether the run has stored a calibration.
    pub saved: bool,
    /// All results, rejected ones included, oldest first.
    pub history: Vec<StoredCalibration>,
    /// All events, oldest first.
    pub events: Vec<Entry>,
    /// The configuration of the unit.
    pub configuration: Option<UnitConfiguration>,
    /// The last mark of motion.
    pub mark: Option<Mark>,
    /// Number of pieces of the present record that have been read.
    pub pieces: u8,
}

/// Number of pieces in which [`Memory`] is read: a record has as many in an EEPROM.
pub const PIECES: u8 = 20;

impl Archive for Memory {
    fn power_up(&mut self) -> FoundRecord {
        FoundRecord { record: self.stored.clone(), writable: true, ..FoundRecord::default() }
    }

    fn save(&mut self, record: &StoredCalibration) -> bool {
        self.history.push(record.clone());
        if record.verdict.accepted() {
            self.stored = Some(record.clone());
            self.saved = true;
        }
        true
    }

    fn read_piece(&mut self, wanted: Wanted) -> Result<Piece, Refusal> {
        self.pieces += 1;
        if self.pieces < PIECES {
            return Ok(Piece::More);
        }
        self.pieces = 0;
        let found = match wanted {
            Wanted::Newest => self.stored.clone(),
            Wanted::Entry { back } => self.history.iter().rev().nth(back.into()).cloned(),
        };
        Ok(found.map_or(Piece::Nothing, Piece::Whole))
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        (self.stored, self.history) = (None, Vec::new());
        Ok(())
    }

    fn configuration(&mut self) -> FoundConfiguration {
        FoundConfiguration { configuration: self.configuration.clone(), ..FoundConfiguration::default() }
    }

    fn configure(&mut self, configuration: &UnitConfiguration) -> Result<(), Refusal> {
        self.configuration = Some(configuration.clone());
        Ok(())
    }

    fn erase_configuration(&mut self) -> Result<(), Refusal> {
        self.configuration = None;
        Ok(())
    }

    fn mark(&mut self, mark: Mark) -> bool {
        self.mark = Some(mark);
        true
    }

    fn last_mark(&mut self) -> Option<Mark> {
        self.mark
    }
}

/// As [`in_process`], with a serial line for commands and messages. `memory` is the memory that the instrument keeps
/// from one power-up to the next.
///
/// # Errors
/// The configuration is refused.
pub fn self_calibrate<T: Real, P: Plant>(
    config: &SelfCalibrationConfig,
    memory: &mut Memory,
    bench: &SharedBench<P>,
    line: &mut impl Line,
    listener: &mut impl Listener<T>,
) -> Result<()> {
    start::<T, P>(&mut Startup::assigned(config.clone(), Restart::PowerOn), memory, bench, line, listener)
}

/// As [`self_calibrate`], from any start of the software.
///
/// # Errors
/// The configuration is refused.
pub fn start<T: Real, P: Plant>(
    startup: &mut Startup,
    memory: &mut Memory,
    bench: &SharedBench<P>,
    line: &mut impl Line,
    listener: &mut impl Listener<T>,
) -> Result<()> {
    let config = startup.config().clone();
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let gimbal = Gimbal::new(&config.axes, &config.motors);
    let mut board = VirtualBoard::new(bench, config.calibrator.rate_hz, gimbal, &mut queue, (memory, line, listener));
    let mut link = Link::new();
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS>::UNCONFIGURED);
    let refused = |error| refused(error, &config.scheme, &config.axes);
    let mut instrument = Instrument::power_up(startup, &mut link, &mut calibrator, &mut board).map_err(refused)?;
    while board.period() {
        instrument.turn(&mut board);
    }
    instrument.power_off(&mut board);
    Ok(())
}

fn replay<T: Real, P: Plant>(
    config: &CalibratorConfig,
    memory: &mut Memory,
    bench: &SharedBench<P>,
    listener: &mut impl Listener<T>,
) -> Result<(), ConfigError> {
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let gimbal = Gimbal::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
    let ends = (memory, &mut Unconnected, listener);
    let mut board = VirtualBoard::new(bench, config.rate_hz, gimbal, &mut queue, ends);
    let mut link = Link::new();
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS>::UNCONFIGURED);
    let mut recording = Recording::new(config, &mut link, &mut calibrator);
    while board.period() {
        recording.turn(&mut board);
    }
    recording.conclude(&mut board);
    Ok(())
}

/// A board on the bench, in this process.
struct VirtualBoard<'a, T: Real, P, L, N> {
    bench: &'a SharedBench<P>,
    interrupts: Interrupts<'a, T, P>,
    samples: SampleConsumer<'a, T>,
    memory: &'a mut Memory,
    line: &'a mut L,
    listener: &'a mut N,
}

impl<'a, T: Real, P: Plant, L, N> VirtualBoard<'a, T, P, L, N> {
    fn new(
        bench: &'a SharedBench<P>,
        rate_hz: f64,
        gimbal: Gimbal<T>,
        queue: &'a mut SampleQueue<T, QUEUE>,
        (memory, line, listener): (&'a mut Memory, &'a mut L, &'a mut N),
    ) -> Self {
        let (producer, samples) = queue.split();
        Self { bench, interrupts: Interrupts::new(bench, rate_hz, gimbal, producer), samples, memory, line, listener }
    }

    /// Advances by a control period. Returns whether the instrument is still switched on.
    fn period(&mut self) -> bool {
        self.interrupts.period(self.bench)
    }
}

impl<T: Real, P: Plant, L: Line, N: Listener<T>> Surroundings<T> for VirtualBoard<'_, T, P, L, N> {
    fn now_us(&self) -> u64 {
        self.bench.borrow().now_us()
    }

    fn next_sample(&mut self) -> Option<SampleWithGimbal<T>> {
        let next = self.samples.pop()?;
        self.listener.raw(&next.sample);
        Some(next)
    }

    fn losses(&mut self) -> LossCounts {
        self.samples.losses()
    }

    fn imu(&mut self) -> Option<ImuIdentity> {
        self.interrupts.imu.identity()
    }

    fn archive(&mut self) -> &mut impl Archive {
        self.memory
    }
}

impl<T: Real, P: Plant, L, N> Axes for VirtualBoard<'_, T, P, L, N> {
    fn status(&mut self) -> GimbalStatus {
        self.interrupts.control.status()
    }

    fn command(&mut self, motion: MotionCommand, seen_us: u64) {
        self.interrupts.control.command(motion, seen_us);
    }

    fn reconfigure(&mut self, axes: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        self.interrupts.control.reconfigure(axes, motors);
    }

    fn angles_rad(&mut self) -> [Option<f64>; 2] {
        self.interrupts.control.angles_rad()
    }

    fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
        self.interrupts.control.locate(angles_rad, tolerance_rad)
    }
}

impl<T: Real, P, L, N: Listener<T>> CorrectedSink<T> for VirtualBoard<'_, T, P, L, N> {
    fn take(&mut self, sample: &CorrectedSample<T>, angles: [Angle; 2], status: SampleStatus) {
        self.listener.corrected(sample, angles, status);
    }
}

impl<T: Real, P: Plant, L, N> Events for VirtualBoard<'_, T, P, L, N> {
    fn record(&mut self, event: Event) {
        let (sequence, time_us) = (self.memory.events.len() as u32, self.bench.borrow().now_us());
        self.memory.events.push(Entry { sequence, time_us, event, repeats: 0 });
    }

    fn event(&mut self, back: u16) -> Option<Entry> {
        self.memory.events.iter().rev().nth(back.into()).cloned()
    }
}

impl<T: Real, P, L, N: Listener<T>> Telemetry for VirtualBoard<'_, T, P, L, N> {
    fn tell(&mut self, message: &Message, _frame: Option<&[u8]>) {
        self.listener.message(message);
    }
}

impl<T: Real, P, L: Line, N> SerialLine for VirtualBoard<'_, T, P, L, N> {
    fn receive(&mut self) -> Option<u8> {
        self.line.receive()
    }

    fn transmit(&mut self, link: &mut Link) {
        self.line.transmit(&mut || link.transmit());
    }
}

/// The data of a board's interrupts.
pub struct Interrupts<'q, T: Real, P> {
    imu: BenchImu<'q, T, P>,
    /// The data of the control interrupt, which the main loop reads too.
    pub control: BenchControl<T, P>,
}

impl<'q, T: Real, P: Plant> Interrupts<'q, T, P> {
    /// The interrupts of a bench whose plant samples `rate_hz` times a second.
    pub fn new(bench: &SharedBench<P>, rate_hz: f64, gimbal: Gimbal<T>, producer: SampleProducer<'q, T>) -> Self {
        Self { imu: BenchImu::new(bench, rate_hz, producer), control: control(bench, gimbal) }
    }

    /// Advances by a control period. Returns whether the instrument is still switched on.
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

/// Runs an instrument as the firmware `image` in the emulator. `eeprom` is the file of its store, which is kept from
/// boot to boot.
///
/// # Errors
/// The emulator is missing or the firmware failed. The error is one line.
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
    let setup = MachineSetup { eeprom, configuration, ..MachineSetup::new(image) };
    run(&setup, bench, on_log, on_message)
}

/// A plant with a power switch. When it is off, the plant does not advance.
pub struct Switched<P> {
    plant: P,
    off: Rc<Cell<bool>>,
}

impl<P> Switched<P> {
    /// The plant, switched on, and its power switch.
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

/// Digest of all messages of a run. Two runs with the same digest agree in every bit of every result.
#[derive(Clone)]
pub struct MessageDigest(crc::Digest<'static, u64, crc::Table<16>>);

static CRC_64: crc::Crc<u64, crc::Table<16>> = crc::Crc::<u64, crc::Table<16>>::new(&crc::CRC_64_XZ);

impl Default for MessageDigest {
    fn default() -> Self {
        Self(CRC_64.digest())
    }
}

impl MessageDigest {
    /// Adds a message to the digest.
    pub fn add(&mut self, message: &Message) {
        let bytes = postcard::to_stdvec(message).expect("messages serialize");
        self.0.update(&bytes);
    }

    /// The digest.
    pub fn finish(self) -> u64 {
        self.0.finalize()
    }
}
