//! The devices of the instrument, played from their data sheets' side: what the drivers of the core are tested against.
//!
//! One file to a chip. Bits, registers and CRCs are written from the data sheets that the drivers name, not with the
//! drivers' code.

pub mod adis16495;
pub mod biss;
mod bits;
pub mod bridge;
mod exchange;
pub mod kvh1750;

pub use exchange::exchange;
