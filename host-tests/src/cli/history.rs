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
    /// Image of an instrument's memory: of its EEPROM, or of the sectors of its flash
    memory: PathBuf,
    /// What the image is of [default: a flash from 256 KiB on]
    #[arg(long, value_enum)]
    kind: Option<KindArgument>,
    /// Write the entries, newest first
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
}

/// What an image is of.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum KindArgument {
    /// From its address 0 on
    Eeprom,
    /// Whole sectors of 128 KiB
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

/// Shows a history, and writes it where it is wanted.
pub fn show(history: &History, json: Option<&Path>) -> anyhow::Result<()> {
    say!("{history}");
    if let Some(path) = json {
        write_json(path, &history.report())?;
        sayln!("written: {}", path.display());
    }
    Ok(())
}
