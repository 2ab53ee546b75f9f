//! Runs the command, and ends the program with its exit status.

use super::command_line::{Arguments, Command};
use super::ending::Ending;
use super::output::say;
use super::{
    apply, calibrate, compare, explain, guide, history, inspect, manual, monitor, monte_carlo, observability, output,
    plan, replay, replicate, simulate,
};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use std::process::ExitCode;

/// Runs the program with the arguments of this process.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return usage(&error),
    };
    match run(arguments) {
        Ok(Ending::Done) => ExitCode::SUCCESS,
        Ok(Ending::NotAccepted) => ExitCode::from(2),
        Err(error) => fail(&format!("{error:#}")),
    }
}

fn run(arguments: Arguments) -> anyhow::Result<Ending> {
    if arguments.quiet {
        output::be_quiet();
    }
    match arguments.command.unwrap_or(Command::Calibrate(arguments.calibrate)) {
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Apply(arguments) => apply::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Observability(arguments) => observability::run(&arguments),
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Montecarlo(arguments) => monte_carlo::run(&arguments),
        Command::Replicate(arguments) => replicate::run(&arguments),
        Command::Monitor(arguments) => monitor::run(&arguments),
        Command::History(arguments) => history::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Guide(arguments) => guide::run(&arguments),
        Command::Completions(arguments) => manual::completions(&arguments, Arguments::command()),
        Command::Man => manual::page(Arguments::command()),
    }
}

/// Prints help and version on the standard output, and errors of the command line in one line on the standard error.
fn usage(error: &clap::Error) -> ExitCode {
    if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) {
        say!("{error}");
        return ExitCode::SUCCESS;
    }
    let text = error.to_string();
    let said = text.split("\n\n").next().unwrap_or_default();
    fail(said.strip_prefix("error: ").unwrap_or(said))
}

/// Prints an error as one line on the standard error.
fn fail(message: &str) -> ExitCode {
    let line: Vec<_> = message.split_whitespace().collect();
    eprintln!("error: {}", line.join(" "));
    ExitCode::FAILURE
}
