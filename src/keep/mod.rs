//! What outlasts a power-off or a reset: stored calibrations and the black box; and the liveness that the watchdog asks for.

pub mod black_box;
pub mod liveness;
pub mod medium;
pub mod record;
pub mod store;
