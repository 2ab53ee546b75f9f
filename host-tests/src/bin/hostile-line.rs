//! Lays siege to the serial line of the firmware in the emulator, and prints what it did and every broken promise.

use anyhow::Result;
use clap::Parser;
use host_tests::study::hostile_line::{Attack, Siege, hostile_line};
use host_tests::study::promises::{Seed, kept};

/// A hostile host at the serial line of the firmware in the emulator: no reset, no urgent message lost, no motion without
/// authority, nothing wrong accepted
#[derive(Parser)]
struct Arguments {
    /// Emulated time, minutes
    #[arg(long, default_value_t = 60.0)]
    minutes: f64,
    #[command(flatten)]
    seed: Seed,
}

fn main() -> Result<()> {
    let Arguments { minutes, seed: Seed { seed } } = Arguments::parse();
    let siege = hostile_line(seed, minutes)?;
    let Siege { emulated_s, wall_s, bytes, frames, answers, urgent, lost, resets, panics, moved_deg, answer_s, .. } =
        siege;
    println!("{:.1} min of emulated time in {:.1} min", emulated_s / 60.0, wall_s / 60.0);
    println!("{bytes} bytes sent, {:.0} a second; {frames} frames, {answers} answers", bytes as f64 / emulated_s);
    for (attack, count) in Attack::ALL.into_iter().zip(siege.attacks) {
        println!("  {count:>5} {}", attack.name());
    }
    println!("{resets} resets, {panics} of them by a panic");
    println!("{urgent} urgent messages, {lost} lost");
    println!("longest time to an answer after an attack: {answer_s:.1} s");
    println!("largest movement of an axis that nobody may move: {moved_deg:.4} deg");
    println!("{} runs judged, {} accepted", siege.judged[0], siege.judged[1]);
    kept(&siege.breaches)
}
