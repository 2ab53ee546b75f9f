//! The random inputs of `cargo test`.

use crate::target::Target;
use bolero::bolero_engine::input::Bytes;
use bolero::bolero_engine::{driver, panic};
use bolero::{BorrowedInput, ByteSliceGenerator, Engine, Test, TestTarget};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// More bytes than most inputs take decisions from.
const MAX_BYTES: u64 = 1024;

/// An engine with a fixed number of inputs. The inputs are the same at every run, where those of bolero's own engine come
/// from the operating system.
pub struct Moment {
    inputs: u64,
}

/// The same test of byte strings by another engine.
#[cfg_attr(fuzzing, expect(dead_code))]
pub fn in_place_of<E>(
    _: TestTarget<ByteSliceGenerator, E, BorrowedInput>,
    target: &dyn Target,
) -> TestTarget<ByteSliceGenerator, Moment, BorrowedInput> {
    TestTarget::new(Moment { inputs: target.moment() })
}

/// The random bytes of this number.
pub fn bytes(number: u64) -> Vec<u8> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(number);
    let mut bytes = vec![0; (random.next_u64() % MAX_BYTES) as usize];
    random.fill_bytes(&mut bytes);
    bytes
}

impl<T: Test> Engine<T> for Moment
where
    T::Value: std::fmt::Debug,
{
    type Output = ();

    fn run(self, mut test: T, options: driver::Options) {
        panic::set_hook();
        let forward = panic::forward_panic(false);
        let broken = (0..self.inputs).map(bytes).find_map(|bytes| {
            let error = test.test(&mut Bytes::new(&bytes, &options)).err()?;
            let shorter = test.shrink(bytes, None, &options);
            Some(shorter.map_or_else(|| error.to_string(), |failure| failure.to_string()))
        });
        panic::forward_panic(forward);
        if let Some(broken) = broken {
            panic!("{broken}");
        }
    }
}
