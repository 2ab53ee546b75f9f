//! The command line: all commands with their help.

use super::apply::ApplyArguments;
use super::calibrate::CalibrateArguments;
use super::compare::CompareArguments;
use super::explain::ExplainArguments;
use super::guide::GuideArguments;
use super::history::HistoryArguments;
use super::inspect::InspectArguments;
use super::manual::CompletionsArguments;
use super::monitor::MonitorArguments;
use super::monte_carlo::MonteCarloArguments;
use super::observability::ObservabilityArguments;
use super::plan::PlanArguments;
use super::replay::ReplayArguments;
use super::replicate::ReplicateArguments;
use super::simulate::SimulateArguments;
use clap::{Parser, Subcommand};

/// Self-calibration of a dual-axis rotational INS.
///
/// The default command is `calibrate`. Exit status: 0 done or accepted, 1 error, 2 calibration not accepted.
#[derive(Debug, Parser)]
#[command(name = "rins", version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    /// Print the outcome only: no progress, no tables, no notes
    #[arg(long, short, global = true)]
    pub quiet: bool,
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub calibrate: CalibrateArguments,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Power up a virtual RINS that calibrates itself in closed loop
    #[command(
        after_help = "Examples:\n  rins calibrate --scheme fast-60 --seed 3\n  rins calibrate --firmware --eeprom eeprom.bin\n  rins calibrate --errors random --noise tactical --json cal.json --report page.html"
    )]
    Calibrate(CalibrateArguments),
    /// Write the log of a virtual RINS that runs a scheme, and its true parameters
    #[command(after_help = "Example: rins simulate --out log.csv --truth truth.json --write-config unit.toml")]
    Simulate(SimulateArguments),
    /// Calibrate from a log
    #[command(
        after_help = "Examples:\n  rins replay log.csv.gz --config unit.toml --json cal.json\n  rins replay flight.parquet --mapping map.toml --config unit.toml"
    )]
    Replay(ReplayArguments),
    /// Describe a log: columns, rate, gaps, noise, stops and moves, scheme, observable parameters
    ///
    /// Columns of any names and units are recognized by their values while the axes turn. `replay` and `apply` can use
    /// the proposed mapping.
    #[command(
        after_help = "Examples:\n  rins inspect log.csv\n  rins inspect foreign.csv --write-mapping map.toml --write-config unit.toml\n  rins replay foreign.csv --mapping map.toml --config unit.toml"
    )]
    Inspect(InspectArguments),
    /// Correct a log with the result of a calibration
    #[command(after_help = "Example: rins apply log.csv --calibration cal.json --out corrected.csv")]
    Apply(ApplyArguments),
    /// Compare two results in sigmas; exit status 2 if they differ by more than chance
    #[command(after_help = "Example: rins compare before.json after.json")]
    Compare(CompareArguments),
    /// Predict the sigmas, the rank and the condition number of a scheme
    #[command(
        after_help = "Examples:\n  rins observability --all\n  rins observability --scheme bai --stop 10 --noise tactical\n  rins observability --scheme mine.toml --config unit.toml --plot sigmas.svg"
    )]
    Observability(ObservabilityArguments),
    /// Find the best scheme of a given duration; the search takes one to two minutes by default
    #[command(
        after_help = "Examples:\n  rins plan --time 120 --out mine.toml\n  rins plan --time 90 --limits=-180..180,-90..90 --axis-rate 30 --out mine.toml\n  rins plan --time 60 --weights gyro_scale_z,gamma=3 --angles 45 --out mine.toml"
    )]
    Plan(PlanArguments),
    /// Calibrate many virtual units, and compare the errors with their bounds and sigmas
    #[command(
        after_help = "Examples:\n  rins montecarlo --runs 1000 --scheme fast-120 --closed-loop\n  rins montecarlo --method bai --errors table1 --noise bai"
    )]
    Montecarlo(MonteCarloArguments),
    /// Repeat the studies of Bai et al., and compare the results on a page; takes one to two minutes
    #[command(after_help = "Example: rins replicate --report replication.html --json replication.json")]
    Replicate(ReplicateArguments),
    /// Show an instrument on a serial line live, and send it commands
    #[command(
        after_help = "Examples:\n  rins monitor --port /dev/ttyACM0\n  rins monitor --port /dev/ttyACM0 --unlock --start --quiet\n  rins monitor --port tcp:10.0.0.7:4000 --read calibration --json cal.json"
    )]
    Monitor(MonitorArguments),
    /// Show the calibrations stored in an image of an instrument's memory
    #[command(after_help = "Example: rins history eeprom.bin --json history.json")]
    History(HistoryArguments),
    /// Explain the code that is printed with a reason, or list all codes
    #[command(after_help = "Examples:\n  rins explain\n  rins explain noise-level")]
    Explain(ExplainArguments),
    /// Print a chapter of the guide, or the list of chapters
    #[command(after_help = "Examples:\n  rins guide\n  rins guide tutorial")]
    Guide(GuideArguments),
    /// Print the completion script of a shell
    #[command(after_help = "Example: rins completions bash > ~/.local/share/bash-completion/completions/rins")]
    Completions(CompletionsArguments),
    /// Print the manual page
    #[command(after_help = "Example: rins man > ~/.local/share/man/man1/rins.1")]
    Man,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn every_command_has_examples_that_are_commands() {
        for command in Arguments::command().get_subcommands() {
            let name = command.get_name();
            let help = command.get_after_help().unwrap_or_else(|| panic!("{name} has no example")).to_string();
            let examples =
                help.lines().filter_map(|line| line.trim_start_matches("Example: ").trim().strip_prefix("rins "));
            let mut own = 0;
            for example in examples {
                let words = example.split(" > ").next().unwrap_or_default().split_whitespace();
                let parsed = Arguments::try_parse_from(std::iter::once("rins").chain(words));
                assert!(parsed.is_ok(), "{example}: {}", parsed.unwrap_err());
                own += usize::from(example.split_whitespace().next() == Some(name));
            }
            assert!(own > 0, "{name}");
        }
    }
}
