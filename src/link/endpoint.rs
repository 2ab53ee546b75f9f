//! The instrument's end of the serial line: it sends messages, receives commands and answers each command.
//!
//! ```text
//! on the wire   the frame encoded by COBS, then a zero byte. An encoded frame contains no zero byte, so a receiver can
//!               start at any time: after a zero byte a new frame begins
//! frame         0     version of the protocol
//!               1     kind of the payload: 'M' message, 'C' command, 'A' answer, 'S' corrected sample
//!               2-3   number, little-endian. Messages are counted, so that gaps show. The sender of a command chooses
//!                     its number, from 1, and the answer repeats it. An answer with number 0 was sent without a
//!                     command. A corrected sample has the lower half of its own number
//!               4..   payload: postcard of `Message`, `Command`, `Answer` or `CorrectedReport`
//!               last  CRC-32/ISO-HDLC of all bytes before it, little-endian, 4 bytes
//! ```
//! Both ends use this module. The other end needs [`encode`] and [`Decoder`] only.
//!
//! The module uses no port and no clock, and it never waits. A frame that is damaged, of another version or of an
//! unknown kind is dropped and counted; [`Status`] reports the counts. A frame that cannot be sent in time is left out
//! as a whole, live values first. Only commands are answered: an intact frame of the command's kind that contains no
//! command of this version is answered with a refusal, and a frame of another version with a hello. Other frames, such
//! as an echo of the instrument's own frames, are counted. While [`Link::is_answered`] is false, an answer waits; then
//! leave received bytes where they are. So the work for commands is bounded however many arrive.

use super::corrected::{MAX_CORRECTED_FRAME_BYTES, Stream};
use super::frame::{Damage, Decoder, MAX_FRAME_BYTES, encode};
use super::lock::Lock;
use super::outbox::Lane;
use super::protocol::{Answer, Command, Hello, LinkCounts, Refusal};
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::sample::{CorrectedSample, SampleStatus};

use super::outbox::Outbox;
use crate::run::telemetry::Message;

/// Memory for urgent frames, bytes: a verdict with all messages before it.
const URGENT_BYTES: usize = 1792;
/// Memory for answers, bytes: the longest answer.
const ANSWER_BYTES: usize = MAX_FRAME_BYTES;
/// Memory for live values, bytes: two estimates.
const ROUTINE_BYTES: usize = 1024;
/// Interval between two statuses, us.
const STATUS_US: u64 = 500_000;

/// The instrument's end of the link. It contains all its memory.
///
/// ```
/// use rins_selfcal::link::{Answer, Command, Decoder, Link, MAX_FRAME_BYTES, encode};
///
/// let (mut instrument, mut host) = (Link::new(), Decoder::new());
/// // The host sends a command with number 7.
/// let mut frame = [0; MAX_FRAME_BYTES];
/// let command = encode(7, &Command::Start, &mut frame).expect("it fits");
/// let received = command.iter().find_map(|byte| instrument.receive(*byte));
/// assert_eq!(received, Some((7, Command::Start)));
/// // The instrument sends the answer with the same number.
/// instrument.reply(7, &Answer::Done);
/// let mut answer = None;
/// while let Some(byte) = instrument.transmit() {
///     if let Some(Ok(frame)) = host.push(byte) {
///         answer = Some((frame.number, frame.read::<Answer>()));
///     }
/// }
/// assert_eq!(answer, Some((7, Some(Answer::Done))));
/// ```
#[derive(Debug)]
pub struct Link {
    decoder: Decoder,
    outbox: Outbox<URGENT_BYTES, ANSWER_BYTES, ROUTINE_BYTES>,
    lock: Lock,
    stream: Stream,
    hello: Option<Hello>,
    messages: u16,
    not_understood: u32,
    overrun: u32,
    status_us: Option<u64>,
}

