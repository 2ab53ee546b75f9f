//! The IMU ADIS16495 on SPI: an interrupt at each data-ready edge.

use super::eeprom::Delay;
use super::pipe_spi::{Chip, PipeBus, PipeSpi};
use super::{EDGE, view};
use crate::Scalar;
use core::sync::atomic::Ordering;
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::drivers::adis16495::{Adis16495, Adis16495Settings};
use rins_selfcal::gimbal::servo::PERIOD_US;

/// What the IMU's interrupt has.
pub struct Imu(Acquisition<'static, Scalar, PipeSpi>);

impl Imu {
    /// Sets the IMU up; `None` if it does not answer.
    pub fn start(bus: PipeBus, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let imu = Adis16495::start(bus.device(Chip::Imu), &mut Delay, &Adis16495Settings::default()).ok()?;
        Some(Self(Acquisition::new(imu, producer)))
    }

    /// Reads a sample into the queue; whether to come again without an edge: never.
    pub fn on_interrupt(&mut self) -> bool {
        let edge_us = u64::from(EDGE[0].load(Ordering::Relaxed)) * PERIOD_US;
        // A sample that is lost has been counted.
        let _ = self.0.on_data_ready(edge_us, view);
        false
    }
}
