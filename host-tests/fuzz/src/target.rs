//! A decoder under test.

use crate::source::Source;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Required outcome of an input, known from the way in which the input was made. Values are compared by their
/// [`digest`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Claim {
    /// Every outcome is allowed.
    Nothing,
    /// The input is refused.
    Refused,
    /// The input is accepted as this value.
    Value(u64),
    /// The input is refused, or accepted as this value.
    NotOther(u64),
}

/// Outcome of an input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The outcome in words. It is also the name of a file in the corpus.
    pub name: &'static str,
    /// Digest of the accepted value.
    pub value: Option<u64>,
}

impl Outcome {
    /// An input that was accepted as this value.
    pub fn accepted(name: &'static str, value: impl Hash) -> Self {
        Self { name, value: Some(digest(value)) }
    }

    /// An input that was refused for this reason.
    pub fn refused(name: &'static str) -> Self {
        Self { name, value: None }
    }

    /// Whether the outcome fulfils a claim.
    pub fn fulfils(&self, claim: Claim) -> bool {
        match claim {
            Claim::Nothing => true,
            Claim::Refused => self.value.is_none(),
            Claim::Value(value) => self.value == Some(value),
            Claim::NotOther(value) => self.value.is_none_or(|found| found == value),
        }
    }
}

/// A number that differs for different values.
pub fn digest(value: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// A decoder, the way in which its inputs are made, and its promises for every input.
pub trait Target {
    /// Name of the target and of its folder in the corpus.
    fn name(&self) -> &'static str;

    /// The number of random inputs in `cargo test`, for at most a second of work.
    fn moment(&self) -> u64;

    /// Whether inputs are kept in files. They are not kept if every change of a configuration changes the format.
    fn has_corpus(&self) -> bool {
        true
    }

    /// Makes an input in the empty `input` by the decisions of `source`.
    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim;

    /// Decodes an input. Panics if a promise is broken.
    fn judge(&self, input: &[u8]) -> Outcome;
}
