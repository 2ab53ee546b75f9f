//! Output of a command: results on the standard output, which may be full or closed, and notes on the standard error.

use std::fmt;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether only the outcome is printed. It is set once, before the command runs.
static QUIET: AtomicBool = AtomicBool::new(false);

/// From now on only the outcome is printed.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether only the outcome is printed.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Writes to the standard output. If that fails, prints the error in one line and ends the program with status 1.
pub fn write(text: fmt::Arguments<'_>) {
    if let Err(error) = std::io::stdout().write_fmt(text) {
        eprintln!("error: standard output: {error}");
        std::process::exit(1);
    }
}

/// As [`write`], but prints nothing in quiet mode.
pub fn write_unless_quiet(text: fmt::Arguments<'_>) {
    if !is_quiet() {
        write(text);
    }
}

/// As `print`, without its panic; prints nothing in quiet mode.
macro_rules! say {
    ($($text:tt)*) => {
        $crate::cli::output::write_unless_quiet(format_args!($($text)*))
    };
}

/// As `println`, without its panic; prints nothing in quiet mode.
macro_rules! sayln {
    ($($text:tt)*) => {
        $crate::cli::output::write_unless_quiet(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// As `println`, without its panic, in quiet mode too: for requested data and for the outcome.
macro_rules! must_sayln {
    ($($text:tt)*) => {
        $crate::cli::output::write(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// Prints a note on the standard error, except in quiet mode.
macro_rules! note {
    ($($text:tt)*) => {
        if !$crate::cli::output::is_quiet() {
            eprintln!("note: {}", format_args!($($text)*));
        }
    };
}

pub(crate) use {must_sayln, note, say, sayln};
