//! The instrument's devices around a [`Plant`]: an ADIS16495-1, two BiSS-C encoders of 32 bits and two rate drives.
//!
//! The encoders hold the angles at the stamp of the IMU's last sample. The IMU samples as often as the plant does, whatever
//! its decimation has been set to.

use crate::chips::adis16495::{Adis16495Chip, Model, flag};
use crate::chips::biss::BissChip;
use crate::chips::exchange;
use crate::plant::{Plant, Reading};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::device::{COMMAND_RATE, CRC_SHORT, DRIVE_FRAME_BYTES, RateDrive, STATUS_OK, STATUS_REFUSED};
use rins_selfcal::drivers::adis16495::{Adis16495, BURST_BYTES, Settings};
use rins_selfcal::drivers::biss::{BissEncoder, Mounting, Resolution};
use rins_selfcal::linear::Real;
use rins_selfcal::queue::SampleProducer;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// One chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The IMU.
    Imu,
    /// Encoder of the outer axis.
    OuterEncoder,
    /// Encoder of the inner axis.
    InnerEncoder,
    /// Drive of the outer axis.
    OuterDrive,
    /// Drive of the inner axis.
    InnerDrive,
    /// The data-ready line of the IMU: high at the edge, low if the instrument is switched off and none will come.
    DataReady,
}

impl Chip {
    /// The chips in the order of their numbers on the emulator's bus.
    pub const ALL: [Self; 6] =
        [Self::Imu, Self::OuterEncoder, Self::InnerEncoder, Self::OuterDrive, Self::InnerDrive, Self::DataReady];
}

/// Spoils the bytes of a transfer, after the chip has answered.
pub type Damage = Box<dyn FnMut(Chip, &mut [u8])>;

/// The chips and the plant they measure and drive.
pub struct Bench<P> {
    plant: P,
    reading: Option<Reading>,
    samples: u32,
    imu: Adis16495Chip,
    encoder: BissChip,
    rates_nrad_s: [i32; 2],
    damage: Option<Damage>,
}

impl<P: Plant> Bench<P> {
    /// The bench around `plant`; the axes are at rest.
    pub fn new(plant: P) -> Self {
        Self {
            plant,
            reading: None,
            samples: 0,
            imu: Adis16495Chip::new(Model::ADIS16495_1),
            encoder: BissChip::new(32),
            rates_nrad_s: [0; 2],
            damage: None,
        }
    }

    /// Lets `damage` spoil all measurements and commands from here on; setting up the IMU is left alone.
    pub fn damage(&mut self, damage: impl FnMut(Chip, &mut [u8]) + 'static) {
        self.damage = Some(Box::new(damage));
    }

    /// Samples the IMU has given.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The plant.
    pub fn plant(&self) -> &P {
        &self.plant
    }

    /// Gives the plant back.
    pub fn into_plant(self) -> P {
        self.plant
    }

    /// The next data-ready edge, if the instrument is still switched on: its time, us.
    pub fn next_edge(&mut self) -> Option<u64> {
        self.reading = self.plant.next_reading();
        let reading = self.reading.as_ref()?;
        if !reading.omega_g.iter().chain(&reading.force_a).all(|number| number.is_finite()) {
            self.imu.raise(flag::SENSOR);
        }
        self.imu.sample(reading.omega_g, reading.force_a, reading.temperature_c.into());
        self.samples = self.samples.wrapping_add(1);
        Some(reading.time_us + Settings::default().lag_us())
    }

    /// One transfer: `frame` holds what the master sends, and after it what the chip does.
    pub fn transfer(&mut self, chip: Chip, frame: &mut [u8]) {
        let is_spared = chip == Chip::DataReady || chip == Chip::Imu && frame.len() != BURST_BYTES;
        let angle_rad = |of: fn(&Reading) -> f64| self.reading.as_ref().map_or(0.0, of);
        match chip {
            Chip::Imu => self.imu.transfer(frame),
            Chip::OuterEncoder => self.encoder.clock(angle_rad(|reading| reading.outer_rad), frame),
            Chip::InnerEncoder => self.encoder.clock(angle_rad(|reading| reading.inner_rad), frame),
            Chip::OuterDrive => self.command(0, frame),
            Chip::InnerDrive => self.command(1, frame),
            Chip::DataReady => frame.fill(self.next_edge().is_some().into()),
        }
        if let Some(damage) = self.damage.as_mut().filter(|_| !is_spared) {
            damage(chip, frame);
        }
    }

