//! A stored calibration and its frame.
//!
//! ```text
//! slot, little-endian   0-2          "RSC"
//!                       3            version of the format, a character
//!                       4-7          sequence number, wraps; the record with the number ahead is the newer record
//!                       8-11         length n of the payload, bytes
//!                       12..12+n     payload
//!                       12+n..16+n   CRC-32/ISO-HDLC of all bytes before
//! ```
//! A frame without a payload is a tombstone: it says that all records before it were erased.
//! Every version of the format has this frame, so that software of every version can tell which record is the newest.
//! The payload is [`StoredCalibration`] in postcard. This software reads and writes one version of the format. It keeps
//! a record of any other version apart from damage, as [`Damage::Version`], and never takes such a record for a
//! calibration.
//!
//! | version | written by software | difference |
//! |---|---|---|
//! | 4 | from 0.2.0 on | the reasons carry the version of their own encoding |
//! | 2, 3 | 0.1.0 | the reasons are tied to the version of the software; version 2 has no verdict |

use crate::run::result::StoredCalibration;
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::Serialize;

/// Memory of one slot, bytes: whole pages of every EEPROM and whole words of every flash.
pub const SLOT_BYTES: usize = 768;
/// Version of the format that is read and written. Count it up whenever the bytes of a [`StoredCalibration`] change.
pub const FORMAT_VERSION: u8 = b'4';

const MAGIC: [u8; 3] = *b"RSC";
const HEADER_BYTES: usize = 12;
const CRC_BYTES: usize = 4;
const PAYLOAD_BYTES: usize = SLOT_BYTES - HEADER_BYTES - CRC_BYTES;
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Why a slot gives no calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Damage {
    /// The slot does not begin with the three letters of a record.
    Magic,
    /// The slot holds an intact record of another version of the format, this character.
    Version(u8),
    /// The length in the header exceeds the slot, bytes.
    Length(u32),
    /// The CRC is wrong.
    Crc,
    /// The CRC is right, but the payload is no calibration.
    Payload,
    /// The memory cannot read the slot.
    Unreadable,
    /// The slot does not keep what is written to it.
    Worn,
}

impl Damage {
    /// Whether the slot is intact and was written by newer software.
    pub fn is_newer(self) -> bool {
        matches!(self, Self::Version(version) if version > FORMAT_VERSION)
    }

    /// Whether the slot is intact and was written in another version of the format, newer or older.
    pub fn is_other_version(self) -> bool {
        matches!(self, Self::Version(_))
    }
}

/// A slot whose frame is right.
pub(super) struct Frame<'a> {
    version: u8,
    pub(super) sequence: u32,
    payload: &'a [u8],
}

impl Frame<'_> {
    /// The calibration.
    ///
    /// # Errors
    /// The record has another version of the format, or its payload is no calibration.
    pub(super) fn record(&self) -> Result<StoredCalibration, Damage> {
        if self.version != FORMAT_VERSION {
            return Err(Damage::Version(self.version));
        }
        postcard::from_bytes(self.payload).map_err(|_| Damage::Payload)
    }

    /// Whether all records before this one were erased. This holds in every version of the format.
    pub(super) fn is_tombstone(&self) -> bool {
        self.payload.is_empty()
    }
}

/// Sequence number and calibration of a slot.
///
/// # Errors
/// What is wrong with the slot.
pub fn decode(slot: &[u8; SLOT_BYTES]) -> Result<(u32, StoredCalibration), Damage> {
    let frame = check(slot)?;
    Ok((frame.sequence, frame.record()?))
}

/// Checks the frame of a slot. It is the same in all versions of the format.
///
/// # Errors
/// What is wrong with the frame.
pub(super) fn check(slot: &[u8; SLOT_BYTES]) -> Result<Frame<'_>, Damage> {
    let [m0, m1, m2, version, s0, s1, s2, s3, l0, l1, l2, l3, rest @ ..] = slot;
    if [*m0, *m1, *m2] != MAGIC {
        return Err(Damage::Magic);
    }
    let length = u32::from_le_bytes([*l0, *l1, *l2, *l3]);
    let (payload, crc) = rest.split_at_checked(length as usize).ok_or(Damage::Length(length))?;
    let stored = crc.first_chunk().ok_or(Damage::Length(length))?;
    let (framed, _) = slot.split_at_checked(HEADER_BYTES + payload.len()).ok_or(Damage::Length(length))?;
    if CRC.checksum(framed) != u32::from_le_bytes(*stored) {
        return Err(Damage::Crc);
    }
    Ok(Frame { version: *version, sequence: u32::from_le_bytes([*s0, *s1, *s2, *s3]), payload })
}

/// Writes the frame into the slot and sets all other bits. Returns the length of the frame; `None` if the record does
/// not fit.
pub fn encode(slot: &mut [u8; SLOT_BYTES], sequence: u32, record: &StoredCalibration) -> Option<usize> {
    frame(slot, sequence, record)
}

/// Writes a frame without a payload, which erases all records before it, and sets all other bits. Returns its length.
pub(super) fn encode_tombstone(slot: &mut [u8; SLOT_BYTES], sequence: u32) -> Option<usize> {
    // The unit type has no bytes in postcard.
    frame(slot, sequence, &())
}

fn frame(slot: &mut [u8; SLOT_BYTES], sequence: u32, record: &impl Serialize) -> Option<usize> {
    slot.fill(0xff);
    let (header, rest) = slot.split_first_chunk_mut::<HEADER_BYTES>()?;
    let payload = postcard::to_slice(record, rest.get_mut(..PAYLOAD_BYTES)?).ok()?.len();
    let ([m0, m1, m2], [s0, s1, s2, s3]) = (MAGIC, sequence.to_le_bytes());
    let [l0, l1, l2, l3] = u32::try_from(payload).ok()?.to_le_bytes();
    *header = [m0, m1, m2, FORMAT_VERSION, s0, s1, s2, s3, l0, l1, l2, l3];
    let (framed, rest) = slot.split_at_mut_checked(HEADER_BYTES + payload)?;
    *rest.first_chunk_mut()? = CRC.checksum(framed).to_le_bytes();
    Some(HEADER_BYTES + payload + CRC_BYTES)
}

/// Number of bytes that the slot's header claims; `None` if the length is not possible.
pub fn used_bytes(head: &[u8; 32]) -> Option<usize> {
    let [_, _, _, _, _, _, _, _, l0, l1, l2, l3, ..] = head;
    let length = u32::from_le_bytes([*l0, *l1, *l2, *l3]) as usize;
    (length <= PAYLOAD_BYTES).then_some(HEADER_BYTES + length + CRC_BYTES)
}
