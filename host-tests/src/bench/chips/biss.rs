//! A BiSS-C encoder: the bits on its line while a master clocks it.

use super::bits::crc;
use std::f64::consts::TAU;

/// An encoder on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct BissChip {
    /// Bits of its position.
    pub bits: u32,
    /// Angle of the axis at the encoder's zero, rad.
    pub zero_rad: f64,
    /// Whether the encoder counts left-handed about the axis.
    pub reversed: bool,
    /// Clocks that the encoder needs to acquire a position.
    pub acknowledge: u32,
    /// Clocks after a frame until the encoder is ready again.
    pub timeout: u32,
    /// The error bit: the position is not valid.
    pub error: bool,
    /// The warning bit.
    pub warning: bool,
    /// The encoder has no power.
    pub dead: bool,
}

impl BissChip {
    /// A right-handed encoder with its zero at the zero of the axis. At 4 MHz it has a position after 5 us and is ready
    /// again 12.5 us after a frame.
    pub fn new(bits: u32) -> Self {
        Self {
            bits,
            zero_rad: 0.0,
            reversed: false,
            acknowledge: 20,
            timeout: 50,
            error: false,
            warning: false,
            dead: false,
        }
    }

    /// Fills the bytes, at most 16, with the line's bits while they are clocked, with the axis at this angle, rad.
    pub fn clock(&self, angle_rad: f64, bytes: &mut [u8]) {
        bytes.fill(0xff);
        if !self.dead {
            bytes.iter_mut().zip(self.line(angle_rad).to_be_bytes()).for_each(|(byte, bits)| *byte = bits);
        }
    }

    /// The bits of the line from the highest bit on: idle until the second rising edge, acknowledgement, start, zero,
    /// content, timeout.
    fn line(&self, angle_rad: f64) -> u128 {
        let content = self.content(angle_rad);
        let bits = self.bits + 2;
        let crc = !crc(6, 0x03, 0, (0..bits).rev().map(|bit| content >> bit & 1 == 1)) & 0x3f;
        let fields = [
            (0b11, 2),
            (0, self.acknowledge),
            (0b10, 2),
            (content, bits),
            (crc.into(), 6),
            (0, self.timeout),
            (u64::MAX, u64::BITS),
            (u64::MAX, u64::BITS),
        ];
        let append = |(line, at): (u128, u32), (value, count): (u64, u32)| {
            let top = u128::from(value) << (u128::BITS - count.max(1));
            (line | top.checked_shr(at).unwrap_or(0), at + count)
        };
        fields.into_iter().fold((0, 0), append).0
    }

    /// Position, error and warning. The error and warning bits are active low.
    fn content(&self, angle_rad: f64) -> u64 {
        let turned_rad = if self.reversed { self.zero_rad - angle_rad } else { angle_rad - self.zero_rad };
        let steps = 2_f64.powi(self.bits as i32);
        let position = (turned_rad / TAU * steps).round().rem_euclid(steps) as u64;
        position << 2 | u64::from(!self.error) << 1 | u64::from(!self.warning)
    }
}
