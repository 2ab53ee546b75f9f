//! Control of both gimbal axes: from encoder readings to motor duties, once in every control period.

pub mod angle_history;
pub mod axis;
mod both_axes;
pub mod control;
pub mod fault;
pub mod servo;

pub use both_axes::*;
pub use fault::{BridgeFault, EncoderFault, Fault, FaultKind};
