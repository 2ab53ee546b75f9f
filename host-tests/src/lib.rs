//! Virtual RINS, bench and reports around the core of `rins-selfcal`.
//!
//! ```text
//! unit, presets, scheme_file -> kinematics, encoder -> virtual_rins -> drive \
//!                                                                             plant -> the core
//!                                                           CSV file -> log  /
//! faults -> fault_campaign: can a disturbed run be accepted with a wrong answer?
//! ```

pub mod bench;
pub mod drive;
pub mod emulator;
pub mod encoder;
pub mod fault_campaign;
pub mod faults;
pub mod kinematics;
pub mod log;
pub mod plant;
pub mod presets;
pub mod scheme_file;
pub mod toml_file;
pub mod truth;
pub mod unit;
pub mod vec3;
pub mod virtual_rins;
