//! What the firmware needs of a board: one trait, which one file for each board implements.

use crate::Scalar;
use embedded_hal::spi::SpiDevice;
use rins_selfcal::acquisition::queue::SampleConsumer;
use rins_selfcal::base::clock_check::ClockFault;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::site::Site;
#[cfg(feature = "kvh1750")]
use rins_selfcal::base::units::MICRO_G;
use rins_selfcal::base::units::{ARCSEC, DEG_SQRT_H};
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::control::{Control, MotorBridge};
use rins_selfcal::instrument::UnitMemory;
use rins_selfcal::keep::medium::Medium;
use rins_selfcal::link::Link;
use rins_selfcal::model::effects::SiteSigmas;
use rins_selfcal::run::config::{CalibratorConfig, SelfCalibrationConfig};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::scheme::library::compiled_in;
use rins_selfcal::segment::white_noise::Noise;

/// The board that this image is built for.
#[cfg(any(feature = "mps2-an500", feature = "mps2-an386"))]
pub use crate::mps2::Mps2 as ThisBoard;
#[cfg(feature = "stm32h743")]
pub use crate::stm32h743::Stm32h743 as ThisBoard;

/// The configuration of a unit that is not commissioned: the usual one, with the noise of the IMU of this image, at an
/// unknown site.
pub fn configuration() -> SelfCalibrationConfig {
    let noise = Noise { margin: 1.0, encoder_sigma_rad: 0.5 * ARCSEC, ..IMU_NOISE };
    let mut calibrator = CalibratorConfig::new(Method::Joint, Site::default(), noise, 200.0);
    calibrator.estimator.site_sigmas = SiteSigmas::UNKNOWN;
    SelfCalibrationConfig::new(calibrator, compiled_in().unwrap_or_else(|| Scheme::default_for(Method::Joint)))
}

/// Typical noise of the ADIS16495-1, from its data sheet.
#[cfg(not(feature = "kvh1750"))]
const IMU_NOISE: Noise =
    Noise { accel_psd_sqrt: 0.008 / 60.0, gyro_psd_sqrt: 0.09 * DEG_SQRT_H, encoder_sigma_rad: 0.0, margin: 1.0 };
/// Largest noise of the KVH 1750 with accelerometers of 10 g, from its data sheet.
#[cfg(feature = "kvh1750")]
const IMU_NOISE: Noise =
    Noise { accel_psd_sqrt: 120.0 * MICRO_G, gyro_psd_sqrt: 0.012 * DEG_SQRT_H, encoder_sigma_rad: 0.0, margin: 1.0 };

/// The parts of a board that the main loop uses.
pub struct Parts<M> {
    /// The samples from the IMU's interrupt.
    pub samples: SampleConsumer<'static, Scalar>,
    /// Calibrations, configuration and marks of motion.
    pub memory: UnitMemory<M>,
    /// Why the software has started.
    pub restart: Restart,
    /// The IMU that is fitted; `None` if its driver cannot know.
    pub imu: Option<ImuIdentity>,
    /// What is wrong with the clock of the time stamps.
    pub clock: Option<ClockFault>,
}

/// A board, as the main loop uses it.
pub trait Board: Sized {
    /// A part of the memory that keeps its content without power.
    type Memory: Medium;

    /// The SPI bus of an encoder.
    type Spi: SpiDevice;

    /// The bridge of a motor.
    type Bridge: MotorBridge;

    /// Greatest age of the last report of (sampling, control, main loop), us.
    const DEADLINES_US: [Option<u32>; 3];

    /// Longest time of a power-up, us, if the board starts the watchdog itself, before anything else.
    const POWER_UP_US: Option<u64>;

    /// Initializes the board. Called once.
    fn start() -> Self;

    /// Starts the interrupts of control and IMU. Called once.
    fn begin(&mut self, gimbal: Gimbal<Scalar>);

    /// Calls `act` with the data of the control interrupt, in a critical section; `None` before [`Self::begin`].
    fn with_control<R>(&mut self, act: impl FnOnce(&mut Control<Scalar, Self::Spi, Self::Bridge>) -> R) -> Option<R>;

    /// Samples, memory and the reason of the start.
    fn parts(&mut self) -> &mut Parts<Self::Memory>;

    /// Sends the frame of a message to the test bench, if the board is on one.
    fn show(&mut self, _frame: &[u8]) {}

    /// Moves bytes from the link to the serial line, as far as there is room now. Received bytes are in the inbox.
    fn transmit(&mut self, link: &mut Link);

    /// The configuration, encoded by postcard; `None` if there is none or if it does not fit into `buffer`.
    fn configuration<'a>(&mut self, buffer: &'a mut [u8]) -> Option<&'a [u8]>;

    /// Time since power-up, us.
    fn now_us(&self) -> u64;

    /// Whether the instrument is switched on. Once switched off, it stays off and gives no more samples.
    fn powered(&self) -> bool;

    /// Sleeps until there is work, at most a tenth of a second.
    fn wait(&mut self);

    /// Reports on the run, then switches off.
    fn finish(self, status: Result<(), ()>) -> !;

    /// A clock that runs freely and wraps. Any code may read it.
    fn ticks() -> u32;

    /// Starts the watchdog. It resets the board unless it is fed at least once a second.
    fn start_watchdog();

    /// Feeds the watchdog.
    fn feed_watchdog();

    /// Switches the motors off, records the reason, and resets. Any code may call it, including fault handlers.
    fn stop(stop: &FatalError) -> !;
}
