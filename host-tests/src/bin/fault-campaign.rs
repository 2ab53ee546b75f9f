//! Runs a fault campaign and prints its table.

use clap::Parser;
use host_tests::calibration::Precision;
use host_tests::study::fault_campaign::{Campaign, Faults, Summary};
use host_tests::study::faults::FaultKind;
use indicatif::ProgressBar;
use std::time::Instant;

/// Runs the joint method many times with one random fault each, and counts accepted wrong results
#[derive(Parser)]
struct Arguments {
    /// Number of runs
    #[arg(long, default_value_t = 1000)]
    runs: u64,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run without faults, and count rejected correct results
    #[arg(long, conflicts_with = "only")]
    clean: bool,
    /// Only the fault whose name contains this text
    #[arg(long)]
    only: Option<String>,
    /// Units with the imperfections of navigation grade, which the filter expects, in place of ideal ones
    #[arg(long)]
    typical: bool,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    precision: Precision,
    /// Print each accepted wrong result and each rejected run without a fault
    #[arg(long)]
    list: bool,
}

fn main() {
    let arguments = Arguments::parse();
    let faults = match &arguments.only {
        _ if arguments.clean => Faults::None,
        None => Faults::All,
        Some(part) => {
            let Some(kind) = FaultKind::ALL.into_iter().find(|kind| kind.name().contains(part.as_str())) else {
                eprintln!("no fault has a name with {part}");
                std::process::exit(1);
            };
            Faults::Only(kind)
        }
    };
    let Arguments { runs, seed, typical, precision, .. } = arguments;
    let campaign = Campaign { runs, seed, faults, typical, precision };
    let bar = ProgressBar::new(campaign.runs);
    let start = Instant::now();
    let outcomes = campaign.run(|| bar.inc(1));
    bar.finish_and_clear();
    if arguments.list {
        for outcome in &outcomes {
            if outcome.wrong.is_some() && outcome.verdict.accepted() {
                println!("seed {}: {:?} {:?}", outcome.seed, outcome.wrong, outcome.fault);
            } else if outcome.fault.is_none() && !outcome.verdict.accepted() {
                for reason in &outcome.verdict.reasons {
                    println!("seed {}: {reason}", outcome.seed);
                }
            }
        }
    }
    print!("{}", Summary::new(&outcomes));
    println!("{:.0} s", start.elapsed().as_secs_f64());
}
