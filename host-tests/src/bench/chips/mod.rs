//! The simulated devices of the instrument. The drivers of the core are tested against them.
//!
//! Each chip has one file. Bits, registers and CRCs are written from the data sheets that the drivers name, without the
//! drivers' code.

pub mod adis16495;
pub mod biss;
mod bits;
pub mod bridge;
mod exchange;
pub mod kvh1750;

pub use exchange::exchange;
