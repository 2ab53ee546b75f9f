//! Rotation schemes: their legs, the library, and the form in which a file describes one.

mod legs;
pub mod library;
mod limits;

pub use legs::{Leg, SETTLING_S, Scheme, SchemeError, Turning};
pub use limits::{MAX_LEGS, MAX_NAME_BYTES};
