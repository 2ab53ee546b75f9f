//! Virtual RINS, bench and reports around the core of `rins-selfcal`.

pub mod plant;
