//! The frame of a stored record. It is the same for every kind of record and in every version of a format, so that
//! software of every version can tell which record is the newest.
//!
//! ```text
//! slot, little-endian   0-2          three letters, the kind of the record
//!                       3            version of the format, a character
//!                       4-7          sequence number, wraps; the record with the number ahead is the newer record
//!                       8-11         length n of the payload, bytes
//!                       12..12+n     payload, the record in postcard
//!                       12+n..16+n   CRC-32/ISO-HDLC of all bytes before
//! ```
//! A frame without a payload is a tombstone: it says that all records before it were erased.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::Serialize;

/// Memory is read and written in pieces of this length, bytes. The header of a frame is in the first piece of a slot.
pub(super) const PIECE_BYTES: usize = 32;

const HEADER_BYTES: usize = 12;
const CRC_BYTES: usize = 4;
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Why a slot gives no record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Damage {
    /// The slot does not begin with the three letters of its kind of record.
    Magic,
    /// The slot holds an intact record of another version of the format, this character.
    Version(u8),
    /// The length in the header exceeds the slot, bytes.
    Length(u32),
    /// The CRC is wrong.
    Crc,
    /// The CRC is right, but the payload is no record.
    Payload,
    /// The memory cannot read the slot.
    Unreadable,
    /// The slot does not keep what is written to it.
    Worn,
}

impl Damage {
    /// The version of the format, if the slot is intact and has another version than this software reads. This is no
    /// damage.
    pub fn other_version(self) -> Option<u8> {
        if let Self::Version(version) = self { Some(version) } else { None }
    }
}

/// The frame of a slot that is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame {
    pub version: u8,
    pub sequence: u32,
    payload_bytes: usize,
}

impl Frame {
    pub fn is_tombstone(self) -> bool {
        self.payload_bytes == 0
    }

    /// The payload in the slot that this frame is of.
    pub fn payload(self, slot: &[u8]) -> &[u8] {
        slot.get(HEADER_BYTES..HEADER_BYTES + self.payload_bytes).unwrap_or_default()
    }
}

/// Checks the frame of a slot.
///
/// # Errors
/// What is wrong with the frame. The version is not checked.
pub(super) fn check(slot: &[u8], magic: [u8; 3]) -> Result<Frame, Damage> {
    let (header, rest) = slot.split_first_chunk::<HEADER_BYTES>().ok_or(Damage::Length(0))?;
    let [m0, m1, m2, version, s0, s1, s2, s3, l0, l1, l2, l3] = *header;
    if [m0, m1, m2] != magic {
        return Err(Damage::Magic);
    }
    let length = u32::from_le_bytes([l0, l1, l2, l3]);
    let (payload, crc) = rest.split_at_checked(length as usize).ok_or(Damage::Length(length))?;
    let stored = crc.first_chunk().ok_or(Damage::Length(length))?;
    let (framed, _) = slot.split_at_checked(HEADER_BYTES + payload.len()).ok_or(Damage::Length(length))?;
    if CRC.checksum(framed) != u32::from_le_bytes(*stored) {
        return Err(Damage::Crc);
    }
    Ok(Frame { version, sequence: u32::from_le_bytes([s0, s1, s2, s3]), payload_bytes: payload.len() })
}

/// Writes the frame of a record into a slot and sets all other bits. The unit type as the record gives a tombstone,
/// because it has no bytes. Returns the length of the frame; `None` if the record does not fit.
pub(super) fn encode(
    slot: &mut [u8],
    ([m0, m1, m2], version): ([u8; 3], u8),
    sequence: u32,
    record: &impl Serialize,
) -> Option<usize> {
    slot.fill(0xff);
    let room = slot.len().checked_sub(CRC_BYTES)?;
    let (header, rest) = slot.get_mut(..room)?.split_first_chunk_mut::<HEADER_BYTES>()?;
    let payload = postcard::to_slice(record, rest).ok()?.len();
    let ([s0, s1, s2, s3], [l0, l1, l2, l3]) = (sequence.to_le_bytes(), u32::try_from(payload).ok()?.to_le_bytes());
    *header = [m0, m1, m2, version, s0, s1, s2, s3, l0, l1, l2, l3];
    let (framed, rest) = slot.split_at_mut_checked(HEADER_BYTES + payload)?;
    *rest.first_chunk_mut()? = CRC.checksum(framed).to_le_bytes();
    Some(HEADER_BYTES + payload + CRC_BYTES)
}

/// Number of bytes that the header of a slot of this length claims; `None` if the length is not possible.
pub(super) fn used_bytes(head: &[u8; PIECE_BYTES], slot_bytes: usize) -> Option<usize> {
    let [_, _, _, _, _, _, _, _, l0, l1, l2, l3, ..] = head;
    let used = (u32::from_le_bytes([*l0, *l1, *l2, *l3]) as usize).checked_add(HEADER_BYTES + CRC_BYTES)?;
    (used <= slot_bytes).then_some(used)
}
