#![doc = "Power-up self-calibration of a dual-axis rotational inertial navigation system."]
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod angle;
pub mod error_model;
pub mod linear;
pub mod sample;
pub mod scheme;
pub mod site;
pub mod units;
