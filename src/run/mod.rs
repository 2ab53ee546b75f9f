//! A calibration run of the whole instrument: its configuration, policy, sequence, and the messages that it sends.

pub mod abort;
pub mod assignment;
pub mod calibrator;
pub mod config;
#[cfg(test)]
mod golden;
pub mod policy;
pub mod result;
pub mod self_calibration;
pub mod sequencer;
pub mod state;
pub mod telemetry;
pub mod unit;
