//! Why the software stops itself, and why it has started.

use core::fmt;
use heapless::String;
use serde::{Deserialize, Serialize};

/// What must go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Task {
    /// The data-ready interrupt.
    Sampling,
    /// The control interrupt.
    Control,
    /// The main loop.
    Main,
}

impl Task {
    /// All of them, in the order of [`Liveness::new`]'s deadlines.
    pub const ALL: [Self; 3] = [Self::Sampling, Self::Control, Self::Main];
}

/// Why the software stops itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stop {
    /// This task hangs.
    Overdue(Task),
    /// Not even who feeds the watchdog gets on; it has given its warning.
    Unfed,
    /// A panic.
    Panic {
        /// The end of the file's name.
        file: String<32>,
        /// The line.
        line: u32,
    },
    /// A fault of the processor.
    Fault(Registers),
    /// The stack is full; the instruction is known if its address is not 0.
    StackOverflow {
        /// Address of the instruction.
        pc: u32,
    },
    /// An interrupt that nobody waits for.
    Interrupt(u32),
    /// A device of the board does not start.
    Board(String<40>),
}

impl Stop {
    /// A panic at this place.
    pub fn panic(file: &str, line: u32) -> Self {
        let start = file.len().saturating_sub(32);
        let end = (start..file.len()).find_map(|start| file.get(start..)).unwrap_or_default();
        Self::Panic { file: String::try_from(end).unwrap_or_default(), line }
    }

    /// A device that does not start, in up to 40 bytes.
    pub fn board(what: &str) -> Self {
        Self::Board(String::try_from(what).unwrap_or_default())
    }
}

/// The processor at a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Registers {
    /// Address of the instruction; 0 where the stack frame cannot be read.
    pub pc: u32,
    /// Return address of its function, likewise.
    pub lr: u32,
    /// Configurable fault status register, CFSR.
    pub status: u32,
    /// Address that could not be accessed, where the status says that it is valid.
    pub address: u32,
}

/// Why the software has started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Restart {
    /// The power came on.
    PowerOn,
    /// The software stopped itself.
    Stopped(Stop),
    /// The watchdog, without a word from the software.
    Watchdog,
    /// The reset line.
    Pin,
    /// A reset without a reason.
    Unexplained,
}

/// Bits of the fault status of ARMv7-M, and what they say.
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

/// The address of a forbidden access, or of a failed one, is valid.
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

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Overdue(Task::Sampling) => f.write_str("sampling hung"),
            Self::Overdue(Task::Control) => f.write_str("control hung"),
            Self::Overdue(Task::Main) => f.write_str("the main loop hung"),
            Self::Unfed => f.write_str("everything hung, and the watchdog was not fed"),
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
            Self::Stopped(stop) => write!(f, "reset after: {stop}"),
            Self::Watchdog => f.write_str("reset by the watchdog"),
            Self::Pin => f.write_str("reset by its line"),
            Self::Unexplained => f.write_str("reset for an unknown reason"),
        }
    }
}
