//! The error model of the instrument, the measurements that a segment gives, and the effects of real hardware.

pub mod correction;
pub mod effects;
pub mod error_model;
pub mod measurement;
pub mod rotation;
pub mod stop_force;
