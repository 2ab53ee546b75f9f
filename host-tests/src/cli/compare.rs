//! `rins compare`

use super::Ending;
use super::arguments::CompareArguments;
use super::output::{say, sayln};
use crate::comparison::Comparison;
use crate::quantity::{fixed, rounded, significant};
use crate::saved::Saved;
use crate::table::by_parameter;
use rins_selfcal::error_model::PARAMETER_INFO;

pub fn run(arguments: &CompareArguments) -> anyhow::Result<Ending> {
    let (first, second) = (Saved::read(&arguments.first)?, Saved::read(&arguments.second)?);
    let comparison = Comparison::new(&first, &second);
    say!("{}", table(&comparison, &first, &second));
    for note in &comparison.notes {
        sayln!("note: {note}");
    }
    let changed: Vec<_> = comparison.changed().collect();
    let limit = fixed(comparison.limit, 2);
    if changed.is_empty() {
        sayln!("agree: no change beyond {limit} sigma, attitude and heading aside");
        return Ok(Ending::Done);
    }
    let named = changed.iter().filter_map(|index| {
        let change = comparison.changes[*index]?;
        Some(format!("{} by {} sigma", PARAMETER_INFO[*index].name, fixed(change.normalized(), 1)))
    });
    sayln!("differ beyond {limit} sigma: {}", named.collect::<Vec<_>>().join(", "));
    Ok(Ending::NotAccepted)
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
    }) + "* of the vehicle: does not count\n"
}
