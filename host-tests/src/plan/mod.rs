//! Finds rotation schemes: the stops, their order and their durations, with the smallest sigmas of chosen parameters in
//! a given time.
//!
//! - `leg_model`: the measurement model of one leg; `information`: the information about the parameters
//! - `forecast`: the information of a scheme, from its geometry alone, in 0.05 ms for ideal hardware
//! - `shared_noise`: the same with the imperfections of the hardware; `triangle`: the Cholesky factor
//! - `objective`: the chosen parameters and their weights
//! - `search`: simulated annealing over the stops
//! - `bound`: the lower bound of any scheme
//! - `request`: the request; `planning`: the search with its result
//! - `rates`: the same at several rates of the axes
//! - `observability`: rank and condition number of a scheme
//! - `prediction`: the sigmas that the core reaches with a scheme
//! - `costs`: what each imperfection of the hardware costs

pub mod bound;
pub mod costs;
mod forecast;
mod information;
mod leg_model;
pub mod objective;
pub mod observability;
mod planning;
pub mod prediction;
pub mod rates;
mod request;
mod search;
mod shared_noise;
mod triangle;

pub use planning::*;
pub use request::*;
