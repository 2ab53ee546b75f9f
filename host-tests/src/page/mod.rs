//! Results as self-contained pages and figures.

mod calibration;
mod canvas;
mod figures;
mod frame;
mod paste;
pub mod plot;
mod replication;

pub use calibration::*;
pub use replication::write_replication;
