//! Frames: the bytes between two zero bytes on the wire. The head of [`super`] shows their layout.
//!
//! Encoder and decoder work byte by byte in fixed memory. The encoder applies COBS and the CRC while postcard writes.
//! The decoder removes COBS while bytes arrive.

use cobs::{DecodeResult, DecoderState, EncoderState, PushResult};
use crc::{CRC_32_ISO_HDLC, Crc, Digest, Table};
use postcard::ser_flavors::Flavor;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Version of the protocol. Frames, the command [`super::Command::Hello`] and its answer are the same in all versions.
pub const PROTOCOL_VERSION: u8 = 7;

/// Longest payload, bytes.
pub const MAX_PAYLOAD_BYTES: usize = 1280;

const HEADER_BYTES: usize = 4;
const CRC_BYTES: usize = 4;
const MAX_CONTENT_BYTES: usize = HEADER_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES;

/// Longest frame, bytes: COBS adds one byte for each begun 254 bytes, and a zero byte ends the frame.
pub const MAX_FRAME_BYTES: usize = MAX_CONTENT_BYTES + MAX_CONTENT_BYTES / 254 + 2;

static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// The payload of a frame.
pub trait Payload: Serialize + DeserializeOwned {
    /// The byte that identifies this kind of payload.
    const KIND: u8;
}

/// Encodes a payload with this number as a frame; `None` if `frame` is too short. [`MAX_FRAME_BYTES`] is always enough.
pub fn encode<'b, P: Payload>(number: u16, payload: &P, frame: &'b mut [u8]) -> Option<&'b [u8]> {
    let mut encoder = Encoder::new(frame);
    let [low, high] = number.to_le_bytes();
    [PROTOCOL_VERSION, P::KIND, low, high].into_iter().try_for_each(|byte| encoder.check_and_put(byte))?;
    let length = postcard::serialize_with_flavor(payload, encoder).ok()?;
    frame.get(..length)
}

/// Writes a frame byte by byte.
struct Encoder<'b> {
    frame: &'b mut [u8],
    length: usize,
    stuffing: EncoderState,
    crc: Digest<'static, u32, Table<1>>,
}

impl<'b> Encoder<'b> {
    fn new(frame: &'b mut [u8]) -> Self {
        // The first code byte of COBS is written later.
        Self { frame, length: 1, stuffing: EncoderState::default(), crc: CRC.digest() }
    }

    fn check_and_put(&mut self, byte: u8) -> Option<()> {
        self.crc.update(&[byte]);
        self.put(byte)
    }

    fn put(&mut self, byte: u8) -> Option<()> {
        match self.stuffing.push(byte) {
            PushResult::AddSingle(byte) => self.append(byte),
            PushResult::ModifyFromStartAndSkip((index, code)) => {
                self.patch(index, code)?;
                self.append(0)
            }
            PushResult::ModifyFromStartAndPushAndSkip((index, code, byte)) => {
                self.patch(index, code)?;
                self.append(byte)?;
                self.append(0)
            }
        }
    }

    fn append(&mut self, byte: u8) -> Option<()> {
        self.patch(self.length, byte)?;
        self.length += 1;
        Some(())
    }

    fn patch(&mut self, index: usize, byte: u8) -> Option<()> {
        *self.frame.get_mut(index)? = byte;
        Some(())
    }

    /// Writes the CRC and the final zero byte. Returns the length of the frame.
    fn end(mut self) -> Option<usize> {
        let crc = self.crc.clone().finalize();
        crc.to_le_bytes().into_iter().try_for_each(|byte| self.put(byte))?;
        let (index, code) = self.stuffing.clone().finalize();
        self.patch(index, code)?;
        self.append(0)?;
        Some(self.length)
    }
}

impl Flavor for Encoder<'_> {
    type Output = usize;

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.check_and_put(byte).ok_or(postcard::Error::SerializeBufferFull)
    }

    fn finalize(self) -> postcard::Result<usize> {
        self.end().ok_or(postcard::Error::SerializeBufferFull)
    }
}

/// A frame with the right CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame<'d> {
    /// Kind of the payload, [`Payload::KIND`].
    pub kind: u8,
    /// Number of the message or of the command.
    pub number: u16,
    payload: &'d [u8],
}

