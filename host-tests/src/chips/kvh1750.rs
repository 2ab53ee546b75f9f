//! A KVH 1750 or 1775 that sends format A, rates in rad/s and temperature in deg C.

use super::{bits_of, crc};

/// The unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Kvh1750Chip {
    sequence: u8,
    /// Sensors that are not valid, as bits of the status.
    pub invalid: u8,
}

impl Kvh1750Chip {
    /// The message of a sample: rates, rad/s, forces, m/s^2, temperature, deg C.
    pub fn message(&mut self, omega: [f64; 3], force: [f64; 3], temperature_c: f64) -> Vec<u8> {
        let numbers = omega.into_iter().chain(force.map(|force| force / 9.806_65));
        let mut message = vec![0xfe, 0x81, 0xff, 0x55];
        message.extend(numbers.flat_map(|number| (number as f32).to_be_bytes()));
        message.extend([0x77 & !self.invalid, self.sequence]);
        message.extend((temperature_c.round() as i16).to_be_bytes());
        // CRC-32/MPEG-2.
        message.extend(crc(32, 0x04c1_1db7, u32::MAX, bits_of(&message)).to_be_bytes());
        self.sequence = (self.sequence + 1) % 128;
        message
    }
}
