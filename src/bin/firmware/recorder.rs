//! The board's black box: where it is, and what goes into it.
#![allow(unsafe_code)]

use core::sync::atomic::{AtomicU32, Ordering};
use rins_selfcal::base::restart::Restart;
use rins_selfcal::keep::black_box::{BlackBox, Entry, Event};

/// Events that are kept: 4 KiB, see `regions.x`.
const EVENTS: usize = 64;

unsafe extern "C" {
    /// Memory that no reset and no start touches.
    static mut _black_box: BlackBox<EVENTS>;
}

/// Number of the next event. Written by the main loop, and by whoever stops the program.
static NEXT: AtomicU32 = AtomicU32::new(0);

fn with<R>(work: impl FnOnce(&mut BlackBox<EVENTS>) -> R) -> R {
    let memory = &raw mut _black_box;
    // Safety: any bytes are a black box. Its users are the main loop and whoever stops the program, after which the main
    // loop does not go on; the reference ends with this function.
    work(unsafe { &mut *memory })
}

/// Finds the last event, and from it and from what the hardware knows, why the software has started. Called once, before
/// anything is recorded.
pub fn start(hardware: Option<Restart>) -> Restart {
    with(|black_box| {
        // Memory that was without power may fail to be read before it is written.
        if hardware == Some(Restart::PowerOn) {
            black_box.clear();
        }
        black_box.fold();
        let last = black_box.newest();
        NEXT.store(last.as_ref().map_or(0, |last| last.sequence.wrapping_add(1)), Ordering::Relaxed);
        Restart::after(hardware, last)
    })
}

/// Records an event of this time, us.
pub fn record(time_us: u64, event: Event) {
    let sequence = NEXT.load(Ordering::Relaxed);
    with(|black_box| black_box.record(&Entry { sequence, time_us, event, repeats: 0 }));
    NEXT.store(sequence.wrapping_add(1), Ordering::Relaxed);
}

/// An event, 0 the newest.
pub fn event(back: u16) -> Option<Entry> {
    let sequence = NEXT.load(Ordering::Relaxed).checked_sub(1 + u32::from(back))?;
    with(|black_box| black_box.entry(sequence))
}
