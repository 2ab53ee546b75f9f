//! Files that a user writes to describe a unit, its site, its errors or a scheme.

pub mod commissioning;
pub mod hardware;
pub mod json_file;
pub mod scheme_file;
pub mod toml_file;
pub mod truth;
pub mod unit_file;
