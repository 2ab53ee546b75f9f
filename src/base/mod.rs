//! Shared types and mathematics. Every room may use this room; this room uses no other room.

pub mod angle;
pub mod bounds;
pub mod clock_check;
#[cfg(test)]
pub(crate) mod golden;
pub mod hardware;
pub mod imu_identity;
pub mod linear;
pub mod loss;
pub mod method;
pub mod profile;
pub mod restart;
pub mod sample;
pub mod site;
pub mod units;
