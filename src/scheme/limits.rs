//! What a scheme has room for. `build.rs` reads this file too.

/// Most legs of one period.
pub const MAX_LEGS: usize = 48;
/// Longest name, bytes.
pub const MAX_NAME_BYTES: usize = 32;
