//! `rins observability`

use super::arguments::axes::AxisArguments;
use super::arguments::method::MethodArguments;
use super::arguments::scheme::SchemeArguments;
use super::arguments::unit::DescriptionArguments;
use super::ending::Ending;
use super::files;
use super::output::{say, sayln};
use crate::base::quantity::{significant, states};
use crate::calibration::Setup;
use crate::calibration::refusal::check_axes;
use crate::files::json_file::write_json;
use crate::page::plot::write_sigmas;
use crate::plan::bound::of_scheme;
use crate::plan::costs::{HardwareCost, HardwareCosts};
use crate::plan::prediction::{Prediction, RankAt, SegmentGain, silent_run};
use crate::result::table;
use clap::Args;
use rayon::prelude::*;
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::INSTALLATION_STATES;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::scheme::library::LIBRARY;
use rins_selfcal::segment::SegmentKind;
use std::iter;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct ObservabilityArguments {
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub unit: DescriptionArguments,
    #[command(flatten)]
    pub method: MethodArguments,
    /// Compare all schemes of the library with the joint method
    #[arg(long, conflicts_with_all = ["scheme", "stop", "periods", "method", "limits", "axis_rate", "acceleration"])]
    pub all: bool,
    /// Plot the sigmas of Bai's twelve states against time in this file
    #[arg(long, value_name = "OUT.svg", conflicts_with = "all")]
    pub plot: Option<PathBuf>,
    /// Write the prediction to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

/// Number of parameters that are named for each segment: those with the largest gain.
const NAMED_GAINS: usize = 3;
/// Smallest gain that is printed, bits.
const LEAST_GAIN: f64 = 0.1;

pub fn run(arguments: &ObservabilityArguments) -> anyhow::Result<Ending> {
    let [noise, config, hardware] = arguments.unit.inputs();
    let outputs = [("--json", arguments.json.as_deref()), ("--plot", arguments.plot.as_deref())];
    files::check(&[arguments.scheme.input(), noise, config, hardware], &outputs)?;
    if arguments.all {
        let setup = setup(arguments)?;
        let predictions = library(&setup);
        if let Some(path) = &arguments.json {
            write_json(path, &predictions)?;
        }
        say!("{}", comparison(&predictions));
        return Ok(Ending::Done);
    }
    let (setup, scheme) = inputs(arguments)?;
    check_axes(&scheme, &arguments.axes.axes())?;
    let mut prediction = predicted(&setup, &scheme);
    if setup.method == Method::Joint && setup.hardware != Hardware::IDEAL {
        prediction.hardware = Some(HardwareCosts::new(&setup, &silent_run(&setup, &scheme)));
    }
    if let Some(path) = &arguments.json {
        write_json(path, &prediction)?;
    }
    if let Some(path) = &arguments.plot {
        write_sigmas(path, &prediction)?;
    }
    say!("{}", text(&prediction));
    if let Some(path) = &arguments.json {
        sayln!("prediction: {}", path.display());
    }
    if let Some(path) = &arguments.plot {
        sayln!("plot: {}", path.display());
    }
    Ok(Ending::Done)
}

/// Setup of the unit, and the scheme.
pub fn inputs(arguments: &ObservabilityArguments) -> anyhow::Result<(Setup, Scheme)> {
    Ok((setup(arguments)?, arguments.scheme.scheme(arguments.method.method)?))
}

fn setup(arguments: &ObservabilityArguments) -> anyhow::Result<Setup> {
    Ok(arguments.method.setup(&arguments.unit.config()?))
}

/// Predictions of all schemes of the library with the joint method.
fn library(setup: &Setup) -> Vec<Prediction> {
    let setup = Setup { method: Method::Joint.into(), ..setup.clone() };
    LIBRARY.par_iter().map(|entry| predicted(&setup, &entry.scheme())).collect()
}

/// Prediction of a scheme, with the least sigma that is possible in its time.
fn predicted(setup: &Setup, scheme: &Scheme) -> Prediction {
    let mut prediction = Prediction::new(setup, scheme);
    if setup.method == Method::Joint {
        prediction.least_possible_arcsec = of_scheme(setup, scheme, prediction.duration_s);
    }
    prediction
}

/// How far the worst sigma is above the least possible sigma, in percent.
fn above_least(prediction: &Prediction) -> Option<String> {
    let least = prediction.least_possible_arcsec.filter(|_| prediction.unobserved.is_empty())?;
    Some(format!("{:.0} %", (prediction.worst_arcsec / least - 1.0) * 100.0))
}

fn comparison(predictions: &[Prediction]) -> String {
    let row = |prediction: &Prediction| {
        vec![
            prediction.scheme.clone(),
            format!("{:.1}", prediction.duration_s),
            if prediction.unobserved.is_empty() { significant(prediction.worst_arcsec) } else { "-".into() },
            table::number_or_none(prediction.least_possible_arcsec, significant),
            above_least(prediction).unwrap_or_else(|| "-".into()),
            format!("{} of {}", prediction.rank, prediction.states),
            significant(prediction.condition_number),
            table::number_or_none(prediction.time_to_1_arcsec_s, |time_s| format!("{time_s:.1}")),
        ]
    };
    let columns = [
        "scheme",
        "time s",
        "worst of 12 arcsec",
        "least possible",
        "above",
        "rank",
        "condition",
        "time to 1 arcsec s",
    ];
    let sources = LIBRARY.iter().map(|entry| {
        let command = entry.command.map_or_else(String::new, |command| format!("\n    {command}"));
        format!("{}: {}{command}\n", entry.name, entry.source)
    });
    let mut text = table::of_numbers(&columns, predictions.iter().map(row)) + "\n";
    text.extend(sources);
    text
}

fn text(prediction: &Prediction) -> String {
    let hidden = if prediction.unobserved.is_empty() {
        String::new()
    } else {
        format!("not observed: {}\n", prediction.unobserved.join(", "))
    };
    let costs =
        prediction.hardware.as_ref().map_or_else(String::new, |hardware| costs(hardware, prediction.worst_arcsec));
    format!(
        "scheme {}, {:.1} s, {} method\n\nBai's 12 states, stacked along the scheme\n{}\ninformation gained, bits, and \
         worst sigma of Bai's 12\n{}\nsigmas of Bai's 12 against time, arcsec\n{}\nall states: rank {} of {}, condition \
         number {}, weakest direction: {}\n{hidden}worst of Bai's 12: {} arcsec{}{}\n\n{costs}{}",
        prediction.scheme,
        prediction.duration_s,
        prediction.method,
        ranks(prediction),
        segments(prediction),
        against_time(prediction),
        prediction.rank,
        prediction.states,
        significant(prediction.condition_number),
        prediction.weakest_direction,
        significant(prediction.worst_arcsec),
        above_least(prediction).zip(prediction.least_possible_arcsec).map_or_else(String::new, |(above, least)| {
            format!(", {above} above the least possible in this time, {}", significant(least))
        }),
        prediction.time_to_1_arcsec_s.map_or_else(String::new, |time_s| format!("; 1 arcsec after {time_s:.1} s")),
        sigmas(prediction)
    )
}

/// What each imperfection of the hardware costs, with this worst sigma of Bai's twelve.
fn costs(hardware: &HardwareCosts, worst_arcsec: f64) -> String {
    let row = |cost: &HardwareCost| {
        let by = worst_arcsec - cost.worst_without_arcsec;
        vec![
            cost.key.into(),
            significant(cost.size),
            significant(cost.worst_without_arcsec),
            format!("{:.1} %", by / worst_arcsec * 100.0),
        ]
    };
    let columns = ["hardware", "size", "worst without it, arcsec", "lower by"];
    format!(
        "what each imperfection of the hardware costs; without all of them the worst of Bai's 12 is {} arcsec\n{}\n",
        significant(hardware.worst_of_ideal_arcsec),
        table::of_numbers(&columns, hardware.each.iter().map(row))
    )
}

fn ranks(prediction: &Prediction) -> String {
    let row = |at: &RankAt| vec![format!("{:.1}", at.time_s), at.rank.to_string(), significant(at.condition_number)];
    table::of_numbers(&["time s", "rank", "condition"], prediction.installation_rank.iter().map(row))
}

fn segments(prediction: &Prediction) -> String {
    let row = |gain: &SegmentGain| {
        let kind = if gain.kind == SegmentKind::Stop { "stop" } else { "move" };
        let all: f64 = gain.gained_bits.0.iter().map(|(_, bits)| bits).sum();
        vec![
            gain.segment.to_string(),
            kind.into(),
            format!("{:.1}", gain.time_s),
            significant(gain.worst_arcsec()),
            format!("{all:.1}"),
            largest_gains(gain),
        ]
    };
    let columns = ["segment", "kind", "end s", "worst arcsec", "gained", "most of it"];
    table::of_numbers(&columns, prediction.segments.iter().map(row))
}

fn largest_gains(gain: &SegmentGain) -> String {
    let mut gains = gain.gained_bits.0.clone();
    gains.sort_by(|a, b| b.1.total_cmp(&a.1));
    let worth = gains.iter().filter(|(_, bits)| *bits >= LEAST_GAIN).take(NAMED_GAINS);
    worth.map(|(name, bits)| format!("{name} {bits:.1}")).collect::<Vec<_>>().join(", ")
}

fn of_twelve(gain: &SegmentGain) -> impl Iterator<Item = (&'static str, f64)> {
    gain.sigmas.0.iter().take(INSTALLATION_STATES).copied()
}

/// Sigmas of Bai's twelve states after every segment.
fn against_time(prediction: &Prediction) -> String {
    let names = prediction.segments.first().into_iter().flat_map(of_twelve).map(|(name, _)| name);
    let columns: Vec<_> = iter::once("end s").chain(names).collect();
    let row = |gain: &SegmentGain| {
        let sigmas = of_twelve(gain).map(|(_, sigma)| significant(sigma));
        iter::once(format!("{:.1}", gain.time_s)).chain(sigmas).collect()
    };
    table::of_numbers(&columns, prediction.segments.iter().map(row))
}

/// All predicted sigmas of the parameters and of the effects of the hardware.
pub fn sigmas(prediction: &Prediction) -> String {
    let both = || prediction.parameters.0.iter().chain(&prediction.effects.0);
    let names: Vec<_> = states().map(|info| info.name).collect();
    table::by_state(&["sigma"], |state| {
        let found = both().find(|(name, _)| *name == names[state]);
        found.map(|(_, predicted)| vec![significant(predicted.sigma)])
    })
}
