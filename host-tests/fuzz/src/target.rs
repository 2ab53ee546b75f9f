//! A decoder under test.

use crate::source::Source;
use std::hash::{DefaultHasher, Hash, Hasher};

/// What must become of an input, by the way it was made. Values are told by [`digest`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Claim {
    /// Whatever it is.
    Nothing,
    /// It is refused.
    Refused,
    /// It is accepted as this value.
    Value(u64),
    /// It is refused, or accepted as this value.
    NotOther(u64),
}

/// What became of an input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// In words, also the name of a file.
    pub name: &'static str,
    /// Digest of what was accepted.
    pub value: Option<u64>,
}

impl Outcome {
    /// Accepted as this value.
    pub fn accepted(name: &'static str, value: impl Hash) -> Self {
        Self { name, value: Some(digest(value)) }
    }

    /// Refused for this reason.
    pub fn refused(name: &'static str) -> Self {
        Self { name, value: None }
    }

    /// Whether a claim holds.
    pub fn fulfils(&self, claim: Claim) -> bool {
        match claim {
            Claim::Nothing => true,
            Claim::Refused => self.value.is_none(),
            Claim::Value(value) => self.value == Some(value),
            Claim::NotOther(value) => self.value.is_none_or(|found| found == value),
        }
    }
}

/// A number that tells values apart.
pub fn digest(value: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// A decoder, how inputs for it are made, and what it promises of every input.
pub trait Target {
    /// Its name, and that of its folder in the corpus.
    fn name(&self) -> &'static str;

    /// The number of random inputs in `cargo test`: a second of work at most.
    fn moment(&self) -> u64;

    /// Whether inputs are kept in files. They are not where every change of a configuration changes the format.
    fn has_corpus(&self) -> bool {
        true
    }

    /// Makes an input in the empty `input`, by the decisions of `source`.
    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim;

    /// Decodes an input; panics where a promise is broken.
    fn judge(&self, input: &[u8]) -> Outcome;
}
