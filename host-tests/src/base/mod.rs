//! Shared by all rooms: parameters in report units, the numbers of the paper, and programs of the system.

pub mod apt;
pub mod bai;
pub mod quantity;
