//! The random inputs of `cargo test`. They are the same in every run. Bolero's own random inputs are not, because they
//! come from the operating system.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Length of a random input, bytes. Most inputs need fewer bytes for their decisions.
const MAX_BYTES: u64 = 1024;

/// The random bytes of the input with this number.
pub fn bytes(number: u64) -> Vec<u8> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(number);
    let mut bytes = vec![0; (random.next_u64() % MAX_BYTES) as usize];
    random.fill_bytes(&mut bytes);
    bytes
}
