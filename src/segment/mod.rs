//! From samples to segments. A segment is one stop or one move. Only the sums of its samples are kept.

mod block;
mod increments;
pub mod intake;
pub mod readings;
pub mod scatter;
mod segmenter;
mod sums;
mod types;
pub mod white_noise;

pub use segmenter::{GUARD_S, Segmenter, Stillness};
pub use types::*;
