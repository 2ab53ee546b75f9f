//! `rins montecarlo`

use super::arguments::axes::AxisArguments;
use super::arguments::method::{self, StudyMethod};
use super::arguments::scheme::{SchemeArguments, UnobservedArguments};
use super::arguments::unit::{VirtualArguments, errors_named, rate_hz};
use super::ending::Ending;
use super::output::{say, sayln};
use super::separating::{self, SeparatingReport};
use super::{files, progress};
use crate::base::bai::TABLE_1_ERRORS;
use crate::base::quantity::{fixed, rounded, significant, states};
use crate::calibration::{HostMethod, Precision};
use crate::files::json_file::write_json;
use crate::files::unit_file::{SiteTable, UnitConfig};
use crate::result::report::{Named, SOFTWARE, Software};
use crate::result::table;
use crate::separating::SeparatingMethod;
use crate::study::monte_carlo::{CONFIDENCE, FitStatistics, LiveTable, MethodStatistics, MonteCarlo, RunResult};
use crate::study::separating::{SeparatingStudy, separating_studies};
use crate::study::statistics::{ErrorStatistics, TOLERANCE};
use anyhow::bail;
use clap::Args;
use rins_selfcal::model::error_model::{PARAMETERS, ParameterInfo};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::SegmentKind;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

#[derive(Debug, Args)]
pub struct MonteCarloArguments {
    /// Number of runs
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    pub runs: u64,
    #[command(flatten)]
    pub scheme: SchemeArguments,
    #[command(flatten)]
    pub axes: AxisArguments,
    #[command(flatten)]
    pub unobserved: UnobservedArguments,
    /// Let the core turn the axes as at power-up, and repeat disturbed stops [default: open loop]
    #[arg(long)]
    pub closed_loop: bool,
    /// Methods on the same data: one, several with commas, or all
    #[arg(long, value_enum, value_delimiter = ',', default_value = "joint")]
    pub method: Vec<StudyMethod>,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
    /// Errors: table1, table3, real, typical, typical:0.5, random, random:1deg, random:tactical, a file, or keys in
    /// one line such as 'parameters.Sgxy = 30, effects.hunting_hz = 1.5'
    #[arg(long, value_name = "NAME|FILE|KEYS", default_value = "random")]
    pub errors: String,
    #[command(flatten)]
    pub unit: VirtualArguments,
    /// Put every unit at another place of the Earth, -400 to 4000 m high, and configure no site
    #[arg(long)]
    pub anywhere: bool,
    /// Write the statistics to this file
    #[arg(long, value_name = "OUT.json")]
    pub json: Option<PathBuf>,
}

/// Legend of the column with Bai's errors.
const BAI_TABLE_1_NOTE: &str = "Bai Table 1: errors of Bai's own simulation as published (Sensors 2019, 19, 4005, Table 1), to compare with RMS error\n";

pub fn run(arguments: &MonteCarloArguments) -> anyhow::Result<Ending> {
    let [errors, noise, config, hardware] = arguments.unit.inputs(&arguments.errors);
    let inputs = [arguments.scheme.input(), errors, noise, config, hardware];
    files::check(&inputs, &[("--json", arguments.json.as_deref())])?;
    let monte_carlo = monte_carlo(arguments)?;
    let separating = separating_methods(arguments)?;
    say!("{}", head(arguments, &monte_carlo)?);
    let bar = progress::bar(arguments.runs, "runs");
    let start = Instant::now();
    let so_far = Mutex::new(SoFar::default());
    let note = |results: &[RunResult]| {
        if let Ok(mut so_far) = so_far.lock() {
            so_far.note(results);
            bar.set_message(so_far.to_string());
        }
        bar.inc(1);
    };
    let methods = if monte_carlo.methods.is_empty() { Vec::new() } else { monte_carlo.run(note)? };
    let separated = separating_studies(&monte_carlo, &separating, || bar.inc(u64::from(methods.is_empty())));
    drop(bar);
    let wall = start.elapsed();
    if let Some(path) = &arguments.json {
        write_json(path, &Report::new(arguments, &monte_carlo, &methods).with_separated(&separated))?;
    }
    let beside_bai = arguments.errors == "table1";
    methods.iter().for_each(|method| say!("\n{}", text(method, beside_bai)));
    separated.iter().for_each(|study| say!("\n{}", separating::study_text(study)));
    if methods.len() + separated.len() > 1 {
        say!("\n{}", side_by_side(&methods, &separated));
    }
    if let Some(path) = &arguments.json {
        sayln!("statistics: {}", path.display());
    }
    progress::wall_time(wall);
    Ok(Ending::Done)
}

