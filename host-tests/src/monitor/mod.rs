//! The host's end of an instrument's serial line: the client, the live view, the recorder and the history.

mod client;
pub mod history;
mod port;
mod recorder;
mod view;

pub use client::{Client, Event};
pub use port::open;
pub use recorder::Recorder;
pub use view::{View, lines};
