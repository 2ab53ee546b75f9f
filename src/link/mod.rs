//! The instrument's end of the serial line: messages out, commands in, and an answer to each command.

mod corrected;
mod endpoint;
mod frame;
#[cfg(test)]
mod golden;
mod lock;
mod outbox;
mod protocol;

pub use corrected::CorrectedReport;
pub use endpoint::{Link, lane};
pub use frame::{
    Damage, Decoder, Dropped, Frame, MAX_FRAME_BYTES, MAX_PAYLOAD_BYTES, PROTOCOL_VERSION, Payload, encode,
};
pub use lock::{Lock, UNLOCK_WORD, UNLOCKED_US};
pub use outbox::Lane;
pub use protocol::{
    Answer, CONFIRM_TOLERANCE_RAD, Command, Hello, Item, LinkCounts, Refusal, Setting, SettingName, Status,
};
