//! The bytes received on the serial line, on their way from its interrupt to the main loop.

use core::cell::{Cell, RefCell};
use critical_section::Mutex;
use heapless::Deque;

/// Size of the queue, bytes: more than arrive while the main loop processes one sample.
const BYTES: usize = 1024;

static RECEIVED: Mutex<RefCell<Deque<u8, BYTES>>> = Mutex::new(RefCell::new(Deque::new()));
static OVERRUN: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Stores a byte, or counts it as lost if the queue is full.
pub fn put(byte: u8) {
    let taken = critical_section::with(|cs| {
        RECEIVED.borrow(cs).try_borrow_mut().is_ok_and(|mut received| received.push_back(byte).is_ok())
    });
    count_lost((!taken).into());
}

/// Counts lost bytes.
pub fn count_lost(bytes: u32) {
    critical_section::with(|cs| OVERRUN.borrow(cs).set(OVERRUN.borrow(cs).get().saturating_add(bytes)));
}

/// The next byte.
pub fn pop() -> Option<u8> {
    critical_section::with(|cs| RECEIVED.borrow(cs).try_borrow_mut().ok()?.pop_front())
}

/// Number of lost bytes.
pub fn lost() -> u32 {
    critical_section::with(|cs| OVERRUN.borrow(cs).get())
}
