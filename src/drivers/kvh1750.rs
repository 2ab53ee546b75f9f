//! Driver for the fibre-optic inertial measurement units KVH 1750 and 1775, message format A on RS-422.
//!
//! Source: KVH Industries, 1775 IMU Technical Manual, Appendix C (Electrical Signaling ICD 56-0298), tables 5-1, 5-2,
//! 5-8 and 5-9. The 1750 sends the same messages.
//!
//! ```text
//! byte  1-4    0xfe81ff55                     29     status
//!       5-16   rotation x y z, f32            30     sequence number, 0 to 127
//!       17-28  acceleration x y z, f32, g     31-32  temperature, i16
//!                                             33-36  CRC-32/MPEG-2 of bytes 1-32
//! ```
//! All numbers have the high byte first. The status has one bit for each sensor, set if the sensor is valid: bits 0 to
//! 2 for the gyros, 4 to 6 for the accelerometers; the other bits are zero. The settings stored in the IMU (`=ROTFMT`,
//! `=ROTUNITS`, `=TEMPUNITS`) decide whether rotation is a rate or an angle increment, in rad or deg. The driver
//! expects the temperature in whole deg C.
//!
//! An output is the mean over its interval only with the filter AVE. Select it for the gyros (`=FILTTYPE,G,AVE`) and
//! for the accelerometers (`=FILTTYPE,A,AVE`). The IMU selects it by itself for outputs on request (`=MSYNC,EXT`).
//! Either request outputs at 200 Hz, or use an output rate of the IMU's own, such as 250 Hz (`=DR,250`). A request is a
//! rising edge on MSYNC (RS-422), which stays high for 30 to 90 us (table 10-1). The message begins 30 to 100 us later
//! (table 11-1 for the signal TOV, which is then MSYNC again).
//!
//! The driver knows no serial number. The unit reports it on request (`?IS`) in its configuration mode only, in which it
//! sends no measurements. The driver does not enter this mode: it only listens, and needs no line to the unit but MSYNC.
//!
//! An f32 near 1 g has steps of 1.2e-7 g, and at 20 deg/s steps of 3e-8 rad/s. At 200 Hz this is less than 1/1000 of
//! the noise with 10 ug/sqrt(Hz), and 1/130 of the noise with 0.001 deg/sqrt(h). The noise dithers the steps.

use super::imu::{Counter, ImuFault, ImuReading, field};
use crate::base::imu_identity::ImuIdentity;
use crate::base::linear::{Real, Vector3, real};
use crate::base::units::{DEG, MICRO_G};
use core::convert::Infallible;
use crc::{CRC_32_MPEG_2, Crc, Table};

/// Length of a message, bytes.
pub const MESSAGE_BYTES: usize = 36;
/// Header of every message.
pub const HEADER: [u8; 4] = [0xfe, 0x81, 0xff, 0x55];
/// Status of a message with six valid sensors.
pub const ALL_VALID: u8 = 0b0111_0111;
const COVERED_BYTES: usize = 32;

static CRC_32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_MPEG_2);

/// Meaning of the rotation numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rotation {
    /// Angular rates, per second.
    Rate,
    /// Angle increments over the interval.
    Increment,
}

/// Settings stored in the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kvh1750Settings {
    /// Output rate, Hz.
    pub rate_hz: f64,
    /// Meaning of the rotation numbers.
    pub rotation: Rotation,
    /// Whether rotation is in degrees; otherwise in radians.
    pub degrees: bool,
    /// Baud rate, from which the driver computes the duration of a message.
    pub baud: u32,
    /// Delay from the end of an interval to the first bit of its message, us.
    pub latency_us: u32,
}

impl Default for Kvh1750Settings {
    /// 200 Hz on request, with the mean of the latencies in the manual; rates in rad/s, 921 600 baud.
    fn default() -> Self {
        Self { rate_hz: 200.0, rotation: Rotation::Rate, degrees: false, baud: 921_600, latency_us: 65 }
    }
}

impl Kvh1750Settings {
    /// Delay from a request, or from the end of an interval, to the last bit of the message, us. A byte takes ten bits.
    pub fn answer_us(&self) -> u64 {
        let message_s = 10.0 * MESSAGE_BYTES as f64 / f64::from(self.baud);
        (message_s * 1e6) as u64 + u64::from(self.latency_us)
    }

