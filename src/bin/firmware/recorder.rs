//! The board's black box: its memory, and the functions that write to it.
#![allow(unsafe_code)]

use core::sync::atomic::{AtomicU32, Ordering};
use rins_selfcal::base::restart::Restart;
use rins_selfcal::keep::black_box::{BlackBox, Entry, Event};

/// Number of events that are kept: 4 KiB, see `regions.x`.
const EVENTS: usize = 64;

unsafe extern "C" {
    // Memory that keeps its content over a reset and a start.
    static mut _black_box: BlackBox<EVENTS>;
}

/// Number of the next event. The main loop writes it, and also the function that stops the program.
static NEXT: AtomicU32 = AtomicU32::new(0);

fn with<R>(work: impl FnOnce(&mut BlackBox<EVENTS>) -> R) -> R {
    let memory = &raw mut _black_box;
    // Safety: any bytes are a valid black box. Its users are the main loop and the function that stops the program,
    // after which the main loop does not continue. The reference ends with this function.
    work(unsafe { &mut *memory })
}

/// Finds the last event, and returns why the software has started, from this event and from what the hardware knows.
/// Called once, before anything is recorded.
pub fn start(hardware: Option<Restart>) -> Restart {
    with(|black_box| {
        // Memory that was without power may give read errors until it is written.
        if hardware == Some(Restart::PowerOn) {
            black_box.clear();
        }
        black_box.fold();
        let last = black_box.newest();
        NEXT.store(last.as_ref().map_or(0, |last| last.sequence.wrapping_add(1)), Ordering::Relaxed);
        Restart::after(hardware, last)
    })
}

/// Records an event at this time, us.
pub fn record(time_us: u64, event: Event) {
    let sequence = NEXT.load(Ordering::Relaxed);
    with(|black_box| black_box.record(&Entry { sequence, time_us, event, repeats: 0 }));
    NEXT.store(sequence.wrapping_add(1), Ordering::Relaxed);
}

/// An event of the black box, 0 for the newest.
pub fn event(back: u16) -> Option<Entry> {
    let sequence = NEXT.load(Ordering::Relaxed).checked_sub(1 + u32::from(back))?;
    with(|black_box| black_box.entry(sequence))
}
