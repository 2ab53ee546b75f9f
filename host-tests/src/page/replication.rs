//! The page that compares the published numbers of Bai et al. with the results of this software, and repeats their
//! figures.

use super::figures;
use super::frame::{Section, document, shown};
use super::{drawings, paper};
use crate::base::bai::{FULL_RANK_S, TABLE_1, TABLE_1_ERRORS, TABLE_3, TABLE_3_DIFFERENCES, Twelve, largest_part};
use crate::base::quantity::{self, fixed, significant};
use crate::plan::observability::{self, INTERVAL_S, along_scheme_every, in_relative_time};
use crate::plan::prediction::{RankAt, duration_s};
use crate::result::table::{GROUPS, Group, number_or_none};
use crate::study::replication::{Foresight, Replication, ShownRun, Study};
use anyhow::Context;
use maud::{Markup, html};
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors, PARAMETER_INFO, block};
use rins_selfcal::scheme::{SETTLING_S, Scheme};
use std::ops::Range;
use std::path::Path;

/// Writes the page.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_replication(path: &Path, replication: &Replication) -> anyhow::Result<()> {
    std::fs::write(path, page(replication)?.into_string()).with_context(|| path.display().to_string())
}

fn page(found: &Replication) -> anyhow::Result<Markup> {
    let sections = [
        Section::new("conditions", "Conditions and Table 2", conditions(found)),
        Section::new("structure", "Frames, method, instrument: Figures 1 to 3, 12 and 13", structure(found)),
        Section::new("motion", "Motion and signals: Figures 4, 5, 7 and 8", motion(found)?),
        Section::new("observability", "Observability: Figure 6", observability(found)?),
        Section::new("activated", "Parameters that each rotation activates", activated(found)),
        Section::new("table-1", "Simulation: Table 1", table_1(found)),
        Section::new("figures-9-11", "Simulation: Figures 9 to 11", estimates(found, &found.simulation, "simulation")?),
        Section::new("table-3", "Laboratory unit: Table 3", table_3(found)),
        Section::new(
            "figures-14-15",
            "Laboratory unit: Figures 14 and 15",
            signals(&found.laboratory, "laboratory", ["14", "15"])?,
        ),
        Section::new(
            "figures-16-18",
            "Laboratory unit: Figures 16 to 18",
            estimates(found, &found.laboratory, "laboratory")?,
        ),
        Section::new("ignored", "What Bai's method takes as zero", ignored(found)),
        Section::new("joint", "The joint method on the same data", joint(found)),
        Section::new("schemes", "The joint method in less time", schemes(found)),
    ];
    Ok(document("Bai et al. beside rins-selfcal", &head(found), &sections))
}

fn head(found: &Replication) -> Markup {
    let runs = found.table_1.of(Method::Bai).runs;
    html! {
        header.verdict {
            h1 { "Bai et al. beside rins-selfcal" }
            p { "S. Bai, J. Lai, P. Lyu, X. Xu, M. Liu, K. Huang, “A System-Level Self-Calibration Method for Installation Errors in a Dual-Axis "
                "Rotational Inertial Navigation System”, Sensors 2019, 19(18), 4005: its results, computed again. "
                "Where the paper prints numbers, this page compares them with ours. The paper's curves are not "
                "available as numbers, so only ours are shown." }
            p { (of_table_1(found)) " " (of_rank(found)) " " (of_real(found)) }
            p { (runs) " runs of each whole unit, and fewer runs of each single effect. The command that gives a "
                "number is printed with it." }
        }
    }
}

fn command(command: &str) -> Markup {
    html! { p.command { code { (command) } } }
}

fn name(index: usize) -> &'static str {
    PARAMETER_INFO[index].name
}

/// Least and largest number.
fn range(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    numbers.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], number| [low.min(number), high.max(number)])
}

fn rms(study: &Study, method: Method) -> impl Iterator<Item = f64> + '_ {
    (0..INSTALLATION_STATES).filter_map(move |index| Some(study.installation(method, index)?.rms_error))
}

fn worst(found: Option<(usize, f64)>) -> String {
    found.map_or_else(|| "-".into(), |(index, arcsec)| format!("{} ({})", significant(arcsec), name(index)))
}

fn worst_in_words(found: Option<(usize, f64)>) -> String {
    found.map_or_else(|| "-".into(), |(index, arcsec)| format!("{} arcsec ({})", significant(arcsec), name(index)))
}

