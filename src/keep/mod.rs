//! What outlasts a power-off or a reset: stored calibrations and the black box. Also the liveness check of the
//! watchdog.

pub mod black_box;
pub mod frame;
pub mod liveness;
pub mod medium;
pub mod record;
pub mod slots;
pub mod store;
