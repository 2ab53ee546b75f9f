//! The instrument's end of a serial line, in this process.

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, poll};
use rins_selfcal::link::{Command, MAX_FRAME_BYTES, encode};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsFd;

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

/// How long to wait for room before the other end is looked at again, ms.
const ROOM_WAIT_MS: u8 = 10;

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
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => self.hung_up = !self.waits_for_reader(),
                Err(_) => self.hung_up = true,
            }
        }
    }

    /// Waits until the reader has made room, for a short while. Returns whether the other end is still open: where it is
    /// closed with a full buffer, writing reports that there is no room, for ever.
    fn waits_for_reader(&self) -> bool {
        let mut ends = [PollFd::new(self.file.as_fd(), PollFlags::POLLOUT)];
        let polled = poll(&mut ends, ROOM_WAIT_MS);
        let hung_up = ends[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP));
        !hung_up && !matches!(polled, Err(error) if error != Errno::EINTR)
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

#[cfg(test)]
mod tests {
    use super::*;
    use nix::fcntl::{FcntlArg, OFlag, fcntl};
    use nix::pty::openpty;
    use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
    use std::thread;
    use std::time::Duration;

    #[test]
    fn nobody_waits_for_a_reader_that_has_gone_before_it_read() {
        let pair = openpty(None, None).expect("a pseudo-terminal");
        let mut settings = tcgetattr(&pair.slave).expect("settings");
        cfmakeraw(&mut settings);
        tcsetattr(&pair.slave, SetArg::TCSANOW, &settings).expect("raw");
        fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).expect("not blocking");
        let mut terminal = Terminal::new(File::from(pair.master));
        let mut bytes = std::iter::repeat_n(b'x', 1 << 20);
        let writer = thread::spawn(move || {
            terminal.transmit(&mut || bytes.next());
            terminal.hung_up
        });
        // The buffer of a pseudo-terminal is full long before.
        thread::sleep(Duration::from_millis(200));
        drop(pair.slave);
        assert!(writer.join().expect("it ends"));
    }
}
