//! The emulator itself.

use super::EMULATOR;
use anyhow::{Result, ensure};
use std::env;
use std::fs::File;
use std::process::{Command, Stdio};

/// Looks for the emulator and installs it where that is allowed.
///
/// # Errors
/// One line with the command that installs it.
pub fn ensure_emulator() -> Result<()> {
    if runs(Command::new(EMULATOR).arg("--version")) {
        return Ok(());
    }
    let lock = File::create(env::temp_dir().join("rins-selfcal-install.lock"))?;
    lock.lock()?;
    let install = format!("apt-get update && apt-get install -y {EMULATOR}");
    let root = nix::unistd::geteuid().is_root();
    let shell = format!("export DEBIAN_FRONTEND=noninteractive; {install}");
    let installed = if root {
        runs(Command::new("sh").args(["-c", &shell]))
    } else {
        runs(Command::new("sudo").args(["-n", "sh", "-c", &shell]))
    };
    let hint = if root { install } else { format!("sudo sh -c '{install}'") };
    ensure!(
        installed && runs(Command::new(EMULATOR).arg("--version")),
        "{EMULATOR} is not installed; install it with: {hint}"
    );
    Ok(())
}

fn runs(command: &mut Command) -> bool {
    let quiet = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    quiet.status().is_ok_and(|status| status.success())
}
