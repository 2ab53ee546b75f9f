//! `rins compare`

use super::ending::Ending;
use super::output::{say, sayln};
use crate::base::quantity::{fixed, rounded, significant};
use crate::result::comparison::Comparison;
use crate::result::saved::Saved;
use crate::result::table::by_parameter;
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct CompareArguments {
    /// The first result
    #[arg(value_name = "A.json")]
    pub first: PathBuf,
    /// The second result
    #[arg(value_name = "B.json")]
    pub second: PathBuf,
}

pub fn run(arguments: &CompareArguments) -> anyhow::Result<Ending> {
    let (first, second) = (Saved::read(&arguments.first)?, Saved::read(&arguments.second)?);
    let comparison = Comparison::new(&first, &second);
    say!("{}", table(&comparison, &first, &second));
    for note in &comparison.notes {
        sayln!("note: {note}");
    }
    sayln!("{}", comparison.in_words());
    Ok(if comparison.changed().next().is_none() { Ending::Done } else { Ending::NotAccepted })
}

fn table(comparison: &Comparison, first: &Saved, second: &Saved) -> String {
    by_parameter(&["first", "second", "change", "sigma", "change/sigma"], |index| {
        let change = comparison.changes[index]?;
        let value = |saved: &Saved| saved.parameters[index].map(|found| rounded(found.value, found.sigma));
        Some(vec![
            value(first)?,
            value(second)?,
            rounded(change.difference, change.sigma),
            significant(change.sigma),
            fixed(change.normalized(), 2) + if Comparison::counts(index) { "" } else { " *" },
        ])
    }) + "* attitude of the vehicle: not counted\n"
}
