//! `rins history`

use super::ending::Ending;
use super::files;
use super::output::{say, sayln};
use crate::files::json_file::write_json;
use crate::monitor::history::{History, MemoryKind};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct HistoryArguments {
    /// Image of an instrument's memory: the EEPROM, or the sectors of the flash
    memory: PathBuf,
    /// Kind of memory [default: flash if the image has 256 KiB or more]
    #[arg(long, value_enum)]
    kind: Option<KindArgument>,
    /// Write the entries to this file, newest first
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
}

/// Kind of memory that an image was taken from.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum KindArgument {
    /// The EEPROM from address 0 on
    Eeprom,
    /// Whole flash sectors of 128 KiB
    Flash,
}

pub fn run(arguments: &HistoryArguments) -> anyhow::Result<Ending> {
    files::check(&[("MEMORY", Some(&arguments.memory))], &[("--json", arguments.json.as_deref())])?;
    let kind = arguments.kind.map(|kind| match kind {
        KindArgument::Eeprom => MemoryKind::Eeprom,
        KindArgument::Flash => MemoryKind::Flash,
    });
    show(&History::read(&arguments.memory, kind)?, arguments.json.as_deref())?;
    Ok(Ending::Done)
}

/// Prints a history, and writes it to a file if one is given.
pub fn show(history: &History, json: Option<&Path>) -> anyhow::Result<()> {
    say!("{history}");
    if let Some(path) = json {
        write_json(path, &history.report())?;
        sayln!("written: {}", path.display());
    }
    Ok(())
}
