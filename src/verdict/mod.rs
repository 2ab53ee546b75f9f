//! From a solution to a verdict with reasons.

mod judge;
mod reason;
mod scale;
mod setting;
pub mod wiring;

pub use judge::*;
pub use reason::{CHANNEL_NAMES, Reason, Sensors, Unrest};
pub use scale::WrongScale;
pub use setting::WrongSetting;
