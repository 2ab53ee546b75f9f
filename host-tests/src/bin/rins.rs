//! The `rins` program. See [`host_tests::cli`].

use nix::sys::signal::{SigHandler, Signal, signal};
use std::process::ExitCode;

fn main() -> ExitCode {
    // Safety: no handler is installed. A closed pipe ends the program, as usual for a filter.
    let _ = unsafe { signal(Signal::SIGPIPE, SigHandler::SigDfl) };
    host_tests::cli::main()
}