// ---------------------------------------------------------------------------------------------------------- conditions

fn conditions(found: &Replication) -> Markup {
    html! {
        p { "The text of the paper that we have has lost the symbols and most units of its formulas. What the paper states "
            "is in the first column as it stands there; what is inferred from it, with the reason, in the second; what "
            "this page uses, in the third." }
        (paper::conditions(&setting(found)))
        h3 { "Table 2: specifications of the dual-axis RINS" }
        (paper::table_2())
        p { "The paper gives one number for each sensor and does not say whether it is a bias or a noise. Here the numbers "
            "of accelerometers and encoders are the noise of every sample (" code { "--noise bai" } "). As noise of a "
            "sample, 0.005 deg/h would be 0.005 arcsec/s, which is too small for any gyro, so the measurement noise of "
            "0.2 is used. Biases of that size are studied separately below." }
    }
}

/// The motion that the page uses, in words.
fn setting(found: &Replication) -> String {
    let scheme = &found.scheme;
    let (moves, stop_s) = (scheme.legs.len(), scheme.first_stop_s);
    let minutes = duration_s(&found.setup, scheme) / 60.0 / f64::from(scheme.periods);
    format!(
        "{moves} moves with ramps of 20 deg/s² and {} stops of {stop_s} s, {minutes:.1} min a period; with {SETTLING_S} s \
         of settling after each move",
        moves + 1,
    )
}

// -------------------------------------------------------------------------------------------------------- own drawings

fn structure(found: &Replication) -> Markup {
    html! {
        p { "The paper's Figures 1 to 3, 12 and 13 are drawings, which our text of it does not contain. These are our own "
            "drawings of what the text says about them." }
        (drawings::frames_of_sensors())
        (drawings::frames_of_mounting())
        (drawings::structure())
        (drawings::instrument())
        (drawings::procedure(found.scheme.first_stop_s))
    }
}

// -------------------------------------------------------------------------------------------------- motion and signals

fn motion(found: &Replication) -> anyhow::Result<Markup> {
    let panels = figures::angle_panels(&found.simulation.signals);
    Ok(html! {
        (drawings::scheme(&found.scheme))
        @for (drawn, letter) in panels.into_iter().zip(["a", "b"]) { (shown(drawn, &format!("figure-5{letter}"), "")?) }
        p { "Figure 5: angles of the inner and the outer axis during the whole calibration, both periods." }
        (signals(&found.simulation, "simulation", ["7", "8"])?)
    })
}

/// The figures of gyros and accelerometers of a run over both periods.
fn signals(series: &ShownRun, which: &str, [gyros, accelerometers]: [&str; 2]) -> anyhow::Result<Markup> {
    let of_gyros = figures::gyro_panels(&series.signals).into_iter().zip(["a", "b", "c"]);
    let of_accelerometers = figures::accelerometer_panels(&series.signals).into_iter().zip(["a", "b", "c"]);
    Ok(html! {
        @for (drawn, letter) in of_gyros { (shown(drawn, &format!("figure-{gyros}{letter}"), "")?) }
        p { "Figure " (gyros) ": outputs of the gyros, " (which) ", averaged between points, both periods." }
        @for (drawn, letter) in of_accelerometers { (shown(drawn, &format!("figure-{accelerometers}{letter}"), "")?) }
        p { "Figure " (accelerometers) ": outputs of the accelerometers, " (which) ", averaged between points, both periods." }
        @for line in &series.commands { (command(line)) }
    })
}

// ------------------------------------------------------------------------------------------------------- observability

/// Each time at which the rank grows, and the rank from then on.
fn rank_steps(ranks: &[RankAt]) -> Vec<RankAt> {
    let mut steps: Vec<RankAt> = Vec::new();
    for at in ranks {
        if steps.last().is_none_or(|last| last.rank < at.rank) {
            steps.push(*at);
        }
    }
    steps
}

/// End of the first move of the inner axis, s.
fn inner_moved_s(scheme: &Scheme) -> f64 {
    let before = scheme.legs.iter().take_while(|leg| leg.inner_rad == 0.0).copied().collect();
    let way_rad = scheme.legs.iter().map(|leg| leg.inner_rad).find(|angle| *angle != 0.0).unwrap_or(0.0);
    let inner_s = scheme.turning().profile(way_rad).duration_s();
    Scheme { legs: before, periods: 1, ..scheme.clone() }.duration_s() + inner_s
}

