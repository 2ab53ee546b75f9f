//! Power-up of an instrument on the bench: in this process, or as the firmware image in the emulator. Both run the same
//! drivers, queue and assembly, and tell the same messages.

use crate::bench::{Bench, SharedBench, drivers};
use crate::emulator::image::Image;
use crate::emulator::{Run, Setup, run};
use crate::line::{Line, Unconnected};
use crate::plant::{Plant, Reading};
use crate::refusal::refused;
use anyhow::{Context, Result};
use rins_selfcal::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::calibrator::{Calibrator, CalibratorConfig};
use rins_selfcal::device::command_rates;
use rins_selfcal::estimator::MAX_SEGMENTS;
use rins_selfcal::linear::Real;
use rins_selfcal::link::{Archive, Hello, Link, MAX_FRAME_BYTES, Moment, Refusal};
use rins_selfcal::queue::SampleQueue;
use rins_selfcal::rate_axis::RateGimbal;
use rins_selfcal::self_calibration::{SelfCalibration, SelfCalibrationConfig};
use rins_selfcal::store::StoredCalibration;
use rins_selfcal::telemetry::Message;
use rins_selfcal::verdict::VerdictLimits;
use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

/// Depth of the queue: here every sample is taken at once.
const QUEUE: usize = 4;

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
            let mut memory = Memory { stored: stored.cloned(), saved: false };
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
}

impl Archive for Memory {
    fn newest(&mut self) -> Result<Option<StoredCalibration>, Refusal> {
        Ok(self.stored.clone())
    }

    fn erase(&mut self) -> Result<(), Refusal> {
        self.stored = None;
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
    let mut tell = |link: &mut Link, message: &Message| {
        on_message(message);
        link.tell(message, &mut [0; MAX_FRAME_BYTES]);
    };
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let (producer, mut consumer) = queue.split();
    let (mut acquisition, mut drives) = drivers(bench, producer);
    tell(&mut link, &Message::Store { found: memory.stored.is_some(), damaged: false, fault: false });
    let refused = |error| refused(error, &config.scheme, &config.axes);
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS, STATES>::UNCONFIGURED);
    let mut run = SelfCalibration::new(config.clone(), memory.stored.as_ref(), &mut calibrator).map_err(refused)?;
    let mut gimbal = RateGimbal::<T>::new(&config.axes, config.calibrator.rate_hz);
    let mut samples = 0;
    let (mut board_s, interval_s) = (0.0, config.calibrator.rate_hz.recip());
    while let Some(edge_us) = next_edge(bench) {
        // A sample that is lost has been counted.
        let _ = acquisition.on_data_ready(edge_us);
        while let Some(sample) = consumer.pop() {
            samples += 1;
            gimbal.measure(&sample);
            let step = run.step(&sample, &gimbal.status(), &mut |message| tell(&mut link, message));
            step.motion.into_iter().for_each(|motion| gimbal.command(motion));
            let answered = command_rates(&mut drives, gimbal.rates_rad_s());
            gimbal.drives_answered(answered);
            if step.save {
                let record = run.record();
                tell(&mut link, &Message::Saved(record.is_some()));
                memory.saved |= record.is_some();
                memory.stored = record.or(memory.stored.take());
                run.saved();
            }
        }
        // The edges are the clock, whether they gave a sample or not.
        board_s += interval_s;
        let moment = Moment { now_us: (board_s * 1e6) as u64, missing: consumer.losses().total() };
        let motion = run.tick(moment.now_us, &gimbal.status(), &mut |message| tell(&mut link, message));
        motion.into_iter().for_each(|motion| gimbal.command(motion));
        if let Some(rates_rad_s) = gimbal.tick(moment.now_us) {
            command_rates(&mut drives, rates_rad_s);
        }
        let axes = run.config().axes;
        link.serve(std::iter::from_fn(|| line.receive()), moment, &mut run, memory);
        if run.config().axes != axes {
            gimbal = RateGimbal::new(&run.config().axes, config.calibrator.rate_hz);
        }
        link.tell_status(moment, &run);
        line.transmit(&mut || link.transmit());
    }
    tell(&mut link, &Message::Queue { samples, losses: consumer.losses() });
    Ok(())
}

fn replay<T: Real, const STATES: usize, P: Plant>(
    config: &CalibratorConfig,
    bench: &SharedBench<P>,
    on_message: &mut impl FnMut(&Message),
) {
    let mut queue = SampleQueue::<T, QUEUE>::new();
    let (producer, mut consumer) = queue.split();
    let (mut acquisition, _) = drivers(bench, producer);
    let mut calibrator = Box::new(Calibrator::<T, MAX_SEGMENTS, STATES>::new(config));
    let mut samples = 0;
    while let Some(edge_us) = next_edge(bench) {
        // A sample that is lost has been counted.
        let _ = acquisition.on_data_ready(edge_us);
        while let Some(sample) = consumer.pop() {
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

fn next_edge<P: Plant>(bench: &SharedBench<P>) -> Option<u64> {
    bench.borrow_mut().next_edge()
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

/// A plant with a switch: turned off, it gives no more readings.
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
    fn next_reading(&mut self) -> Option<Reading> {
        if self.off.get() { None } else { self.plant.next_reading() }
    }

    fn command_rates(&mut self, rates_rad_s: [f64; 2]) {
        self.plant.command_rates(rates_rad_s);
    }
}

/// A bench that drivers in this process share.
pub fn shared<P: Plant>(plant: P) -> SharedBench<P> {
    Rc::new(RefCell::new(Bench::new(plant)))
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
