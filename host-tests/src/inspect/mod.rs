//! Inspects a log: columns and units, sampling, noise, stops and moves, scheme, and which parameters are observable.
//!
//! ```text
//!          shape -> sketch -> geometry, names -> guess: a mapping
//! log  -->                                        |
//!          with the mapping: passage (samples, segments, alignment) -> turned (scheme)
//!                                        '-> allan, hunting -> shapes -> noise -> rows
//!                                        '-> residuals: encoders, and what the solver names -> what is observable
//! ```
//! Each arrow from the log reads the whole log once, in memory that does not grow with the length of the log.

pub mod allan;
pub mod geometry;
pub mod guess;
pub mod hunting;
mod inspection;
pub mod names;
pub mod noise;
pub mod passage;
pub mod residuals;
pub mod rows;
pub mod shape;
pub mod shapes;
pub mod sketch;
pub mod turned;

pub use inspection::*;
