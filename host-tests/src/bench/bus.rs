//! The chips on the bench's bus, and the transfer of a control period.

use rins_selfcal::drivers::biss::CAPTURE_BYTES;

/// One chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The IMU, or the receiver of its serial line.
    Imu,
    /// Encoder of the outer axis.
    OuterEncoder,
    /// Encoder of the inner axis.
    InnerEncoder,
    /// Not a chip, but a control period with all that the emulated control interrupt exchanges, in one transfer: see
    /// [`PERIOD_BYTES`].
    Period,
    /// The line that switches both bridges off until the next period. Nothing is transferred.
    MotorsOff,
}

/// Length of the transfer of a period. Sent: the pins of the outer and the inner bridge for the period that begins, three
/// bytes each: duty, low byte first, then direction (1) and enable (2). Received: at its end bits of [`input`], and what the
/// outer and the inner encoder say.
pub const PERIOD_BYTES: usize = 1 + 2 * CAPTURE_BYTES;

impl Chip {
    /// The chips in the order of their numbers on the emulator's bus.
    pub const ALL: [Self; 5] = [Self::Imu, Self::OuterEncoder, Self::InnerEncoder, Self::Period, Self::MotorsOff];
}

/// Bits of the inputs.
pub mod input {
    /// The instrument is switched on.
    pub const POWERED: u8 = 1;
    /// The IMU asks for its interrupt: its data-ready line had an edge, or bytes came from it.
    pub const IMU: u8 = 2;
    /// The fault lines of the outer and the inner bridge, high if there is none.
    pub const FAULT: [u8; 2] = [4, 8];
}

/// Spoils the bytes of a transfer, after the chip has answered, or those of a message of the IMU.
pub type Damage = Box<dyn FnMut(Chip, &mut [u8])>;
