//! Virtual RINS, bench and reports around the core of `rins-selfcal`.
//!
//! ```text
//! base -> files -> virtual_unit -> log -> calibration -> separating -> result -> plan -> inspect \
//!                       |                      |                     |              page, monitor -> cli
//!                       '------> bench --------'------> study -------'             /
//! ```
//! Each room knows only rooms that are above it in this list:
//! - `base`: parameters in report units, the numbers of the paper, programs of the system
//! - `files`: what a user writes: the unit, its true errors, a scheme
//! - `virtual_unit`: an instrument that exists in numbers only, along a scheme or with its windings driven
//! - `log`: readings from files and into files
//! - `calibration`: readings through the core's chain
//! - `separating`: readings through the methods that the paper compares itself with
//! - `result`: what came of it: JSON, tables, signals, comparison
//! - `plan`: finds schemes, and predicts what the core makes of them
//! - `inspect`: what a log of any columns is
//! - `bench`: the instrument's devices, and on them the core in this process or the firmware in the emulator
//! - `study`: many runs: statistics, disturbances, failures, and the paper's own results
//! - `page`: results as pages and figures
//! - `monitor`: the other end of the instrument's serial line, and what its memory holds
//! - `cli`: the commands of `rins`, each with its arguments

pub mod base;
pub mod files;
pub mod virtual_unit;

pub mod log;

pub mod calibration;

pub mod separating;

pub mod result;

pub mod plan;

pub mod inspect;

pub mod bench;

pub mod study;

pub mod page;

pub mod monitor;

pub mod cli;
