//! What a calibration gave, as JSON and as tables, and held against another one.

pub mod comparison;
pub mod report;
pub mod saved;
pub mod signals;
pub mod table;
