//! From a solution to a verdict with reasons.

mod assessment;
mod fit;
mod judge;
mod limits;
mod motion;
mod noise;
mod reason;
mod scale;
mod setting;
pub mod wiring;

pub use assessment::{Assessment, Verdict};
pub use fit::is_good_fit;
pub use judge::judge;
pub use limits::{LIMIT_BOUNDS, VerdictLimits};
pub use motion::unrest;
pub use reason::{CHANNEL_NAMES, Reason, Sensors, Unrest};
pub use scale::WrongScale;
pub use setting::WrongSetting;
