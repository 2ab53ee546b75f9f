//! Bytes that came in over the serial line, from its interrupt to the main loop.

use core::cell::{Cell, RefCell};
use critical_section::Mutex;
use heapless::Deque;

/// Bytes that wait for the main loop: more than come in while it is busy with one sample.
const BYTES: usize = 1024;

static RECEIVED: Mutex<RefCell<Deque<u8, BYTES>>> = Mutex::new(RefCell::new(Deque::new()));
static OVERRUN: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Takes a byte in, or counts it.
pub fn put(byte: u8) {
    let taken = critical_section::with(|cs| {
        RECEIVED.borrow(cs).try_borrow_mut().is_ok_and(|mut received| received.push_back(byte).is_ok())
    });
    count_lost((!taken).into());
}

/// Counts bytes that were lost.
pub fn count_lost(bytes: u32) {
    critical_section::with(|cs| OVERRUN.borrow(cs).set(OVERRUN.borrow(cs).get().saturating_add(bytes)));
}

/// The next byte.
pub fn pop() -> Option<u8> {
    critical_section::with(|cs| RECEIVED.borrow(cs).try_borrow_mut().ok()?.pop_front())
}

/// Bytes that were lost.
pub fn lost() -> u32 {
    critical_section::with(|cs| OVERRUN.borrow(cs).get())
}
