//! The host's end of an instrument's serial line: the client, the live view, the recording and the history.

mod client;
pub mod history;
mod port;
mod recorder;
mod recording;
mod view;

pub use client::{Client, Event, LineClosed, UNEXPECTED, refused};
pub use port::open;
pub use recording::Recording;
pub use view::{View, lines};
