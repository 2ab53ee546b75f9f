//! SPI to devices that the host simulates, through named pipes opened by semihosting. A request consists of chip
//! number, length and bytes; the answer has the same number of bytes. A semihosting call stops the virtual processor,
//! so host and guest run in lock step.

use super::semihosting::File;
use super::wire::{MAX_TRANSFER_BYTES, PERIOD_BYTES, chip, input};
use crate::work::Span;
use core::sync::atomic::{AtomicBool, Ordering};
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};

/// Whether the instrument is switched on. Cleared by the interrupt, read by the main loop.
pub static POWERED: AtomicBool = AtomicBool::new(true);

/// Number of a chip on the host's bench.
#[derive(Clone, Copy)]
pub enum Chip {
    /// The IMU, or the receiver of its serial line.
    Imu = chip::IMU as isize,
    /// A control period: see [`super::pipe_pins`].
    Period = chip::PERIOD as isize,
    /// The line that switches both motors off until the next period.
    MotorsOff = chip::MOTORS_OFF as isize,
}

/// The bus: one pipe for requests and one for answers.
#[derive(Clone, Copy)]
pub struct PipeBus {
    requests: File,
    answers: File,
}

/// One chip on the bus.
pub struct PipeSpi {
    bus: PipeBus,
    chip: Chip,
}

/// Fault of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PipeFault {
    /// The host has closed the pipes.
    Closed,
    /// The transfer is longer than [`MAX_TRANSFER_BYTES`].
    TooLong,
}

impl Error for PipeFault {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for PipeSpi {
    type Error = PipeFault;
}

impl SpiDevice for PipeSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), PipeFault> {
        let mut request = Request::new(self.chip);
        operations.iter().try_for_each(|operation| request.add(operation))?;
        // Interrupts and the main loop share the bus, so a transfer must not be interrupted.
        critical_section::with(|_| {
            let span = Span::start();
            let done = self.bus.exchange(&mut request);
            span.put_aside();
            done
        })?;
        let mut answer = request.frame();
        for operation in operations {
            answer = give(answer, operation);
        }
        Ok(())
    }
}

/// Switches the motors off. Fault handlers call it, so it uses no memory of the bus.
pub fn motors_off() {
    if let Some(requests) = File::open(c"requests", File::WRITE) {
        // The request has no bytes and no answer.
        requests.write(&[Chip::MotorsOff as u8, 0]);
    }
}

/// A transfer: the chip's number, the number of bytes, and the bytes. The bytes are first those to send and then those
/// received.
struct Request {
    bytes: [u8; 2 + MAX_TRANSFER_BYTES],
    length: usize,
}

impl Request {
    fn new(chip: Chip) -> Self {
        let mut bytes = [0; 2 + MAX_TRANSFER_BYTES];
        if let Some(number) = bytes.first_mut() {
            *number = chip as u8;
        }
        Self { bytes, length: 0 }
    }

    /// Adds the bytes that the operation sends; zeros if it only reads.
    fn add(&mut self, operation: &Operation<'_, u8>) -> Result<(), PipeFault> {
        let (sent, length): (&[u8], usize) = match operation {
            Operation::Read(received) => (&[], received.len()),
            Operation::Write(sent) => (sent, sent.len()),
            Operation::Transfer(received, sent) => (sent, received.len().max(sent.len())),
            Operation::TransferInPlace(both) => (both, both.len()),
            Operation::DelayNs(_) => return Ok(()),
        };
        let rest = self.bytes.get_mut(2 + self.length..).filter(|rest| rest.len() >= length);
        for (place, byte) in rest.ok_or(PipeFault::TooLong)?.iter_mut().zip(sent) {
            *place = *byte;
        }
        self.length += length;
        if let Some(count) = self.bytes.get_mut(1) {
            *count = self.length as u8;
        }
        Ok(())
    }

    fn frame(&self) -> &[u8] {
        self.bytes.get(2..2 + self.length).unwrap_or(&[])
    }
}

/// Gives an operation the bytes that were received during it. Returns the remaining bytes.
fn give<'a>(answer: &'a [u8], operation: &mut Operation<'_, u8>) -> &'a [u8] {
    let length = match operation {
        Operation::Read(received) | Operation::TransferInPlace(received) => fill(received, answer),
        Operation::Transfer(received, sent) => fill(received, answer).max(sent.len()),
        Operation::Write(sent) => sent.len(),
        Operation::DelayNs(_) => 0,
    };
    answer.get(length..).unwrap_or(&[])
}

fn fill(received: &mut [u8], answer: &[u8]) -> usize {
    for (place, byte) in received.iter_mut().zip(answer) {
        *place = *byte;
    }
    received.len()
}

impl PipeBus {
    /// Opens the pipes.
    pub fn open() -> Option<Self> {
        Some(Self { requests: File::open(c"requests", File::WRITE)?, answers: File::open(c"answers", File::READ)? })
    }

    /// The chip as a driver sees it.
    pub fn device(self, chip: Chip) -> PipeSpi {
        PipeSpi { bus: self, chip }
    }

    /// Lets the host simulate one control period. Returns whether the instrument is switched on.
    pub fn period(self, frame: &mut [u8; PERIOD_BYTES]) -> bool {
        let done = self.device(Chip::Period).transfer_in_place(frame);
        let [inputs, ..] = *frame;
        let on = done.is_ok() && inputs & input::POWERED != 0;
        POWERED.fetch_and(on, Ordering::Relaxed);
        on
    }

    fn exchange(self, request: &mut Request) -> Result<(), PipeFault> {
        let Request { bytes, length } = request;
        let sent =
            bytes.get(..2 + *length).is_some_and(|sent| POWERED.load(Ordering::Relaxed) && self.requests.write(sent));
        if sent && bytes.get_mut(2..2 + *length).is_some_and(|frame| self.answers.read_exact(frame)) {
            Ok(())
        } else {
            POWERED.store(false, Ordering::Relaxed);
            Err(PipeFault::Closed)
        }
    }
}
