//! The firmware's images, which cargo builds for each board with its own configuration.

use crate::bench::imu::Imu;
use anyhow::{Context, Result, bail, ensure};
use std::env;
use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The target of the firmware.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The profile of the firmware in `Cargo.toml`.
const PROFILE: &str = "firmware";

/// A board or emulated machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Board {
    /// QEMU's Cortex-M7 with double precision
    Mps2An500,
    /// QEMU's Cortex-M4F: `f32`
    Mps2An386,
    /// NUCLEO-H743ZI2, on a register model of its chip
    Stm32h743,
}

impl Board {
    /// Name of the firmware's feature and, for emulated boards, of the emulator's machine.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mps2An500 => "mps2-an500",
            Self::Mps2An386 => "mps2-an386",
            Self::Stm32h743 => "stm32h743",
        }
    }

    /// Whether QEMU supports the board.
    pub const fn is_emulated(self) -> bool {
        !matches!(self, Self::Stm32h743)
    }

    /// Additional cargo configuration for the processor.
    const fn configuration(self) -> Option<&'static str> {
        match self {
            Self::Mps2An500 | Self::Stm32h743 => None,
            Self::Mps2An386 => Some(".cargo/cortex-m4.toml"),
        }
    }
}

/// The target of an image: board and IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// The board.
    pub board: Board,
    /// The board's IMU.
    pub imu: Imu,
}

impl Variant {
    /// The features, combined in one name.
    pub fn features(self) -> String {
        let imu = match self.imu {
            Imu::Adis16495 => "",
            Imu::Kvh1750 => ",kvh1750",
        };
        format!("{}{imu}", self.board.name())
    }
}

impl From<Board> for Variant {
    /// The board with an ADIS16495.
    fn from(board: Board) -> Self {
        Self { board, imu: Imu::Adis16495 }
    }
}

/// An image and its board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// The ELF file.
    pub path: PathBuf,
    /// The board.
    pub board: Board,
    /// The board's IMU.
    pub imu: Imu,
}

impl Image {
    /// The ELF file's bytes.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(&self) -> Result<Vec<u8>> {
        fs::read(&self.path).with_context(|| format!("cannot read {}", self.path.display()))
    }
}

/// Builds the firmware and returns its image. Installs the target if the toolchain lacks it.
///
/// # Errors
/// One line that names the missing part and the command that installs it, or the output of cargo.
pub fn build(variant: impl Into<Variant>) -> Result<Image> {
    let variant = variant.into();
    let (root, targets) = places()?;
    // Each image has its own directory, because a running `cargo test` locks the usual directory and the images differ.
    let directory = targets.join(variant.features().replace(',', "-"));
    fs::create_dir_all(&directory).with_context(|| format!("cannot make {}", directory.display()))?;
    // Only one process builds or installs at a time.
    let lock = File::create(directory.join(".lock"))?;
    lock.lock()?;
    ensure_target(&root)?;
    let output = cargo()
        .current_dir(&root)
        .args(["build", "--profile", PROFILE, "--quiet", "--package", "rins-selfcal", "--bin", "firmware"])
        .args(["--features", &variant.features(), "--target", TARGET, "--target-dir"])
        .arg(&directory)
        .args(variant.board.configuration().iter().flat_map(|file| ["--config", file]))
        .output()
        .context("cannot run cargo")?;
    ensure!(output.status.success(), "the firmware does not build:\n{}", String::from_utf8_lossy(&output.stderr));
    Ok(Image { path: directory.join(TARGET).join(PROFILE).join("firmware"), board: variant.board, imu: variant.imu })
}

/// The workspace, and the folder of its builds.
pub(super) fn places() -> Result<(PathBuf, PathBuf)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("host-tests has no parent")?;
    let targets = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), |dir| root.join(dir));
    Ok((root.to_owned(), targets))
}

/// cargo without the environment that replaces or doubles the linker arguments of `.cargo/config.toml`.
pub(super) fn cargo() -> Command {
    let mut command = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    for name in ["RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS", "CARGO_BUILD_RUSTFLAGS", "CARGO_BUILD_TARGET"] {
        command.env_remove(name);
    }
    let of_target = |name: &OsString| {
        let name = name.to_string_lossy();
        name.starts_with("CARGO_TARGET_") && name.ends_with("_RUSTFLAGS")
    };
    for name in env::vars_os().map(|(name, _)| name).filter(of_target) {
        command.env_remove(name);
    }
    command
}

fn ensure_target(root: &Path) -> Result<()> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc)
        .current_dir(root)
        .args(["--print", "target-libdir", "--target", TARGET])
        .output()
        .context("cannot run rustc")?;
    if output.status.success() && Path::new(String::from_utf8_lossy(&output.stdout).trim()).is_dir() {
        return Ok(());
    }
    let added = Command::new("rustup").current_dir(root).args(["target", "add", TARGET]).output();
    match added {
        Ok(output) if output.status.success() => Ok(()),
        _ => bail!("the toolchain lacks the firmware's target; install it with: rustup target add {TARGET}"),
    }
}
