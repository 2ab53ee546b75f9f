//! Results as self-contained pages and figures.

mod calibration;
mod canvas;
mod drawings;
mod figures;
mod frame;
mod paper;
mod paste;
pub mod plot;
mod replication;

pub use calibration::*;
pub use replication::write_replication;
