//! Driver for an absolute rotary encoder with the BiSS-C interface, read over SPI. The interface is unidirectional,
//! with one encoder on the line.
//!
//! Source: BiSS Interface Protocol Description (C-mode), iC-Haus; Renishaw data sheets L-9709-9001 and L-9709-9005,
//! BiSS C-mode (unidirectional) for RESOLUTE encoders, 26 and 32 bit.
//!
//! ```text
//! MA   (SCK)   ‾‾\_/‾\_/‾\_ ...                                                              ‾‾‾
//! SLO  (MISO)  ‾‾‾‾‾‾‾\____ack____/‾start‾\_0_| position, MSB first | error | warning | CRC |___timeout___/‾‾
//! ```
//! The encoder latches its position at the first edge of MA. From the second rising edge on it holds the line low
//! (acknowledgement). When the position is ready, it sends a start bit and a zero bit, then the position. Error and
//! warning are active low. The CRC has 6 bits, polynomial x^6 + x + 1 (0x43), initial value zero, over position, error
//! and warning, and is sent inverted. It detects every one and two wrong bits. After the CRC the line stays low until
//! the encoder is ready for the next request; then it goes high.
//!
//! MA is the SPI clock and idles high. The SPI mode is 2 or 3; use the mode whose sampling edge comes later after the
//! delay of the line. There is no chip select, and no data goes to the encoder. One read clocks 96 bits. With 32 bits
//! of position this leaves room for up to 52 bits of acknowledgement. At 4 MHz a read takes 24 us, and the encoder has
//! 13 us to acquire the position (assumed: at most 10 us).
//!
//! A wrong bit before the position can shift the frame, and a CRC of 6 bits misses a shifted frame once in 64 times. So
//! the driver refuses a frame whose start bit has moved by more than one bit since the last read; one bit is the jitter
//! of the line against the clock. If the next read has the same new start, that read is accepted.

use crate::base::angle::Angle;
use crc::{Algorithm, Crc, Table};
use embedded_hal::spi::SpiDevice;

/// Length of a read, bytes.
pub const CAPTURE_BYTES: usize = 12;
const CAPTURE_BITS: u32 = 8 * CAPTURE_BYTES as u32;

/// CRC-6 of BiSS-C, inverted as it is sent.
pub const CRC_6_BISS: Algorithm<u8> = Algorithm {
    width: 6,
    poly: 0x03,
    init: 0x00,
    refin: false,
    refout: false,
    xorout: 0x3f,
    check: 0x2e,
    residue: 0x3f,
};
static CRC_6: Crc<u8, Table<1>> = Crc::<u8, Table<1>>::new(&CRC_6_BISS);

/// Position bits per turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resolution {
    /// 2^26 steps per turn, 0.019 arcsec each.
    Bits26,
    /// 2^32 steps per turn, 0.0003 arcsec each.
    Bits32,
}

impl Resolution {
    const fn bits(self) -> u32 {
        match self {
            Self::Bits26 => 26,
            Self::Bits32 => 32,
        }
    }
}

/// Mounting of the encoder on its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Mounting {
    /// Encoder reading at the zero angle of the axis.
    pub zero: Angle,
    /// Whether the encoder counts left-handed about the axis.
    pub reversed: bool,
}

impl Mounting {
    /// The encoder counts right-handed, and its zero is the zero of the axis.
    pub const STRAIGHT: Self = Self { zero: Angle::from_ticks(0), reversed: false };

    /// Angle of the axis for the encoder reading `read`.
    const fn angle(&self, read: Angle) -> Angle {
        let turned = read.ticks().wrapping_sub(self.zero.ticks());
        Angle::from_ticks(if self.reversed { turned.wrapping_neg() } else { turned })
    }
}

/// Why the driver returns no angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BissFault<E> {
    /// The bus transfer failed.
    Bus(E),
    /// The line stayed high: no encoder, no supply, or a broken wire.
    NoAnswer,
    /// The line was low at the start, or stayed low: the encoder was not ready, or has no position.
    NotReady,
    /// The bits do not form a frame, or the start of the frame has moved since the last read.
    Framing,
    /// The frame has a wrong CRC.
    Crc,
    /// The encoder sets its error bit: the position is not valid.
    Error,
}

