//! From segments to parameters: the filter, the estimators of both methods, and tests for change.

pub mod constancy;
pub mod filter;
mod joint;
pub mod observability;
pub mod rehearsal;
pub mod two_stage;

pub use joint::*;