impl Link {
    /// A link before the first byte.
    pub const fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            outbox: Outbox::new(),
            lock: Lock::new(),
            stream: Stream::new(),
            hello: None,
            messages: 0,
            not_understood: 0,
            overrun: 0,
            status_us: None,
        }
    }

    /// Sends what the instrument is, now and whenever a frame of another version arrives.
    pub fn greet(&mut self, hello: Hello) {
        self.volunteer(&Answer::Hello(hello.clone()));
        self.hello = Some(hello);
    }

    /// Takes one received byte. Returns the command and its number if this byte completes a command. Not inlined, as
    /// other functions here: frames and payloads are large, and the next function can use the same stack.
    #[inline(never)]
    pub fn receive(&mut self, byte: u8) -> Option<(u16, Command)> {
        match self.decoder.push(byte)? {
            Ok(frame) => match frame.read() {
                Some(command) => return Some((frame.number, command)),
                None => {
                    let (number, is_command) = (frame.number, frame.is::<Command>());
                    self.not_understood = self.not_understood.saturating_add(1);
                    if is_command {
                        self.reply(number, &Answer::Refused(Refusal::NotUnderstood));
                    }
                }
            },
            Err(Damage::Version(_)) => {
                if let Some(hello) = self.hello.clone() {
                    self.reply(0, &Answer::Hello(hello));
                }
            }
            Err(Damage::Corrupt) => {}
        }
        None
    }

    /// Answers the command of this number.
    #[inline(never)]
    pub fn reply(&mut self, number: u16, answer: &Answer) {
        let mut frame = [0; MAX_FRAME_BYTES];
        self.put(encode(number, answer, &mut frame), Lane::Answer);
    }

    /// Whether all answers are sent, so that there is room for the answer to the next command.
    pub fn is_answered(&self) -> bool {
        self.outbox.is_answered()
    }

    /// Puts a message into the outbox and returns its frame for other channels. Messages without a lane go to the other
    /// channels only. They are too long for a serial line, and commands can read their content.
    pub fn tell<'b>(&mut self, message: &Message, frame: &'b mut [u8; MAX_FRAME_BYTES]) -> Option<&'b [u8]> {
        let framed = encode(self.messages, message, frame);
        if let Some(lane) = lane(message) {
            self.messages = self.messages.wrapping_add(1);
            self.put(framed, lane);
        }
        framed
    }

    /// Switches the stream of corrected samples on or off. The samples are counted from 0 each time that the stream was
    /// off before.
    pub fn stream(&mut self, on: bool) {
        self.stream.switch(on);
    }

    /// Puts a corrected sample into the outbox while the stream is on.
    #[inline(never)]
    pub fn take<T: Real>(&mut self, sample: &CorrectedSample<T>, angles: [Angle; 2], status: SampleStatus) {
        if let Some(report) = self.stream.report(sample, angles, status) {
            let mut frame = [0; MAX_CORRECTED_FRAME_BYTES];
            self.put(encode(report.number as u16, &report, &mut frame), Lane::Routine);
        }
    }

    /// Unlocks the commands that change settings if `word` is the right word; otherwise locks them. Returns whether the
    /// word was right.
    pub fn unlock(&mut self, word: u32, now_us: u64) -> bool {
        self.lock.unlock(word, now_us)
    }

    /// Whether the commands that change settings are unlocked.
    pub fn is_unlocked(&self, now_us: u64) -> bool {
        self.lock.is_unlocked(now_us)
    }

    /// The next byte for the wire.
    pub fn transmit(&mut self) -> Option<u8> {
        self.outbox.pop()
    }

    /// Notes the total number of received bytes that were lost because they were not fetched in time.
    pub fn note_overrun(&mut self, bytes: u32) {
        self.overrun = bytes;
    }

    /// The counts of lost bytes and frames.
    pub fn counts(&self) -> LinkCounts {
        LinkCounts {
            dropped: self.decoder.dropped(),
            not_understood: self.not_understood,
            overrun: self.overrun,
            unsent: self.outbox.unsent(),
        }
    }

    /// Sends an answer that no command asked for.
    #[inline(never)]
    pub fn volunteer(&mut self, answer: &Answer) {
        let mut frame = [0; MAX_FRAME_BYTES];
        let lane = if matches!(answer, Answer::Status(_)) { Lane::Routine } else { Lane::Urgent };
        self.put(encode(0, answer, &mut frame), lane);
    }

    fn put(&mut self, frame: Option<&[u8]>, lane: Lane) {
        match frame {
            Some(frame) => self.outbox.put(frame, lane),
            None => self.outbox.count(true),
        }
    }

    /// Whether the status is due, which happens twice a second. If so, the next status is due half a second later.
    pub fn is_status_due(&mut self, now_us: u64) -> bool {
        let due = self.status_us.is_none_or(|last_us| now_us.abs_diff(last_us) >= STATUS_US);
        if due {
            self.status_us = Some(now_us);
        }
        due
    }
}

impl Default for Link {
    fn default() -> Self {
        Self::new()
    }
}

/// The lane of a message on the serial line; `None` if it is not sent there.
pub fn lane(message: &Message) -> Option<Lane> {
    match message {
        Message::Covariance { .. } | Message::Innovations(_) => None,
        Message::Segment(_) | Message::Corrected { .. } | Message::Queue { .. } => Some(Lane::Routine),
        Message::Store { .. }
        | Message::Decided(_)
        | Message::Released
        | Message::Refused(_)
        | Message::State { .. }
        | Message::Solved { .. }
        | Message::Judged(_)
        | Message::Aborted(_)
        | Message::Fault(_)
        | Message::Saved(_)
        | Message::Restarted(_) => Some(Lane::Urgent),
    }
}
