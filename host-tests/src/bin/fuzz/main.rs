//! Feeds the decoders with inputs at random, whole, damaged and hostile, and checks what each promises of every one.
//!
//! ```text
//! source    random numbers, noise and damage
//! target    what a decoder under test is; `targets` has one file to each
//! campaign  many inputs on all cores, and what became of them
//! corpus    the shortest input of every outcome, kept in files and judged again by the tests
//! ```
//! Each target knows what is right by another way than the decoder: the frames, CRCs and layouts of `reference`, or what an
//! input was made from. An input depends on the seed, the target and its number alone.

mod campaign;
mod corpus;
mod reference;
mod source;
mod target;
mod targets;

use campaign::{Campaign, Tally};
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use target::Target;

/// Inputs at random for the decoders of the link, the drivers and the store: none may panic, and each must keep its
/// promises.
#[derive(Parser)]
struct Arguments {
    /// Number of inputs in all
    #[arg(long, default_value_t = 1_000_000)]
    inputs: u64,
    /// All inputs come from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only the target of this name, with all inputs
    #[arg(long)]
    only: Option<String>,
    /// Judges the inputs of this folder in place of new ones
    #[arg(long, value_name = "FOLDER", conflicts_with = "write")]
    replay: Option<PathBuf>,
    /// Writes the shortest input of every outcome into this folder
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let all = targets::all();
    let chosen = |target: &&dyn Target| arguments.only.as_ref().is_none_or(|only| only == target.name());
    let chosen: Vec<&dyn Target> = all.iter().map(AsRef::as_ref).filter(chosen).collect();
    if chosen.is_empty() {
        let names: Vec<_> = all.iter().map(|target| target.name()).collect();
        return Err(format!("no such target; known: {}", names.join(", ")));
    }
    if let Some(folder) = &arguments.replay {
        println!("{} inputs judged as their files are named", corpus::replay(folder, &chosen)?);
        return Ok(());
    }
    let shares: u64 = chosen.iter().map(|target| target.share()).sum();
    let mut left = arguments.inputs;
    for (index, target) in chosen.iter().enumerate() {
        let part = (u128::from(arguments.inputs) * u128::from(target.share()) / u128::from(shares)) as u64;
        let inputs = if index + 1 == chosen.len() { left } else { part };
        left -= inputs;
        let start = Instant::now();
        let tally = Campaign { inputs, seed: arguments.seed }.run(*target)?;
        print(*target, &tally, inputs, start.elapsed().as_secs_f64());
        if let Some(folder) = &arguments.write {
            corpus::write(folder, *target, &tally)?;
        }
    }
    println!("{} inputs, no promise broken", arguments.inputs);
    Ok(())
}

fn print(target: &dyn Target, tally: &Tally, inputs: u64, seconds: f64) {
    println!("{}: {inputs} inputs, {:.0} a second", target.name(), inputs as f64 / seconds);
    for (outcome, count) in tally.counts() {
        println!("  {count:>10}  {outcome}");
    }
}
