//! TOML files. An error is one line that names file, line and key.

use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Why a TOML file is refused.
#[derive(Debug, thiserror::Error)]
pub enum TomlFileError {
    /// The file cannot be read or written.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The name is neither built in nor a file.
    #[error("unknown '{name}'; known: {known}, or a file")]
    Name {
        /// The requested name.
        name: String,
        /// The built-in names.
        known: &'static str,
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

/// The text of a TOML file. It is kept so that an error can name the line of a wrong value.
pub struct TomlFile {
    path: PathBuf,
    text: String,
}

impl TomlFile {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not UTF-8.
    pub fn read(path: &Path) -> Result<Self, TomlFileError> {
        let text = std::fs::read_to_string(path).map_err(|cause| TomlFileError::Io { path: path.into(), cause })?;
        Ok(Self { path: path.into(), text })
    }

    /// A text that does not come from a file. Errors give `name` in place of a path.
    pub fn of_text(name: &str, text: &str) -> Self {
        Self { path: name.into(), text: text.into() }
    }

    /// The contents as a value.
    ///
    /// # Errors
    /// The syntax is wrong, a key is unknown, or a value has the wrong type.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, TomlFileError> {
        toml::from_str(&self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start.min(self.text.len()));
            let line = self.text.as_bytes()[..at].iter().filter(|&&byte| byte == b'\n').count() + 1;
            let named = error.message().split('`').nth(1);
            let line = named.map_or(line, |key| self.line_of(line, key));
            let message = error.message().trim().replace('\n', "; ");
            let key = self.key_on(line).filter(|key| !message.contains(&format!("`{key}`")));
            self.content(line, key.map_or(message.clone(), |key| format!("{key}: {message}")))
        })
    }

    /// The error for a wrong value of `key` in the table `[table]`. An empty `table` means the keys before the first
    /// table.
    pub fn wrong_value(&self, table: &str, key: &str, what: &str) -> TomlFileError {
        let mut current = "";
        let mut found = 1;
        for (number, line) in (1..).zip(self.text.lines()) {
            let line = line.trim();
            if line.starts_with('[') {
                current = line.trim_start_matches('[').split(']').next().unwrap_or("").trim();
            } else if current == table && self.key_on(number) == Some(key) {
                found = number;
            }
        }
        self.content(found, format!("{key}: {what}"))
    }

    /// The first line from `line` on that sets `key`. It is `line` itself if no line sets the key, so that errors of a
    /// whole table are reported at the first line of the table.
    fn line_of(&self, line: usize, key: &str) -> usize {
        let lines = line..=self.text.lines().count();
        lines.into_iter().find(|line| self.key_on(*line) == Some(key)).unwrap_or(line)
    }

    fn key_on(&self, line: usize) -> Option<&str> {
        let (key, _) = self.text.lines().nth(line - 1)?.split_once('=')?;
        Some(key.trim().trim_matches('"'))
    }

    fn content(&self, line: usize, message: String) -> TomlFileError {
        TomlFileError::Content { path: self.path.clone(), line, message }
    }
}
