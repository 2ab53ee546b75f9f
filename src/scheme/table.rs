//! Format of a scheme file. The core reads no files, so this file is not a module of it: `build.rs` and `host-tests`
//! include this file.

use serde::{Deserialize, Serialize};
use std::path::Path;

/// Keys of a scheme file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SchemeTable {
    #[serde(default)]
    pub name: String,
    #[serde(default = "default_rate")]
    pub rate_deg_s: f64,
    #[serde(default = "default_rate")]
    pub acceleration_deg_s2: f64,
    pub first_stop_s: f64,
    #[serde(default = "one_period")]
    pub periods: u8,
    pub legs: Vec<LegTable>,
}

/// One leg: a move, then a stop.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LegTable {
    pub outer_deg: f64,
    pub inner_deg: f64,
    pub stop_s: f64,
}

fn default_rate() -> f64 {
    20.0
}

fn one_period() -> u8 {
    1
}

impl SchemeTable {
    /// The name in the file, or, if the file has no name, the first eight characters of the file's own name.
    pub fn name_or(&self, path: &Path) -> String {
        let stem = || path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        // Eight characters are at most 32 bytes in UTF-8.
        if self.name.is_empty() { stem().chars().take(8).collect() } else { self.name.clone() }
    }
}
