//! Inspects a log: columns and units, sampling, noise, stops and moves, scheme, and which parameters are observable.
//!
//! ```text
//!          shape -> sketch -> geometry, names -> guess: a mapping
//! log  -->                                        |
//!          with the mapping: passage (samples, segments, alignment) -> turned (scheme)
//!                                        '-> allan -> noise -> what is observable
//! ```
//! Each arrow from the log reads the whole log once, in memory that does not grow with the length of the log.

pub mod allan;
pub mod geometry;
pub mod guess;
mod inspection;
pub mod names;
pub mod noise;
pub mod passage;
pub mod shape;
pub mod sketch;
pub mod turned;

pub use inspection::*;