/// The separating methods that are chosen. They need open loop and a known latitude; `all` leaves them out elsewhere.
fn separating_methods(arguments: &MonteCarloArguments) -> anyhow::Result<Vec<SeparatingMethod>> {
    if !arguments.closed_loop && !arguments.anywhere {
        return Ok(method::separating(&arguments.method));
    }
    if arguments.method.iter().any(|method| matches!(method, StudyMethod::Separating(_))) {
        bail!("the separating methods run in open loop and need a known latitude: no --closed-loop, no --anywhere");
    }
    Ok(Vec::new())
}

/// Summary of the runs so far, over all methods.
#[derive(Default)]
struct SoFar {
    refused: u64,
    /// Largest sigma of the twelve installation errors, arcsec, and largest error in sigmas.
    worst: [f64; 2],
}

impl SoFar {
    fn note(&mut self, results: &[RunResult]) {
        self.refused += u64::from(!results.iter().all(RunResult::accepted));
        for worst in results.iter().map(RunResult::worst) {
            self.worst = [0, 1].map(|number| self.worst[number].max(worst[number]));
        }
    }
}

impl fmt::Display for SoFar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [sigma, error] = self.worst.map(significant);
        write!(f, "worst sigma {sigma} arcsec, largest error {error} sigma; {} not accepted so far", self.refused)
    }
}

/// Description of the study, printed above the tables.
fn head(arguments: &MonteCarloArguments, monte_carlo: &MonteCarlo) -> anyhow::Result<String> {
    let MonteCarlo { scheme, unit, rate_hz, seed, .. } = monte_carlo;
    let mut described = arguments.unit.described(unit)?;
    if let Some((_, rest)) = described.split_once('\n').filter(|_| arguments.anywhere) {
        described = format!("site: another place for every unit, none is configured\n{rest}");
    }
    let periods = if scheme.periods == 1 { "1 period".into() } else { format!("{} periods", scheme.periods) };
    let separating = separating_methods(arguments)?;
    let of_chain = monte_carlo.methods.iter().map(|method| method.name());
    let methods: Vec<_> = of_chain.chain(separating.iter().map(|method| method.name())).collect();
    Ok(format!(
        "{} runs of {:.1} s at {rate_hz} Hz, {}, seed {seed}\nscheme: {}, {periods}, {} stops of {}\nmethod: {}\n\
         errors: {}\n{described}",
        monte_carlo.runs,
        monte_carlo.duration_s(),
        if monte_carlo.closed_loop { "closed loop" } else { "open loop" },
        scheme.name,
        scheme.moves() + 1,
        stops(scheme),
        methods.join(" and "),
        arguments.errors
    ))
}

/// Duration of the stops, or its range.
fn stops(scheme: &Scheme) -> String {
    let all = || scheme.legs.iter().map(|leg| leg.stop_s).chain([scheme.first_stop_s]);
    let (shortest, longest) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
    if shortest < longest { format!("{shortest} to {longest} s") } else { format!("{longest} s") }
}

/// The study that the arguments describe.
pub fn monte_carlo(arguments: &MonteCarloArguments) -> anyhow::Result<MonteCarlo> {
    let described = arguments.unit.config()?;
    let unit = if arguments.anywhere { UnitConfig { site: SiteTable::default(), ..described } } else { described };
    let methods = method::of_chain(&arguments.method);
    // The paper's method needs the longest scheme, and the separating methods are compared with it.
    let only_joint = methods == [HostMethod::Joint] && method::separating(&arguments.method).is_empty();
    let longest = if only_joint { HostMethod::Joint } else { HostMethod::Bai };
    Ok(MonteCarlo {
        runs: arguments.runs,
        methods,
        precision: arguments.precision,
        scheme: arguments.scheme.scheme(longest)?,
        axes: arguments.axes.axes(),
        refuse_unobserved: !arguments.unobserved.run_unobserved,
        closed_loop: arguments.closed_loop,
        errors: errors_named(&arguments.errors)?,
        rate_hz: rate_hz(&unit),
        unit,
        seed: arguments.unit.seed,
    })
}

fn text(method: &MethodStatistics, beside_bai: bool) -> String {
    let name = method.method.name();
    let counts = format!(
        "{} accepted ({} of them wrong), {} rejected, {} not converged, {} diverged, {} aborted",
        method.accepted, method.accepted_wrong, method.rejected, method.unconverged, method.diverged, method.aborted
    );
    let mut text = format!("{name} method: {counts}\n");
    text += &listed("  wrong: ", &method.wrong, method.accepted_wrong);
    text += &listed("  - ", &method.rejections, method.rejected + method.aborted);
    let beside_bai = beside_bai && method.method == HostMethod::Bai;
    let note = if beside_bai { BAI_TABLE_1_NOTE } else { "" };
    text + "\n" + &errors(method, beside_bai) + note + &summary(method) + &live(&method.live)
}

