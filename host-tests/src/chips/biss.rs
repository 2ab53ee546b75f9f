//! A BiSS-C encoder: what its line carries while a master clocks it.

use super::crc;
use std::f64::consts::TAU;

/// An encoder on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct BissChip {
    /// Bits of its position.
    pub bits: u32,
    /// Angle of the axis at the encoder's zero, rad.
    pub zero_rad: f64,
    /// Whether it counts left-handed about the axis.
    pub reversed: bool,
    /// Clocks that it takes for a position.
    pub acknowledge: u32,
    /// Clocks after a frame until it is ready again.
    pub timeout: u32,
    /// It does not vouch for its position.
    pub error: bool,
    /// It asks for attention.
    pub warning: bool,
    /// It has no power.
    pub dead: bool,
}

impl BissChip {
    /// Right-handed with its zero at the axis'; at 4 MHz ready after 5 us, and again 12.5 us after a frame.
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

    /// The line while the bytes are clocked, with the axis at this angle, rad.
    pub fn clock(&self, angle_rad: f64, bytes: &mut [u8]) {
        bytes.fill(0xff);
        if self.dead {
            return;
        }
        for (at, bit) in self.line(angle_rad).into_iter().take(8 * bytes.len()).enumerate() {
            if !bit {
                bytes[at / 8] &= !(0x80 >> (at % 8));
            }
        }
    }

    /// Idle until the second rising edge, acknowledgement, start, zero, content, timeout.
    fn line(&self, angle_rad: f64) -> Vec<bool> {
        let content = self.content(angle_rad);
        let crc = !crc(6, 0x03, 0, content.iter().copied()) & 0x3f;
        let repeated = |bit: bool, count: u32| std::iter::repeat_n(bit, count as usize);
        repeated(true, 2)
            .chain(repeated(false, self.acknowledge))
            .chain([true, false])
            .chain(content)
            .chain((0..6).rev().map(|bit| crc >> bit & 1 == 1))
            .chain(repeated(false, self.timeout))
            .collect()
    }

    /// Position, high bit first, error and warning, low if there is one.
    fn content(&self, angle_rad: f64) -> Vec<bool> {
        let turned_rad = if self.reversed { self.zero_rad - angle_rad } else { angle_rad - self.zero_rad };
        let steps = 2_f64.powi(self.bits as i32);
        let position = (turned_rad / TAU * steps).round().rem_euclid(steps) as u64;
        let position = (0..self.bits).rev().map(|bit| position >> bit & 1 == 1);
        position.chain([!self.error, !self.warning]).collect()
    }
}