fn of_rank(found: &Replication) -> String {
    let steps = rank_steps(&found.observability.prediction.installation_rank);
    let moved_s = inner_moved_s(&found.scheme);
    let before = steps.iter().take_while(|at| at.time_s < moved_s).last().map_or(0, |at| at.rank);
    let full = steps.iter().find(|at| at.rank == INSTALLATION_STATES);
    let full = full.map_or_else(|| "never".into(), |at| format!("after {:.0} s", at.time_s));
    format!(
        "The rank of Figure 6 is {before} until the inner axis has moved, at {moved_s:.0} s, and 12 {full}, not after \
         {FULL_RANK_S} s."
    )
}

/// Elapsed time (s) and rank at each growth of the rank, with a row of (B13) for every 5 ms of a move.
fn steps_at_5_ms(found: &Replication) -> Vec<(f64, usize)> {
    let mut steps: Vec<(f64, usize)> = Vec::new();
    let base = InstrumentErrors::default();
    along_scheme_every(INTERVAL_S, &found.scheme, &found.setup.site, &base, |time_s, seen| {
        if steps.last().is_none_or(|(_, rank)| *rank < seen.rank) {
            steps.push((time_s, seen.rank));
        }
    });
    steps
}

fn observability(found: &Replication) -> anyhow::Result<Markup> {
    let Foresight { prediction, command: line } = &found.observability;
    let [values, rank] = figures::singular_values(&found.scheme, &found.setup.site, &InstrumentErrors::default());
    let row = |at: &RankAt| html! { tr { td { (format!("{:.1}", at.time_s)) } td { (at.rank) } td { (significant(at.condition_number)) } } };
    let steps: Vec<_> =
        steps_at_5_ms(found).iter().map(|(time_s, rank)| format!("{rank} from {time_s:.3} s")).collect();
    Ok(html! {
        (shown(values, "figure-6", "Figure 6: singular values of the stripped observability matrix along one period; values that count as zero are drawn on the axis.")?)
        (shown(rank, "figure-6-rank", "Rank of the matrix.")?)
        p { "The paper reads full rank after " (FULL_RANK_S) " s from its Figure 6. Here (B11) is stacked at the end "
            "of each stop and (B13) for every 5 ms of each move, in elapsed time, and the rank "
            "is " (steps.join(", ")) "." }
        p { "As long as only the outer axis, x, turns on a level base, the specific force has no x component. So (B11) "
            "has zero columns for Sayz and Sazy. A turn about x leaves alpha, the mounting angle about x, without "
            "effect in I - R^T. Longer measuring does not help; only turns of the inner axis do. The condition number "
            "shows how much the rank before is worth: some states are observed through Earth rate alone." }
        (relative_time(found)?)
        (command(line))
        details { summary { "Rank and condition number against scheme time" }
            div.scroll { table id="ranks" {
                thead { tr { th { "time, s" } th { "rank of 12" } th { "condition number" } } }
                tbody { @for at in &prediction.installation_rank { (row(at)) } }
            } } }
    })
}

fn relative_time(found: &Replication) -> anyhow::Result<Markup> {
    let along = in_relative_time(&found.scheme, &found.setup.site, &InstrumentErrors::default());
    let ranks: Vec<usize> = along.iter().map(|seen| seen.rank).collect();
    let full = ranks.iter().position(|rank| *rank == INSTALLATION_STATES);
    let full = full.map_or_else(|| "never".into(), |place| format!("after {:.2} s", (place + 1) as f64 * INTERVAL_S));
    Ok(html! {
        p { "The paper says of Figures 9 to 11 that their time is relative, and of Figure 6 that its interval is 0.005 s. "
            "If the time of Figure 6 is relative too, it passes only while something is activated: here one interval of "
            (INTERVAL_S) " s for each move and each stop after the first one, in their order. In this time the rank is "
            "full " (full) ", which is less than the 0.2 s of the paper, and in elapsed time it is full much later." }
        (shown(figures::relative_rank(&ranks), "figure-6-relative", "Figure 6 in relative time.")?)
    })
}

/// The three steps of the paper's section 3.2.1 and the numbers of parameters that its text lists.
const STEPS: [(&str, &str); 3] = [("1, about x of the IMU", "three"), ("2, about y", "four"), ("3, about z", "five")];

