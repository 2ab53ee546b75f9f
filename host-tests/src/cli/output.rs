//! The standard output, which may be full or gone.

use std::fmt;
use std::io::Write;

/// Writes to the standard output; where it takes no more, says so in one line and ends the program with status 1.
pub fn write(text: fmt::Arguments<'_>) {
    if let Err(error) = std::io::stdout().write_fmt(text) {
        eprintln!("error: standard output: {error}");
        std::process::exit(1);
    }
}

/// As `print`, without its panic.
macro_rules! say {
    ($($text:tt)*) => {
        $crate::cli::output::write(format_args!($($text)*))
    };
}

/// As `println`, without its panic.
macro_rules! sayln {
    ($($text:tt)*) => {
        $crate::cli::output::write(format_args!("{}\n", format_args!($($text)*)))
    };
}

pub(crate) use {say, sayln};
