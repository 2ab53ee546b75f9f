//! Many inputs for one target, on all cores.

use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};

/// Inputs from one random source.
const BATCH: u64 = 2048;

/// How many inputs, and which.
pub struct Campaign {
    /// How many.
    pub inputs: u64,
    /// They come from it.
    pub seed: u64,
}

/// How often every outcome came, and the shortest input that led to it.
#[derive(Default)]
pub struct Tally(BTreeMap<&'static str, (u64, Vec<u8>)>);

impl Tally {
    /// Outcomes and how often they came.
    pub fn counts(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.0.iter().map(|(name, (count, _))| (*name, *count))
    }

    /// Outcomes and the shortest inputs that led to them.
    pub fn shortest(&self) -> impl Iterator<Item = (&'static str, &[u8])> {
        self.0.iter().map(|(name, (_, input))| (*name, input.as_slice()))
    }

    fn add(&mut self, name: &'static str, count: u64, input: &[u8]) {
        let (counted, shortest) = self.0.entry(name).or_insert_with(|| (0, input.to_vec()));
        *counted += count;
        if (input.len(), input) < (shortest.len(), shortest.as_slice()) {
            *shortest = input.to_vec();
        }
    }

    fn join(mut self, other: Self) -> Self {
        other.0.iter().for_each(|(name, (count, input))| self.add(name, *count, input));
        self
    }
}

impl Campaign {
    /// Judges all inputs.
    ///
    /// # Errors
    /// The first input found that breaks a promise.
    pub fn run(&self, target: &dyn Target) -> Result<Tally, String> {
        let hook = take_hook();
        set_hook(Box::new(|_| ()));
        let batches = (0..self.inputs.div_ceil(BATCH)).into_par_iter();
        let tally = batches.map(|batch| self.batch(target, batch)).try_reduce(Tally::default, |a, b| Ok(a.join(b)));
        set_hook(hook);
        tally
    }

    fn batch(&self, target: &dyn Target, batch: u64) -> Result<Tally, String> {
        let mut source = Source::new(digest((self.seed, target.name(), batch)));
        let (mut tally, mut input) = (Tally::default(), Vec::new());
        for _ in batch * BATCH..self.inputs.min((batch + 1) * BATCH) {
            input.clear();
            let claim = target.make(&mut source, &mut input);
            let outcome = judge(target, &input, claim)?;
            tally.add(outcome.name, 1, &input);
        }
        Ok(tally)
    }
}

/// Judges an input.
///
/// # Errors
/// It breaks a promise; one line says which, with all bytes of the input.
pub fn judge(target: &dyn Target, input: &[u8], claim: Claim) -> Result<Outcome, String> {
    let broken = |what: &str| {
        let bytes: String = input.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{}: {what}; input {bytes}", target.name())
    };
    match catch_unwind(AssertUnwindSafe(|| target.judge(input))) {
        Ok(outcome) if outcome.fulfils(claim) => Ok(outcome),
        Ok(outcome) => Err(broken(&format!("{outcome:?}, but {claim:?}"))),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("it panics");
            Err(broken(&text.replace('\n', " ")))
        }
    }
}
