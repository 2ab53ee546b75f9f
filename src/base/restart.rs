//! Fatal errors, after which the software resets the processor, and the reason of the last reset.

use core::fmt;
use heapless::String;
use serde::{Deserialize, Serialize};

/// A task that the watchdog supervises.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Task {
    /// The data-ready interrupt.
    Sampling,
    /// The control interrupt.
    Control,
    /// The main loop.
    Main,
}

impl Task {
    /// All tasks, in the order of the deadlines of `Liveness::new`.
    pub const ALL: [Self; 3] = [Self::Sampling, Self::Control, Self::Main];
}

/// Fatal error: the reason why the software resets the processor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FatalError {
    /// A task missed its deadline.
    Overdue(Task),
    /// The code that feeds the watchdog did not run; the watchdog raised its early-warning interrupt.
    Unfed,
    /// The code panicked.
    Panic {
        /// Last 32 bytes of the file name.
        file: String<32>,
        /// Line number.
        line: u32,
    },
    /// The processor raised a fault exception.
    Fault(Registers),
    /// The stack overflowed.
    StackOverflow {
        /// Address of the instruction that overflowed the stack, or 0 if unknown.
        pc: u32,
    },
    /// An interrupt without a handler occurred; the number of its vector.
    Interrupt(u32),
    /// A device of the board did not start. The text says which.
    Board(String<40>),
}

impl FatalError {
    /// A panic at `line` of `file`.
    pub fn panic(file: &str, line: u32) -> Self {
        let start = file.len().saturating_sub(32);
        let end = (start..file.len()).find_map(|start| file.get(start..)).unwrap_or_default();
        Self::Panic { file: String::try_from(end).unwrap_or_default(), line }
    }

    /// A device that did not start. `what` is the message; a message longer than 40 bytes is dropped.
    pub fn board(what: &str) -> Self {
        Self::Board(String::try_from(what).unwrap_or_default())
    }
}

/// Registers of the processor at a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Registers {
    /// Address of the faulting instruction. 0 if the stack frame cannot be read.
    pub pc: u32,
    /// Return address of the faulting function. 0 if the stack frame cannot be read.
    pub lr: u32,
    /// Configurable fault status register, CFSR.
    pub status: u32,
    /// Address of the failed access. It is valid only if `status` says so.
    pub address: u32,
}

/// Reason of the last reset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Restart {
    /// The power was switched on.
    PowerOn,
    /// The software reset the processor after a fatal error.
    Stopped(FatalError),
    /// The watchdog reset the processor, and the software left no reason.
    Watchdog,
    /// The NRST pin reset the processor.
    Pin,
    /// The reset reason is unknown.
    Unexplained,
    /// The supply voltage was too low for a moment.
    BrownOut,
}

/// Bits of the configurable fault status register (ARMv7-M) and their messages.
const STATUS_BITS: [(u32, &str); 12] = [
    (1, "not executable"),
    (1 << 1, "access not allowed"),
    (1 << 8, "instruction cannot be read"),
    (1 << 9, "data cannot be read or written"),
    (1 << 10, "data could not be written"),
    (1 << 12, "stack cannot be written"),
    (1 << 16, "undefined instruction"),
    (1 << 17, "invalid state"),
    (1 << 18, "invalid return"),
    (1 << 19, "no coprocessor"),
    (1 << 24, "unaligned access"),
    (1 << 25, "division by zero"),
];

/// Either of these bits says that the address of the failed access is valid: MMARVALID, BFARVALID.
const ADDRESS_VALID: u32 = 1 << 7 | 1 << 15;

impl fmt::Display for Registers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pc, lr, status, address } = self;
        f.write_str("processor fault")?;
        for (_, text) in STATUS_BITS.iter().filter(|(bit, _)| status & bit != 0) {
            write!(f, ", {text}")?;
        }
        if status & ADDRESS_VALID != 0 {
            write!(f, ", at address {address:#010x}")?;
        }
        write!(f, "; pc {pc:#010x}, lr {lr:#010x}, status {status:#010x}")
    }
}

impl fmt::Display for FatalError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Overdue(Task::Sampling) => f.write_str("the data-ready interrupt missed its deadline"),
            Self::Overdue(Task::Control) => f.write_str("the control interrupt missed its deadline"),
            Self::Overdue(Task::Main) => f.write_str("the main loop missed its deadline"),
            Self::Unfed => f.write_str("no task fed the watchdog in time"),
            Self::Panic { file, line } => write!(f, "panic in {file}, line {line}"),
            Self::Fault(registers) => registers.fmt(f),
            Self::StackOverflow { pc } => write!(f, "stack overflow; pc {pc:#010x}"),
            Self::Interrupt(number) => write!(f, "unexpected interrupt {number}"),
            Self::Board(what) => f.write_str(what),
        }
    }
}

impl fmt::Display for Restart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PowerOn => f.write_str("power on"),
            Self::Stopped(error) => write!(f, "reset after: {error}"),
            Self::Watchdog => f.write_str("reset by the watchdog"),
            Self::Pin => f.write_str("reset by the NRST pin"),
            Self::Unexplained => f.write_str("reset for an unknown reason"),
            Self::BrownOut => f.write_str("reset because the supply voltage was too low"),
        }
    }
}
