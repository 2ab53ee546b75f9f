//! Drivers of the instrument's devices: IMU, angle encoders and motor drives on SPI.
//!
//! Every access is one full-duplex transfer (mode 0), started by a command byte. Numbers are little-endian, floating-point
//! numbers IEEE 754. Byte 0 of an answer means nothing.
//!
//! ```text
//! IMU, 68 bytes        sent      0      0x01
//!                      received  1      status
//!                                2-9    time stamp, us, u64
//!                                10-13  number of the sample, u32, wraps
//!                                14-37  angular rate x y z, rad/s, f64
//!                                38-61  specific force x y z, m/s^2, f64
//!                                62-65  temperature, deg C, f32
//!                                66-67  CRC-16/IBM-3740 of bytes 1-65
//! encoder, 7 bytes     sent      0      0x01
//!                      received  1      status
//!                                2-5    angle at the IMU's time stamp, 2^-32 turn, u32
//!                                6      CRC-8/SAE-J1850 of bytes 1-5
//! rate drive, 8 bytes  sent      0      0x02
//!                                1-4    rate, right-handed about the axis, nrad/s, i32
//!                                5      CRC-8/SAE-J1850 of bytes 0-4
//!                      received  6      status
//!                                7      CRC-8/SAE-J1850 of byte 6
//! ```
//! The time stamp is the middle of the interval over which rate and force are means, and the encoders latch their angles
//! then; the data-ready edge comes at the end of the interval. The drivers pass stamps and angles on as they are. For an
//! IMU that stamps the edge, take half an interval off here, and let the encoders latch half an interval earlier.
//!
//! A bus that floats, all zeros or all ones, never passes both CRC and status.

use crate::angle::Angle;
use crate::linear::{Real, Vector3, real};
use crc::{CRC_8_SAE_J1850, CRC_16_IBM_3740, Crc, Table};
use embedded_hal::spi::SpiDevice;

/// Command byte that reads a measurement.
pub const COMMAND_READ: u8 = 0x01;
/// Command byte that sets the rate of a drive.
pub const COMMAND_RATE: u8 = 0x02;
/// Status of a device that did what it was told.
pub const STATUS_OK: u8 = 0xA5;
/// Status of a device whose instrument is switched off: there are no data and there will be none.
pub const STATUS_POWERED_OFF: u8 = 0x5A;
/// Status of a drive that refused a command with a wrong CRC; it keeps the rate it had.
pub const STATUS_REFUSED: u8 = 0xC3;

/// Length of the IMU's transfer, bytes.
pub const IMU_FRAME_BYTES: usize = 68;
/// Length of an encoder's transfer, bytes.
pub const ENCODER_FRAME_BYTES: usize = 7;
/// Length of a drive's transfer, bytes.
pub const DRIVE_FRAME_BYTES: usize = 8;

/// CRC of the short frames.
pub const CRC_SHORT: Crc<u8, Table<1>> = Crc::<u8, Table<1>>::new(&CRC_8_SAE_J1850);
/// CRC of the IMU's frame.
pub const CRC_IMU: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_IBM_3740);

// One table of each in memory, not one per use.
static SHORT: Crc<u8, Table<1>> = CRC_SHORT;
static IMU: Crc<u16, Table<16>> = CRC_IMU;

/// What went wrong in one transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceError<E> {
    /// The bus did not carry the transfer.
    Bus(E),
    /// The frame arrived damaged, or nobody answered.
    Crc,
    /// The device says that the instrument is switched off.
    PoweredOff,
    /// The device reports this status in place of a measurement or of the execution of a command.
    Status(u8),
}

/// Result of one transfer on the bus `S`.
pub type DeviceResult<R, S> = Result<R, DeviceError<<S as embedded_hal::spi::ErrorType>::Error>>;

/// One measurement of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuReading<T: Real> {
    /// Middle of the interval over which rate and force are means, us.
    pub time_us: u64,
    /// Number of the sample since the IMU was switched on, wraps.
    pub count: u32,
    /// Gyro outputs on their own axes, rad/s.
    pub omega_g: Vector3<T>,
    /// Accelerometer outputs on their own axes, m/s^2.
    pub force_a: Vector3<T>,
    /// Temperature, deg C; not a number where there is no sensor.
    pub temperature_c: f32,
}

/// The inertial measurement unit.
#[derive(Debug)]
pub struct Imu<S> {
    spi: S,
}

impl<S: SpiDevice> Imu<S> {
    /// The IMU on `spi`.
    pub fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Reads the measurement of the last data-ready edge.
    ///
    /// # Errors
    /// The transfer failed, its CRC is wrong or the status is not [`STATUS_OK`].
    pub fn read<T: Real>(&mut self) -> DeviceResult<ImuReading<T>, S> {
        let mut frame = [0; IMU_FRAME_BYTES];
        frame[0] = COMMAND_READ;
        self.spi.transfer_in_place(&mut frame).map_err(DeviceError::Bus)?;
        if IMU.checksum(&field::<1, 65, _>(&frame)) != u16::from_le_bytes(field::<66, 2, _>(&frame)) {
            return Err(DeviceError::Crc);
        }
        check_status(frame[1])?;
        Ok(ImuReading {
            time_us: u64::from_le_bytes(field::<2, 8, _>(&frame)),
            count: u32::from_le_bytes(field::<10, 4, _>(&frame)),
            omega_g: vector(field::<14, 8, _>(&frame), field::<22, 8, _>(&frame), field::<30, 8, _>(&frame)),
            force_a: vector(field::<38, 8, _>(&frame), field::<46, 8, _>(&frame), field::<54, 8, _>(&frame)),
            temperature_c: f32::from_le_bytes(field::<62, 4, _>(&frame)),
        })
    }
}