/// One decoded frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Frame {
    /// Index of the start bit among the captured bits.
    start: u32,
    position: u32,
    /// Whether the error bit is clear, so that the position is valid.
    good: bool,
    /// Whether the warning bit is set: dirt on the scale, or wear.
    warns: bool,
}

/// Driver of the encoder of one axis.
#[derive(Debug)]
pub struct BissEncoder<S> {
    spi: S,
    resolution: Resolution,
    mounting: Mounting,
    /// Start of the last frame; `None` before the first frame.
    start: Option<u32>,
    warnings: u32,
}

impl<S: SpiDevice> BissEncoder<S> {
    /// A driver for the encoder on `spi`.
    pub fn new(spi: S, resolution: Resolution, mounting: Mounting) -> Self {
        Self { spi, resolution, mounting, start: None, warnings: 0 }
    }

    /// Number of angles that came with a warning. The counter saturates.
    pub fn warnings(&self) -> u32 {
        self.warnings
    }

    /// The bus to the encoder, to set its mode.
    pub fn bus(&mut self) -> &mut S {
        &mut self.spi
    }

    /// Forgets where the last frame began, after the bus has got another mode.
    pub fn forget(&mut self) {
        self.start = None;
    }

    /// Number of good frames among this many. `pause` lets the encoder become ready between two frames.
    pub fn good_frames(&mut self, frames: u32, mut pause: impl FnMut()) -> u32 {
        self.forget();
        let mut good = 0;
        for _ in 0..frames {
            good += u32::from(self.read().is_ok());
            pause();
        }
        good
    }

    /// Reads the angle of the axis at the time when the read begins.
    ///
    /// # Errors
    /// The driver returns no angle, for the returned reason.
    pub fn read(&mut self) -> Result<Angle, BissFault<S::Error>> {
        let mut capture = [0; CAPTURE_BYTES];
        self.spi.read(&mut capture).map_err(BissFault::Bus)?;
        let frame = decode(&capture, self.resolution)?;
        let before = self.start.replace(frame.start).unwrap_or(frame.start);
        if frame.start.abs_diff(before) > 1 {
            return Err(BissFault::Framing);
        }
        if !frame.good {
            return Err(BissFault::Error);
        }
        self.warnings = self.warnings.saturating_add(u32::from(frame.warns));
        let ticks = frame.position << (32 - self.resolution.bits());
        Ok(self.mounting.angle(Angle::from_ticks(ticks)))
    }
}

