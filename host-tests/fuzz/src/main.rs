//! Fuzz targets for the decoders of link, drivers, assignment and store.
//!
//! Each target is a test with the name of the target. `cargo test` judges the corpus and some random inputs, which are
//! the same in every run. `cargo bolero test` searches for new inputs, guided by code coverage, until an input breaks a
//! promise or the user stops the search. The search needs `cargo install cargo-bolero` and `g++`:
//!
//! ```text
//! cargo bolero test link_frames --package fuzz --sanitizer NONE -T 60s \
//!     --corpus-dir target/fuzz/link-frames --crashes-dir target/fuzz/crashes -E host-tests/fuzz/corpus/link-frames
//! ```
//!
//! The folder `corpus` keeps one short input for every outcome of a target, in a file named after the outcome. After a
//! change of a format, `cargo test --package fuzz -- --ignored` replaces the files that have lost their outcome.
//!
//! ```text
//! source     decisions and damage, from the bytes of the fuzzer
//! target     the trait of a fuzz target; `targets` has one file for each target
//! reference  frames and CRCs, computed independently of the decoders
//! judge      the two ways to use the fuzzer's bytes, and the check of the promises
//! moment     the random inputs of `cargo test`
//! corpus     the inputs kept in files
//! ```
//! Every target knows the right result independently of the decoder: from `reference`, or from the way in which the
//! input was made.

mod corpus;
mod judge;
mod moment;
mod reference;
mod source;
mod target;
mod targets;

#[cfg(not(fuzzing))]
use target::Target;
use targets::adis16495::Burst;
use targets::assignment::Assignments;
use targets::biss::Biss;
use targets::kvh1750::Stream;
use targets::link_commands::LinkCommands;
use targets::link_frames::LinkFrames;
use targets::link_payloads::LinkPayloads;
use targets::store_records::Records;
use targets::store_recovery::Recovery;

/// Judges the inputs of the fuzzer, or the random inputs of `cargo test`. cargo-bolero finds the test by `check`.
macro_rules! fuzz {
    ($target:expr) => {{
        #[cfg(fuzzing)]
        let fuzzer = bolero::check!();
        let target = $target;
        let judge = |bytes: &[u8]| judge::both_readings(&target, bytes).unwrap_or_else(|broken| panic!("{broken}"));
        #[cfg(fuzzing)]
        fuzzer.for_each(judge);
        #[cfg(not(fuzzing))]
        (0..target.moment()).for_each(|number| judge(&moment::bytes(number)));
    }};
}

#[test]
fn link_frames() {
    fuzz!(LinkFrames::new());
}

#[test]
fn link_payloads() {
    fuzz!(LinkPayloads::new());
}

#[test]
fn link_commands() {
    fuzz!(LinkCommands::new());
}

#[test]
fn biss() {
    fuzz!(Biss);
}

#[test]
fn adis16495() {
    fuzz!(Burst);
}

#[test]
fn kvh1750() {
    fuzz!(Stream);
}

#[test]
fn assignment() {
    fuzz!(Assignments::new());
}

#[test]
fn store_records() {
    fuzz!(Records::new());
}

#[test]
fn store_recovery() {
    fuzz!(Recovery::new());
}

#[test]
fn every_corpus_file_has_the_outcome_of_its_name() {
    let broken = corpus::judged(&targets::all());
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn random_inputs_are_the_same_at_every_run() {
    assert_eq!(moment::bytes(7), moment::bytes(7));
    assert_ne!(moment::bytes(7), moment::bytes(8));
}

#[test]
#[ignore = "writes into the corpus"]
fn corpus_is_renewed() {
    targets::all().iter().for_each(|target| corpus::renew(target.as_ref()));
}
