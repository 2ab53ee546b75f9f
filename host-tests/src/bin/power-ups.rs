//! Powers units with cables up many times, and prints whether an axis left its travel.

use anyhow::{Result, ensure};
use clap::Parser;
use host_tests::study::power_ups::{PowerUps, power_ups};

/// Power-ups at random angles, with the power cut at random moments and all kinds of travel: an axis never leaves its
/// travel, or the instrument refuses to move
#[derive(Parser)]
struct Arguments {
    /// Number of power-ups
    #[arg(long, default_value_t = 10_000)]
    count: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> Result<()> {
    let Arguments { count, seed } = Arguments::parse();
    let PowerUps { count, cut, moved, refused, confirmed, beyond_deg, breaches } = power_ups(seed, count);
    println!("{count} power-ups, {cut} cut by a loss of power; in {moved} the axes moved");
    println!("{refused} refusals to move, {confirmed} turns confirmed by the operator");
    println!("largest excess over the travel: {beyond_deg:.3} deg");
    breaches.iter().for_each(|breach| println!("  {breach}"));
    ensure!(breaches.is_empty(), "an axis left its travel");
    Ok(())
}
