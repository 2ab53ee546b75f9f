//! Control of both gimbal axes: from encoder readings to motor duties, once in every control period.

pub mod angle_history;
pub mod axis;
mod both_axes;
#[cfg(test)]
mod closed_loop;
pub mod control;
#[cfg(test)]
mod extremes;
pub mod fault;
#[cfg(test)]
mod plant;
pub mod servo;
pub mod tracker;
pub mod travel;

pub use both_axes::*;
pub use fault::{BridgeFault, EncoderFault, Fault, FaultKind, TurnFault};
pub use travel::{LocateError, LocateRefusal, Travel, TurnSource, TurnState};
