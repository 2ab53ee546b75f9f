//! A client that sends commands to an instrument and receives its answers and messages.

use super::port::Port;
use crate::result::table::explained;
use anyhow::{Context, Error, Result, anyhow, bail};
use rins_selfcal::link::{
    Answer, Command, CorrectedReport, Damage, Decoder, Dropped, MAX_FRAME_BYTES, PROTOCOL_VERSION, Refusal,
    UNLOCK_WORD, encode,
};
use rins_selfcal::run::telemetry::Message;
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::time::{Duration, Instant};

/// Longest time to wait for an erasure. A flash needs seconds for every sector, and an emulator is slower still.
const ERASING: Duration = Duration::from_secs(60);
/// Number of times a command is sent, at equal intervals, before the client reports that the instrument does not
/// answer. Carrying out a command twice does no harm.
const ATTEMPTS: u32 = 3;

/// Error of an answer that is not the one of its command.
pub const UNEXPECTED: &str = "the answer of the instrument does not match the request";

/// The other end of the line is closed: the instrument is switched off, or its device is unplugged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the instrument has closed the line")]
pub struct LineClosed;

/// An event from the instrument.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A message of the run.
    Message(Message),
    /// An answer and the number of its command; 0 for an answer without a command.
    Answer(u16, Answer),
    /// A corrected sample.
    Corrected(CorrectedReport),
}

/// The host's end of the line.
pub struct Client {
    port: Box<dyn Port>,
    patience: Duration,
    decoder: Decoder,
    events: VecDeque<Event>,
    number: u16,
    /// Number of the last command whose answer was returned. Further answers to it, if it was sent again, are dropped.
    answered: Option<u16>,
    next_message: Option<u16>,
    missing: u32,
    unread: u32,
    version: Option<u8>,
}

impl Client {
    /// A client at `port` that waits for an answer for at most `patience`.
    pub fn new(port: Box<dyn Port>, patience: Duration) -> Self {
        Self {
            port,
            patience,
            decoder: Decoder::new(),
            events: VecDeque::new(),
            number: 0,
            answered: None,
            next_message: None,
            missing: 0,
            unread: 0,
            version: None,
        }
    }

    /// Counts of frames that arrived damaged.
    pub fn dropped(&self) -> Dropped {
        self.decoder.dropped()
    }

    /// Number of messages that were sent but did not arrive, counted by the gaps in their numbers.
    pub fn missing(&self) -> u32 {
        self.missing
    }

    /// The next event, if one arrives within 20 ms.
    ///
    /// # Errors
    /// [`LineClosed`], or the line cannot be read.
    pub fn poll(&mut self) -> Result<Option<Event>> {
        if self.events.is_empty() {
            self.read()?;
        }
        Ok(self.events.pop_front().filter(|event| !self.is_repeated(event)))
    }

    /// Whether the event is one more answer to a command that has been answered.
    fn is_repeated(&self, event: &Event) -> bool {
        matches!(event, Event::Answer(number @ 1.., _) if Some(*number) == self.answered)
    }

