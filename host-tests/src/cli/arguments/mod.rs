//! Arguments that several commands share.

pub mod axes;
pub mod hardware;
pub mod log;
pub mod method;
pub mod scheme;
pub mod unit;
pub mod value;
