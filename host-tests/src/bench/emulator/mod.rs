//! The firmware image in QEMU, with the host as its bench.

pub mod debugger;
pub mod image;
mod machine;

pub use machine::*;