/// The first of so many, each on a line, and how many more there are.
fn listed(mark: &str, first: &[String], all: usize) -> String {
    let lines = first.iter().map(|line| format!("{mark}{line}\n"));
    let more = all.saturating_sub(first.len());
    lines.chain((more > 0).then(|| format!("{mark}and {more} more\n"))).collect()
}

/// Live estimates, a row for each segment.
fn live(table: &LiveTable) -> String {
    if table.segments.is_empty() {
        return String::new();
    }
    let [low, high] = table.bounds;
    let mut text = format!(
        "\nlive estimates, mean (error/sigma)^2 of the parameters that are observed; {} % bounds of all together \
         {low:.3} to {high:.3}\n{:>7}  {:4}  {:>8}  {:>6}  {:>7}  {:>7}\n",
        CONFIDENCE * 100.0,
        "end s",
        "kind",
        "observed",
        "mean",
        "outside",
        "largest"
    );
    for segment in &table.segments {
        let Some((name, largest)) = segment.largest() else { continue };
        let kind = if segment.kind == SegmentKind::Stop { "stop" } else { "move" };
        let (end_s, mean, observed) = (segment.end_s, segment.mean(), segment.mean_normalized_squared.0.len());
        let outside = segment.outside;
        text += &format!("{end_s:7.1}  {kind:4}  {observed:8}  {mean:6.3}  {outside:7}  {largest:7.3}  {name}\n");
    }
    text
}

fn errors(method: &MethodStatistics, beside_bai: bool) -> String {
    let mut columns = vec!["RMS error", "mean error", "bound", "RMS/bound", "scatter", "(error/sigma)^2"];
    if beside_bai {
        columns.push("Bai Table 1");
    }
    table::by_state(&columns, |index| {
        let mut cells = error_cells(method.states[index].as_ref()?, method.normalized_bounds);
        if beside_bai {
            let theirs = TABLE_1_ERRORS.get(index).copied();
            cells.push(table::number_or_none(theirs, |error| format!("{error:.3}")));
        }
        Some(cells)
    })
}

fn error_cells(found: &ErrorStatistics, [low, high]: [f64; 2]) -> Vec<String> {
    let mark = |outside: bool| if outside { "!" } else { " " };
    let normalized = found.mean_normalized_squared;
    vec![
        significant(found.rms_error),
        rounded(found.mean_error, found.rms_error),
        significant(found.bound),
        fixed(found.ratio, 3) + mark(found.is_outside()),
        fixed(found.scatter, 3),
        fixed(normalized, 3) + mark(!(low..=high).contains(&normalized)),
    ]
}

fn summary(method: &MethodStatistics) -> String {
    let [low, high] = method.normalized_bounds;
    let (mean, largest) = method.ratios();
    let (inside, all) = method.consistent();
    let (outside, by_chance) = method.outside();
    let tolerance = TOLERANCE * 100.0;
    let fit = &method.fit;
    let percent = CONFIDENCE * 100.0;
    format!(
        "wrong: one of the twelve installation errors or the non-perpendicularity off by more than 4.5 sigma and \
         1 arcsec; by chance at most {} ({percent} %); largest error in an accepted run {} sigma\n\
         bound: Cramer-Rao bound, predicted for the true errors of each run's unit; root mean square over the runs\n\
         scatter: standard deviation of RMS/bound at this number of runs\n\
         RMS/bound: mean {}, largest {}; more than {tolerance:.0} % off 1: {outside} of {all} (!), {by_chance:.1} \
         expected by chance\n\
         mean (error/sigma)^2: {inside} of {all} inside {low:.3} to {high:.3} ({percent} % bounds of all together; ! = \
         outside)\n\
         chi-square of the fit: mean {} with {:.1} degrees of freedom, {percent} % bounds {:.2} to {:.2}\n",
        method.wrong_by_chance(),
        fixed(method.largest_accepted, 1),
        fixed(mean, 3),
        fixed(largest, 3),
        fixed(fit.mean_chi_square, 2),
        fit.mean_degrees_of_freedom,
        fit.bounds[0],
        fit.bounds[1]
    )
}

