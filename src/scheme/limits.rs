//! Sizes of a scheme. `build.rs` includes this file too.

/// Largest number of legs in one period.
pub const MAX_LEGS: usize = 48;
/// Longest name of a scheme, bytes.
pub const MAX_NAME_BYTES: usize = 32;
