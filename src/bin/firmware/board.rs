//! What the firmware wants of a board: one trait, fulfilled in one file for each board.

use crate::Scalar;
use embedded_hal::spi::SpiDevice;
use rins_selfcal::control::{Control, MotorBridge};
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::queue::SampleConsumer;
use rins_selfcal::store::CalibrationStore;
use rins_selfcal::store::medium::Medium;

/// The board that this image is built for.
#[cfg(any(feature = "mps2-an500", feature = "mps2-an386"))]
pub use crate::mps2::Mps2 as ThisBoard;
#[cfg(feature = "stm32h743")]
pub use crate::stm32h743::Stm32h743 as ThisBoard;

/// A board, as the main loop has it.
pub trait Board: Sized {
    /// Memory that keeps calibrations while the power is off.
    type Memory: Medium;

    /// Bus of an encoder.
    type Spi: SpiDevice;

    /// Bridge of a motor.
    type Bridge: MotorBridge;

    /// Sets the board up. Called once.
    fn start() -> Self;

    /// Lets control and data-ready interrupts begin. Called once.
    fn begin(&mut self, gimbal: Gimbal<Scalar>);

    /// Does something with what the control interrupt has, in a critical section; `None` before [`Self::begin`].
    fn with_control<R>(&mut self, act: impl FnOnce(&mut Control<Scalar, Self::Spi, Self::Bridge>) -> R) -> Option<R>;

    /// Samples of the data-ready interrupt.
    fn samples(&mut self) -> &mut SampleConsumer<'static, Scalar>;

    /// Calibration records.
    fn store(&mut self) -> &mut CalibrationStore<Self::Memory>;

    /// Sends a frame to the host; one that cannot be sent is lost.
    fn send(&mut self, frame: &[u8]);

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

    /// Tells what happened, with some numbers, and ends the program. Called from everywhere, faults included.
    fn stop(what: &str, numbers: &[u32]) -> !;
}
