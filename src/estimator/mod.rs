//! From segments to parameters: the filter, the estimator with both methods, and the tests for changes during a run.

mod bai;
mod configuration;
pub mod constancy;
pub mod filter;
mod joint;
mod kinds;
mod passes;
pub mod rehearsal;
mod solution;
mod sweep;

pub use configuration::{
    BEFORE_EFFECTS, BEFORE_PARAMETERS, BaiTuning, EstimatorConfig, HEADING_BOUNDS, HeadingSource, KNOWN_LATITUDE_RAD,
    STATES, TUNING_BOUNDS,
};
pub use joint::{Estimator, LEAST_TURN_RAD, MAX_SEGMENTS};
pub use solution::{EffectEstimates, Estimate, Fit, LargestInnovation, OBSERVED_RATIO, SegmentInnovations, Solution};
