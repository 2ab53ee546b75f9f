//! The instrument's end of a serial line, in this process.

use rins_selfcal::link::{Command, MAX_FRAME_BYTES, encode};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};

/// The instrument's side of a serial line.
pub trait Line {
    /// The next received byte.
    fn receive(&mut self) -> Option<u8>;

    /// Sends the bytes from `next` as long as the line has room.
    fn transmit(&mut self, next: &mut dyn FnMut() -> Option<u8>);
}

/// A line to which nothing is connected.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unconnected;

impl Line for Unconnected {
    fn receive(&mut self) -> Option<u8> {
        None
    }

    fn transmit(&mut self, next: &mut dyn FnMut() -> Option<u8>) {
        while next().is_some() {}
    }
}

/// Somebody at the other end of a line who sends commands and does not listen.
pub trait Commander {
    /// Looks at the instrument and gives the next commands to `send`. Called whenever all commands before have arrived.
    fn look(&mut self, send: &mut dyn FnMut(&Command));
}

/// A line with a [`Commander`] at its other end.
pub struct CommandLine<C> {
    /// Who sends the commands.
    pub commander: C,
    sent: VecDeque<u8>,
}

impl<C> CommandLine<C> {
    /// The line before the first command.
    pub fn new(commander: C) -> Self {
        Self { commander, sent: VecDeque::new() }
    }
}

impl<C: Commander> Line for CommandLine<C> {
    fn receive(&mut self) -> Option<u8> {
        if self.sent.is_empty() {
            let sent = &mut self.sent;
            self.commander.look(&mut |command| {
                let mut frame = [0; MAX_FRAME_BYTES];
                sent.extend(encode(1, command, &mut frame).expect("a command fits into a frame"));
            });
        }
        self.sent.pop_front()
    }

    fn transmit(&mut self, next: &mut dyn FnMut() -> Option<u8>) {
        while next().is_some() {}
    }
}

/// One end of a pseudo-terminal. Reading does not block. Sending waits for the reader, so that an instrument that runs
/// faster than real time loses no bytes.
#[derive(Debug)]
pub struct Terminal {
    file: File,
    received: VecDeque<u8>,
    hung_up: bool,
}

impl Terminal {
    /// The line on `file`.
    pub fn new(file: File) -> Self {
        Self { file, received: VecDeque::new(), hung_up: false }
    }

    fn write(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() && !self.hung_up {
            match self.file.write(bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                    std::thread::yield_now();
                }
                Err(_) => self.hung_up = true,
            }
        }
    }
}

impl Line for Terminal {
    fn receive(&mut self) -> Option<u8> {
        let mut bytes = [0; 256];
        if self.received.is_empty()
            && let Ok(count) = self.file.read(&mut bytes)
        {
            self.received.extend(&bytes[..count]);
        }
        self.received.pop_front()
    }

    fn transmit(&mut self, next: &mut dyn FnMut() -> Option<u8>) {
        let bytes: Vec<u8> = std::iter::from_fn(next).collect();
        self.write(&bytes);
    }
}
