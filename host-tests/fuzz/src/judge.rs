//! The two ways to use the fuzzer's bytes, and the check of a target's promises.

use crate::source::Source;
use crate::target::{Claim, Outcome, Target};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Judges the bytes as an input, and then the input that is made by the decisions in the bytes. The second input has a
/// right CRC, so it reaches the inner parts of the decoder at once.
///
/// # Errors
/// The text of [`judge`].
pub fn both_readings(target: &dyn Target, bytes: &[u8]) -> Result<(), String> {
    judge(target, bytes, Claim::Nothing)?;
    let (input, claim) = made(target, bytes);
    judge(target, &input, claim).map(|_| ())
}

/// The input that is made by the decisions in these bytes, and the required outcome.
pub fn made(target: &dyn Target, bytes: &[u8]) -> (Vec<u8>, Claim) {
    let mut input = Vec::new();
    let claim = target.make(&mut Source::new(bytes), &mut input);
    (input, claim)
}

/// Judges an input.
///
/// # Errors
/// The input breaks a promise: the broken promise and the bytes of the input, in one line.
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
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without text");
            Err(broken(&text.replace('\n', " ")))
        }
    }
}
