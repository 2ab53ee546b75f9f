//! Prints what the calibration makes of each effect of real hardware alone.

use clap::Parser;
use host_tests::study::effects_table::{FURTHER, NOISE_KEYS, Row, SITE, alone, effects, row};
use host_tests::study::monte_carlo::ErrorSource;
use rins_selfcal::scheme::Scheme;

/// Runs units with one effect of real hardware each, at several sizes, with hardware of navigation grade configured,
/// and prints a table
#[derive(Parser)]
struct Arguments {
    /// Number of runs of each row
    #[arg(long, default_value_t = 40)]
    runs: u64,
    /// Sizes, in units of the typical sizes [default: 0.5,1,2,5; with --no-state 1,2,5,10,20]
    #[arg(long, value_delimiter = ',')]
    sizes: Vec<f64>,
    /// Effects that have no state in the filter, at larger sizes: those that it takes as noise, and those that it knows
    /// nothing of
    #[arg(long)]
    no_state: bool,
    /// Only the effects whose names contain this text
    #[arg(long)]
    only: Option<String>,
    /// Schemes; bai has stops of 10 s
    #[arg(long, value_delimiter = ',', default_values_t = ["fast-180".to_string(), "bai".into(), "19-position".into()])]
    schemes: Vec<String>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let named = |name: &String| match name.as_str() {
        "bai" => Ok(Scheme::bai(10.0, 1)),
        _ => Scheme::named(name).ok_or_else(|| anyhow::anyhow!("the library has no scheme {name}")),
    };
    let schemes: Vec<Scheme> = arguments.schemes.iter().map(named).collect::<Result<_, _>>()?;
    let usual: &[f64] = if arguments.no_state { &[1.0, 2.0, 5.0, 10.0, 20.0] } else { &[0.5, 1.0, 2.0, 5.0] };
    let sizes = if arguments.sizes.is_empty() { usual } else { &arguments.sizes };
    println!(
        "{:30}{:13}{:>8}{:>10}{:>7}  {:36}first reason",
        "effect", "scheme", "size", "accepted", "wrong", "largest mean (error/sigma)^2"
    );
    let is_asked = |name: &str| arguments.only.as_ref().is_none_or(|only| name.contains(only));
    let print = |name: &str, size: String, errors: ErrorSource| {
        for scheme in &schemes {
            let Row { accepted, wrong, dishonest: (largest, parameter), reason, .. } =
                row(errors.clone(), scheme, arguments.runs, arguments.seed)?;
            let reason = reason.map_or_else(String::new, |(code, count)| format!("{code} ({count})"));
            let largest = if accepted > 0 { format!("{largest:.2} {parameter}") } else { "-".into() };
            println!("{name:30}{:13}{size:>8}{accepted:10}{wrong:7}  {largest:36}{reason}", scheme.name);
        }
        anyhow::Ok(())
    };
    let asked = effects().filter(|effect| is_asked(effect.key));
    for effect in asked.filter(|effect| !arguments.no_state || NOISE_KEYS.contains(&effect.key)) {
        for times in sizes {
            print(effect.key, format!("x {times}"), alone(effect, *times))?;
        }
    }
    let further = if arguments.no_state { &FURTHER[..] } else { &SITE[..] };
    for effect in further.iter().filter(|further| is_asked(further.name)) {
        for size in effect.sizes {
            print(effect.name, size.to_string(), effect.alone(*size))?;
        }
    }
    Ok(())
}
