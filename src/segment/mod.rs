//! From samples to segments: a segment is one stop or one move, and only its sums are kept.

mod block;
pub mod intake;
pub mod readings;
pub mod scatter;
mod segmenter;
mod sums;
mod types;
pub mod white_noise;

pub use segmenter::{GUARD_S, Segmenter, Stillness};
pub use types::*;
