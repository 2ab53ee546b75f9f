//! The other end of an instrument's serial line: a client that asks and listens, and what it shows.

mod client;
pub mod history;
mod port;
mod recorder;
mod view;

pub use client::{Client, Event};
pub use port::open;
pub use recorder::Recorder;
pub use view::{View, lines};