    /// Delay from the middle of an interval to the last bit of its message, us.
    fn lag_us(&self) -> u64 {
        (0.5e6 / self.rate_hz) as u64 + self.answer_us()
    }

    /// Scale factor from a rotation number of the message to rad/s.
    fn rotation_rad_s(&self) -> f64 {
        let unit = if self.degrees { DEG } else { 1.0 };
        match self.rotation {
            Rotation::Rate => unit,
            Rotation::Increment => unit * self.rate_hz,
        }
    }
}

/// Counters of discarded data. Each counter saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Discarded {
    /// Bytes outside of valid messages.
    pub bytes: u32,
    /// Messages with a wrong CRC.
    pub messages: u32,
}

/// Driver: finds messages in the bytes of a UART.
#[derive(Debug)]
pub struct Kvh1750 {
    lag_us: u64,
    rotation_rad_s: f64,
    counter: Counter,
    message: [u8; MESSAGE_BYTES],
    length: usize,
    discarded: Discarded,
}

impl Kvh1750 {
    /// A driver for an IMU with these settings; no byte has arrived yet.
    pub fn new(settings: &Kvh1750Settings) -> Self {
        Self {
            lag_us: settings.lag_us(),
            rotation_rad_s: settings.rotation_rad_s(),
            counter: Counter::new(7),
            message: [0; MESSAGE_BYTES],
            length: 0,
            discarded: Discarded::default(),
        }
    }

    /// Always `None`: the unit reports its serial number in its configuration mode only, which this driver does not
    /// enter.
    pub fn identity(&self) -> Option<ImuIdentity> {
        None
    }

    /// Data discarded so far.
    pub fn discarded(&self) -> Discarded {
        self.discarded
    }

    /// Takes one byte, received at `now_us`. The last byte of a message returns its measurement or its fault. After a
    /// wrong CRC the driver searches the bytes of that message for a header, so that no message behind it is lost.
    pub fn push<T: Real>(&mut self, byte: u8, now_us: u64) -> Option<Result<ImuReading<T>, ImuFault<Infallible>>> {
        if let Some(place) = self.message.get_mut(self.length) {
            (*place, self.length) = (byte, self.length + 1);
        }
        self.drop_until_header(0);
        if self.length < MESSAGE_BYTES {
            return None;
        }
        let Some(message) = Kvh1750Message::decode(&self.message) else {
            self.discarded.messages = self.discarded.messages.saturating_add(1);
            self.drop_until_header(1);
            self.counter.count_reported();
            return Some(Err(ImuFault::Crc));
        };
        self.length = 0;
        Some(self.reading(&message, now_us))
    }

    fn reading<T: Real>(
        &mut self,
        message: &Kvh1750Message,
        now_us: u64,
    ) -> Result<ImuReading<T>, ImuFault<Infallible>> {
        let mut numbers = message.rotation.iter().chain(&message.acceleration);
        if message.status != ALL_VALID || !numbers.all(|number| number.is_finite()) {
            self.counter.count_reported();
            return Err(ImuFault::Status(message.status.into()));
        }
        let scaled = |numbers: [f32; 3], unit: f64| Vector3::from(numbers.map(|x| real(f64::from(x) * unit)));
        Ok(ImuReading {
            time_us: now_us.saturating_sub(self.lag_us),
            missed: self.counter.take(message.sequence.into()),
            omega_g: scaled(message.rotation, self.rotation_rad_s),
            force_a: scaled(message.acceleration, 1e6 * MICRO_G),
            temperature_c: f32::from(message.temperature),
        })
    }

    /// Drops at least `least` bytes from the front, up to the next position where a header can begin.
    fn drop_until_header(&mut self, least: usize) {
        let held = self.message.get(..self.length).unwrap_or(&[]);
        let begins = |at: &usize| held.iter().skip(*at).zip(&HEADER).all(|(byte, wanted)| byte == wanted);
        let from = (least..self.length).find(begins).unwrap_or(self.length);
        if from == 0 {
            return;
        }
        let mut kept = [0; MESSAGE_BYTES];
        for (place, byte) in kept.iter_mut().zip(held.iter().skip(from)) {
            *place = *byte;
        }
        (self.message, self.length) = (kept, self.length.saturating_sub(from));
        self.discarded.bytes = self.discarded.bytes.saturating_add(from as u32);
    }
}

