//! Frames with a right CRC and a wrong payload. The instrument must refuse them, and the host must not show wrong
//! values.

use super::samples;
use super::stable_bytes;
use crate::reference;
use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use host_tests::monitor::{Event, View, lines};
use rins_selfcal::link::{Answer, Command, Decoder, Dropped, Link, MAX_PAYLOAD_BYTES, PROTOCOL_VERSION, Refusal};
use rins_selfcal::run::telemetry::Message;

/// Kind, number and payload.
pub struct LinkPayloads {
    by_kind: [(u8, Vec<Vec<u8>>); 3],
}

impl LinkPayloads {
    /// Damages the sample payloads.
    pub fn new() -> Self {
        let samples = samples::all();
        Self { by_kind: [b'C', b'A', b'M'].map(|kind| (kind, samples.of(kind))) }
    }
}

impl Target for LinkPayloads {
    fn name(&self) -> &'static str {
        "link-payloads"
    }

    fn moment(&self) -> u64 {
        8_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        let (kind, payloads) = source.pick(&self.by_kind);
        let mut payload = source.pick(payloads).clone();
        let whole = source.one_in(8);
        let claim = if whole { Claim::Value(digest((*kind, &payload))) } else { Claim::Nothing };
        if !whole && source.one_in(8) {
            payload = source.noise(40);
        } else if !whole {
            source.damage(&mut payload);
        }
        input.push(if whole || !source.one_in(16) { *kind } else { source.byte() });
        input.extend((source.bits() as u16).to_le_bytes());
        input.extend(payload);
        claim
    }

    fn judge(&self, input: &[u8]) -> Outcome {
        let [kind, low, high, payload @ ..] = input else { return Outcome::refused("nothing") };
        let number = u16::from_le_bytes([*low, *high]);
        let frame = reference::frame(PROTOCOL_VERSION, *kind, number, payload);
        let command = as_instrument(&frame, *kind, number, payload.len() <= MAX_PAYLOAD_BYTES);
        match (*kind, command, as_host(&frame)) {
            (b'C', Some(command), None) => Outcome::accepted("command", (b'C', stable_bytes(&command))),
            (b'A', None, Some(Event::Answer(_, answer))) => Outcome::accepted("answer", (b'A', stable_bytes(&answer))),
            (b'M', None, Some(Event::Message(message))) => Outcome::accepted("message", (b'M', stable_bytes(&message))),
            (b'C' | b'A' | b'M', None, None) if payload.len() <= MAX_PAYLOAD_BYTES => Outcome::refused("no-payload"),
            (_, None, None) if payload.len() <= MAX_PAYLOAD_BYTES => Outcome::refused("unknown-kind"),
            (_, None, None) => Outcome::refused("too-long"),
            (kind, command, event) => panic!("kind {kind}: {command:?} and {event:?}"),
        }
    }
}

/// The command that the instrument reads from the frame. A frame of the command's kind that is no command is refused
/// under its number. Frames of other kinds are counted only.
fn as_instrument(frame: &[u8], kind: u8, number: u16, fits: bool) -> Option<Command> {
    let mut link = Link::new();
    let commands: Vec<_> = frame.iter().filter_map(|byte| link.receive(*byte)).collect();
    assert!(commands.len() <= 1);
    let sent: Vec<u8> = std::iter::from_fn(|| link.transmit()).collect();
    match commands.into_iter().next() {
        Some((numbered, command)) => {
            assert_eq!((numbered, sent.len()), (number, 0));
            Some(command)
        }
        None if fits && kind != b'C' => {
            assert_eq!((sent.len(), link.counts().not_understood), (0, 1));
            None
        }
        None if fits => {
            let refused = events(&sent);
            assert_eq!(refused, [Event::Answer(number, Answer::Refused(Refusal::NotUnderstood))]);
            None
        }
        None => {
            assert_eq!((sent.len(), link.counts().dropped.corrupt), (0, 1));
            None
        }
    }
}

/// The event that the host reads from the frame. The host must be able to show every event.
fn as_host(frame: &[u8]) -> Option<Event> {
    let event = events(frame).into_iter().next()?;
    let mut view = View::default();
    view.note(&event);
    assert!(
        view.screen(80, Dropped::default(), 0)
            .iter()
            .chain(&lines(&event))
            .all(|line| !line.contains(char::is_control))
    );
    Some(event)
}

fn events(bytes: &[u8]) -> Vec<Event> {
    let mut decoder = Decoder::new();
    let event = |byte: &u8| {
        let frame = decoder.push(*byte)?.ok()?;
        let answer = frame.read::<Answer>().map(|answer| Event::Answer(frame.number, answer));
        answer.or_else(|| frame.read::<Message>().map(Event::Message))
    };
    bytes.iter().filter_map(event).collect()
}
