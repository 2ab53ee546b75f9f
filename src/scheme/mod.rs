//! Rotation schemes: their legs, the library of named schemes, and the format of scheme files.

mod legs;
pub mod library;
mod limits;

pub use legs::{Leg, SETTLING_S, Scheme, SchemeError, Turning};
pub use limits::{MAX_LEGS, MAX_NAME_BYTES};
