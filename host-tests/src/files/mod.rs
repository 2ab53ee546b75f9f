//! Files that a user writes and that say what a unit, its site, its errors or a scheme is.

pub mod json_file;
pub mod scheme_file;
pub mod toml_file;
pub mod truth;
pub mod unit_file;
