//! Bits and CRCs by their definitions.

/// CRC of `width` bits, high bit first, by its definition: the remainder of a polynomial division, bit by bit.
pub(super) fn crc(width: u32, polynomial: u32, initial: u32, bits: impl IntoIterator<Item = bool>) -> u32 {
    let mask = u32::MAX >> (32 - width);
    bits.into_iter().fold(initial, |crc, bit| {
        let overflows = crc >> (width - 1) & 1 == 1;
        (crc << 1 ^ if overflows != bit { polynomial } else { 0 }) & mask
    })
}

/// The bits of bytes, high bit first.
pub(super) fn bits_of(bytes: &[u8]) -> impl Iterator<Item = bool> {
    bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1 == 1))
}
