//! The link's decoder on streams of frames, damaged frames and noise.

use super::samples;
use crate::reference::{self, Found};
use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use rins_selfcal::link::{Damage, Decoder, MAX_FRAME_BYTES, PROTOCOL_VERSION, Payload, encode};
use serde::de::{SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// The frame that follows every stream.
const PROBE: (u16, &[u8]) = (0x0100, &[1, 0, 2]);

/// Streams of frames.
pub struct LinkFrames {
    payloads: Vec<(u8, Vec<u8>)>,
}

impl LinkFrames {
    /// Makes frames with the sample payloads.
    pub fn new() -> Self {
        let samples = samples::all();
        Self { payloads: samples.all.clone() }
    }

    /// A good frame, in most cases a short frame.
    fn frame(&self, source: &mut Source) -> Vec<u8> {
        let (kind, payload) = source.pick(&self.payloads);
        let long = source.one_in(16);
        let payload = &payload[..if long { payload.len() } else { payload.len().min(24) }];
        reference::frame(PROTOCOL_VERSION, *kind, source.bits() as u16, payload)
    }

    fn piece(&self, source: &mut Source) -> Vec<u8> {
        match source.below(8) {
            0 => source.noise(40),
            1 => {
                let bound = if source.one_in(8) { 3000 } else { 30 };
                vec![source.byte(); source.below(bound)]
            }
            2 => {
                let (version, kind, number) = (source.byte(), source.byte(), source.bits() as u16);
                reference::frame(version, kind, number, &source.noise(20))
            }
            3 | 4 => self.frame(source),
            _ => {
                let mut frame = self.frame(source);
                source.damage(&mut frame);
                frame
            }
        }
    }
}

impl Target for LinkFrames {
    fn name(&self) -> &'static str {
        "link-frames"
    }

    fn moment(&self) -> u64 {
        35_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        match source.below(4) {
            0 => {
                input.extend(self.frame(source));
                Claim::Value(digest(expected(input)))
            }
            1 => {
                input.extend(self.frame(source));
                let count = 1 + source.below(3);
                source.flip(input, count);
                Claim::Refused
            }
            _ => {
                (0..=source.below(4)).for_each(|_| input.extend(self.piece(source)));
                Claim::Nothing
            }
        }
    }

    /// The decoder finds the same frames as the reference, and all damage is counted. Two frames follow the stream. The
    /// second is always received. The first is received if a zero byte comes before it.
    fn judge(&self, input: &[u8]) -> Outcome {
        let mut decoder = Decoder::new();
        let found = received(&mut decoder, input);
        assert_eq!(found, expected(input));
        let count = |of: fn(&Found) -> bool| found.iter().filter(|found| of(found)).count();
        let dropped = decoder.dropped();
        assert_eq!(dropped.corrupt as usize, count(|found| *found == Found::Corrupt));
        assert_eq!(dropped.version as usize, count(|found| matches!(found, Found::Version(_))));
        let (number, payload) = PROBE;
        let probe = encoded(number, payload);
        let [first, second] = [(); 2].map(|()| received(&mut decoder, &probe));
        let sound = [Found::Frame(b'C', number, payload.into())];
        assert_eq!(second, sound, "out of step");
        assert!(first == sound || input.last().is_some_and(|last| *last != 0), "{first:?}");
        let name = found.last().map_or("nothing", name);
        let accepted = found.iter().any(|found| matches!(found, Found::Frame(..)));
        if accepted { Outcome::accepted(name, &found) } else { Outcome::refused(name) }
    }
}

/// The frames that the reference finds. Payloads of unknown kinds are not compared.
fn expected(input: &[u8]) -> Vec<Found> {
    let known = |found| match found {
        Found::Frame(kind, number, _) if !b"CAM".contains(&kind) => Found::Frame(kind, number, Vec::new()),
        found => found,
    };
    reference::stream(input).into_iter().map(known).collect()
}

fn name(found: &Found) -> &'static str {
    match found {
        Found::Frame(b'C', ..) => "command",
        Found::Frame(b'A', ..) => "answer",
        Found::Frame(b'M', ..) => "message",
        Found::Frame(..) => "unknown-kind",
        Found::Corrupt => "corrupt",
        Found::Version(_) => "other-version",
    }
}

fn encoded(number: u16, payload: &[u8]) -> Vec<u8> {
    let frame = &mut [0; MAX_FRAME_BYTES];
    encode(number, &Raw::<b'C'>(payload.into()), frame).expect("it is short").to_vec()
}

fn received(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Found> {
    let found = |byte: &u8| {
        Some(match decoder.push(*byte)? {
            Err(Damage::Corrupt) => Found::Corrupt,
            Err(Damage::Version(version)) => Found::Version(version),
            Ok(frame) => {
                let known =
                    [frame.read().map(|Raw::<b'C'>(bytes)| bytes), frame.read().map(|Raw::<b'A'>(bytes)| bytes)];
                let message = frame.read().map(|Raw::<b'M'>(bytes)| bytes);
                let payload = known.into_iter().flatten().next().or(message);
                Found::Frame(frame.kind, frame.number, payload.unwrap_or_default())
            }
        })
    };
    bytes.iter().filter_map(found).collect()
}

/// Any payload, byte for byte.
struct Raw<const KIND: u8>(Vec<u8>);

impl<const KIND: u8> Payload for Raw<KIND> {
    const KIND: u8 = KIND;
}

impl<const KIND: u8> Serialize for Raw<KIND> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| bytes.serialize_element(byte))?;
        bytes.end()
    }
}

impl<'de, const KIND: u8> Deserialize<'de> for Raw<KIND> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(usize::MAX, ToTheEnd).map(Self)
    }
}

struct ToTheEnd;

impl<'de> Visitor<'de> for ToTheEnd {
    type Value = Vec<u8>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("bytes")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Vec<u8>, A::Error> {
        Ok(std::iter::from_fn(|| bytes.next_element().ok().flatten()).collect())
    }
}
