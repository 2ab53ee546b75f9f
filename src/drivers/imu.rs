//! What every IMU gives: a reading or a fault, the fields of a frame, and the unit's own sample counter.

use crate::base::linear::{Real, Vector3};

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
pub(super) fn field<const AT: usize, const N: usize, const L: usize>(frame: &[u8; L]) -> [u8; N] {
    const { assert!(AT + N <= L) };
    let mut bytes = [0; N];
    bytes.copy_from_slice(&frame[AT..AT + N]);
    bytes
}

/// Follows the sample counter of an IMU that counts modulo `2^bits`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counter {
    mask: u32,
    last: Option<u32>,
    /// Samples since then that were lost and told of.
    told: u32,
}

impl Counter {
    pub(super) const fn new(bits: u32) -> Self {
        Self { mask: (1 << bits) - 1, last: None, told: 0 }
    }

    /// A sample was lost, and its reason told.
    pub(super) fn lose(&mut self) {
        self.told = self.told.saturating_add(1);
    }

    /// A sample came; how many before it are missing and nobody was told of. A number from the past, by less than half the
    /// range, is an IMU that has restarted: nothing is known to be missing.
    pub(super) fn take(&mut self, count: u32) -> u32 {
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
