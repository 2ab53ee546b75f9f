//! Drivers of the instrument's devices over embedded-hal 1.0, each from a public data sheet named in its head.
//!
//! ```text
//! bridge     motor bridge, PWM and direction    duty from -1 to 1         -> pins
//! biss       absolute encoder, BiSS-C           bits clocked in over SPI  -> Angle
//! adis16495  IMU on SPI with data-ready         burst of 20 words         -> ImuReading
//! kvh1750    fibre-optic IMU on RS-422          bytes of a UART           -> ImuReading
//! ```
//! A driver refuses what its device does not vouch for, and says why. Nothing here reads a clock: times are arguments.

pub mod adis16495;
pub mod biss;
pub mod bridge;
pub mod kvh1750;

use crate::linear::{Real, Vector3};

/// One measurement of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuReading<T: Real> {
    /// Middle of the interval over which rate and force are means, us.
    pub time_us: u64,
    /// Samples between the last reading and this one that nobody was told of, by the IMU's own count.
    pub missed: u32,
    /// Gyro outputs on their own axes, rad/s.
    pub omega_g: Vector3<T>,
    /// Accelerometer outputs on their own axes, m/s^2.
    pub force_a: Vector3<T>,
    /// Temperature, deg C.
    pub temperature_c: f32,
}

/// Why there is no measurement of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuFault<E> {
    /// The bus did not carry the transfer.
    Bus(E),
    /// What came is not the beginning of an answer.
    NoAnswer,
    /// The answer arrived damaged.
    Crc,
    /// The IMU reports these faults of its own; the bits are in the driver's head.
    Status(u16),
}

/// `N` bytes from `AT` on; a field outside its frame does not compile.
fn field<const AT: usize, const N: usize, const L: usize>(frame: &[u8; L]) -> [u8; N] {
    const { assert!(AT + N <= L) };
    let mut bytes = [0; N];
    bytes.copy_from_slice(&frame[AT..AT + N]);
    bytes
}

/// Follows the sample counter of an IMU that counts modulo `2^bits`.
#[derive(Clone, Copy, Debug)]
struct Counter {
    mask: u32,
    last: Option<u32>,
    /// Samples since then that were lost and told of.
    told: u32,
}

impl Counter {
    const fn new(bits: u32) -> Self {
        Self { mask: (1 << bits) - 1, last: None, told: 0 }
    }

    /// A sample was lost, and its reason told.
    fn lose(&mut self) {
        self.told = self.told.saturating_add(1);
    }

    /// A sample came; how many before it are missing and nobody was told of. A number from the past, by less than half the
    /// range, is an IMU that has restarted: nothing is known to be missing.
    fn take(&mut self, count: u32) -> u32 {
        let ahead = self.last.map_or(0, |last| count.wrapping_sub(last.wrapping_add(1)) & self.mask);
        let missing = if ahead > self.mask / 2 { 0 } else { ahead };
        let missed = missing.saturating_sub(self.told);
        (self.last, self.told) = (Some(count), 0);
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_missing_sample_is_told_once() {
        let mut counter = Counter::new(7);
        assert_eq!(counter.take(126), 0);
        assert_eq!(counter.take(127), 0);
        assert_eq!(counter.take(3), 3, "0, 1 and 2");
        counter.lose();
        counter.lose();
        assert_eq!(counter.take(7), 1, "4, 5 and 6 are missing, two were told of");
        assert_eq!(counter.take(7), 0, "from the past: restarted");
    }
}
