//! A log and the mapping of its columns.

use crate::cli::files::NamedFile;
use crate::log::{Layout, Mapping};
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct LogArguments {
    /// Log: CSV, Parquet or a raw matrix; CSV and matrix may be compressed with gzip
    #[arg(value_name = "LOG")]
    pub log: PathBuf,
    /// Mapping of the log's columns and units [default: the standard columns]
    #[arg(long, value_name = "MAP.toml")]
    mapping: Option<PathBuf>,
}

impl LogArguments {
    /// The input files.
    pub fn inputs(&self) -> [NamedFile<'_>; 2] {
        [("LOG", Some(&self.log)), ("--mapping", self.mapping.as_deref())]
    }

    /// Layout of the log: from its mapping file if one is given, otherwise the standard layout.
    pub fn layout(&self) -> anyhow::Result<Layout> {
        let mapped = self.mapping.as_deref().map(|mapping| Mapping::read(mapping, &self.log));
        Ok(mapped.unwrap_or_else(|| Ok(Layout::standard(&self.log)))?)
    }
}
