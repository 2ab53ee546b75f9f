//! `rins plan`

use super::Ending;
use super::arguments::{PlanArguments, unit_config};
use super::observability::sigmas;
use super::output::{say, sayln};
use super::{files, progress};
use crate::base::quantity::{HEADING, significant};
use crate::files::json_file::write_json;
use crate::files::scheme_file::write_scheme;
use crate::plan::objective::Criterion;
use crate::plan::prediction::Prediction;
use crate::plan::{PlanRequest, Planned, plan};
use crate::result::table;
use anyhow::ensure;
use rins_selfcal::base::units::DEG;
use rins_selfcal::model::error_model::PARAMETER_INFO;
use rins_selfcal::scheme::Scheme;
use std::path::Path;
use std::sync::Mutex;

pub fn run(arguments: &PlanArguments) -> anyhow::Result<Ending> {
    let inputs = [("--config", arguments.config.as_deref()), ("--noise", arguments.noise.as_deref().map(Path::new))];
    files::check(&inputs, &[("--out", Some(arguments.out.as_path())), ("--json", arguments.json.as_deref())])?;
    let unit = unit_config(arguments.config.as_ref(), arguments.noise.as_deref(), None)?;
    let request = arguments.request(&unit)?;
    let stem = arguments.out.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let planned = search(&request, arguments.name.as_deref().unwrap_or(&stem))?;
    let prediction = Prediction::new(&request.setup, &planned.scheme);
    refuse_unobserved(&prediction)?;
    write_scheme(&arguments.out, &planned.scheme)?;
    if let Some(path) = &arguments.json {
        write_json(path, &prediction)?;
    }
    say!("{}\n{}\n{}", legs(&planned.scheme), sigmas(&prediction), summary(&request, &planned, &prediction));
    sayln!("scheme: {}", arguments.out.display());
    if let Some(path) = &arguments.json {
        sayln!("prediction: {}", path.display());
    }
    Ok(Ending::Done)
}

/// A calibration by a scheme that leaves parameters unobserved, the heading apart, is refused before anything turns.
fn refuse_unobserved(prediction: &Prediction) -> anyhow::Result<()> {
    let heading = PARAMETER_INFO[HEADING].name;
    let missing: Vec<_> = prediction.unobserved.iter().copied().filter(|name| *name != heading).collect();
    ensure!(
        missing.is_empty(),
        "the best scheme found leaves {} unobserved and would be refused, so it is not written; give more --time or \
         --evaluations, finer --angles, wider --limits, or --weights for these parameters too",
        missing.join(", ")
    );
    Ok(())
}

fn search(request: &PlanRequest, name: &str) -> anyhow::Result<Planned> {
    let bar = progress::bar(request.evaluations, "schemes");
    let best = Mutex::new(f64::INFINITY);
    let progress = |looked_at, value: f64| {
        if let Ok(mut best) = best.lock()
            && value < *best
        {
            *best = value;
            bar.set_message(format!("best so far: {}", significant(value)));
        }
        bar.inc(looked_at);
    };
    Ok(plan(request, name, &progress)?)
}

fn legs(scheme: &Scheme) -> String {
    let first = (0.0, 0.0, scheme.first_stop_s);
    let rest = scheme.legs.iter().map(|leg| (leg.outer_rad, leg.inner_rad, leg.stop_s));
    let row = |(outer, inner, stop_s): (f64, f64, f64)| {
        vec![format!("{:.1}", outer / DEG + 0.0), format!("{:.1}", inner / DEG + 0.0), format!("{stop_s:.3}")]
    };
    table::of_numbers(&["outer deg", "inner deg", "stop s"], std::iter::once(first).chain(rest).map(row))
}

fn summary(request: &PlanRequest, planned: &Planned, prediction: &Prediction) -> String {
    let what = match request.objective.criterion() {
        Criterion::Worst => "worst weighted sigma",
        Criterion::A => "root mean square of the weighted sigmas",
        Criterion::D => "geometric mean of the weighted sigmas' axes",
    };
    let value = significant(planned.value);
    let bound = planned.bound.map_or_else(
        || "the least possible is not known for this objective".into(),
        |bound| {
            let above = (planned.value / bound - 1.0) * 100.0;
            format!("{above:.0} % above the least possible, {}", significant(bound))
        },
    );
    format!("{:.3} s of {} s; {what} {value}; {bound}\n", prediction.duration_s, request.time_s)
}