    fn command(&mut self, axis: usize, frame: &mut [u8]) {
        let Ok(frame) = <&mut [u8; DRIVE_FRAME_BYTES]>::try_from(&mut *frame) else { return frame.fill(0xff) };
        if frame[0] != COMMAND_RATE {
            return frame.fill(0xff);
        }
        let accepted = CRC_SHORT.checksum(&frame[..5]) == frame[5];
        if accepted {
            self.rates_nrad_s[axis] = i32::from_le_bytes([frame[1], frame[2], frame[3], frame[4]]);
            self.plant.command_rates(self.rates_nrad_s.map(|rate| f64::from(rate) * 1e-9));
        }
        frame.fill(0);
        frame[6] = if accepted { STATUS_OK } else { STATUS_REFUSED };
        frame[7] = CRC_SHORT.checksum(&frame[6..7]);
    }
}

/// A bench that several drivers share.
pub type SharedBench<P> = Rc<RefCell<Bench<P>>>;

/// One chip of a shared bench as a driver sees it.
pub struct BenchSpi<P> {
    bench: SharedBench<P>,
    chip: Chip,
}

impl<P: Plant> BenchSpi<P> {
    /// The bus to `chip`.
    pub fn new(bench: &SharedBench<P>, chip: Chip) -> Self {
        Self { bench: Rc::clone(bench), chip }
    }
}

impl<P> ErrorType for BenchSpi<P> {
    type Error = Infallible;
}

impl<P: Plant> SpiDevice for BenchSpi<P> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        exchange(operations, |bytes| self.bench.borrow_mut().transfer(self.chip, bytes));
        Ok(())
    }
}

/// Nothing on the bench takes time.
struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _ns: u32) {}
}

/// The acquisition of a bench: what the data-ready interrupt runs on the board.
pub type BenchAcquisition<'q, T, P> = Acquisition<'q, T, BenchSpi<P>, BenchSpi<P>, BenchSpi<P>>;

/// The drivers of a bench, put together as on the board: what the interrupt has, and the drives (outer, inner).
///
/// # Panics
/// The IMU does not start.
pub fn drivers<'q, T: Real, P: Plant>(
    bench: &SharedBench<P>,
    producer: SampleProducer<'q, T>,
) -> (BenchAcquisition<'q, T, P>, [RateDrive<BenchSpi<P>>; 2]) {
    let spi = |chip| BenchSpi::new(bench, chip);
    let imu = Adis16495::start(spi(Chip::Imu), &mut NoDelay, &Settings::default()).expect("a sound IMU");
    let encoder = |chip| BissEncoder::new(spi(chip), Resolution::Bits32, Mounting::STRAIGHT);
    let (outer, inner) = (encoder(Chip::OuterEncoder), encoder(Chip::InnerEncoder));
    let drives = [Chip::OuterDrive, Chip::InnerDrive].map(|chip| RateDrive::new(spi(chip)));
    (Acquisition::new(imu, outer, inner, producer), drives)
}

/// A plant that stands still for a number of samples at 200 Hz: level, on an Earth that does not turn.
#[derive(Clone, Debug)]
pub struct AtRest {
    edges: std::ops::Range<u32>,
    /// Rates commanded last, (outer, inner), rad/s.
    pub rates_rad_s: [f64; 2],
}

impl AtRest {
    /// Stands still for `samples`.
    pub fn new(samples: u32) -> Self {
        Self { edges: 0..samples, rates_rad_s: [f64::NAN; 2] }
    }
}

impl Plant for AtRest {
    fn next_reading(&mut self) -> Option<Reading> {
        let edge = self.edges.next()?;
        Some(Reading {
            time_us: u64::from(edge) * 5000,
            omega_g: [0.0; 3],
            force_a: [0.0, 0.0, 9.8],
            outer_rad: 0.0,
            inner_rad: 0.0,
            temperature_c: 20.0,
        })
    }

    fn command_rates(&mut self, rates_rad_s: [f64; 2]) {
        self.rates_rad_s = rates_rad_s;
    }
}
