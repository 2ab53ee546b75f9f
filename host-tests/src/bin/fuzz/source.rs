//! Random numbers, noise and damage.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Bytes at which decoders turn: ends of ranges, zero bytes of frames, what a BiSS, ADIS or KVH frame begins with.
const TURNS: [u8; 12] = [0x00, 0x01, 0x02, 0x7f, 0x80, 0xfe, 0xff, 0xa5, 0x81, 0x55, 0xfd, 0x40];
/// Numbers at which checks turn.
const NUMBERS: [f64; 8] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 5e-324, f64::MAX, 1e-9];

/// Everything random.
pub struct Source(Xoshiro256PlusPlus);

impl Source {
    /// The same numbers for the same seed.
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number below `bound`, which is not zero.
    pub fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.bits()) * bound as u128) >> 64) as usize
    }

    /// True once in `count` times.
    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }

    /// One of several.
    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Any byte, half of the time one at which decoders turn.
    pub fn byte(&mut self) -> u8 {
        if self.one_in(2) { *self.pick(&TURNS) } else { self.bits() as u8 }
    }

    /// Fewer than `bound` bytes.
    pub fn noise(&mut self, bound: usize) -> Vec<u8> {
        (0..self.below(bound)).map(|_| self.byte()).collect()
    }

    /// Turns `count` different bits over.
    pub fn flip(&mut self, bytes: &mut [u8], count: usize) {
        let mut flipped = Vec::with_capacity(count);
        while flipped.len() < count {
            let bit = self.below(8 * bytes.len());
            if !flipped.contains(&bit) {
                bytes[bit / 8] ^= 0x80 >> (bit % 8);
                flipped.push(bit);
            }
        }
    }

    /// Does one to three things to bytes that a line, a memory or an enemy could.
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
