//! A stored calibration as a kind of record: `"RSC"` in the [frame], and [`StoredCalibration`] as the
//! payload.
//!
//! This software writes one version of the format, and reads it and the version before. It keeps a record of any other
//! version apart from damage, as [`Damage::Version`], and never takes such a record for a calibration.
//!
//! | version | written by software | difference |
//! |---|---|---|
//! | 5 | from 0.3.0 on | the last field is the identity of the IMU; a record of version 4 is read as one without it |
//! | 4 | 0.2.0 | the reasons carry the version of their own encoding |
//! | 2, 3 | 0.1.0 | the reasons are tied to the version of the software; version 2 has no verdict |

use super::frame::{self, Damage};
use super::slots::Kind;
use crate::run::result::StoredCalibration;

/// Memory of one slot, bytes: whole pages of every EEPROM and whole words of every flash.
pub const SLOT_BYTES: usize = 768;
/// Version of the format that is written. Count it up whenever the bytes of a [`StoredCalibration`] change.
pub const FORMAT_VERSION: u8 = b'5';
/// The version before, which is read too.
const WITHOUT_IMU: u8 = b'4';

/// Smallest number of calibrations that a store keeps.
pub const HISTORY: usize = 8;
/// Largest number of slots of a store. Only a part of a larger memory is used.
pub(super) const MAX_SLOTS: usize = 64;

/// Stored calibrations.
#[derive(Debug)]
pub enum Calibrations {}

impl Kind for Calibrations {
    const MAGIC: [u8; 3] = *b"RSC";
    const VERSION: u8 = FORMAT_VERSION;
    const HISTORY: usize = HISTORY;
    const MAX_SLOTS: usize = MAX_SLOTS;
    type Slot = [u8; SLOT_BYTES];
    const BLANK: [u8; SLOT_BYTES] = [0xff; SLOT_BYTES];
    type Record = StoredCalibration;

    fn decode(version: u8, payload: &[u8]) -> Result<StoredCalibration, Damage> {
        let mut extended = Self::BLANK;
        let payload = match version {
            FORMAT_VERSION => payload,
            WITHOUT_IMU => with_no_imu(&mut extended, payload).ok_or(Damage::Payload)?,
            version => return Err(Damage::Version(version)),
        };
        postcard::from_bytes(payload).map_err(|_| Damage::Payload)
    }
}

/// A payload of the version before in the present version: `None` as its last field, which is a zero in postcard.
fn with_no_imu<'b>(buffer: &'b mut [u8], payload: &[u8]) -> Option<&'b [u8]> {
    let extended = buffer.get_mut(..payload.len() + 1)?;
    extended.iter_mut().zip(payload.iter().chain(&[0])).for_each(|(to, from)| *to = *from);
    Some(extended)
}

/// Sequence number and calibration of a slot.
///
/// # Errors
/// What is wrong with the slot.
pub fn decode(slot: &[u8; SLOT_BYTES]) -> Result<(u32, StoredCalibration), Damage> {
    let frame = frame::check(slot, Calibrations::MAGIC)?;
    Ok((frame.sequence, Calibrations::decode(frame.version, frame.payload(slot))?))
}

/// Writes the frame into the slot and sets all other bits. Returns the length of the frame; `None` if the record does
/// not fit.
pub fn encode(slot: &mut [u8; SLOT_BYTES], sequence: u32, record: &StoredCalibration) -> Option<usize> {
    frame::encode(slot, (Calibrations::MAGIC, Calibrations::VERSION), sequence, record)
}