fn activated(found: &Replication) -> Markup {
    let names = |states: &[usize]| states.iter().map(|state| name(*state)).collect::<Vec<_>>().join(", ");
    let steps = observability::activated(&found.scheme);
    let turns = ["x", "y", "z"].into_iter().zip(observability::activated_by_turns());
    html! {
        p { "Section 3.2.1 of the paper lists, for the stops of period one, three, four and five activated parameters; "
            "their names are lost in our text. The table has what (B11) gives on a level base: the parameters on which "
            "it depends at the stops of a step, and the number of independent combinations of them that the stops of "
            "this step show." }
        div.scroll { table id="activated-numbers" {
            thead { tr { th.text { "step" } th.text { "moves" } th { "paper: activated" } th { "combinations" } th.text { "parameters in (B11)" } } }
            tbody { @for ((step, theirs), found) in STEPS.iter().zip(&steps) {
                tr { td { (step) } td { (found.legs.start + 1) " to " (found.legs.end) } td { (theirs) } td { (found.rank) } td { (names(&found.states)) } }
            } }
        } }
        p { "Section 3.2.2: while the IMU turns about one axis in period two, (B13) shows two parameters: "
            @for (axis, states) in turns { "about " (axis) " " (names(&states)) "; " }
            "each rotation axis has two, as the paper says." }
    }
}

// -------------------------------------------------------------------------------------------------------------- tables

/// A table with a row for each of the twelve installation errors; `id` is the name of the table.
fn of_twelve(id: &str, columns: &[&str], cells: impl Fn(usize) -> Vec<String>) -> Markup {
    let group = |index: usize| GROUPS.iter().find(|group| group.states.start == index);
    html! {
        div.scroll { table id=(id) {
            thead { tr { th { "arcsec" } @for column in columns { th { (column) } } } }
            tbody { @for index in 0..INSTALLATION_STATES {
                @if let Some(group) = group(index) { tr.group { th colspan=(columns.len() + 1) { (group.title) } } }
                tr { td { (name(index)) } @for cell in cells(index) { td { (cell) } } }
            } }
        } }
    }
}

/// Error of one run of a series, arcsec.
fn error_of(series: &ShownRun, index: usize) -> f64 {
    let value = quantity::values(&series.outcome.estimate().errors)[index];
    value - series.truth.0[index].unwrap_or_default()
}

/// Published errors divided by ours, the root mean square of many runs.
fn in_ours<'a>(published: &'a Twelve, study: &'a Study, method: Method) -> impl Iterator<Item = f64> + 'a {
    published.iter().zip(rms(study, method)).map(|(theirs, ours)| theirs / ours)
}

/// Range of the published errors of a group divided by ours, in words.
fn group_in_ours(group: &Group, published: &Twelve, study: &Study) -> String {
    let ratios = in_ours(published, study, Method::Bai).enumerate();
    let of_group = ratios.filter(|(index, _)| group.states.contains(index)).map(|(_, ratio)| ratio);
    let [low, high] = range(of_group);
    format!("{} {} to {}", group.title, fixed(low, 1), fixed(high, 1))
}

fn of_table_1(found: &Replication) -> String {
    let [low, high] = range(rms(&found.table_1, Method::Bai));
    let groups = GROUPS.iter().filter(|group| group.states.end <= INSTALLATION_STATES);
    let groups: Vec<_> = groups.map(|group| group_in_ours(group, &TABLE_1_ERRORS, &found.table_1)).collect();
    format!(
        "In the simulation of Table 1 the RMS errors of Bai's method are {} to {} arcsec here. Ratios of \
         the paper's errors, from one run, to ours: {}.",
        significant(low),
        significant(high),
        groups.join(", ")
    )
}

fn table_1(found: &Replication) -> Markup {
    let study = &found.table_1;
    let columns =
        ["true", "Bai: error", "ours: error of run 1", "RMS of all runs", "stated sigma", "Bai / our RMS", "joint RMS"];
    html! {
        (of_twelve("table-1-numbers", &columns, |index| {
            let ours = study.installation(Method::Bai, index);
            let of = |number: Option<f64>| number_or_none(number, significant);
            vec![
                fixed(TABLE_1[index], 0),
                fixed(TABLE_1_ERRORS[index], 3),
                fixed(error_of(&found.simulation, index), 3),
                of(ours.map(|ours| ours.rms_error)),
                of(ours.map(|ours| ours.bound)),
                number_or_none(ours.map(|ours| TABLE_1_ERRORS[index] / ours.rms_error), |ratio| fixed(ratio, 2)),
                of(study.installation(Method::Joint, index).map(|joint| joint.rms_error)),
            ]
        }))
        p { (bound_sentence("Table 1", "4 %", &TABLE_1_ERRORS, &TABLE_1)) " Of our RMS errors the largest part is "
            (percent(largest_rms_part(study))) "." }
        p { "The paper's column is the error of one run. By chance, such a number is below a third of the root mean "
            "square for one parameter in four, and above twice the root mean square for one in twenty. Larger "
            "differences are not explained: P0, Q and R of the paper's filters are not in its text. Ours are in "
            code { "rins guide theory" } ". The stated sigma is that of the filter, which takes the noise of all "
            "measurements as independent." }
        @for line in &found.simulation.commands { (command(line)) }
        (command(&study.command))
    }
}

