#![doc = "Power-up self-calibration of a dual-axis rotational inertial navigation system."]
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod acquisition;
pub mod angle;
pub mod assignment;
pub mod axis;
pub mod calibrator;
pub mod constancy;
pub mod device;
pub mod error_model;
pub mod estimator;
pub mod intake;
pub mod kalman;
pub mod linear;
pub mod measurement;
pub mod method;
pub mod observability;
pub mod options;
pub mod queue;
pub mod sample;
pub mod scheme;
pub mod segment;
pub mod self_calibration;
pub mod sequencer;
pub mod site;
pub mod store;
pub mod telemetry;
pub mod units;
pub mod verdict;
pub mod wiring;
