//! The error model of the instrument, the measurements that a segment gives, and optional effects of real hardware.

pub mod correction;
pub mod error_model;
pub mod measurement;
pub mod options;
pub mod rotation;
pub mod stop_force;