fn percent(part: f64) -> String {
    format!("{:.2} %", part * 100.0)
}

fn bound_sentence(table: &str, bound: &str, errors: &Twelve, values: &Twelve) -> String {
    let largest = percent(largest_part(errors, values));
    format!(
        "The paper states that all errors of {table} are less than {bound}; the largest of its numbers is {largest}."
    )
}

/// The largest RMS error of Bai's method on the unit of Table 1, in parts of the true value.
fn largest_rms_part(study: &Study) -> f64 {
    rms(study, Method::Bai).zip(TABLE_1).map(|(error, truth)| error / truth).fold(0.0, f64::max)
}

/// One run as Table 3 of the paper has it.
fn as_table_3(id: &str, series: &ShownRun) -> Markup {
    let result = quantity::values(&series.outcome.estimate().errors);
    let [reference, by_forces] = series.separated.map(|separated| quantity::values(&separated.errors));
    let columns = [
        "paper: reference",
        "difference",
        "percent",
        "ours: reference [11], [13]",
        "Bai's method - reference",
        "percent",
        "true value",
        "reference - true",
        "[11], [14] - true",
    ];
    of_twelve(id, &columns, |index| {
        let difference = result[index] - reference[index];
        let truth = series.truth.0[index].unwrap_or_default();
        vec![
            fixed(TABLE_3[index], 3),
            fixed(TABLE_3_DIFFERENCES[index], 3),
            percent((TABLE_3_DIFFERENCES[index] / TABLE_3[index]).abs()),
            fixed(reference[index], 3),
            fixed(difference, 3),
            percent((difference / reference[index]).abs()),
            fixed(truth, 3),
            fixed(reference[index] - truth, 3),
            fixed(by_forces[index] - truth, 3),
        ]
    })
}

/// Largest error of the reference among angles of a run, arcsec.
fn reference_error(series: &ShownRun, angles: Range<usize>) -> f64 {
    let reference = quantity::values(&series.separated[0].errors);
    angles.map(|index| (reference[index] - series.truth.0[index].unwrap_or_default()).abs()).fold(0.0, f64::max)
}

fn table_3(found: &Replication) -> Markup {
    let columns =
        ["Bai: reference", "Bai: difference", "only the twelve: our RMS", "real unit: our RMS", "real unit: joint RMS"];
    let nine = |series| fixed(reference_error(series, 0..block::MOUNTING), 2);
    let mounting = |series| fixed(reference_error(series, block::MOUNTING..INSTALLATION_STATES), 2);
    html! {
        p { "In the paper the reference is the result of two separating methods on the same unit: [11], a Kalman filter on "
            "attitude and velocity, for the nine non-orthogonality angles, and [13], a thin-shell search on the residual "
            "rotation of the gyros, for the mounting angles. The estimation error of Table 3 is the difference to this "
            "reference. Here the same is done with virtual units, of which the true values are known too. The last column "
            "has [14], the singular values of the forces, in place of [13]." }
        p { (bound_sentence("Table 3", "6 %", &TABLE_3_DIFFERENCES, &TABLE_3)) }
        h3 { "Only the twelve errors of Table 3" }
        (as_table_3("table-3-twelve", &found.twelve))
        @for line in &found.twelve.commands { (command(line)) }
        h3 { "With all other errors of a real unit" }
        (as_table_3("table-3-real", &found.laboratory))
        p { "On the first unit the reference is off by " (nine(&found.twelve)) " arcsec at most in the nine angles and by "
            (mounting(&found.twelve)) " arcsec in the mounting angles. On the second, with axes 4 arcsec off perpendicular, "
            "by " (nine(&found.laboratory)) " and " (mounting(&found.laboratory)) " arcsec: both [13] and [14] take the "
            "axes as perpendicular, which the paper states of its unit to 4 arcsec. So a difference of this size can be an "
            "error of the reference as well as one of the method." }
        @for line in &found.laboratory.commands { (command(line)) }
        h3 { "Many runs against the true values" }
        (of_twelve("table-3-numbers", &columns, |index| {
            let of = |study: &Study, method| number_or_none(study.installation(method, index).map(|ours| ours.rms_error), significant);
            vec![
                fixed(TABLE_3[index], 3),
                fixed(TABLE_3_DIFFERENCES[index], 3),
                of(&found.table_3, Method::Bai),
                of(&found.real, Method::Bai),
                of(&found.real, Method::Joint),
            ]
        }))
        p { "The first unit has all other errors zero, as the paper assumes. The second has biases of 30 ug and "
            "0.005 deg/h, scale factors off by 100 and 20 ppm, axes 4 arcsec off perpendicular and a base out of level. The "
            "paper's differences lie " (between(found)) "." }
        (command(&found.table_3.command))
        (command(&found.real.command))
    }
}

