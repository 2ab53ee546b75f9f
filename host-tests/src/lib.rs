//! Virtual RINS, bench and reports around the core of `rins-selfcal`.
//!
//! ```text
//! unit, presets, scheme_file -> kinematics, encoder -> virtual_rins -> drive \
//!                                                                             plant -> the core
//!                                                               file -> log  /
//!
//! virtual_run, replay -> calibration, signals -> report, table, page -> cli
//! refusal: what the core has against a scheme
//! closed_loop, prediction -> plot, monte_carlo -^
//! inspect: what a log of any columns is
//! saved: a result read back -> comparison; history: all that an instrument keeps
//! bai: what the source of the method publishes; replication: what is run to be laid beside it -> page
//! monitor: the other end of the instrument's serial line, `line` the instrument's own end in this process
//! plan: finds schemes; prediction then says what the core makes of them
//! faults -> fault_campaign: can a disturbed run be accepted with a wrong answer?
//! fault_table: what the instrument does when an axis, the IMU or the power fails
//! chips: the devices that the core's drivers read and drive
//! ```

pub mod base;
pub mod bench;
pub mod calibration;
pub mod cli;
pub mod files;
pub mod inspect;
pub mod log;
pub mod monitor;
pub mod page;
pub mod plan;
pub mod result;
pub mod study;
pub mod virtual_unit;
