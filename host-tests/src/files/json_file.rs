//! JSON files. An error is one line that names file, line and key.

use anyhow::Context;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Why a JSON file is refused.
#[derive(Debug, thiserror::Error)]
pub enum JsonFileError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The contents are wrong.
    #[error("{}:{line}: {message}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong. The text names the key.
        message: String,
    },
}

/// Reads a file.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, JsonFileError> {
    let text = std::fs::read_to_string(path).map_err(|cause| JsonFileError::Io { path: path.into(), cause })?;
    serde_json::from_str(&text).map_err(|error| {
        let text = error.to_string();
        let message = text.rsplit_once(" at line ").map_or(text.as_str(), |(message, _)| message);
        JsonFileError::Content { path: path.into(), line: error.line().max(1), message: message.into() }
    })
}

/// Writes a report.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_json(path: &Path, report: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(report).with_context(|| path.display().to_string())?;
    std::fs::write(path, text + "\n").with_context(|| path.display().to_string())
}
