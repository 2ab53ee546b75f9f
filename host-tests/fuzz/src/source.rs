//! Decisions, noise and damage, from the bytes of the fuzzer.

/// Bytes at which decoders branch: ends of ranges, zero bytes of frames, first bytes of BiSS, ADIS and KVH frames.
const TURNS: [u8; 12] = [0x00, 0x01, 0x02, 0x7f, 0x80, 0xfe, 0xff, 0xa5, 0x81, 0x55, 0xfd, 0x40];
/// Numbers at which checks branch.
const NUMBERS: [f64; 8] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 5e-324, f64::MAX, 1e-9];

/// A source of decisions. After the last byte every decision is the first possible decision.
pub struct Source<'b>(&'b [u8]);

impl<'b> Source<'b> {
    /// Decisions from these bytes, in order. A change of one byte changes few decisions, so that a fuzzer keeps most of
    /// the path that it has reached.
    pub fn new(bytes: &'b [u8]) -> Self {
        Self(bytes)
    }

    fn next<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.0.split_at(N.min(self.0.len()));
        self.0 = rest;
        std::array::from_fn(|index| head.get(index).copied().unwrap_or(0))
    }

    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        u64::from_le_bytes(self.next())
    }

    /// A number below `bound`, which is at least 1 and at most 65 536.
    pub fn below(&mut self, bound: usize) -> usize {
        if bound <= 1 << 8 {
            (usize::from(u8::from_le_bytes(self.next())) * bound) >> 8
        } else {
            (usize::from(u16::from_le_bytes(self.next())) * bound) >> 16
        }
    }

    /// True once in `count` times.
    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }

    /// One of several.
    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Any byte. Half of the bytes are bytes at which decoders branch.
    pub fn byte(&mut self) -> u8 {
        if self.one_in(2) { *self.pick(&TURNS) } else { u8::from_le_bytes(self.next()) }
    }

    /// Fewer than `bound` bytes.
    pub fn noise(&mut self, bound: usize) -> Vec<u8> {
        (0..self.below(bound)).map(|_| self.byte()).collect()
    }

    /// Inverts `count` different bits. The bytes must have at least `count` bits.
    pub fn flip(&mut self, bytes: &mut [u8], count: usize) {
        let mut flipped = Vec::with_capacity(count);
        while flipped.len() < count {
            let mut bit = self.below(8 * bytes.len());
            while flipped.contains(&bit) {
                bit = (bit + 1) % (8 * bytes.len());
            }
            bytes[bit / 8] ^= 0x80 >> (bit % 8);
            flipped.push(bit);
        }
    }

    /// Damages bytes in one to three ways in which a line, a memory or an attacker could.
    pub fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(3) {
            self.damage_once(bytes);
        }
    }

    fn damage_once(&mut self, bytes: &mut Vec<u8>) {
        let at = self.below(bytes.len() + 1);
        let to = (at + self.below(24)).min(bytes.len());
        match self.below(9) {
            0 if !bytes.is_empty() => {
                let count = 1 + self.below(3);
                self.flip(bytes, count);
            }
            1 if at < bytes.len() => bytes[at] = self.byte(),
            2 => drop(bytes.splice(at..at, self.noise(9))),
            3 => drop(bytes.drain(at..to)),
            4 => bytes.truncate(at),
            5 => bytes.extend_from_within(at..to),
            6 => bytes[at..to].iter_mut().for_each(|byte| *byte = self.byte()),
            7 => bytes[at..to].fill(self.byte()),
            _ if at + 8 <= bytes.len() => bytes[at..at + 8].copy_from_slice(&self.pick(&NUMBERS).to_le_bytes()),
            _ => bytes.push(self.byte()),
        }
    }
}
