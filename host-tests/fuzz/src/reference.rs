//! Reference results, computed independently of the decoders: frames of the link, CRCs.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use rins_selfcal::link::{MAX_PAYLOAD_BYTES, PROTOCOL_VERSION};

static CRC_32: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);
/// Bytes of a frame around the payload: version, kind, number and CRC.
const OVERHEAD_BYTES: usize = 8;

/// CRC-32/ISO-HDLC.
pub fn crc_32(bytes: &[u8]) -> u32 {
    CRC_32.checksum(bytes)
}

/// Content of a frame of the link.
#[derive(Clone, Debug, PartialEq, Hash)]
pub enum Found {
    /// Kind, number and payload.
    Frame(u8, u16, Vec<u8>),
    /// A damaged frame.
    Corrupt,
    /// A frame of another version, with that version.
    Version(u8),
}

/// A frame of the link with a right CRC.
pub fn frame(version: u8, kind: u8, number: u16, payload: &[u8]) -> Vec<u8> {
    let mut content = vec![version, kind];
    content.extend(number.to_le_bytes());
    content.extend(payload);
    content.extend(crc_32(&content).to_le_bytes());
    let mut frame = stuffed(&content);
    frame.push(0);
    frame
}

/// COBS encoding. Each run of bytes other than zero is preceded by its length. Runs are split into parts of at most
/// 254.
fn stuffed(content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for mut run in content.split(|byte| *byte == 0) {
        while let Some((part, rest)) = run.split_at_checked(254) {
            bytes.push(255);
            bytes.extend(part);
            run = rest;
        }
        bytes.push(1 + run.len() as u8);
        bytes.extend(run);
    }
    bytes
}

/// COBS decoding. `None` if a run is longer than the rest of the bytes.
fn unstuffed(mut bytes: &[u8]) -> Option<Vec<u8>> {
    let mut content = Vec::new();
    while let Some((length, rest)) = bytes.split_first() {
        let (run, rest) = rest.split_at_checked(usize::from(*length) - 1)?;
        content.extend(run);
        if *length < 255 && !rest.is_empty() {
            content.push(0);
        }
        bytes = rest;
    }
    Some(content)
}

/// Content of a stream: one result for each run of bytes that a zero byte ends.
pub fn stream(bytes: &[u8]) -> Vec<Found> {
    let ended = bytes.iter().rposition(|byte| *byte == 0).map_or(&[][..], |end| &bytes[..end]);
    ended.split(|byte| *byte == 0).filter(|run| !run.is_empty()).map(found).collect()
}

fn found(run: &[u8]) -> Found {
    let Some(content) = unstuffed(run) else { return Found::Corrupt };
    if !(OVERHEAD_BYTES..=OVERHEAD_BYTES + MAX_PAYLOAD_BYTES).contains(&content.len()) {
        return Found::Corrupt;
    }
    let (checked, crc) = content.split_at(content.len() - 4);
    if crc_32(checked).to_le_bytes() != crc {
        return Found::Corrupt;
    }
    match checked[0] {
        PROTOCOL_VERSION => Found::Frame(checked[1], u16::from_le_bytes([checked[2], checked[3]]), checked[4..].into()),
        version => Found::Version(version),
    }
}