/// Finds the frame among the captured bits.
fn decode<E>(capture: &[u8; CAPTURE_BYTES], resolution: Resolution) -> Result<Frame, BissFault<E>> {
    // The captured bits in the order of their arrival, from the most significant bit.
    let mut line = capture.iter().fold(0, |line, byte| line << 8 | u128::from(*byte)) << (u128::BITS - CAPTURE_BITS);
    let idle = line.leading_ones();
    if idle == CAPTURE_BITS {
        return Err(BissFault::NoAnswer);
    }
    let start = idle + (line << idle).leading_zeros();
    if idle == 0 || start >= CAPTURE_BITS {
        return Err(BissFault::NotReady);
    }
    let mut take = |bits: u32| {
        let taken = line >> (u128::BITS - bits);
        line <<= bits;
        taken
    };
    let (position_bits, flag_bits, crc_bits) = (resolution.bits(), 2, 6);
    let end = start + 2 + position_bits + flag_bits + crc_bits;
    if end > CAPTURE_BITS {
        return Err(BissFault::Framing);
    }
    // Skip idle and acknowledgement. The start bit follows.
    take(start);
    let start_and_zero = take(2);
    let content = take(position_bits + flag_bits) as u64;
    let crc = take(crc_bits) as u8;
    // The line is low until the encoder is ready, then high.
    let timeout = line.leading_zeros().min(CAPTURE_BITS - end);
    let ready = (line << timeout).leading_ones();
    if start_and_zero != 0b10 || timeout + ready != CAPTURE_BITS - end {
        return Err(BissFault::Framing);
    }
    // Leading zeros do not change a CRC with initial value zero, so the content can be processed as whole bytes.
    let [_, _, _, bytes @ ..] = content.to_be_bytes();
    if CRC_6.checksum(&bytes) != crc {
        return Err(BissFault::Crc);
    }
    Ok(Frame { start, position: (content >> flag_bits) as u32, good: content & 2 != 0, warns: content & 1 == 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::spi::ErrorKind;
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use proptest::prelude::*;
    use std::convert::Infallible;

    /// CRC by long division with the polynomial. The driver uses a table instead.
    fn crc_6(content: u64, bits: u32) -> u64 {
        let divisor = 0b100_0011 << (bits - 1);
        let rest =
            (0..bits).fold(
                content << 6,
                |rest, bit| {
                    if rest >> (bits + 5 - bit) & 1 == 1 { rest ^ divisor >> bit } else { rest }
                },
            );
        !rest & 0x3f
    }

    /// Captured bits with `ack` bits of acknowledgement. The remaining bits at the end are high (ready).
    fn line(resolution: Resolution, ack: u32, position: u32, flags: u64) -> u128 {
        let bits = resolution.bits() + 2;
        let content = u64::from(position) << 2 | flags;
        let frame = (2_u128 << bits | u128::from(content)) << 6 | u128::from(crc_6(content, bits));
        let (head, timeout) = (2 + ack, 5);
        let rest = CAPTURE_BITS - head - (2 + bits + 6) - timeout;
        let ones = |bits: u32| (1_u128 << bits) - 1;
        ones(2) << (CAPTURE_BITS - 2) | frame << (timeout + rest) | ones(rest)
    }

    fn bytes(line: u128) -> [u8; CAPTURE_BYTES] {
        std::array::from_fn(|index| (line >> (8 * (CAPTURE_BYTES - 1 - index))) as u8)
    }

    fn decoded(line: u128, resolution: Resolution) -> Result<Frame, BissFault<Infallible>> {
        decode(&bytes(line), resolution)
    }

    /// Reads the lines one after the other.
    fn read(lines: &[u128], mounting: Mounting) -> Vec<Result<Angle, BissFault<ErrorKind>>> {
        let script: Vec<_> = lines
            .iter()
            .flat_map(|line| {
                let read = Transaction::read_vec(bytes(*line).to_vec());
                [Transaction::transaction_start(), read, Transaction::transaction_end()]
            })
            .collect();
        let mut spi = Mock::new(&script);
        let mut encoder = BissEncoder::new(spi.clone(), Resolution::Bits32, mounting);
        let angles = lines.iter().map(|_| encoder.read()).collect();
        spi.done();
        angles
    }

    #[test]
    fn the_crc_is_that_of_the_polynomial() {
        let check = b"123456789".iter().fold(0_u128, |bits, byte| bits << 8 | u128::from(*byte));
        assert_eq!(Crc::<u8>::new(&CRC_6_BISS).checksum(b"123456789"), CRC_6_BISS.check);
        assert_eq!(crc_6((check & 0xffff_ffff) as u64, 32) as u8, CRC_6.checksum(b"6789"));
        // The remainder of x^6 is x + 1.
        assert_eq!(CRC_6.checksum(&[1]), !0b11 & 0x3f);
    }

    #[test]
    fn mounting_sets_direction_and_zero() {
        let lines = [line(Resolution::Bits32, 9, 1000, 3)];
        let mounted = |zero, reversed| Mounting { zero: Angle::from_ticks(zero), reversed };
        assert_eq!(read(&lines, Mounting::STRAIGHT), [Ok(Angle::from_ticks(1000))]);
        assert_eq!(read(&lines, mounted(400, false)), [Ok(Angle::from_ticks(600))]);
        assert_eq!(read(&lines, mounted(400, true)), [Ok(Angle::from_ticks(600_u32.wrapping_neg()))]);
    }

    #[test]
    fn a_position_of_26_bits_is_a_fraction_of_the_turn() {
        let mut spi = Mock::new(&[
            Transaction::transaction_start(),
            Transaction::read_vec(bytes(line(Resolution::Bits26, 1, 3 << 24, 3)).to_vec()),
            Transaction::transaction_end(),
        ]);
        let mut encoder = BissEncoder::new(spi.clone(), Resolution::Bits26, Mounting::STRAIGHT);
        assert_eq!(encoder.read(), Ok(Angle::from_ticks(3 << 30)));
        spi.done();
    }

    #[test]
    fn each_defect_of_a_frame_has_its_fault() {
        let good = line(Resolution::Bits32, 9, 5, 3);
        let late = line(Resolution::Bits32, 12, 5, 3);
        let cases = [
            (u128::MAX, Err(BissFault::NoAnswer)),
            (0, Err(BissFault::NotReady)),
            (good >> 3, Err(BissFault::NotReady)),
            (1 << (CAPTURE_BITS - 1), Err(BissFault::NotReady)),
            (1 << (CAPTURE_BITS - 1) | 1 << 40, Err(BissFault::Framing)),
            (line(Resolution::Bits32, 9, 5, 0b01), Err(BissFault::Error)),
            (good, Ok(Angle::from_ticks(5))),
            (good ^ 1 << 60, Err(BissFault::Crc)),
            // The line after the frame is low, high and low again.
            (good ^ 1, Err(BissFault::Framing)),
            (late, Err(BissFault::Framing)),
            (late, Ok(Angle::from_ticks(5))),
        ];
        for ((line, expected), found) in cases.iter().zip(read(&cases.map(|(line, _)| line), Mounting::STRAIGHT)) {
            assert_eq!(found, *expected, "{line:024x}");
        }
    }

    #[test]
    fn a_warning_is_counted_and_the_angle_accepted() {
        let script = [
            Transaction::transaction_start(),
            Transaction::read_vec(bytes(line(Resolution::Bits32, 4, 77, 0b10)).to_vec()),
            Transaction::transaction_end(),
        ];
        let mut spi = Mock::new(&script);
        let mut encoder = BissEncoder::new(spi.clone(), Resolution::Bits32, Mounting::STRAIGHT);
        assert_eq!((encoder.read(), encoder.warnings()), (Ok(Angle::from_ticks(77)), 1));
        spi.done();
    }

    /// Exhaustive over the bits of a read: no single wrong bit gives another angle.
    #[test]
    fn no_wrong_bit_gives_a_wrong_angle() {
        for position in [0, 1, 0x8000_0000, 0x5555_5555, 0xaaaa_aaaa, 0x1234_5678, u32::MAX] {
            for ack in [3, 9, 30] {
                let good = line(Resolution::Bits32, ack, position, 3);
                for bit in 0..CAPTURE_BITS {
                    let angles = read(&[good, good ^ 1 << bit, good], Mounting::STRAIGHT);
                    let right = |angle: &Result<Angle, _>| angle.is_ok_and(|angle| angle.ticks() == position);
                    assert!(right(&angles[0]) && (right(&angles[1]) || angles[1].is_err()), "{position:x} {ack} {bit}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn a_frame_is_decoded_as_sent(position: u32, ack in 1_u32..40, flags in 0_u64..4) {
            for (resolution, position) in [(Resolution::Bits32, position), (Resolution::Bits26, position >> 6)] {
                let frame = decoded(line(resolution, ack, position, flags), resolution).unwrap();
                let expected = Frame { start: 2 + ack, position, good: flags & 2 != 0, warns: flags & 1 == 0 };
                prop_assert_eq!(frame, expected);
            }
        }

        /// The CRC detects every two wrong bits in its content and in itself.
        #[test]
        fn two_wrong_bits_are_found(position: u32, ack in 1_u32..40, flags in 0_u64..4, a in 0_u32..40, b in 0_u32..40) {
            prop_assume!(a != b);
            let last = CAPTURE_BITS - (2 + ack + 2 + 40);
            let wrong = line(Resolution::Bits32, ack, position, flags) ^ 1 << (last + a) ^ 1 << (last + b);
            prop_assert_eq!(decoded(wrong, Resolution::Bits32), Err(BissFault::Crc));
        }

        #[test]
        fn any_bytes_are_decoded_or_refused(bytes: [u8; CAPTURE_BYTES]) {
            for resolution in [Resolution::Bits26, Resolution::Bits32] {
                if let Ok(frame) = decode::<Infallible>(&bytes, resolution) {
                    let position = u64::from(frame.position);
                    prop_assert!(position >> resolution.bits() == 0);
                }
            }
        }
    }
}
