//! What the firmware wants of a board: one trait, fulfilled in one file for each board.

use crate::Scalar;
use embedded_hal::spi::SpiDevice;
use rins_selfcal::acquisition::queue::SampleConsumer;
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::control::{Control, MotorBridge};
use rins_selfcal::keep::medium::Medium;
use rins_selfcal::keep::store::CalibrationStore;
use rins_selfcal::link::Link;

/// The board that this image is built for.
#[cfg(any(feature = "mps2-an500", feature = "mps2-an386"))]
pub use crate::mps2::Mps2 as ThisBoard;
#[cfg(feature = "stm32h743")]
pub use crate::stm32h743::Stm32h743 as ThisBoard;

/// What every board has for the main loop.
pub struct Parts<M> {
    /// Samples of the IMU's interrupt.
    pub samples: SampleConsumer<'static, Scalar>,
    /// Calibration records.
    pub store: CalibrationStore<M>,
    /// Why the software has started.
    pub restart: Restart,
}

/// A board, as the main loop has it.
pub trait Board: Sized {
    /// Memory that keeps calibrations while the power is off.
    type Memory: Medium;

    /// Bus of an encoder.
    type Spi: SpiDevice;

    /// Bridge of a motor.
    type Bridge: MotorBridge;

    /// How old the last report of (sampling, control, main loop) may become, us.
    const DEADLINES_US: [Option<u32>; 3];

    /// Sets the board up. Called once.
    fn start() -> Self;

    /// Lets the interrupts of control and IMU begin. Called once.
    fn begin(&mut self, gimbal: Gimbal<Scalar>);

    /// Does something with what the control interrupt has, in a critical section; `None` before [`Self::begin`].
    fn with_control<R>(&mut self, act: impl FnOnce(&mut Control<Scalar, Self::Spi, Self::Bridge>) -> R) -> Option<R>;

    /// Samples, store and the reason of the start.
    fn parts(&mut self) -> &mut Parts<Self::Memory>;

    /// Gives a frame of a message to whoever has this board on a bench.
    fn show(&mut self, _frame: &[u8]) {}

    /// Sends what the link has over the serial line, as far as there is room now. What comes in is in the inbox.
    fn transmit(&mut self, link: &mut Link);

    /// The configuration, as postcard; `None` if there is none, or more than fits in `buffer`.
    fn configuration<'a>(&mut self, buffer: &'a mut [u8]) -> Option<&'a [u8]>;

    /// Time since power-up, us.
    fn now_us(&self) -> u64;

    /// Whether the instrument is switched on. Once off, it stays off, and no more samples come.
    fn powered(&self) -> bool;

    /// Sleeps until there is something to do, a tenth of a second at most.
    fn wait(&mut self);

    /// Reports on the run and switches off.
    fn finish(self, status: Result<(), ()>) -> !;

    /// A clock that runs freely and wraps; readable from everywhere.
    fn ticks() -> u32;

    /// Starts the watchdog: unless it is fed at least once a second it resets.
    fn start_watchdog();

    /// Feeds the watchdog.
    fn feed_watchdog();

    /// Switches the motors off, records why, and resets. Called from everywhere, faults included.
    fn stop(stop: &FatalError) -> !;
}
