//! `rins plan`

use super::arguments::axes::{TravelArgument, pace, travel};
use super::arguments::scheme::seconds;
use super::arguments::unit::{DescriptionArguments, rate_hz};
use super::arguments::value::number_in;
use super::ending::Ending;
use super::observability::sigmas;
use super::output::{say, sayln};
use super::{files, progress};
use crate::base::quantity::{HEADING, significant};
use crate::calibration::{Precision, Setup};
use crate::files::json_file::write_json;
use crate::files::scheme_file::write_scheme;
use crate::files::unit_file::UnitConfig;
use crate::plan::objective::{Criterion, Objective};
use crate::plan::prediction::Prediction;
use crate::plan::rates::{AtRate, plan_over_rates};
use crate::plan::{PlanRequest, Planned, plan};
use crate::result::table;
use anyhow::ensure;
use clap::Args;
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::model::error_model::PARAMETER_INFO;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::scheme::Turning;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Mutex;

#[derive(Debug, Args)]
pub struct PlanArguments {
    /// Duration of the scheme including first stop, ramps and settling, s
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    time: f64,
    /// Write the scheme to this file
    #[arg(long, value_name = "SCHEME.toml")]
    pub out: PathBuf,
    /// Name of the scheme [default: the name of the file]
    #[arg(long)]
    pub name: Option<String>,
    /// Travel of the outer and the inner axis, deg; none allows two turns either way [default: none]
    #[arg(long, value_name = "LOW..HIGH,LOW..HIGH", value_parser = travel, allow_hyphen_values = true)]
    limits: Option<TravelArgument>,
    /// Rate of the moves, deg/s, or a range of rates of which the best is found; that takes twice as long
    #[arg(long, value_name = "DEG_S|LOW..HIGH", default_value = "20", value_parser = axis_rates, allow_hyphen_values = true)]
    axis_rate: AxisRates,
    /// Acceleration of the moves, deg/s^2
    #[arg(long, value_name = "DEG_S2", default_value_t = 20.0, value_parser = pace, allow_negative_numbers = true)]
    acceleration: f64,
    /// Stop at multiples of this angle, deg, or at any angle (free) [default: free for ideal hardware, otherwise 45]
    #[arg(long, value_name = "DEG|free", value_parser = angle_step)]
    angles: Option<AngleStep>,
    /// Settling time of the accelerometers after a move, s; the firmware always waits at least 0.3 s
    #[arg(long, value_name = "S", default_value_t = 0.3, value_parser = settling, allow_negative_numbers = true)]
    settling: f64,
    /// Parameters to optimize, each by name or as NAME=FACTOR with a weight [default: Bai's twelve states]
    #[arg(long, value_name = "NAME[=FACTOR],..", value_delimiter = ',', value_parser = weight)]
    weights: Vec<(String, f64)>,
    /// Function of the weighted sigmas that is minimized
    #[arg(long, value_enum, default_value_t)]
    criterion: Criterion,
    #[command(flatten)]
    unit: DescriptionArguments,
    /// Number of schemes to evaluate; the search time is proportional to this number
    #[arg(long, value_name = "N", default_value_t = 300_000, value_parser = clap::value_parser!(u64).range(100..))]
    evaluations: u64,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the prediction to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

impl PlanArguments {
    pub fn request(&self, unit: &UnitConfig) -> anyhow::Result<PlanRequest> {
        let setup = Setup::new(unit, rate_hz(unit), Method::Joint, Precision::F64);
        let objective = if self.weights.is_empty() {
            Objective::installation(self.criterion)
        } else {
            Objective::weighted(self.criterion, &self.weights).map_err(anyhow::Error::msg)?
        };
        Ok(PlanRequest {
            setup,
            time_s: self.time,
            turning: Turning { rate_rad_s: self.axis_rate.0[0] * DEG, acceleration_rad_s2: self.acceleration * DEG },
            settling_s: self.settling,
            travel: self.limits.and_then(|limits| limits.0).unwrap_or_default(),
            angle_step_rad: self.angles.map_or_else(|| usual_step_rad(&unit.hardware()), |step| step.0),
            objective,
            evaluations: self.evaluations,
            seed: self.seed,
        })
    }
}

/// Step of the stop angles, rad; `None` allows any angle.
#[derive(Clone, Copy, Debug)]
struct AngleStep(Option<f64>);

/// Step of the stop angles for a unit with this hardware. Errors that have no state, such as the sub-division of an encoder,
/// are taken as independent from stop to stop. Stops that are close to each other would share them.
fn usual_step_rad(hardware: &Hardware) -> Option<f64> {
    (*hardware != Hardware::IDEAL).then_some(45.0 * DEG)
}

/// Lowest and highest rate of the moves, deg/s; equal if only one is permitted.
#[derive(Clone, Copy, Debug)]
struct AxisRates([f64; 2]);

fn axis_rates(text: &str) -> Result<AxisRates, String> {
    let Some((low, high)) = text.split_once("..") else { return pace(text).map(|rate| AxisRates([rate; 2])) };
    match (pace(low.trim())?, pace(high.trim())?) {
        (low, high) if low < high => Ok(AxisRates([low, high])),
        _ => Err("the lowest rate must be below the highest".into()),
    }
}

fn angle_step(text: &str) -> Result<AngleStep, String> {
    if text == "free" { Ok(AngleStep(None)) } else { Ok(AngleStep(Some(number_in(text, 0.01, 180.0)? * DEG))) }
}

fn weight(text: &str) -> Result<(String, f64), String> {
    let (name, factor) = text.split_once('=').unwrap_or((text, "1"));
    let factor = factor.parse().map_err(|_| format!("{name}: the weight is not a number"))?;
    Ok((name.into(), factor))
}

fn settling(text: &str) -> Result<f64, String> {
    number_in(text, 0.0, 60.0)
}

pub fn run(arguments: &PlanArguments) -> anyhow::Result<Ending> {
    files::check(
        &arguments.unit.inputs(),
        &[("--out", Some(arguments.out.as_path())), ("--json", arguments.json.as_deref())],
    )?;
    let unit = arguments.unit.config()?;
    let request = arguments.request(&unit)?;
    let stem = arguments.out.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let (planned, rates) = search(&request, arguments.axis_rate, arguments.name.as_deref().unwrap_or(&stem))?;
    let prediction = Prediction::new(&request.setup, &planned.scheme);
    refuse_unobserved(&prediction)?;
    write_scheme(&arguments.out, &planned.scheme)?;
    if let Some(path) = &arguments.json {
        write_json(path, &Report { prediction: &prediction, rates: &rates })?;
    }
    if !rates.is_empty() {
        sayln!("{}", against_rate(&rates, &planned.scheme));
    }
    say!("{}\n{}\n{}", legs(&planned.scheme), sigmas(&prediction), summary(&request, &planned, &prediction));
    sayln!("scheme: {}", arguments.out.display());
    if let Some(path) = &arguments.json {
        sayln!("prediction: {}", path.display());
    }
    Ok(Ending::Done)
}

/// Refuses a scheme that leaves parameters other than the heading unobserved. The instrument would refuse the scheme
/// too, before any axis turns.
fn refuse_unobserved(prediction: &Prediction) -> anyhow::Result<()> {
    let heading = PARAMETER_INFO[HEADING].name;
    let missing: Vec<_> = prediction.unobserved.iter().copied().filter(|name| *name != heading).collect();
    ensure!(
        missing.is_empty(),
        "the best scheme found leaves {} unobserved, and the instrument would refuse it; no file is written; give more --time or \
         --evaluations, finer --angles, wider --limits, or --weights for these parameters too",
        missing.join(", ")
    );
    Ok(())
}

/// The prediction, and what schemes at other rates reach.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    prediction: &'a Prediction,
    #[serde(skip_serializing_if = "<[AtRate]>::is_empty")]
    rates: &'a [AtRate],
}

