//! Prints how the instrument reacts to each failure at several phases of a run.

use clap::Parser;
use host_tests::study::fault_table::{Failing, Fate, Phase, fate, good_calibration};

/// Injects each failure at each phase of a run, and prints the reaction and the reports of the firmware
#[derive(Parser)]
struct Arguments {
    /// Only failures whose name contains this text
    #[arg(long, default_value = "")]
    only: String,
    /// Axis that fails: 0 for outer, which turns first, or 1 for inner
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..2))]
    axis: u8,
}

fn main() {
    let arguments = Arguments::parse();
    let before = good_calibration();
    println!(
        "{:<25}{:<15}{:>11}  {:<11}{:<6}{:<22}reported",
        "fault", "phase", "stopped ms", "ends in", "kept", "wound deg"
    );
    for (failing, name) in Failing::ALL.into_iter().filter(|(_, name)| name.contains(&arguments.only)) {
        for phase in Phase::ALL {
            print(name, phase, &fate(failing, phase, arguments.axis.into(), &before));
        }
    }
}

fn print(name: &str, phase: Phase, fate: &Fate) {
    let stopped = fate.stopped_ms.map_or("never".into(), |ms| ms.to_string());
    let told = match fate.accepted {
        Some(worst) => format!("accepted, worst parameter off by {worst:.1} sigma"),
        None => fate.told.join("; "),
    };
    let (kept, state) = (if fate.stored { "yes" } else { "NO" }, format!("{:?}", fate.state));
    let [outer, inner] = fate.wound_rad.map(|[low, high]| format!("{:.0}..{:.0}", low.to_degrees(), high.to_degrees()));
    let wound = format!("{outer}, {inner}");
    println!("{name:<25}{:<15}{stopped:>11}  {state:<11}{kept:<6}{wound:<22}{told}", phase.name());
}
