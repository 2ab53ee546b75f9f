//! The chips on the bench's bus.

use super::wire::chip;

/// Numbers on the bus of the machine of the board STM32H743, beside those of the emulator.
const OUTER_ENCODER: u8 = 1;
const INNER_ENCODER: u8 = 2;
/// Not a chip: the word that the IMU sends next. See [`Bench::imu_answer`](super::Bench::imu_answer).
pub const IMU_ANSWER: u8 = 5;

/// A chip on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The IMU, or the receiver of its serial line.
    Imu,
    /// Encoder of the outer axis.
    OuterEncoder,
    /// Encoder of the inner axis.
    InnerEncoder,
    /// Not a chip: a control period, with all data that the emulated control interrupt exchanges in one transfer. See
    /// [`PERIOD_BYTES`](super::wire::PERIOD_BYTES).
    Period,
    /// Not a chip: the line that switches both bridges off until the next period. No bytes are transferred.
    MotorsOff,
}

impl Chip {
    /// The chip of this number on the emulator's bus.
    pub fn numbered(number: u8) -> Option<Self> {
        match number {
            chip::IMU => Some(Self::Imu),
            OUTER_ENCODER => Some(Self::OuterEncoder),
            INNER_ENCODER => Some(Self::InnerEncoder),
            chip::PERIOD => Some(Self::Period),
            chip::MOTORS_OFF => Some(Self::MotorsOff),
            _ => None,
        }
    }
}

/// Damages the bytes of a transfer after the chip has answered, or the bytes of a message of the IMU.
pub type Damage = Box<dyn FnMut(Chip, &mut [u8])>;
