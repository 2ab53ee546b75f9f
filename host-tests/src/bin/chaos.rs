//! Runs instruments in chaos, and prints what they did and every broken promise.

use anyhow::{Result, ensure};
use clap::Parser;
use host_tests::study::chaos::{Chaos, chaos};

/// Random samples, clocks, faults, resets and commands: nothing may move without authority, and nothing wrong may be
/// accepted
#[derive(Parser)]
struct Arguments {
    /// Number of steps, half of them in f64 and half in f32
    #[arg(long, default_value_t = 3_000_000)]
    steps: u64,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> Result<()> {
    let Arguments { steps, seed } = Arguments::parse();
    let double = print("f64", &chaos::<f64>(seed, steps / 2));
    let single = print("f32", &chaos::<f32>(seed, steps - steps / 2));
    ensure!(double + single == 0, "promises were broken");
    Ok(())
}

fn print(name: &str, chaos: &Chaos) -> usize {
    let Chaos { power_ups, moves, judged, states, breaches } = chaos;
    println!("{name}: {power_ups} power-ups, {moves} moves, {judged} runs judged, {} broken promises", breaches.len());
    for (state, steps) in states {
        println!("  {state:<12}{steps:>9} steps");
    }
    breaches.iter().for_each(|breach| println!("  {breach}"));
    breaches.len()
}
