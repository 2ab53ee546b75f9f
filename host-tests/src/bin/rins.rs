//! The `rins` program.
fn main() {}
