//! What the work takes: time by kind of work, without what is nobody's own.

use crate::board::{Board, ThisBoard};
use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};
use critical_section::Mutex;

/// Ticks that are nobody's own work: transfers, telemetry, and interrupts, which may come into any other span. Written
/// by interrupts and the main loop; spans nest, so each knows what came into it.
static ASIDE: AtomicU32 = AtomicU32::new(0);

/// Time from here on.
pub struct Span {
    start: u32,
    aside: u32,
}

impl Span {
    /// Begins now.
    pub fn start() -> Self {
        Self { start: ThisBoard::ticks(), aside: ASIDE.load(Ordering::Relaxed) }
    }

    fn ticks(&self) -> u32 {
        ThisBoard::ticks().wrapping_sub(self.start)
    }

    /// Ticks so far, without what is put aside.
    fn own_ticks(&self) -> u32 {
        critical_section::with(|_| self.ticks().wrapping_sub(ASIDE.load(Ordering::Relaxed).wrapping_sub(self.aside)))
    }

    /// Puts all of it aside.
    pub fn put_aside(self) {
        critical_section::with(|_| ASIDE.store(self.aside.wrapping_add(self.ticks()), Ordering::Relaxed));
    }
}

/// What a span was for. The order is that of the emulator's file `run`.
#[derive(Clone, Copy)]
pub enum Work {
    /// The control interrupt.
    Control,
    /// The IMU's interrupt.
    Acquire,
    /// A sample while the axes stand.
    Stop,
    /// A sample while they turn.
    Move,
    /// A sample that ends a segment.
    Segment,
    /// A piece of the final pass.
    Solve,
    /// A sample that is corrected.
    Correct,
    /// Everything else.
    Other,
}

/// Kinds of work.
const WORKS: usize = Work::Other as usize + 1;

/// Spans of one kind of work.
#[derive(Clone, Copy)]
pub struct Load {
    /// How many.
    pub spans: u32,
    /// All of them, ticks.
    pub ticks: u64,
    /// The longest, ticks.
    pub longest: u32,
}

static LOADS: Mutex<Cell<[Load; WORKS]>> = Mutex::new(Cell::new([Load { spans: 0, ticks: 0, longest: 0 }; WORKS]));

/// Counts a span, which ends here.
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

/// All work so far, in the order of [`Work`].
pub fn loads() -> [Load; WORKS] {
    critical_section::with(|cs| LOADS.borrow(cs).get())
}