/// The angle encoder of one axis.
#[derive(Debug)]
pub struct Encoder<S> {
    spi: S,
}

impl<S: SpiDevice> Encoder<S> {
    /// The encoder on `spi`.
    pub fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Reads the angle at the IMU's last time stamp.
    ///
    /// # Errors
    /// The transfer failed, its CRC is wrong or the status is not [`STATUS_OK`].
    pub fn read(&mut self) -> DeviceResult<Angle, S> {
        let mut frame = [0; ENCODER_FRAME_BYTES];
        frame[0] = COMMAND_READ;
        self.spi.transfer_in_place(&mut frame).map_err(DeviceError::Bus)?;
        if SHORT.checksum(&field::<1, 5, _>(&frame)) != frame[6] {
            return Err(DeviceError::Crc);
        }
        check_status(frame[1])?;
        Ok(Angle::from_ticks(u32::from_le_bytes(field::<2, 4, _>(&frame))))
    }
}

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
        STATUS_POWERED_OFF => Err(DeviceError::PoweredOff),
        other => Err(DeviceError::Status(other)),
    }
}

/// `N` bytes of a frame from `AT` on; a field outside its frame does not compile.
fn field<const AT: usize, const N: usize, const L: usize>(frame: &[u8; L]) -> [u8; N] {
    const { assert!(AT + N <= L) };
    let mut bytes = [0; N];
    bytes.copy_from_slice(&frame[AT..AT + N]);
    bytes
}

fn vector<T: Real>(x: [u8; 8], y: [u8; 8], z: [u8; 8]) -> Vector3<T> {
    Vector3::from([x, y, z].map(|bytes| real(f64::from_le_bytes(bytes))))
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

    fn imu_frame() -> [u8; IMU_FRAME_BYTES] {
        let mut bytes = vec![0, STATUS_OK];
        bytes.extend(123_456_789_012_u64.to_le_bytes());
        bytes.extend(77_u32.to_le_bytes());
        for value in [1e-5_f64, -2.0, 3.0, 0.1, -0.2, 9.8] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(21.5_f32.to_le_bytes());
        let crc = CRC_IMU.checksum(&bytes[1..]);
        bytes.extend(crc.to_le_bytes());
        bytes.try_into().unwrap()
    }

    fn encoder_frame(status: u8, ticks: u32) -> [u8; ENCODER_FRAME_BYTES] {
        let mut frame = [0; ENCODER_FRAME_BYTES];
        frame[1] = status;
        frame[2..6].copy_from_slice(&ticks.to_le_bytes());
        frame[6] = CRC_SHORT.checksum(&frame[1..6]);
        frame
    }

    #[test]
    fn crc_check_values_of_the_catalogue() {
        assert_eq!(CRC_SHORT.checksum(b"123456789"), 0x4b);
        assert_eq!(CRC_IMU.checksum(b"123456789"), 0x29b1);
    }

    #[test]
    fn imu_reading_is_decoded() {
        let reading = Imu::new(chip(imu_frame())).read::<f64>().unwrap();
        assert_eq!((reading.time_us, reading.count, reading.temperature_c), (123_456_789_012, 77, 21.5));
        assert_eq!(reading.omega_g, Vector3::new(1e-5, -2.0, 3.0));
        assert_eq!(reading.force_a, Vector3::new(0.1, -0.2, 9.8));
        let reading = Imu::new(chip(imu_frame())).read::<f32>().unwrap();
        assert_eq!(reading.force_a.z, 9.8_f32);
    }

    #[test]
    fn every_flipped_bit_of_a_measurement_is_found() {
        for bit in 8..8 * IMU_FRAME_BYTES {
            let mut frame = imu_frame();
            frame[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Imu::new(chip(frame)).read::<f64>(), Err(DeviceError::Crc), "bit {bit}");
        }
        for bit in 8..8 * ENCODER_FRAME_BYTES {
            let mut frame = encoder_frame(STATUS_OK, 0x1234_5678);
            frame[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Encoder::new(chip(frame)).read(), Err(DeviceError::Crc), "bit {bit}");
        }
    }

    #[test]
    fn a_floating_bus_is_no_measurement() {
        for level in [0x00, 0xff] {
            assert_eq!(Imu::new(chip([level; IMU_FRAME_BYTES])).read::<f64>(), Err(DeviceError::Crc));
            assert_eq!(Encoder::new(chip([level; ENCODER_FRAME_BYTES])).read(), Err(DeviceError::Crc));
            assert!(RateDrive::new(chip([level; DRIVE_FRAME_BYTES])).command(5).is_err());
        }
    }

    #[test]
    fn statuses_have_names() {
        let read = |status| Encoder::new(chip(encoder_frame(status, 9))).read();
        assert_eq!(read(STATUS_OK), Ok(Angle::from_ticks(9)));
        assert_eq!(read(STATUS_POWERED_OFF), Err(DeviceError::PoweredOff));
        assert_eq!(read(3), Err(DeviceError::Status(3)));
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
