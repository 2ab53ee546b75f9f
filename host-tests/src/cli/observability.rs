//! `rins observability`

use super::Ending;
use super::arguments::{ObservabilityArguments, unit_config};
use crate::prediction::Prediction;
use crate::quantity::significant;
use crate::report::write_json;
use crate::table;
use rins_selfcal::error_model::PARAMETER_INFO;

pub fn run(arguments: &ObservabilityArguments) -> anyhow::Result<Ending> {
    let unit = unit_config(arguments.config.as_ref(), arguments.noise.as_deref(), None)?;
    let method = arguments.method.method();
    let scheme = arguments.scheme.scheme(method)?;
    let prediction = Prediction::new(&arguments.method.setup(&unit), &scheme);
    print!("{}", text(&prediction));
    if let Some(path) = &arguments.json {
        write_json(path, &prediction)?;
        println!("prediction: {}", path.display());
    }
    Ok(Ending::Done)
}

fn text(prediction: &Prediction) -> String {
    format!(
        "scheme {}, {:.1} s, {} method\n\nBai's 12 states, stacked along the scheme\n{}\nall states: rank {} of {}, \
         condition number {}\n\n{}",
        prediction.scheme,
        prediction.duration_s,
        prediction.method,
        ranks(prediction),
        prediction.rank,
        prediction.states,
        significant(prediction.condition_number),
        sigmas(prediction)
    )
}

fn ranks(prediction: &Prediction) -> String {
    let row = |at: &crate::prediction::RankAt| {
        vec![format!("{:.1}", at.time_s), at.rank.to_string(), significant(at.condition_number)]
    };
    table::of_numbers(&["time s", "rank", "condition"], prediction.installation_rank.iter().map(row))
}

/// All predicted sigmas, by parameter.
pub fn sigmas(prediction: &Prediction) -> String {
    table::by_parameter(&["sigma"], |index| {
        let name = PARAMETER_INFO[index].name;
        let found = prediction.parameters.0.iter().find(|(other, _)| *other == name);
        found.map(|(_, predicted)| vec![significant(predicted.sigma)])
    })
}
