//! Runs instruments in chaos, and prints what they did and every broken promise.

use anyhow::Result;
use clap::Parser;
use host_tests::study::chaos::{Chaos, chaos};
use host_tests::study::promises::{Seed, kept};

/// Random samples, clocks, faults, resets and commands: nothing may move without authority, and nothing wrong may be
/// accepted
#[derive(Parser)]
struct Arguments {
    /// Number of steps, half of them in f64 and half in f32
    #[arg(long, default_value_t = 3_000_000)]
    steps: u64,
    #[command(flatten)]
    seed: Seed,
}

fn main() -> Result<()> {
    let Arguments { steps, seed: Seed { seed } } = Arguments::parse();
    let (double, single) = (chaos::<f64>(seed, steps / 2), chaos::<f32>(seed, steps - steps / 2));
    print("f64", &double);
    print("f32", &single);
    kept(double.breaches.iter().chain(&single.breaches))
}

fn print(name: &str, Chaos { power_ups, moves, judged, states, .. }: &Chaos) {
    println!("{name}: {power_ups} power-ups, {moves} moves, {judged} runs judged");
    for (state, steps) in states {
        println!("  {state:<12}{steps:>9} steps");
    }
}
