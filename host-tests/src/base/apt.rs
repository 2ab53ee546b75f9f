//! Programs and libraries of the system that the project needs. What is missing is installed where that is allowed.
//! Otherwise the error names it and the command that installs it.

use anyhow::{Result, ensure};
use std::env;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};

/// Looks for a program. If it is missing, installs its package where that is allowed.
///
/// # Errors
/// One line with the command that installs it.
pub fn ensure_installed(program: &str, package: &str) -> Result<()> {
    ensure(program, package, || runs(Command::new(program).arg("--version")))
}

/// As [`ensure_installed`], for a library: one of its files is `name` in a folder of libraries.
///
/// # Errors
/// One line with the command that installs it.
pub fn ensure_library(name: &str, package: &str) -> Result<()> {
    ensure(name, package, || {
        let folders = ["/usr/lib", "/usr/lib64", "/usr/local/lib"].map(Path::new);
        let inner = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
        // Debian has each version of LLVM in a folder `llvm-N/lib`.
        let all = inner.flat_map(|inner| [inner.path(), inner.path().join("lib")]).chain(folders.map(Path::to_owned));
        all.into_iter().any(|folder| folder.join(name).exists())
    })
}

fn ensure(program: &str, package: &str, is_there: impl Fn() -> bool) -> Result<()> {
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
