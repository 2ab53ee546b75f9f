//! Power-up self-calibration of a dual-axis rotational inertial navigation system (RINS).
//!
//! ```text
//! data-ready interrupt                                main loop
//! drivers -> acquisition -> queue->| intake -> segment -> measurement -> kalman -> estimator -> verdict -> store
//!                                  |    '------------- calibrator -------------'
//!                                  | sequencer -> motion commands
//!                                  '---------------- self_calibration ------------------------> telemetry
//! ```
//! Rooms decide and return values; only drivers touch pins. Time is an argument. Dictionaries, which every room may use:
//! `units`, `angle`, `linear`, `site`, `sample`, `error_model`, `profile`, `scheme`, `method`, `policy`.
//!
//! The control interrupt, once a millisecond, is `control`: encoders -> gimbal (both axes, faults) -> axis (profile) -> servo
//! -> bridges. Its angles go through `angle_history` into the samples.
//!
//! Beside the estimator: `options` (further states), `scatter`, `reading` and `white_noise` (what a stop shows of it), `weighting`
//! (gains of the two-stage method), `constancy` (tests for change), `observability`, and `rehearsal`, which before anything
//! turns gives the estimator the segments that a scheme would bring. Beside the verdict: `wiring`. Beside all: `liveness`, for the watchdog, and `black_box`, for
//! the next start. `assignment` is the configuration
//! of all rooms. `telemetry` is the messages of all rooms; calibrator and self_calibration tell them to whoever calls.
//! `link` carries them over a serial line, and commands back.
//!
//! Frames: n local level (east, north, up); b vehicle, which is r at gimbal angles (0, 0); r fixed to the inner gimbal, x
//! along the outer and z along the inner axis; s IMU; a, g the accelerometers' and the gyros' own axes. `rot_ab` takes
//! b-components to a-components. SI units, radians.
//!
//! [`guide`] leads from a first calibration to the reasons of a rejected one.
//!
//! Source of the method: Bai et al., "A System-Level Self-Calibration Method for Installation Errors in a Dual-Axis
//! Rotational Inertial Navigation System", Sensors 2019, 19(18), 4005.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod acquisition;
pub mod base;
pub mod drivers;
pub mod estimator;
pub mod gimbal;
pub mod guide;
pub mod instrument;
pub mod keep;
pub mod link;
pub mod model;
pub mod run;
pub mod scheme;
pub mod segment;
pub mod verdict;
