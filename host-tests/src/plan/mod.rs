//! Finds rotation schemes: the stops, in which order and for how long, that make the parameters that matter as good as
//! they can be within a given time.
//!
//! - `information`: what a scheme will bring, from its geometry alone, in a twentieth of a millisecond
//! - `objective`: which parameters matter, and how they are weighed
//! - `search`: simulated annealing over the stops
//! - `bound`: what no scheme can go below
//! - `request`: what is asked for; `planning`: what comes of it
//! - `observability`: what a rotation scheme makes observable
//! - `prediction`: what the core makes of a scheme

pub mod bound;
pub mod information;
pub mod objective;
pub mod observability;
mod planning;
pub mod prediction;
mod request;
pub mod search;

pub use planning::*;
pub use request::*;