fn search(request: &PlanRequest, rates: AxisRates, name: &str) -> anyhow::Result<(Planned, Vec<AtRate>)> {
    let AxisRates([low, high]) = rates;
    let sweeps = low < high;
    let bar = progress::bar(request.evaluations * if sweeps { 2 } else { 1 }, "schemes");
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
    if sweeps {
        Ok(plan_over_rates(request, [low * DEG, high * DEG], name, &progress)?)
    } else {
        Ok((plan(request, name, &progress)?, Vec::new()))
    }
}

/// The objective against the rate. The chosen rate is marked.
fn against_rate(rates: &[AtRate], scheme: &Scheme) -> String {
    let row = |at: &AtRate| {
        let chosen = (at.rate_deg_s * DEG / scheme.rate_rad_s - 1.0).abs() < 1e-9;
        let value = at.value.map_or_else(|| "-".into(), significant);
        vec![format!("{:.2}", at.rate_deg_s), value, if chosen { "*".into() } else { String::new() }]
    };
    table::of_numbers(&["axis rate deg/s", "objective", ""], rates.iter().map(row))
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
        || "the least possible value is not known for this objective".into(),
        |bound| {
            let above = (planned.value / bound - 1.0) * 100.0;
            format!("{above:.0} % above the least possible, {}", significant(bound))
        },
    );
    format!("{:.3} s of {} s; {what} {value}; {bound}\n", prediction.duration_s, request.time_s)
}