/// RMS errors and sigmas of the methods on the same data, for the parameters that all of them estimate.
fn side_by_side(methods: &[MethodStatistics], separated: &[SeparatingStudy]) -> String {
    let names = methods.iter().map(|method| method.method.name());
    let names = names.chain(separated.iter().map(|study| study.method.name()));
    let heads: Vec<_> = names.flat_map(|name| [format!("{name} RMS"), "sigma".into()]).collect();
    let heads: Vec<_> = heads.iter().map(String::as_str).collect();
    let table = table::by_parameter(&heads, |index| {
        let of_chain = methods.iter().map(|method| {
            let errors = method.states[index]?;
            Some([errors.rms_error, errors.bound].map(significant))
        });
        let of_separating = separated.iter().map(|study| {
            let errors = (*study.installation.get(index)?)?;
            Some([significant(errors.rms_error), table::number_or_none(errors.sigma, significant)])
        });
        Some(of_chain.chain(of_separating).collect::<Option<Vec<_>>>()?.into_iter().flatten().collect())
    });
    format!("all methods on the same data\n\n{table}")
}

/// Contents of the JSON file.
#[derive(Serialize)]
pub struct Report<'a> {
    runs: u64,
    scheme: &'a str,
    periods: u8,
    errors: &'a str,
    noise: crate::files::unit_file::Noise,
    rate_hz: f64,
    precision: crate::calibration::Precision,
    seed: u64,
    confidence: f64,
    methods: Named<MethodReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    separating: Option<Named<SeparatingReport>>,
    software: Software,
}

#[derive(Serialize)]
struct MethodReport {
    runs: usize,
    accepted: usize,
    accepted_wrong: usize,
    rejected: usize,
    unconverged: usize,
    diverged: usize,
    aborted: usize,
    rejections: Vec<String>,
    wrong: Vec<String>,
    mean_ratio: f64,
    largest_ratio: f64,
    ratios_outside: usize,
    ratios_outside_by_chance: f64,
    normalized_squared_bounds: [f64; 2],
    wrong_by_chance: u64,
    largest_accepted_sigmas: f64,
    fit: FitStatistics,
    live: LiveTable,
    parameters: Named<ParameterStatistics>,
    effects: Named<ParameterStatistics>,
}

#[derive(Serialize)]
struct ParameterStatistics {
    #[serde(flatten)]
    errors: ErrorStatistics,
    unit: &'static str,
}

impl<'a> Report<'a> {
    pub fn new(arguments: &'a MonteCarloArguments, monte_carlo: &'a MonteCarlo, methods: &[MethodStatistics]) -> Self {
        Self {
            runs: arguments.runs,
            scheme: monte_carlo.scheme.name.as_str(),
            periods: monte_carlo.scheme.periods,
            errors: &arguments.errors,
            noise: monte_carlo.unit.noise,
            rate_hz: monte_carlo.rate_hz,
            precision: monte_carlo.precision,
            seed: monte_carlo.seed,
            confidence: CONFIDENCE,
            methods: Named(methods.iter().map(|method| (method.method.name(), method.into())).collect()),
            separating: None,
            software: SOFTWARE,
        }
    }

    fn with_separated(self, studies: &[SeparatingStudy]) -> Self {
        let reports = studies.iter().map(|study| (study.method.name(), study.into())).collect();
        Self { separating: (!studies.is_empty()).then_some(Named(reports)), ..self }
    }
}

impl From<&MethodStatistics> for MethodReport {
    fn from(method: &MethodStatistics) -> Self {
        let (mean_ratio, largest_ratio) = method.ratios();
        let (ratios_outside, ratios_outside_by_chance) = method.outside();
        let of_state = |(info, errors): (&'static ParameterInfo, &Option<ErrorStatistics>)| {
            errors.map(|errors| (info.name, ParameterStatistics { errors, unit: info.unit }))
        };
        Self {
            runs: method.runs,
            accepted: method.accepted,
            accepted_wrong: method.accepted_wrong,
            rejected: method.rejected,
            unconverged: method.unconverged,
            diverged: method.diverged,
            aborted: method.aborted,
            rejections: method.rejections.clone(),
            wrong: method.wrong.clone(),
            mean_ratio,
            largest_ratio,
            ratios_outside,
            ratios_outside_by_chance,
            normalized_squared_bounds: method.normalized_bounds,
            wrong_by_chance: method.wrong_by_chance(),
            largest_accepted_sigmas: method.largest_accepted,
            fit: method.fit,
            live: method.live.clone(),
            parameters: Named(states().zip(&method.states).take(PARAMETERS).filter_map(of_state).collect()),
            effects: Named(states().zip(&method.states).skip(PARAMETERS).filter_map(of_state).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_listed_is_counted() {
        let first = ["run 3: Sgxy".to_string(), "run 5: alpha".into()];
        assert_eq!(listed("  wrong: ", &first, 2), "  wrong: run 3: Sgxy\n  wrong: run 5: alpha\n");
        assert_eq!(listed("  - ", &first[..1], 4), "  - run 3: Sgxy\n  - and 3 more\n");
    }
}
