//! Prints what every method makes of the same units.

use clap::Parser;
use host_tests::result::table;
use host_tests::study::methods_table::{SUMMARY_COLUMNS, Terms, UNITS, parameters, row, summary};

/// Calibrates units of the paper's two tables, units with all errors of a real one, and units of navigation grade with
/// every method on the same data, and prints their errors
#[derive(Parser)]
struct Arguments {
    /// Number of units of each kind
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(2..))]
    runs: u64,
    /// Duration of every stop of the scheme "bai", which is run twice, s
    #[arg(long, default_value_t = 20.0)]
    stop: f64,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> anyhow::Result<()> {
    let Arguments { runs, stop, seed } = Arguments::parse();
    let terms = Terms { runs, stop_s: stop, seed };
    println!("scheme bai, two periods, stops of {stop} s; {runs} units of each kind, seed {seed}");
    println!(
        "honest: the mean of (error/sigma)^2 over the units is inside the 99 % bounds of all means (! = outside)\n"
    );
    let rows: Vec<_> = UNITS.iter().map(|kind| Ok((kind, row(kind, &terms)?))).collect::<anyhow::Result<_>>()?;
    print!("{}", table::of_words(&SUMMARY_COLUMNS, rows.iter().flat_map(|(kind, methods)| summary(kind, methods))));
    for (kind, methods) in &rows {
        print!("\n{}: {}\n{}", kind.errors, kind.title, parameters(methods));
    }
    Ok(())
}
