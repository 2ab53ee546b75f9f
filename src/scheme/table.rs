//! A scheme file. No module of the library, which reads no files: `build.rs` and host-tests both include this.

use serde::{Deserialize, Serialize};
use std::path::Path;

/// The keys of the file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SchemeTable {
    #[serde(default)]
    pub name: String,
    #[serde(default = "twenty")]
    pub rate_deg_s: f64,
    #[serde(default = "twenty")]
    pub acceleration_deg_s2: f64,
    pub first_stop_s: f64,
    #[serde(default = "once")]
    pub periods: u8,
    pub legs: Vec<LegTable>,
}

/// A move and the stop after it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LegTable {
    pub outer_deg: f64,
    pub inner_deg: f64,
    pub stop_s: f64,
}

fn twenty() -> f64 {
    20.0
}

fn once() -> u8 {
    1
}

impl SchemeTable {
    /// The name it has, or else the start of its file's.
    pub fn name_or(&self, path: &Path) -> String {
        let stem = || path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        // Eight characters are at most 32 bytes.
        if self.name.is_empty() { stem().chars().take(8).collect() } else { self.name.clone() }
    }
}
