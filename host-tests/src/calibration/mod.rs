//! Runs the core's chain on readings of a virtual unit or of a log.

mod chain;
pub mod method;
pub mod refusal;
pub mod replay;
pub mod virtual_run;

pub use chain::*;
pub use method::HostMethod;