impl Frame<'_> {
    /// Whether the frame is of the kind of `P`.
    pub fn is<P: Payload>(&self) -> bool {
        self.kind == P::KIND
    }

    /// The payload, if it is a `P` and no byte is left over.
    pub fn read<P: Payload>(&self) -> Option<P> {
        if !self.is::<P>() {
            return None;
        }
        let (payload, rest) = postcard::take_from_bytes(self.payload).ok()?;
        rest.is_empty().then_some(payload)
    }
}

/// Why a frame is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Damage {
    /// The frame is cut short, too long, not valid COBS, or its CRC is wrong.
    Corrupt,
    /// The CRC is right, but the frame has this other version of the protocol.
    Version(u8),
}

/// Numbers of frames that a receiver dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Dropped {
    /// See [`Damage::Corrupt`].
    pub corrupt: u32,
    /// See [`Damage::Version`].
    pub version: u32,
}

/// Finds frames in a stream of bytes. A frame that follows a zero byte is found whatever came before it.
#[derive(Debug)]
pub struct Decoder {
    stuffing: DecoderState,
    content: [u8; MAX_CONTENT_BYTES],
    length: usize,
    /// Whether a byte has arrived since the last zero byte.
    started: bool,
    /// The frame under way is already damaged. The decoder waits for its end.
    spoilt: bool,
    dropped: Dropped,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder between two frames.
    pub const fn new() -> Self {
        let dropped = Dropped { corrupt: 0, version: 0 };
        let content = [0; MAX_CONTENT_BYTES];
        Self { stuffing: DecoderState::Idle, content, length: 0, started: false, spoilt: false, dropped }
    }

    /// The numbers of frames dropped so far.
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Takes one received byte. Returns the frame, or what is wrong with the frame, if this byte ends it. Zero bytes
    /// between frames have no meaning.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, Damage>> {
        let stuffed = self.stuffing.feed(byte);
        if byte != 0 {
            self.started = true;
            if let Ok(DecodeResult::DataContinue(byte)) = stuffed {
                self.keep(byte);
            }
            return None;
        }
        let whole = !self.spoilt && matches!(stuffed, Ok(DecodeResult::DataComplete));
        let length = self.length;
        (self.length, self.spoilt) = (0, false);
        if !core::mem::take(&mut self.started) {
            return None;
        }
        let frame = check(if whole { self.content.get(..length)? } else { &[] });
        match frame {
            Err(Damage::Corrupt) => self.dropped.corrupt = self.dropped.corrupt.saturating_add(1),
            Err(Damage::Version(_)) => self.dropped.version = self.dropped.version.saturating_add(1),
            Ok(_) => {}
        }
        Some(frame)
    }

    fn keep(&mut self, byte: u8) {
        match self.content.get_mut(self.length) {
            Some(place) => {
                *place = byte;
                self.length += 1;
            }
            None => self.spoilt = true,
        }
    }
}

