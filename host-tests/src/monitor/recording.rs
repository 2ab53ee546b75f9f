//! A recording of the stream of corrected samples, from its begin to its end.

use super::client::{Client, Event, UNEXPECTED};
use super::recorder::Recorder;
use anyhow::{Error, Result, bail};
use rins_selfcal::link::{Answer, Command, Status};
use std::mem::take;
use std::path::Path;

/// A recording that is under way. The stream is on until the end of the recording switches it off.
#[derive(Debug)]
pub struct Recording {
    recorder: Recorder,
    /// Whether the instrument corrects its samples.
    correcting: bool,
    /// Time of the last status that no command asked for, us. These statuses arrive in their order.
    time_us: u64,
    /// Whether the instrument was reset and its stream is off.
    is_reset: bool,
    /// The first error of the file.
    failed: Option<Error>,
}

impl Recording {
    /// Switches the stream on and creates the file, after the instrument has answered: an older recording is not lost
    /// to a wrong port. The stream is switched off before, so that its samples are counted from 0. `other` receives the
    /// other events.
    ///
    /// # Errors
    /// The instrument does not answer, the line is broken, or the file cannot be written.
    pub fn begin(client: &mut Client, path: &Path, mut other: impl FnMut(&Event)) -> Result<Self> {
        client.ask(&Command::Stream(false), &mut other)?;
        let Answer::Status(status) = client.ask(&Command::Status, &mut other)? else { bail!(UNEXPECTED) };
        let mut recording = Self::new(Recorder::create(path, status.time_us)?, &status);
        let on = client.ask(&Command::Stream(true), |event| {
            recording.note(event);
            other(event);
        });
        match on {
            Ok(_) => Ok(recording),
            Err(error) => {
                // The answer may have been lost only. A further error of the line would say the same.
                let _ = client.send(&Command::Stream(false));
                Err(error)
            }
        }
    }

    fn new(recorder: Recorder, status: &Status) -> Self {
        Self { recorder, correcting: status.correcting, time_us: 0, is_reset: false, failed: None }
    }

    /// Takes an event: records a sample, and notices a reset of the instrument.
    pub fn note(&mut self, event: &Event) {
        match event {
            Event::Corrected(report) => {
                if let Err(error) = self.recorder.record(report) {
                    self.failed.get_or_insert(error);
                }
            }
            Event::Answer(0, Answer::Hello(_)) => self.note_reset(),
            Event::Answer(0, Answer::Status(status)) => self.note_status(status),
            Event::Answer(..) | Event::Message(_) => {}
        }
    }

    fn note_status(&mut self, status: &Status) {
        // The hello after the reset was lost.
        if status.time_us < self.time_us {
            self.note_reset();
        }
        (self.time_us, self.correcting) = (status.time_us, status.correcting);
    }

    fn note_reset(&mut self) {
        self.recorder.note_reset();
        (self.time_us, self.is_reset) = (0, true);
    }

