//! What a command says: on the standard output, which may be full or gone, and in notes on the standard error.

use std::fmt;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether only how it ends is to be said. Set once, before a command runs.
static QUIET: AtomicBool = AtomicBool::new(false);

/// From here on nothing is said but how it ends.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether nothing is to be said but how it ends.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Writes to the standard output; where it takes no more, says so in one line and ends the program with status 1.
pub fn write(text: fmt::Arguments<'_>) {
    if let Err(error) = std::io::stdout().write_fmt(text) {
        eprintln!("error: standard output: {error}");
        std::process::exit(1);
    }
}

/// As [`write`], unless nothing is to be said.
pub fn write_unless_quiet(text: fmt::Arguments<'_>) {
    if !is_quiet() {
        write(text);
    }
}

/// As `print`, without its panic; nothing where nothing is to be said.
macro_rules! say {
    ($($text:tt)*) => {
        $crate::cli::output::write_unless_quiet(format_args!($($text)*))
    };
}

/// As `println`, without its panic; nothing where nothing is to be said.
macro_rules! sayln {
    ($($text:tt)*) => {
        $crate::cli::output::write_unless_quiet(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// As `println`, without its panic: what was asked for, or how it ends.
macro_rules! must_sayln {
    ($($text:tt)*) => {
        $crate::cli::output::write(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// A line on the standard error that is no error.
macro_rules! note {
    ($($text:tt)*) => {
        if !$crate::cli::output::is_quiet() {
            eprintln!("note: {}", format_args!($($text)*));
        }
    };
}

pub(crate) use {must_sayln, note, say, sayln};