/// Comparison of the published differences with both virtual units, in words.
fn between(found: &Replication) -> String {
    let study = |study| rms(study, Method::Bai).collect::<Vec<_>>();
    let (twelve, real) = (study(&found.table_3), study(&found.real));
    let count =
        |beyond: &dyn Fn(usize) -> bool| (0..twelve.len().min(real.len())).filter(|index| beyond(*index)).count();
    let above = count(&|index| TABLE_3_DIFFERENCES[index] > twelve[index]);
    let below = count(&|index| TABLE_3_DIFFERENCES[index] < real[index]);
    format!("above the root mean square of the first for {above} of 12, and below that of the second for {below} of 12")
}

fn estimates(found: &Replication, series: &ShownRun, which: &str) -> anyhow::Result<Markup> {
    let groups = [
        block::GYRO_NON_ORTHOGONALITY..block::ACCEL_NON_ORTHOGONALITY,
        block::ACCEL_NON_ORTHOGONALITY..block::MOUNTING,
        block::MOUNTING..block::ACCEL_BIAS,
    ];
    Ok(html! {
        p { "Estimates of one run by Bai's method: after every stop and move, the final estimate from all "
            "segments up to then, against time in seconds, with a band of three sigmas. The dashed line is the true "
            "value. The errors of the accelerometers and the mounting angles are found in period one, the errors of "
            "the gyros in period two." }
        @for group in groups { div.small { @for index in group {
            (shown(figures::estimate(&series.outcome, index, Some(&series.truth)), &format!("{which}-{}", name(index)), "")?)
        } } }
        p { "The numbers are " code { "estimates." (which) } " in the output of:" }
        (command(&found.command))
        p { "The last estimates alone come from:" }
        @for line in &series.commands { (command(line)) }
    })
}

// ----------------------------------------------------------------------------------------------------- what is ignored

fn of_real(found: &Replication) -> String {
    let (bai, joint) = (found.real.worst_rms(Method::Bai), found.real.worst_rms(Method::Joint));
    format!(
        "On a unit with all errors of a real one, the largest RMS error of Bai's method is {}; that of the joint \
         method, on the same data, is \
         {}.",
        worst_in_words(bai),
        worst_in_words(joint)
    )
}

/// Titles of the effects whose worst error is below twice the worst error from noise alone, and the effect with the
/// largest error.
fn effects(found: &Replication) -> (Vec<&'static str>, String) {
    let size = |study: &Study| study.worst_mean(Method::Bai).map_or(f64::INFINITY, |(_, arcsec)| arcsec);
    let noise = found.ignored.first().map_or(0.0, size);
    let effects = || found.ignored.iter().skip(1);
    let small = effects().filter(|study| size(study) < 2.0 * noise).map(|study| study.title).collect();
    let largest = effects().max_by(|a, b| size(a).total_cmp(&size(b)));
    let largest = largest.map_or_else(String::new, |study| {
        format!("{}, {}", study.title, worst_in_words(study.worst_mean(Method::Bai)))
    });
    (small, largest)
}

