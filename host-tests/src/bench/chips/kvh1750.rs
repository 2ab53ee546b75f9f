//! A KVH 1750 or 1775 that sends a message of format A at each request, with rates in rad/s and temperature in deg C.

use super::bits::{bits_of, crc};

/// Baud rate.
const BAUD: u64 = 921_600;
/// Time from a request to the first bit, us. The data sheet gives 30 to 100 us.
const LATENCY_US: u64 = 65;

/// The unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Kvh1750Chip {
    sequence: u8,
    /// Sensors whose values are not valid, as bits of the status.
    pub invalid: u8,
}

impl Kvh1750Chip {
    /// Restarts the unit, as if its supply had failed for a moment. It keeps its settings.
    pub fn restart(&mut self) {
        self.sequence = 0;
    }

    /// The message of a sample: rates, rad/s, forces, m/s^2, temperature, deg C.
    pub fn message(&mut self, omega: [f64; 3], force: [f64; 3], temperature_c: f64) -> Vec<u8> {
        let invalid = self.invalid | not_numbers(omega) | not_numbers(force) << 4;
        let numbers = omega.into_iter().chain(force.map(|force| force / 9.806_65));
        let mut message = vec![0xfe, 0x81, 0xff, 0x55];
        message.extend(numbers.flat_map(|number| (number as f32).to_be_bytes()));
        message.extend([0x77 & !invalid, self.sequence]);
        message.extend((temperature_c.round() as i16).to_be_bytes());
        // CRC-32/MPEG-2.
        message.extend(crc(32, 0x04c1_1db7, u32::MAX, bits_of(&message)).to_be_bytes());
        self.sequence = (self.sequence + 1) % 128;
        message
    }
}

/// A bit for each value that is not a finite number.
fn not_numbers(numbers: [f64; 3]) -> u8 {
    (0..).zip(numbers).filter(|(_, number)| !number.is_finite()).fold(0, |bits, (bit, _)| bits | 1 << bit)
}

/// Time from a request until a byte of its message, counted from 0, is complete, us. A byte has ten bits on the line.
pub fn arrival_us(byte: usize) -> u64 {
    LATENCY_US + (byte as u64 + 1) * 10_000_000 / BAUD
}
