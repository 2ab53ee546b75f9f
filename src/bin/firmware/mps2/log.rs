//! Sends logs of defmt to the host's log pipe, with one write for each frame.
#![allow(unsafe_code)]

use super::semihosting::File;
use crate::board::{Board, ThisBoard};
use core::cell::UnsafeCell;
use rins_selfcal::base::restart::FatalError;

struct Log {
    restore: critical_section::RestoreState,
    encoder: defmt::Encoder,
    open: bool,
    file: Option<File>,
    buffer: heapless::Vec<u8, 256>,
}

impl Log {
    fn put(&mut self, encode: impl FnOnce(&mut defmt::Encoder, &mut dyn FnMut(&[u8]))) {
        let Self { encoder, file, buffer, .. } = self;
        encode(encoder, &mut |bytes| {
            if buffer.extend_from_slice(bytes).is_err() {
                flush(*file, buffer);
                let _ = buffer.extend_from_slice(bytes);
            }
        });
    }
}

fn flush(file: Option<File>, buffer: &mut heapless::Vec<u8, 256>) {
    if let Some(file) = file {
        // A failed write loses this log frame only.
        let _ = file.write(buffer);
    }
    buffer.clear();
}

struct LogCell(UnsafeCell<Log>);

// Safety: the cell is used between `acquire` and `release` only. They hold a critical section on the only core.
unsafe impl Sync for LogCell {}

static LOG: LogCell = LogCell(UnsafeCell::new(Log {
    restore: critical_section::RestoreState::invalid(),
    encoder: defmt::Encoder::new(),
    open: false,
    file: None,
    buffer: heapless::Vec::new(),
}));

/// Sends logs to the host's log pipe, with one write for each frame.
#[defmt::global_logger]
struct Logger;

// Safety: a frame is one critical section. A frame inside another frame stops the program.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // Safety: `release` restores the state; the reference ends with this function.
        let (restore, log) = unsafe { (critical_section::acquire(), &mut *LOG.0.get()) };
        if log.open {
            ThisBoard::stop(&FatalError::board("log inside a log"));
        }
        log.open = true;
        log.restore = restore;
        log.file = log.file.or_else(|| File::open(c"log", File::WRITE));
        log.put(|encoder, write| encoder.start_frame(write));
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // Safety: called after `acquire`, within its critical section.
        let log = unsafe { &mut *LOG.0.get() };
        log.put(|encoder, write| encoder.end_frame(write));
        flush(log.file, &mut log.buffer);
        log.open = false;
        // Safety: this is the state that `acquire` returned.
        unsafe { critical_section::release(log.restore) };
    }

    unsafe fn write(bytes: &[u8]) {
        // Safety: called after `acquire`, within its critical section.
        let log = unsafe { &mut *LOG.0.get() };
        log.put(|encoder, write| encoder.write(bytes, write));
    }
}