fn ignored(found: &Replication) -> Markup {
    let row = |study: &Study| {
        let (bai, joint) = (study.of(Method::Bai), study.of(Method::Joint));
        html! {
            tr id={ "ignored-" (study.name) } {
                td { (study.title) }
                td { (worst(study.worst_mean(Method::Bai))) }
                td { (fixed(bai.fit.mean_chi_square, 0)) " / " (fixed(bai.fit.mean_degrees_of_freedom, 0)) }
                td { (bai.accepted) " of " (bai.runs) }
                td { (worst(study.worst_mean(Method::Joint))) }
                td { (joint.accepted) " of " (joint.runs) }
            }
        }
    };
    let (small, largest) = effects(found);
    html! {
        p { "Each effect alone, on a unit without any other error: the mean error over the runs of the installation "
            "error that is worst, arcsec. The first row is with noise only." }
        div.scroll { table id="ignored-numbers" {
            thead { tr { th {} th { "Bai's method" } th { "chi-square" } th { "accepted" } th { "joint" } th { "accepted" } } }
            tbody { @for study in &found.ignored { (row(study)) } }
        } }
        p { "Bai's method has no state for such an effect. The largest error is from: " (largest) ". "
            @if !small.is_empty() { "Effects with an error of the size of that from noise: " (small.join("; ")) ". " }
            "An effect without a state increases the chi-square, and such a run is rejected. The joint method has a "
            "state or a noise for each effect, as large as " code { "--hardware" } " says." }
        details { summary { "Commands" } @for study in &found.ignored { (command(&study.command)) } }
    }
}

// --------------------------------------------------------------------------------------------------------------- joint

fn joint(found: &Replication) -> Markup {
    let columns = [
        "Table 1: Bai's method, RMS",
        "joint RMS",
        "(error/sigma)²",
        "real unit: Bai's method, RMS",
        "joint RMS",
        "(error/sigma)²",
        "factor gained",
    ];
    let [low, high] = found.real.of(Method::Joint).normalized_bounds;
    let accepted = |study: &Study| {
        let of = |method| format!("{} of {}", study.of(method).accepted, study.of(method).runs);
        format!("{} with Bai's method, {} joint", of(Method::Bai), of(Method::Joint))
    };
    html! {
        (of_twelve("joint-numbers", &columns, |index| {
            let of = |study: &Study| {
                let [bai, joint] = [Method::Bai, Method::Joint].map(|method| study.installation(method, index).copied());
                let number = |number: Option<f64>| number_or_none(number, significant);
                let honest = number_or_none(joint.map(|joint| joint.mean_normalized_squared), |honest| fixed(honest, 2));
                let gained = bai.zip(joint).map(|(bai, joint)| bai.rms_error / joint.rms_error);
                (vec![number(bai.map(|found| found.rms_error)), number(joint.map(|found| found.rms_error)), honest], gained)
            };
            let (mut cells, (real, gained)) = (of(&found.table_1).0, of(&found.real));
            cells.extend(real);
            cells.push(number_or_none(gained, |gained| fixed(gained, 1)));
            cells
        }))
        p { "The mean of (error/sigma)² is 1 if the sigmas are correct; for so many runs, 99 % of the means lie within "
            (fixed(low, 2)) " to " (fixed(high, 2)) ". Runs accepted: Table 1 " (accepted(&found.table_1)) "; real unit "
            (accepted(&found.real)) "." }
        (command(&found.table_1.command))
        (command(&found.real.command))
    }
}

fn schemes(found: &Replication) -> Markup {
    let row = |Foresight { prediction, command: line }: &Foresight| {
        html! {
            tr { td { (prediction.scheme) } td { (fixed(prediction.duration_s, 0)) } td { (significant(prediction.worst_arcsec)) }
                td { (prediction.rank) " of " (prediction.states) } td { (significant(prediction.condition_number)) }
                td.wide { code { (line) } } }
        }
    };
    let bai = found.table_1.worst_rms(Method::Bai);
    html! {
        p { "Predictions with the noise of the simulation (" code { "--noise bai" } "), for all 28 states. Both "
            "periods of the paper's scheme take "
            (fixed(duration_s(&found.setup, &found.scheme), 0)) " s, and the largest RMS error of Bai's method is then " (worst_in_words(bai)) "." }
        div.scroll { table id="scheme-numbers" {
            thead { tr { th { "scheme" } th { "time, s" } th { "worst sigma, arcsec" } th { "rank" } th { "condition number" } th.text { "command" } } }
            tbody { @for foresight in &found.schemes { (row(foresight)) } }
        } }
    }
}