/// Content of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kvh1750Message {
    /// Rotation about x, y, z, in the unit and form of the IMU's settings.
    pub rotation: [f32; 3],
    /// Acceleration along x, y, z, g.
    pub acceleration: [f32; 3],
    /// Validity bits of the sensors.
    pub status: u8,
    /// Sequence number, 0 to 127.
    pub sequence: u8,
    /// Temperature, deg C.
    pub temperature: i16,
}

impl Kvh1750Message {
    /// Decodes a message. Returns `None` if the header or the CRC is wrong.
    pub fn decode(message: &[u8; MESSAGE_BYTES]) -> Option<Self> {
        let crc = u32::from_be_bytes(field::<32, 4, _>(message));
        if !message.starts_with(&HEADER) || CRC_32.checksum(&field::<0, COVERED_BYTES, _>(message)) != crc {
            return None;
        }
        let float = f32::from_be_bytes;
        let ([status], [sequence]) = (field::<28, 1, _>(message), field::<29, 1, _>(message));
        Some(Self {
            rotation: [field::<4, 4, _>(message), field::<8, 4, _>(message), field::<12, 4, _>(message)].map(float),
            acceleration: [field::<16, 4, _>(message), field::<20, 4, _>(message), field::<24, 4, _>(message)]
                .map(float),
            status,
            sequence,
            temperature: i16::from_be_bytes(field::<30, 2, _>(message)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Message of an IMU at rest with one axis up.
    const RECORDED: [u8; MESSAGE_BYTES] = [
        0xfe, 0x81, 0xff, 0x55, 0xbc, 0x64, 0x6c, 0x1e, 0x3c, 0x3f, 0xf9, 0x81, 0x3b, 0x3c, 0x1e, 0x78, 0xbc, 0x06,
        0x5f, 0xb7, 0xbb, 0x2f, 0xbd, 0x79, 0x3f, 0x7e, 0x98, 0x00, 0x77, 0x47, 0x00, 0x14, 0x16, 0x8d, 0x8b, 0x1d,
    ];

    type Pushed = Result<ImuReading<f64>, ImuFault<Infallible>>;

    /// CRC computed bit by bit, independent of the driver.
    fn crc_32(bytes: &[u8]) -> u32 {
        bytes.iter().fold(!0, |crc, byte| {
            (0..8)
                .fold(crc ^ u32::from(*byte) << 24, |crc: u32, _| crc << 1 ^ (0x04c1_1db7 & (crc >> 31).wrapping_neg()))
        })
    }

    fn message(numbers: [f32; 6], status: u8, sequence: u8) -> Vec<u8> {
        let numbers = numbers.into_iter().flat_map(f32::to_be_bytes);
        let mut bytes: Vec<u8> = HEADER.into_iter().chain(numbers).chain([status, sequence, 0, 21]).collect();
        bytes.extend(crc_32(&bytes).to_be_bytes());
        bytes
    }

    fn numbered(sequence: u8) -> Vec<u8> {
        message([0.25, -0.5, 1.0, 0.0, -1.0, 2.0], ALL_VALID, sequence)
    }

    fn push(unit: &mut Kvh1750, bytes: &[u8]) -> Vec<Pushed> {
        bytes.iter().filter_map(|byte| unit.push(*byte, 1_000_000)).collect()
    }

    #[test]
    fn a_recorded_message_is_read() {
        assert_eq!(crc_32(&RECORDED[..32]), 0x168d_8b1d);
        let message = Kvh1750Message::decode(&RECORDED).unwrap();
        assert_eq!((message.status, message.sequence, message.temperature), (ALL_VALID, 71, 20));
        assert_eq!(message.acceleration[2], 0.994_506_84);
        assert_eq!(message.rotation[0], -0.013_941_793);
    }

    #[test]
    fn units_and_time_stamp_follow_the_settings() {
        let degrees = Kvh1750Settings {
            rotation: Rotation::Increment,
            degrees: true,
            latency_us: 10,
            ..Kvh1750Settings::default()
        };
        for (settings, rate, time_us) in [(Kvh1750Settings::default(), 0.25, 997_045), (degrees, 50.0 * DEG, 997_100)] {
            let reading = push(&mut Kvh1750::new(&settings), &numbered(3))[0].unwrap();
            assert!((reading.omega_g.x - rate).abs() < 1e-15);
            assert!((reading.force_a - Vector3::new(0.0, -9.806_65, 19.6133)).amax() < 1e-14);
            assert_eq!((reading.time_us, reading.missed, reading.temperature_c), (time_us, 0, 21.0));
        }
    }

    #[test]
    fn missing_and_invalid_messages_are_reported_once() {
        let mut unit = Kvh1750::new(&Kvh1750Settings::default());
        let mut damaged = numbered(126);
        damaged[10] ^= 1;
        let invalid = message([0.0; 6], ALL_VALID & !4, 127);
        let infinite = message([0.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0], ALL_VALID, 0);
        let stream = [numbered(125), damaged, invalid, infinite, numbered(3)].concat();
        let missed: Vec<_> =
            push(&mut unit, &stream).iter().map(|pushed| pushed.map(|reading| reading.missed)).collect();
        let told = |bits: u8| Err(ImuFault::Status(bits.into()));
        assert_eq!(missed, [Ok(0), Err(ImuFault::Crc), told(ALL_VALID & !4), told(ALL_VALID), Ok(2)]);
        assert_eq!(unit.discarded(), Discarded { bytes: 36, messages: 1 });
    }

    #[test]
    fn a_message_after_a_truncated_message_is_not_lost() {
        for kept in 1..MESSAGE_BYTES {
            let mut unit = Kvh1750::new(&Kvh1750Settings::default());
            let stream = [numbered(0), numbered(1)[..kept].to_vec(), numbered(2), numbered(3)].concat();
            let read = push(&mut unit, &stream).iter().filter(|pushed| pushed.is_ok()).count();
            assert_eq!((read, unit.discarded().bytes), (3, kept as u32), "{kept}");
        }
    }

    proptest! {
        #[test]
        fn a_message_is_decoded_as_sent(rotation: [f32; 3], acceleration: [f32; 3], status: u8, sequence: u8) {
            let [a, b, c] = rotation;
            let [d, e, f] = acceleration;
            let sent = message([a, b, c, d, e, f], status, sequence);
            let decoded = Kvh1750Message::decode(&sent.try_into().unwrap()).unwrap();
            prop_assert_eq!(decoded.rotation.map(f32::to_bits), rotation.map(f32::to_bits));
            prop_assert_eq!(decoded.acceleration.map(f32::to_bits), acceleration.map(f32::to_bits));
            prop_assert_eq!((decoded.status, decoded.sequence, decoded.temperature), (status, sequence, 21));
        }

        #[test]
        fn two_wrong_bits_are_found(a in 0_usize..288, b in 0_usize..288) {
            prop_assume!(a != b);
            let mut wrong = RECORDED;
            for bit in [a, b] {
                wrong[bit / 8] ^= 1 << (bit % 8);
            }
            prop_assert_eq!(Kvh1750Message::decode(&wrong), None);
        }

        /// After any noise, every whole message is read, and every byte of the noise is counted.
        #[test]
        fn noise_costs_no_message(noise in prop::collection::vec(any::<u8>(), 0..200), sequence in 0_u8..100) {
            let mut unit = Kvh1750::new(&Kvh1750Settings::default());
            push(&mut unit, &noise);
            let behind = (sequence..sequence + 4).flat_map(numbered).collect::<Vec<_>>();
            let read: Vec<_> = push(&mut unit, &behind).into_iter().filter_map(Result::ok).collect();
            prop_assert_eq!(read.len(), 4);
            prop_assert!(read.iter().all(|reading| reading.missed == 0));
            prop_assert_eq!(unit.discarded().bytes, noise.len() as u32);
        }
    }
}
