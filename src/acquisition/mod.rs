//! From the IMU's interrupt to the queue of samples that the main loop reads.

pub mod queue;
mod sampler;

pub use sampler::{Acquisition, Sampler, Streaming, View};
