//! SPI to devices that the host plays, behind named pipes opened by semihosting: a transfer is a request of chip number,
//! length and bytes, answered by as many bytes. A semihosting call stops the virtual processor, so host and guest go in
//! lock step.

use super::semihosting::File;
use crate::work::Span;
use core::sync::atomic::{AtomicBool, Ordering};
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};

/// Longest transfer on SPI, bytes.
const MAX_TRANSFER_BYTES: usize = 96;

/// Whether the instrument is switched on. Cleared by the interrupt, read by the main loop.
pub static POWERED: AtomicBool = AtomicBool::new(true);

/// Number of a chip on the host's bench.
#[derive(Clone, Copy)]
pub enum Chip {
    /// The IMU.
    Imu = 0,
    /// Encoder of the outer axis.
    OuterEncoder = 1,
    /// Encoder of the inner axis.
    InnerEncoder = 2,
    /// Drive of the outer axis.
    OuterDrive = 3,
    /// Drive of the inner axis.
    InnerDrive = 4,
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
    /// More than one operation, another than a full-duplex transfer in place, or more bytes than the bus takes.
    Unsupported,
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
        let [Operation::TransferInPlace(frame)] = operations else { return Err(PipeFault::Unsupported) };
        // The interrupt and the main loop share the bus.
        critical_section::with(|_| {
            let span = Span::start();
            let done = self.bus.transfer(self.chip, frame);
            span.put_aside();
            done
        })
    }
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

    fn transfer(self, chip: Chip, frame: &mut [u8]) -> Result<(), PipeFault> {
        let mut request = [0; 2 + MAX_TRANSFER_BYTES];
        let [number, length, bytes @ ..] = &mut request;
        *number = chip as u8;
        *length = u8::try_from(frame.len()).map_err(|_| PipeFault::Unsupported)?;
        bytes.get_mut(..frame.len()).ok_or(PipeFault::Unsupported)?.copy_from_slice(frame);
        let request = request.get(..2 + frame.len()).ok_or(PipeFault::Unsupported)?;
        if POWERED.load(Ordering::Relaxed) && self.requests.write(request) && self.answers.read_exact(frame) {
            Ok(())
        } else {
            POWERED.store(false, Ordering::Relaxed);
            Err(PipeFault::Closed)
        }
    }
}
