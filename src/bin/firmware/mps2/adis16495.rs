//! The IMU ADIS16495 on SPI, with an interrupt at each data-ready edge.

use super::eeprom::Delay;
use super::pipe_spi::{Chip, PipeBus, PipeSpi};
use super::{EDGE, view};
use crate::Scalar;
use core::sync::atomic::Ordering;
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::drivers::adis16495::{Adis16495, Adis16495Settings};
use rins_selfcal::gimbal::servo::PERIOD_US;

/// The data of the IMU's interrupt.
pub struct Imu(Acquisition<'static, Scalar, PipeSpi>);

impl Imu {
    /// Initializes the IMU; `None` if the IMU does not answer.
    pub fn start(bus: PipeBus, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let imu = Adis16495::start(bus.device(Chip::Imu), &mut Delay, &Adis16495Settings::default()).ok()?;
        Some(Self(Acquisition::new(imu, producer)))
    }

    /// Product and serial number.
    pub fn identity(&self) -> Option<ImuIdentity> {
        Some(self.0.imu().identity())
    }

    /// Reads a sample into the queue. Returns false: the interrupt need not be called again without an edge.
    pub fn on_interrupt(&mut self) -> bool {
        let edge_us = u64::from(EDGE[0].load(Ordering::Relaxed)) * PERIOD_US;
        // The queue counts a lost sample, so the result is not needed.
        let _ = self.0.on_data_ready(edge_us, view);
        false
    }
}
