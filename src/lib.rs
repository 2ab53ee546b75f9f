#![doc = "Power-up self-calibration of a dual-axis rotational inertial navigation system."]
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod acquisition;
pub mod angle;
pub mod device;
pub mod error_model;
pub mod linear;
pub mod method;
pub mod queue;
pub mod sample;
pub mod scheme;
pub mod site;
pub mod store;
pub mod telemetry;
pub mod units;
