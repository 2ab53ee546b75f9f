//! The random inputs of `cargo test`. They are the same at every run, where bolero takes those of its own from the
//! operating system.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// More bytes than most inputs take decisions from.
const MAX_BYTES: u64 = 1024;

/// The random bytes of this number.
pub fn bytes(number: u64) -> Vec<u8> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(number);
    let mut bytes = vec![0; (random.next_u64() % MAX_BYTES) as usize];
    random.fill_bytes(&mut bytes);
    bytes
}
