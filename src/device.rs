//! The motor drive of one axis that takes rates: a private protocol on SPI, mode 0.
//!
//! ```text
//! 8 bytes    sent      0      0x02
//!                      1-4    rate, right-handed about the axis, nrad/s, i32, little-endian
//!                      5      CRC-8/SAE-J1850 of bytes 0-4
//!            received  6      status
//!                      7      CRC-8/SAE-J1850 of byte 6
//! ```
//! A bus that floats, all zeros or all ones, never passes both CRC and status.

use crate::linear::Real;
use crc::{CRC_8_SAE_J1850, Crc, Table};
use embedded_hal::spi::SpiDevice;

/// Command byte that sets the rate of a drive.
pub const COMMAND_RATE: u8 = 0x02;
/// Status of a device that did what it was told.
pub const STATUS_OK: u8 = 0xA5;
/// Status of a drive that refused a command with a wrong CRC; it keeps the rate it had.
pub const STATUS_REFUSED: u8 = 0xC3;

/// Length of a drive's transfer, bytes.
pub const DRIVE_FRAME_BYTES: usize = 8;

/// CRC of the frames.
pub const CRC_SHORT: Crc<u8, Table<1>> = Crc::<u8, Table<1>>::new(&CRC_8_SAE_J1850);
// One table in memory, not one per use.
static SHORT: Crc<u8, Table<1>> = CRC_SHORT;

/// What went wrong in one transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceError<E> {
    /// The bus did not carry the transfer.
    Bus(E),
    /// The frame arrived damaged, or nobody answered.
    Crc,
    /// The device reports this status and has not done what it was told.
    Status(u8),
}

/// Result of one transfer on the bus `S`.
pub type DeviceResult<R, S> = Result<R, DeviceError<<S as embedded_hal::spi::ErrorType>::Error>>;

/// The motor drive of one axis, in velocity mode.
#[derive(Debug)]
pub struct RateDrive<S> {
    spi: S,
}

impl<S: SpiDevice> RateDrive<S> {
    /// The drive on `spi`.
    pub fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Commands a rate, right-handed about the axis, nrad/s.
    ///
    /// # Errors
    /// The transfer failed, the CRC of the acknowledgement is wrong or its status is not [`STATUS_OK`]. Unless it was a
    /// status, the drive may have taken the command or not: command again.
    pub fn command(&mut self, rate_nrad_s: i32) -> DeviceResult<(), S> {
        let [r0, r1, r2, r3] = rate_nrad_s.to_le_bytes();
        let sent = [COMMAND_RATE, r0, r1, r2, r3];
        let mut frame = [COMMAND_RATE, r0, r1, r2, r3, SHORT.checksum(&sent), 0, 0];
        self.spi.transfer_in_place(&mut frame).map_err(DeviceError::Bus)?;
        if SHORT.checksum(&[frame[6]]) != frame[7] {
            return Err(DeviceError::Crc);
        }
        check_status(frame[6])
    }
}

/// Commands both drives (outer, inner), rad/s. Returns which of them took the command.
pub fn command_rates<T: Real, S: SpiDevice>(drives: &mut [RateDrive<S>; 2], rates_rad_s: [T; 2]) -> [bool; 2] {
    let [outer, inner] = drives;
    let [outer_rad_s, inner_rad_s] = rates_rad_s.map(rate_nrad_s);
    [outer.command(outer_rad_s).is_ok(), inner.command(inner_rad_s).is_ok()]
}

/// A rate in rad/s as a drive takes it, nrad/s; saturates at 2.147 rad/s, not-a-number gives 0.
pub fn rate_nrad_s<T: Real>(rate_rad_s: T) -> i32 {
    use crate::linear::ComplexField;
    ComplexField::round(rate_rad_s.widened() * 1e9) as i32
}

fn check_status<E>(status: u8) -> Result<(), DeviceError<E>> {
    match status {
        STATUS_OK => Ok(()),
        other => Err(DeviceError::Status(other)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::convert::Infallible;
    use embedded_hal::spi::{ErrorType, Operation};

    /// Answers every transfer with one frame and keeps what was sent.
    struct Chip<const L: usize> {
        answer: [u8; L],
        sent: Vec<u8>,
    }

    impl<const L: usize> ErrorType for Chip<L> {
        type Error = Infallible;
    }

    impl<const L: usize> SpiDevice for Chip<L> {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
            let [Operation::TransferInPlace(frame)] = operations else { panic!("one transfer") };
            self.sent = frame.to_vec();
            frame.copy_from_slice(&self.answer);
            Ok(())
        }
    }

    fn chip<const L: usize>(answer: [u8; L]) -> Chip<L> {
        Chip { answer, sent: Vec::new() }
    }

    #[test]
    fn crc_check_value_of_the_catalogue() {
        assert_eq!(CRC_SHORT.checksum(b"123456789"), 0x4b);
    }

    #[test]
    fn a_floating_bus_acknowledges_nothing() {
        for level in [0x00, 0xff] {
            assert!(RateDrive::new(chip([level; DRIVE_FRAME_BYTES])).command(5).is_err());
        }
    }

    #[test]
    fn a_rate_is_sent_with_its_crc() {
        let answer = |status| [0, 0, 0, 0, 0, 0, status, CRC_SHORT.checksum(&[status])];
        let mut drive = RateDrive::new(chip(answer(STATUS_OK)));
        assert_eq!(drive.command(rate_nrad_s(-0.349_065_850_4)), Ok(()));
        assert_eq!(drive.spi.sent[1..5], (-349_065_850_i32).to_le_bytes());
        assert_eq!(drive.spi.sent[5], CRC_SHORT.checksum(&drive.spi.sent[..5]));
        let mut drive = RateDrive::new(chip(answer(STATUS_REFUSED)));
        assert_eq!(drive.command(1), Err(DeviceError::Status(STATUS_REFUSED)));
    }

    #[test]
    fn rates_saturate() {
        assert_eq!(rate_nrad_s(3.0), i32::MAX);
        assert_eq!(rate_nrad_s(-3.0_f32), i32::MIN);
        assert_eq!(rate_nrad_s(f64::NAN), 0);
    }
}