    /// The command that the recording needs now: after a reset, the one that switches the stream on again.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn due(&mut self) -> Result<Option<Command>> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => Ok(take(&mut self.is_reset).then_some(Command::Stream(true))),
        }
    }

    /// Switches the stream off, and records the samples that arrive until the instrument answers. Returns what the
    /// recording holds, in one line, also if something failed.
    pub fn end(mut self, client: &mut Client, mut other: impl FnMut(&Event)) -> (String, Result<()>) {
        let off = client.ask(&Command::Stream(false), |event| {
            self.note(event);
            other(event);
        });
        let written = self.failed.take().map_or_else(|| self.recorder.flush(), Err);
        let off = off.map(drop).map_err(|error| error.context("the stream of corrected samples is not switched off"));
        (self.summary(), written.and(off))
    }

    fn summary(&self) -> String {
        let why = match (self.recorder.has_begun(), self.correcting) {
            (true, _) => "",
            (false, false) => "; the instrument corrects no samples, because it has no calibration",
            (false, true) => "; the instrument corrects its samples, but none arrived",
        };
        format!("{}{why}", self.recorder.summary())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::angle::Angle;
    use rins_selfcal::base::linear::{Matrix3, Vector3};
    use rins_selfcal::base::sample::{CorrectedSample, SampleStatus};
    use rins_selfcal::link::{Hello, Link, LinkCounts};
    use rins_selfcal::run::state::State;
    use std::cell::RefCell;
    use std::io::{self, Read, Write};
    use std::rc::Rc;
    use std::time::Duration;

    /// An instrument that takes a sample every 5 ms, with its end of the link.
    struct Instrument {
        link: Link,
        time_us: u64,
        correcting: bool,
    }

    impl Instrument {
        fn new() -> Self {
            let mut link = Link::new();
            link.greet(Hello::new::<f64>());
            Self { link, time_us: 0, correcting: true }
        }

        fn sample(&mut self) {
            self.time_us += 5_000;
            let (force_s, omega_is_s) = (Vector3::zeros(), Vector3::zeros());
            let sample =
                CorrectedSample { time_us: self.time_us, force_s, omega_is_s, rot_sb: Matrix3::<f64>::identity() };
            if self.correcting {
                self.link.take(&sample, [Angle::default(); 2], SampleStatus::NONE);
            }
        }

        fn status(&self) -> Answer {
            Answer::Status(Status {
                time_us: self.time_us,
                state: State::Correcting,
                legs: 0,
                segments: 0,
                left_s: 0.0,
                angles_rad: [0.0; 2],
                correcting: self.correcting,
                unlocked: false,
                motion_lock: None,
                missing: 0,
                link: LinkCounts::default(),
            })
        }

        fn receive(&mut self, byte: u8) {
            let Some((number, command)) = self.link.receive(byte) else { return };
            let answer = match command {
                Command::Stream(on) => {
                    self.link.stream(on);
                    Answer::Done
                }
                Command::Status => self.status(),
                command => panic!("{command:?}"),
            };
            self.link.reply(number, &answer);
        }
    }

    /// The instrument's line. A read without data is a time-out, as on a serial device.
    #[derive(Clone)]
    struct FakeLine(Rc<RefCell<Instrument>>);

    impl Read for FakeLine {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let mut instrument = self.0.borrow_mut();
            let sent = std::iter::from_fn(|| instrument.link.transmit());
            let count = bytes.iter_mut().zip(sent).map(|(byte, sent)| *byte = sent).count();
            if count > 0 { Ok(count) } else { Err(io::ErrorKind::TimedOut.into()) }
        }
    }

    impl Write for FakeLine {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            bytes.iter().for_each(|byte| self.0.borrow_mut().receive(*byte));
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A recording of the fake instrument, from its begin on.
    struct Case {
        line: FakeLine,
        client: Client,
        recording: Recording,
        _folder: tempfile::TempDir,
    }

    impl Case {
        fn begin(instrument: Instrument) -> Self {
            let line = FakeLine(Rc::new(RefCell::new(instrument)));
            let mut client = Client::new(Box::new(line.clone()), Duration::from_secs(5));
            let folder = tempfile::tempdir().unwrap();
            let recording = Recording::begin(&mut client, &folder.path().join("corrected.csv"), |_| ()).unwrap();
            Self { line, client, recording, _folder: folder }
        }

        /// Lets the instrument take samples, then takes all events, and sends the command that is due.
        fn samples(&mut self, count: usize) {
            (0..count).for_each(|_| self.line.0.borrow_mut().sample());
            while let Some(event) = self.client.poll().unwrap() {
                self.recording.note(&event);
            }
            if let Some(command) = self.recording.due().unwrap() {
                self.client.ask(&command, |event| self.recording.note(event)).unwrap();
            }
        }

        fn summary(mut self) -> String {
            let (summary, ended) = self.recording.end(&mut self.client, |_| ());
            ended.unwrap();
            // The instrument does not stream any more.
            self.line.0.borrow_mut().sample();
            assert_eq!(self.client.poll().unwrap(), None);
            summary
        }
    }

    #[test]
    fn samples_of_an_earlier_stream_are_not_recorded() {
        let mut instrument = Instrument::new();
        instrument.link.stream(true);
        for _ in 0..7 {
            instrument.sample();
        }
        // The line has sent the first two samples already, so that the first one that is left over has number 2.
        for _ in 0..300 {
            instrument.link.transmit();
        }
        let mut case = Case::begin(instrument);
        case.samples(3);
        assert_eq!(case.summary(), "corrected samples: 3 recorded, 0 missing");
    }

    #[test]
    fn after_a_reset_the_stream_is_switched_on_again() {
        let mut case = Case::begin(Instrument::new());
        case.samples(3);
        *case.line.0.borrow_mut() = Instrument::new();
        case.samples(2);
        case.samples(4);
        let summary = "corrected samples: 7 recorded, 0 missing; the instrument began to count anew, restarts: 1";
        assert_eq!(case.summary(), summary);
    }

    #[test]
    fn a_reset_whose_hello_was_lost_shows_in_the_time_of_the_status() {
        let mut case = Case::begin(Instrument::new());
        let status = |case: &mut Case| {
            let mut instrument = case.line.0.borrow_mut();
            let status = instrument.status();
            instrument.link.volunteer(&status);
        };
        case.samples(3);
        status(&mut case);
        case.samples(0);
        *case.line.0.borrow_mut() = Instrument { link: Link::new(), ..Instrument::new() };
        status(&mut case);
        case.samples(0);
        case.samples(4);
        let summary = "corrected samples: 7 recorded, 0 missing; the instrument began to count anew, restarts: 1";
        assert_eq!(case.summary(), summary);
    }

    #[test]
    fn an_empty_recording_says_why() {
        let case = Case::begin(Instrument { correcting: false, ..Instrument::new() });
        let none = "corrected samples: 0 recorded, 0 missing; ";
        let why = "the instrument corrects no samples, because it has no calibration";
        assert_eq!(case.summary(), format!("{none}{why}"));
        let why = "the instrument corrects its samples, but none arrived";
        assert_eq!(Case::begin(Instrument::new()).summary(), format!("{none}{why}"));
    }

    #[test]
    fn the_first_failure_of_the_file_ends_the_recording_and_the_stream() {
        let mut case = Case::begin(Instrument::new());
        let (reader, writer) = io::pipe().unwrap();
        let file = std::os::fd::OwnedFd::from(writer).into();
        case.recording.recorder = Recorder::of(file, Path::new("pipe"), 0).unwrap();
        drop(reader);
        // More rows than are written at once.
        for _ in 0..1000 {
            case.line.0.borrow_mut().sample();
            let event = case.client.poll().unwrap().expect("a sample");
            case.recording.note(&event);
        }
        let (summary, ended) = case.recording.end(&mut case.client, |_| ());
        assert_eq!(summary, "corrected samples: 0 recorded, 0 missing");
        assert_eq!(ended.unwrap_err().to_string(), "pipe: cannot write");
        case.line.0.borrow_mut().sample();
        assert_eq!(case.client.poll().unwrap(), None);
    }
}
