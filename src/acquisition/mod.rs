//! From the interrupt of the IMU to the queue of samples that the main loop reads.

pub mod queue;
mod sampler;

pub use sampler::{Acquisition, GimbalView, Sampler, Streaming};
