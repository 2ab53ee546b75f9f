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
//! observability: what a rotation scheme makes observable
//! bai: what the source of the method publishes; replication: what is run to be laid beside it -> page
//! monitor: the other end of the instrument's serial line, `line` the instrument's own end in this process
//! plan: finds schemes; prediction then says what the core makes of them
//! faults -> fault_campaign: can a disturbed run be accepted with a wrong answer?
//! fault_table: what the instrument does when an axis, the IMU or the power fails
//! chips: the devices that the core's drivers read and drive
//! ```

pub mod apt;
pub mod bai;
pub mod bench;
pub mod calibration;
pub mod chips;
pub mod cli;
pub mod closed_loop;
pub mod comparison;
pub mod drive;
pub mod emulator;
pub mod encoder;
pub mod fault_campaign;
pub mod fault_table;
pub mod faults;
pub mod firmware_sizes;
pub mod gimbal_plant;
pub mod history;
pub mod inspect;
pub mod json_file;
pub mod kinematics;
pub mod line;
pub mod log;
pub mod memory;
pub mod monitor;
pub mod monte_carlo;
pub mod motor;
pub mod observability;
pub mod page;
pub mod plan;
pub mod plant;
pub mod plot;
pub mod power_up;
pub mod prediction;
pub mod presets;
pub mod quantity;
pub mod refusal;
pub mod replay;
pub mod replication;
pub mod report;
pub mod saved;
pub mod scheme_file;
pub mod servo_bench;
pub mod signals;
pub mod statistics;
pub mod table;
pub mod toml_file;
pub mod truth;
pub mod unit;
pub mod vec3;
pub mod virtual_rins;
pub mod virtual_run;
