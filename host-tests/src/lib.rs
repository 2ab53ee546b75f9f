//! Virtual RINS, bench and reports around the core of `rins-selfcal`.

pub mod bench;
pub mod emulator;
pub mod plant;
