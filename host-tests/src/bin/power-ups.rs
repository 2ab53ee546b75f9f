//! Powers units with cables up many times, and prints whether an axis left its travel.

use anyhow::Result;
use clap::Parser;
use host_tests::study::power_ups::{PowerUps, power_ups};
use host_tests::study::promises::{Seed, kept};

/// Power-ups at random angles, with the power cut at random moments and all kinds of travel: an axis never leaves its
/// travel, or the instrument refuses to move
#[derive(Parser)]
struct Arguments {
    /// Number of power-ups
    #[arg(long, default_value_t = 10_000)]
    count: u32,
    #[command(flatten)]
    seed: Seed,
}

fn main() -> Result<()> {
    let Arguments { count, seed: Seed { seed } } = Arguments::parse();
    let PowerUps { count, cut, moved, refused, confirmed, beyond_deg, breaches } = power_ups(seed, count);
    println!("{count} power-ups, {cut} cut by a loss of power; in {moved} the axes moved");
    println!("{refused} refusals to move, {confirmed} turns confirmed by the operator");
    println!("largest excess over the travel: {beyond_deg:.3} deg");
    kept(&breaches)
}
