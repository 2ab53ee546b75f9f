//! Numbers with their ranges, and errors that name the option of a wrong value.

use crate::files::toml_file::TomlFileError;
use anyhow::Context;

/// Adds the name of the option to an error about an unknown name or an unreadable file. Errors inside a file name the
/// file already.
pub fn of_option<T>(option: &'static str, found: Result<T, TomlFileError>) -> anyhow::Result<T> {
    match found {
        Err(error @ (TomlFileError::Name { .. } | TomlFileError::Io { .. })) => Err(error).context(option),
        found => Ok(found?),
    }
}

pub fn positive(text: &str) -> Result<f64, String> {
    number_in(text, 1e-6, 1e9)
}

pub fn at_least_one(text: &str) -> Result<f64, String> {
    number_in(text, 1.0, 1e3)
}

pub fn number_in(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_string())?;
    if (low..=high).contains(&number) { Ok(number) } else { Err(format!("not between {low} and {high}")) }
}
