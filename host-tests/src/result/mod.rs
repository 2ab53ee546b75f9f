//! The result of a calibration as JSON and as tables, and its comparison with another result.

pub mod comparison;
pub mod report;
pub mod saved;
pub mod signals;
pub mod table;
