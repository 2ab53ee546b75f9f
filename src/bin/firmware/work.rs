//! Measures the processor time that each kind of work takes, without the time of interrupts and transfers.

use crate::board::{Board, ThisBoard};
use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};
use critical_section::Mutex;

/// Ticks that belong to no span's own work: transfers with devices, the serial line and the memory, the log, and
/// interrupts, which may come during any span. The encoding of messages is work and is not included. Interrupts and the
/// main loop write it. Spans nest, so each span subtracts what was added during it.
static ASIDE: AtomicU32 = AtomicU32::new(0);

/// A period of processor time that is being measured.
pub struct Span {
    start: u32,
    aside: u32,
}

impl Span {
    /// Begins a span now.
    pub fn start() -> Self {
        Self { start: ThisBoard::ticks(), aside: ASIDE.load(Ordering::Relaxed) }
    }

    fn ticks(&self) -> u32 {
        ThisBoard::ticks().wrapping_sub(self.start)
    }

    /// Ticks since the start of the span, without those that belong to no span's own work.
    fn own_ticks(&self) -> u32 {
        critical_section::with(|_| self.ticks().wrapping_sub(ASIDE.load(Ordering::Relaxed).wrapping_sub(self.aside)))
    }

    /// Ends the span and excludes its ticks from all spans around it.
    pub fn put_aside(self) {
        critical_section::with(|_| ASIDE.store(self.aside.wrapping_add(self.ticks()), Ordering::Relaxed));
    }
}

/// The kinds of work. The order is that of the emulator's file `run`.
#[derive(Clone, Copy)]
pub enum Work {
    /// The control interrupt.
    Control,
    /// The IMU's interrupt.
    Acquire,
    /// A sample while the axes are at rest.
    Stop,
    /// A sample while the axes turn.
    Move,
    /// A sample that ends a segment.
    Segment,
    /// A piece of a pass over all segments.
    Solve,
    /// A sample that is corrected.
    Correct,
    /// Everything else.
    Other,
}

/// Number of kinds of work.
const WORKS: usize = Work::Other as usize + 1;

/// The processor time of one kind of work.
#[derive(Clone, Copy)]
pub struct Load {
    /// Number of spans.
    pub spans: u32,
    /// Sum of all spans, ticks.
    pub ticks: u64,
    /// The longest span, ticks.
    pub longest: u32,
}

static LOADS: Mutex<Cell<[Load; WORKS]>> = Mutex::new(Cell::new([Load { spans: 0, ticks: 0, longest: 0 }; WORKS]));

/// Ends a span and adds it to its kind of work.
pub fn count(work: Work, span: &Span) {
    let ticks = span.own_ticks();
    critical_section::with(|cs| {
        let mut loads = LOADS.borrow(cs).get();
        if let Some(load) = loads.get_mut(work as usize) {
            load.spans = load.spans.wrapping_add(1);
            load.ticks += u64::from(ticks);
            load.longest = load.longest.max(ticks);
        }
        LOADS.borrow(cs).set(loads);
    });
}

/// The processor time of all kinds of work so far, in the order of [`Work`].
pub fn loads() -> [Load; WORKS] {
    critical_section::with(|cs| LOADS.borrow(cs).get())
}
