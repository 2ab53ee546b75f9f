//! The decoders under test.

pub mod adis16495;
pub mod assignment;
pub mod biss;
pub mod kvh1750;
pub mod link_commands;
pub mod link_frames;
pub mod link_payloads;
mod samples;
pub mod store_records;
pub mod store_recovery;

use crate::target::Target;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// All targets.
pub fn all() -> Vec<Box<dyn Target>> {
    vec![
        Box::new(link_frames::LinkFrames::new()),
        Box::new(link_payloads::LinkPayloads::new()),
        Box::new(link_commands::LinkCommands::new()),
        Box::new(biss::Biss),
        Box::new(adis16495::Burst),
        Box::new(kvh1750::Stream),
        Box::new(assignment::Assignments::new()),
        Box::new(store_records::Records::new()),
        Box::new(store_recovery::Recovery::new()),
    ]
}

/// A value as bytes, for comparison.
fn bytes_of(value: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(value).expect("every value can be encoded")
}

/// As [`bytes_of`], for a decoded value. Checks that the value is the same after another encoding and decoding.
fn stable_bytes<T: Serialize + DeserializeOwned>(value: &T) -> Vec<u8> {
    let bytes = bytes_of(value);
    let again: T = postcard::from_bytes(&bytes).expect("what was decoded can be encoded and decoded");
    assert_eq!(bytes_of(&again), bytes, "the value differs after another encoding and decoding");
    bytes
}
