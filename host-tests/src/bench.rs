//! The chips of the instrument's devices, over a [`Plant`]: the other side of `rins_selfcal::device`.
//!
//! The frames are written from the tables of that module's head, not with its code. A chip that is asked something it does
//! not know leaves the line high.

use crate::plant::{Plant, Reading};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::angle::Angle;
use rins_selfcal::device::{
    COMMAND_RATE, COMMAND_READ, CRC_IMU, CRC_SHORT, DRIVE_FRAME_BYTES, ENCODER_FRAME_BYTES, Encoder, IMU_FRAME_BYTES,
    Imu, RateDrive, STATUS_OK, STATUS_POWERED_OFF, STATUS_REFUSED,
};
use rins_selfcal::linear::Real;
use rins_selfcal::queue::SampleProducer;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// One chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The IMU: reading it is the next data-ready edge.
    Imu,
    /// Encoder of the outer axis.
    OuterEncoder,
    /// Encoder of the inner axis.
    InnerEncoder,
    /// Drive of the outer axis.
    OuterDrive,
    /// Drive of the inner axis.
    InnerDrive,
}

impl Chip {
    /// The chips in the order of their numbers on the emulator's bus.
    pub const ALL: [Self; 5] = [Self::Imu, Self::OuterEncoder, Self::InnerEncoder, Self::OuterDrive, Self::InnerDrive];
}

/// Spoils the frame of a transfer, after the chip has answered.
pub type Damage = Box<dyn FnMut(Chip, &mut [u8])>;

/// The chips and the plant they measure and drive.
pub struct Bench<P> {
    plant: P,
    reading: Option<Reading>,
    samples: u32,
    rates_nrad_s: [i32; 2],
    damage: Option<Damage>,
}

impl<P: Plant> Bench<P> {
    /// The bench around `plant`; the axes are at rest.
    pub fn new(plant: P) -> Self {
        Self { plant, reading: None, samples: 0, rates_nrad_s: [0; 2], damage: None }
    }

    /// Lets `damage` spoil the frames of all transfers from here on.
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

    /// One transfer: `frame` holds what the master sends, and after it what the chip does.
    pub fn transfer(&mut self, chip: Chip, frame: &mut [u8]) {
        match chip {
            Chip::Imu => self.read_imu(frame),
            Chip::OuterEncoder => read_encoder(self.reading.map(|reading| reading.outer_rad), frame),
            Chip::InnerEncoder => read_encoder(self.reading.map(|reading| reading.inner_rad), frame),
            Chip::OuterDrive => self.command(0, frame),
            Chip::InnerDrive => self.command(1, frame),
        }
        if let Some(damage) = &mut self.damage {
            damage(chip, frame);
        }
    }

    fn read_imu(&mut self, frame: &mut [u8]) {
        let Ok(frame) = <&mut [u8; IMU_FRAME_BYTES]>::try_from(&mut *frame) else { return frame.fill(0xff) };
        if frame[0] != COMMAND_READ {
            return frame.fill(0xff);
        }
        self.reading = self.plant.next_reading();
        frame.fill(0);
        frame[1] = STATUS_POWERED_OFF;
        if let Some(reading) = &self.reading {
            frame[1] = STATUS_OK;
            frame[2..10].copy_from_slice(&reading.time_us.to_le_bytes());
            frame[10..14].copy_from_slice(&self.samples.to_le_bytes());
            let numbers = reading.omega_g.iter().chain(&reading.force_a);
            for (bytes, number) in frame[14..62].chunks_exact_mut(8).zip(numbers) {
                bytes.copy_from_slice(&number.to_le_bytes());
            }
            frame[62..66].copy_from_slice(&reading.temperature_c.to_le_bytes());
            self.samples = self.samples.wrapping_add(1);
        }
        let crc = CRC_IMU.checksum(&frame[1..66]);
        frame[66..].copy_from_slice(&crc.to_le_bytes());
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

fn read_encoder(angle_rad: Option<f64>, frame: &mut [u8]) {
    let Ok(frame) = <&mut [u8; ENCODER_FRAME_BYTES]>::try_from(&mut *frame) else { return frame.fill(0xff) };
    if frame[0] != COMMAND_READ {
        return frame.fill(0xff);
    }
    frame.fill(0);
    frame[1] = if angle_rad.is_some() { STATUS_OK } else { STATUS_POWERED_OFF };
    frame[2..6].copy_from_slice(&Angle::from_rad(angle_rad.unwrap_or(0.0)).ticks().to_le_bytes());
    frame[6] = CRC_SHORT.checksum(&frame[1..6]);
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
        match operations {
            [Operation::TransferInPlace(frame)] => self.bench.borrow_mut().transfer(self.chip, frame),
            _ => unreachable!("the drivers use one transfer in place"),
        }
        Ok(())
    }
}

/// The acquisition of a bench: what the data-ready interrupt runs on the board.
pub type BenchAcquisition<'q, T, P> = Acquisition<'q, T, BenchSpi<P>, BenchSpi<P>, BenchSpi<P>>;

/// The drivers of a bench, put together as on the board: what the interrupt has, and the drives (outer, inner).
pub fn drivers<'q, T: Real, P: Plant>(
    bench: &SharedBench<P>,
    producer: SampleProducer<'q, T>,
) -> (BenchAcquisition<'q, T, P>, [RateDrive<BenchSpi<P>>; 2]) {
    let spi = |chip| BenchSpi::new(bench, chip);
    let imu = Imu::new(spi(Chip::Imu));
    let (outer, inner) = (Encoder::new(spi(Chip::OuterEncoder)), Encoder::new(spi(Chip::InnerEncoder)));
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
