//! The devices of the instrument, played from their data sheets' side: what the drivers of the core are tested against.
//!
//! One file to a chip. Bits, registers and CRCs are written from the data sheets that the drivers name, not with the
//! drivers' code.

pub mod adis16495;
pub mod biss;
pub mod bridge;
pub mod kvh1750;

use embedded_hal::spi::Operation;

/// CRC of `width` bits, high bit first, by its definition: the remainder of a division, a bit at a time.
fn crc(width: u32, polynomial: u32, initial: u32, bits: impl IntoIterator<Item = bool>) -> u32 {
    let mask = u32::MAX >> (32 - width);
    bits.into_iter().fold(initial, |crc, bit| {
        let overflows = crc >> (width - 1) & 1 == 1;
        (crc << 1 ^ if overflows != bit { polynomial } else { 0 }) & mask
    })
}

/// The bits of bytes, high bit first.
fn bits_of(bytes: &[u8]) -> impl Iterator<Item = bool> {
    bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1 == 1))
}

/// One transaction with a chip that sees so many bytes, both ways, whatever operations they are.
pub fn exchange(operations: &mut [Operation<'_, u8>], chip: impl FnOnce(&mut [u8])) {
    let mut bytes = Vec::new();
    for operation in operations.iter() {
        match operation {
            Operation::Read(received) => bytes.resize(bytes.len() + received.len(), 0),
            Operation::Write(sent) => bytes.extend_from_slice(sent),
            Operation::TransferInPlace(both) => bytes.extend_from_slice(both),
            Operation::Transfer(received, sent) => {
                bytes.extend_from_slice(sent);
                bytes.resize(bytes.len() + received.len().saturating_sub(sent.len()), 0);
            }
            Operation::DelayNs(_) => {}
        }
    }
    chip(&mut bytes);
    let mut rest = bytes.as_slice();
    for operation in operations {
        let length = match operation {
            Operation::Read(both) | Operation::TransferInPlace(both) => {
                both.copy_from_slice(&rest[..both.len()]);
                both.len()
            }
            Operation::Transfer(received, sent) => {
                received.copy_from_slice(&rest[..received.len()]);
                received.len().max(sent.len())
            }
            Operation::Write(sent) => sent.len(),
            Operation::DelayNs(_) => 0,
        };
        rest = &rest[length..];
    }
}
