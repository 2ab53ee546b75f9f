//! Power-up self-calibration of a dual-axis rotational inertial navigation system (RINS).
//!
//! This page is the map. Each room is a module, and a room names only rooms above it in this list:
//!
//! | room | one job |
//! |---|---|
//! | [`base`] | shared types and mathematics: angles, samples, units, sites, motion profiles |
//! | [`drivers`] | IMUs, encoders and motor bridges over embedded-hal |
//! | [`segment`] | samples become segments: one segment is one stop or one move |
//! | [`scheme`] | rotation schemes and their library |
//! | [`model`] | the error model, the measurements that a segment gives, the correction of a sample |
//! | [`estimator`] | segments become parameters with a covariance |
//! | [`verdict`] | a solution becomes a verdict with reasons |
//! | [`gimbal`] | the control interrupt: encoder readings become motor duties |
//! | [`acquisition`] | the IMU's interrupt: readings become samples in a queue |
//! | [`run`] | one calibration run: configuration, policy, sequence, messages |
//! | [`keep`] | what outlasts a power-off or a reset: stored calibrations, black box, liveness |
//! | [`link`] | frames and payloads of the serial line |
//! | [`instrument`] | the one main loop |
//! | [`guide`] | chapters for users, no code |
//!
//! ```text
//! IMU interrupt -> acquisition -> queue -> instrument (main loop)
//!                                             |
//!       segment -> model -> estimator -> verdict -> run -> keep, link
//!                                                    |-> motion commands -> gimbal -> drivers
//!                                                    '-> corrected samples -> sink
//! ```
//!
//! # Where to look
//!
//! | question | place |
//! |---|---|
//! | What do the accelerometers measure at a stop? | [`model::stop_force`] |
//! | What do the gyros measure in a move? | [`model::rotation`] |
//! | How is one sample corrected? | [`model::correction::Calibration::correct`] |
//! | When was a stop not at rest? | [`verdict::unrest`] |
//! | What happens at power-up? | [`instrument::Instrument::power_up`], then the edges of [`run::sequencer`] |
//!
//! # Conventions
//!
//! Frames: n local level (east, north, up); b vehicle, equal to r at gimbal angles (0, 0); r fixed to the inner gimbal,
//! x along the outer axis and z along the inner axis; s IMU; a and g the own axes of the accelerometers and of the
//! gyros. `rot_ab` takes b-components to a-components. All values are in SI units and radians. Rooms decide and return
//! values; only drivers touch pins. No room has a clock of its own: the caller gives the time as an argument, or as a
//! function that reads the clock of the board.
//!
//! # Features
//!
//! The library has one feature, `defmt`: the public types that a firmware logs implement `defmt::Format`. All other
//! features belong to the firmware binary: a board (`mps2-an500`, `mps2-an386`, `stm32h743`), the IMU (`kvh1750` in
//! place of the ADIS16495) and the scalar (`single-precision`: f32 in place of f64).
//!
//! Source of the method: Bai et al., "A System-Level Self-Calibration Method for Installation Errors in a Dual-Axis
//! Rotational Inertial Navigation System", Sensors 2019, 19(18), 4005.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod base;

pub mod drivers;

pub mod segment;

pub mod scheme;

pub mod model;

pub mod estimator;

pub mod verdict;

pub mod gimbal;

pub mod acquisition;

pub mod run;

pub mod keep;

pub mod link;

pub mod instrument;

pub mod guide;
