//! The chips on the bench's bus.

use super::wire::chip;

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
    /// [`PERIOD_BYTES`](super::wire::PERIOD_BYTES).
    Period,
    /// The line that switches both bridges off until the next period. Nothing is transferred.
    MotorsOff,
}

impl Chip {
    /// The chip of this number on the emulator's bus.
    pub fn numbered(number: u8) -> Option<Self> {
        match number {
            chip::IMU => Some(Self::Imu),
            chip::PERIOD => Some(Self::Period),
            chip::MOTORS_OFF => Some(Self::MotorsOff),
            _ => None,
        }
    }
}

/// Spoils the bytes of a transfer, after the chip has answered, or those of a message of the IMU.
pub type Damage = Box<dyn FnMut(Chip, &mut [u8])>;