    fn read(&mut self) -> Result<()> {
        let mut bytes = [0; 4096];
        let count = match self.port.read(&mut bytes) {
            Ok(0) => bail!(LineClosed),
            Ok(count) => count,
            Err(error)
                if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                return Ok(());
            }
            Err(error) => return Err(failed(error, "cannot read from the line")),
        };
        bytes[..count].iter().for_each(|byte| self.receive(*byte));
        Ok(())
    }

    fn receive(&mut self, byte: u8) {
        let frame = match self.decoder.push(byte) {
            None | Some(Err(Damage::Corrupt)) => return,
            Some(Err(Damage::Version(version))) => {
                self.version = Some(version);
                return;
            }
            Some(Ok(frame)) => frame,
        };
        let number = frame.number;
        if let Some(answer) = frame.read() {
            self.events.push_back(Event::Answer(number, answer));
        } else if let Some(message) = frame.read() {
            self.count(number);
            self.events.push_back(Event::Message(message));
        } else if let Some(report) = frame.read() {
            self.events.push_back(Event::Corrected(report));
        } else {
            self.unread += 1;
        }
    }

    fn count(&mut self, number: u16) {
        let expected = self.next_message.unwrap_or(number);
        self.missing += u32::from(number.wrapping_sub(expected));
        self.next_message = Some(number.wrapping_add(1));
    }

    /// Sends a command without waiting for the answer. Returns the number of the command.
    ///
    /// # Errors
    /// The line is broken.
    pub fn send(&mut self, command: &Command) -> Result<u16> {
        self.number = self.number.checked_add(1).unwrap_or(1);
        self.send_again(command)?;
        Ok(self.number)
    }

    fn send_again(&mut self, command: &Command) -> Result<()> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let frame = encode(self.number, command, &mut frame).context("the command is too long for a frame")?;
        // A leading zero byte ends any partial frame that noise has started.
        let written = self.port.write_all(&[0]).and_then(|()| self.port.write_all(frame));
        written.map_err(|error| failed(error, "cannot write to the line"))
    }

    /// Sends a command and waits for its answer. Sends the command again if no answer arrives in a third of the longest
    /// time to wait. `other` receives all other events.
    ///
    /// # Errors
    /// The instrument refuses (with its reason) or does not answer, or the line is broken.
    pub fn ask(&mut self, command: &Command, other: impl FnMut(&Event)) -> Result<Answer> {
        accepted(self.answer(command, other)?)
    }

    /// As [`Self::ask`], but returns a refusal as an answer.
    ///
    /// # Errors
    /// The instrument does not answer, or the line is broken.
    pub fn answer(&mut self, command: &Command, mut other: impl FnMut(&Event)) -> Result<Answer> {
        self.number = self.number.checked_add(1).unwrap_or(1);
        let patience = if *command == Command::Erase { self.patience.max(ERASING) } else { self.patience };
        for _ in 0..ATTEMPTS {
            self.send_again(command)?;
            let sent = Instant::now();
            while sent.elapsed() < patience / ATTEMPTS {
                match self.poll()? {
                    Some(Event::Answer(number, answer)) if number == self.number => {
                        self.answered = Some(number);
                        return Ok(answer);
                    }
                    Some(event) => other(&event),
                    None => {}
                }
            }
        }
        match self.version {
            Some(version) => {
                bail!(
                    "the instrument uses version {version} of the protocol, but this program uses version {PROTOCOL_VERSION}"
                )
            }
            None => bail!("the instrument does not answer"),
        }
    }

    /// Unlocks the instrument, then sends a command as [`Self::ask`] does.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn ask_unlocked(&mut self, command: &Command, mut other: impl FnMut(&Event)) -> Result<Answer> {
        self.ask(&Command::Unlock(UNLOCK_WORD), &mut other)?;
        self.ask(command, other)
    }
}

/// The error of a line, where `doing` failed.
fn failed(error: io::Error, doing: &'static str) -> Error {
    match error.kind() {
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset | ErrorKind::UnexpectedEof => LineClosed.into(),
        _ => Error::new(error).context(doing),
    }
}

/// The error of a command that the instrument refused.
pub fn refused(refusal: &Refusal) -> Error {
    anyhow!("refused: {refusal}; {}", explained(refusal.code()))
}

fn accepted(answer: Answer) -> Result<Answer> {
    match answer {
        Answer::Refused(refusal) => Err(refused(&refusal)),
        answer => Ok(answer),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::io::{Read, Write};
    use std::rc::Rc;

    /// A line on which the answers of the other end are put. It counts the commands.
    #[derive(Clone, Default)]
    struct FakeLine(Rc<RefCell<(VecDeque<u8>, usize)>>);

    impl FakeLine {
        fn answer(&self, number: u16, answer: &Answer) {
            let mut frame = [0; MAX_FRAME_BYTES];
            self.0.borrow_mut().0.extend(encode(number, answer, &mut frame).unwrap());
        }
    }

    impl Read for FakeLine {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            match self.0.borrow_mut().0.read(bytes)? {
                0 => Err(ErrorKind::TimedOut.into()),
                count => Ok(count),
            }
        }
    }

    impl Write for FakeLine {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.borrow_mut().1 += usize::from(bytes.len() > 1);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_silent_instrument_is_asked_several_times_within_the_longest_wait() {
        let (line, patience) = (FakeLine::default(), Duration::from_millis(60));
        let mut client = Client::new(Box::new(line.clone()), patience);
        let begun = Instant::now();
        let error = client.ask(&Command::Hello, |_| ()).unwrap_err();
        assert_eq!(error.to_string(), "the instrument does not answer");
        assert!(begun.elapsed() >= patience && begun.elapsed() < 2 * patience, "{:?}", begun.elapsed());
        assert_eq!(line.0.borrow().1, 3);
    }

    #[test]
    fn a_command_is_answered_once_and_a_refusal_names_its_page() {
        let line = FakeLine::default();
        let mut client = Client::new(Box::new(line.clone()), Duration::from_secs(5));
        line.answer(1, &Answer::Done);
        // The answer to the same command, sent again.
        line.answer(1, &Answer::Refused(Refusal::Policy));
        line.answer(2, &Answer::Refused(Refusal::Locked));
        let mut others = 0;
        assert_eq!(client.ask(&Command::Start, |_| others += 1).unwrap(), Answer::Done);
        let refused = client.ask(&Command::Erase, |_| others += 1).unwrap_err().to_string();
        assert!(refused.starts_with("refused: [locked] ") && refused.contains("`rins explain locked`"), "{refused}");
        assert_eq!(others, 0);
    }
}
