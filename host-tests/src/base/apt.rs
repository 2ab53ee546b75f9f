//! Programs of the system that the project needs. A missing program is installed where that is allowed. Otherwise the
//! error names the program and the command that installs it.

use anyhow::{Result, ensure};
use std::env;
use std::fs::File;
use std::process::{Command, Stdio};

/// Looks for a program. If it is missing, installs its package where that is allowed.
///
/// # Errors
/// One line with the command that installs it.
pub fn ensure_installed(program: &str, package: &str) -> Result<()> {
    let is_there = || runs(Command::new(program).arg("--version"));
    if is_there() {
        return Ok(());
    }
    // Only one process installs at a time.
    let lock = File::create(env::temp_dir().join("rins-selfcal-install.lock"))?;
    lock.lock()?;
    let install = format!("apt-get update && apt-get install -y {package}");
    let shell = format!("export DEBIAN_FRONTEND=noninteractive; {install}");
    let root = nix::unistd::geteuid().is_root();
    let installed = is_there()
        || if root {
            runs(Command::new("sh").args(["-c", &shell]))
        } else {
            runs(Command::new("sudo").args(["-n", "sh", "-c", &shell]))
        };
    let hint = if root { install } else { format!("sudo sh -c '{install}'") };
    ensure!(installed && is_there(), "{program} is not installed; install it with: {hint}");
    Ok(())
}

fn runs(command: &mut Command) -> bool {
    let quiet = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    quiet.status().is_ok_and(|status| status.success())
}