fn check(content: &[u8]) -> Result<Frame<'_>, Damage> {
    let (checked, crc) = content.split_last_chunk::<CRC_BYTES>().ok_or(Damage::Corrupt)?;
    let ([version, kind, low, high], payload) = checked.split_first_chunk().ok_or(Damage::Corrupt)?;
    if CRC.checksum(checked) != u32::from_le_bytes(*crc) {
        return Err(Damage::Corrupt);
    }
    if *version != PROTOCOL_VERSION {
        return Err(Damage::Version(*version));
    }
    Ok(Frame { kind: *kind, number: u16::from_le_bytes([*low, *high]), payload })
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::Vec as Bounded;
    use std::vec::Vec;

    impl Payload for Bounded<u8, MAX_PAYLOAD_BYTES> {
        const KIND: u8 = b'T';
    }

    type Bytes = Bounded<u8, MAX_PAYLOAD_BYTES>;

    fn framed(bytes: &[u8]) -> Vec<u8> {
        let mut frame = [0xaa; MAX_FRAME_BYTES];
        encode(7, &Bytes::from_slice(bytes).unwrap(), &mut frame).unwrap().to_vec()
    }

    /// What a decoder returns for these bytes: payloads and damages, in order.
    fn received(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Result<Vec<u8>, Damage>> {
        let mut all = Vec::new();
        for byte in bytes {
            if let Some(result) = decoder.push(*byte) {
                all.push(result.map(|frame| frame.read::<Bytes>().unwrap().to_vec()));
            }
        }
        all
    }

    /// The expected frame is built by hand: version, kind, number, payload of one byte, CRC, with COBS.
    #[test]
    fn a_frame_is_laid_out_as_said() {
        let content = [PROTOCOL_VERSION, b'T', 7, 0, 1, 0x2a];
        let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&content).to_le_bytes();
        assert!(!crc.contains(&0));
        let expected = [&[4, PROTOCOL_VERSION, b'T', 7, 7, 1, 0x2a], &crc[..], &[0]].concat();
        assert_eq!(framed(&[0x2a]), expected);
    }

    #[test]
    fn every_length_comes_back_and_its_frame_holds_one_zero() {
        // The length of the payload takes two of its bytes.
        for length in (0..MAX_PAYLOAD_BYTES - 2).step_by(3).chain([MAX_PAYLOAD_BYTES - 2]) {
            for period in [1, 7, 254, 255, 2000] {
                let value = |index: usize| if index % period == period - 1 { 0 } else { 1 + (index % 255) as u8 };
                let bytes: Vec<u8> = (0..length).map(value).collect();
                let frame = framed(&bytes);
                assert_eq!(frame.iter().position(|byte| *byte == 0), Some(frame.len() - 1));
                assert_eq!(received(&mut Decoder::new(), &frame), [Ok(bytes)], "{length}, a zero every {period}");
            }
        }
    }

    #[test]
    fn a_payload_that_is_too_long_is_not_framed() {
        let bytes = Bytes::from_slice(&[1; MAX_PAYLOAD_BYTES]).unwrap();
        assert_eq!(encode(0, &bytes, &mut [0; MAX_FRAME_BYTES]), None);
    }

    #[test]
    fn every_single_bit_error_is_found_and_costs_two_frames_at_most() {
        let (frame, next) = (framed(&[1, 0, 2, 3]), framed(&[9]));
        for bit in 0..8 * frame.len() {
            let mut bytes = frame.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let stream = [&bytes[..], &next, &next].concat();
            let mut decoder = Decoder::new();
            let results = received(&mut decoder, &stream);
            assert!(!results.contains(&Ok([1, 0, 2, 3].to_vec())), "bit {bit}");
            assert_eq!(results.last(), Some(&Ok([9].to_vec())), "bit {bit}");
            assert!(decoder.dropped().corrupt >= 1);
        }
    }

    #[test]
    fn cut_frames_noise_and_overlong_ones_are_counted_and_the_next_is_found() {
        let frame = framed(&[5, 6]);
        let cut = [&frame[..frame.len() - 3], &[0]].concat();
        let overlong = [&[0xff; 3000][..], &[0]].concat();
        for (bad, count) in [(cut, 1), (overlong, 1), (vec![1, 1, 1, 0, 0xff, 0, 0, 0], 2)] {
            let mut decoder = Decoder::new();
            let results = received(&mut decoder, &[&bad[..], &frame].concat());
            assert_eq!(results.last(), Some(&Ok([5, 6].to_vec())));
            assert_eq!(decoder.dropped(), Dropped { corrupt: count, version: 0 });
        }
    }

    #[test]
    fn another_version_is_told_from_damage() {
        let mut content = [PROTOCOL_VERSION + 1, b'T', 1, 1].to_vec();
        content.extend(Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&content).to_le_bytes());
        let mut frame = [0; 32];
        let length = cobs::encode(&content, &mut frame);
        let mut decoder = Decoder::new();
        assert_eq!(received(&mut decoder, &frame[..=length]), [Err(Damage::Version(PROTOCOL_VERSION + 1))]);
        assert_eq!(decoder.dropped(), Dropped { corrupt: 0, version: 1 });
    }

    #[test]
    fn bytes_after_a_payload_and_other_kinds_are_not_read() {
        let content = [1, 5, 9];
        let frame = |kind, payload| Frame { kind, number: 0, payload };
        assert_eq!(frame(b'T', &content[..2]).read::<Bytes>().unwrap(), [5]);
        assert_eq!(frame(b'T', &content).read::<Bytes>(), None);
        assert_eq!(frame(b'U', &content[..2]).read::<Bytes>(), None);
    }
}
