//! The `rins` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    host_tests::cli::main()
}
