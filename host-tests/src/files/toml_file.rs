//! TOML files. An error is one line that names file, line and key.

use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
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
    #[error("{}", unknown(name, known))]
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
    /// The keys on the command line are wrong.
    #[error("{option}: {message}")]
    Keys {
        /// The option.
        option: &'static str,
        /// What is wrong. The text names the key.
        message: String,
    },
}

fn unknown(name: &str, known: &str) -> String {
    if name.contains('/') || name.ends_with(".toml") {
        format!("there is no file '{name}'; names in place of a file: {known}")
    } else {
        format!("unknown '{name}'; known: {known}, or a file")
    }
}

/// Where a text comes from.
enum Source {
    File(PathBuf),
    Option(&'static str),
}

/// The text of a TOML file. It is kept so that an error can name the line of a wrong value.
pub struct TomlFile {
    source: Source,
    text: String,
}

impl TomlFile {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not UTF-8.
    pub fn read(path: &Path) -> Result<Self, TomlFileError> {
        let text = std::fs::read_to_string(path).map_err(|cause| TomlFileError::Io { path: path.into(), cause })?;
        Ok(Self { source: Source::File(path.into()), text })
    }

    /// A file with a single table, whose keys are given on the command line, with commas between them.
    pub fn of_keys(option: &'static str, table: &str, keys: &str) -> Self {
        Self { source: Source::Option(option), text: format!("{table} = {{ {keys} }}") }
    }

    /// The contents of a file that has this table and nothing else.
    ///
    /// # Errors
    /// As [`Self::parse`]; or the table is missing, or the file has something else.
    pub fn only_table<T: DeserializeOwned>(&self, table: &str) -> Result<T, TomlFileError> {
        let all: toml::Table = self.parse().map_err(|error| match error {
            TomlFileError::Keys { option, message } => {
                let message = format!("not KEY = VALUE, KEY = VALUE with texts in quotes: {message}");
                TomlFileError::Keys { option, message }
            }
            other => other,
        })?;
        if let Some((other, value)) = all.iter().find(|(key, _)| *key != table) {
            let what = if value.is_table() {
                format!("this file may have the table [{table}] only; give a whole unit description as --config")
            } else {
                format!("is outside of a table; write [{table}] above it")
            };
            return Err(self.wrong_value("", other, &what));
        }
        let mut tables: BTreeMap<String, T> = self.parse()?;
        tables.remove(table).ok_or_else(|| self.content(1, format!("the table [{table}] is missing")))
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
            let key = match self.source {
                Source::File(_) => self.key_on(line).filter(|key| !message.contains(&format!("`{key}`"))),
                Source::Option(_) => self.key_before(at).filter(|_| !message.contains('`')),
            };
            self.content(line, key.map_or(message.clone(), |key| format!("{key}: {message}")))
        })
    }

    /// The error for a wrong value of `key` in the table `[table]`. An empty `table` means the keys before the first
    /// table. The line is that of the key, or else of the innermost table around it.
    pub fn wrong_value(&self, table: &str, key: &str, what: &str) -> TomlFileError {
        let joined = |table: &str, key: &str| if table.is_empty() { key.into() } else { format!("{table}.{key}") };
        let wanted: String = joined(table, key);
        let (mut current, mut depth, mut found) = (String::new(), 0, 1);
        for (number, line) in (1..).zip(self.text.lines()) {
            let header = line.trim().strip_prefix('[').and_then(|rest| rest.trim_start_matches('[').split(']').next());
            // A line that begins with numbers in brackets continues a value.
            let path = match header.filter(|header| !header.contains(',')) {
                Some(header) => {
                    current = header.trim().into();
                    current.clone()
                }
                None => self.key_on(number).map_or_else(String::new, |key| joined(&current, key)),
            };
            let around = wanted.strip_prefix(&path).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
            if around && path.len() >= depth {
                (depth, found) = (path.len(), number);
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

    /// The key whose value is at this place of the text.
    fn key_before(&self, at: usize) -> Option<&str> {
        let (before, _) = self.text.get(..at)?.rsplit_once('=')?;
        before.rsplit([',', '{', ' ']).find(|word| !word.is_empty())
    }

    fn content(&self, line: usize, message: String) -> TomlFileError {
        match &self.source {
            Source::File(path) => TomlFileError::Content { path: path.clone(), line, message },
            Source::Option(option) => TomlFileError::Keys { option, message },
        }
    }
}
