//! Results as text tables.

use crate::base::quantity::{self, fixed, rounded, significant, states};
use crate::calibration::{Enlargement, Outcome};
use crate::files::truth::ParameterTable;
use comfy_table::{Cell, CellAlignment, Table, presets};
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::model::effects::{EFFECT_INFO, effect};
use rins_selfcal::model::error_model::{PARAMETERS, ParameterInfo, block};
use rins_selfcal::verdict::CHANNEL_NAMES;
use std::ops::Range;

/// Text in place of a missing number.
const NONE: &str = "-";

/// Parameters under one heading.
pub struct Group {
    /// The heading.
    pub title: &'static str,
    /// The states, by index.
    pub states: Range<usize>,
}

/// Groups of the parameters, then groups of the effects of the hardware.
pub const GROUPS: [Group; 16] = [
    Group { title: "gyro non-orthogonality", states: block::GYRO_NON_ORTHOGONALITY..block::ACCEL_NON_ORTHOGONALITY },
    Group { title: "accelerometer non-orthogonality", states: block::ACCEL_NON_ORTHOGONALITY..block::MOUNTING },
    Group { title: "mounting angles", states: block::MOUNTING..block::ACCEL_BIAS },
    Group { title: "accelerometer bias", states: block::ACCEL_BIAS..block::ACCEL_SCALE },
    Group { title: "accelerometer scale", states: block::ACCEL_SCALE..block::GYRO_BIAS },
    Group { title: "gyro bias", states: block::GYRO_BIAS..block::GYRO_SCALE },
    Group { title: "gyro scale", states: block::GYRO_SCALE..block::NON_PERPENDICULARITY },
    Group { title: "gimbal axes", states: block::NON_PERPENDICULARITY..block::ATTITUDE },
    Group { title: "attitude of the base", states: block::ATTITUDE..PARAMETERS },
    Group {
        title: "accelerometers: quadratic and asymmetry",
        states: of(effect::ACCEL_QUADRATIC.start, effect::ACCEL_ASYMMETRY.end),
    },
    Group {
        title: "gyros: asymmetry and scale against rate",
        states: of(effect::GYRO_ASYMMETRY.start, effect::GYRO_RATE_SCALE.end),
    },
    Group { title: "warm-up", states: of(effect::ACCEL_WARM_UP.start, effect::GYRO_SCALE_WARM_UP.end) },
    Group { title: "encoders: harmonics and backlash", states: of(effect::GEOMETRY.start, WOBBLE) },
    Group { title: "axes: wobble and sag", states: of(WOBBLE, effect::GEOMETRY.end) },
    Group { title: "drift of the base", states: of(effect::BASE_DRIFT.start, effect::BASE_DRIFT.end) },
    Group { title: "site", states: of(effect::LATITUDE, effect::GRAVITY + 1) },
];

/// The first effect of the axes, behind the harmonics and the backlash of the encoders.
const WOBBLE: usize = effect::GEOMETRY.start + 16 + 2;

/// Effects from the first one to before the second one, as states.
const fn of(first: usize, end: usize) -> Range<usize> {
    PARAMETERS + first..PARAMETERS + end
}

/// An effect is listed if the run has reduced its sigma to this part of its configured size.
const SEEN: f64 = 0.7;

/// A table in groups with a row (name, cells, unit) for each parameter for which `row` returns cells.
pub fn by_parameter(columns: &[&str], row: impl Fn(usize) -> Option<Vec<String>>) -> String {
    by_state(columns, |state| if state < PARAMETERS { row(state) } else { None })
}

/// As [`by_parameter`], for the parameters and then the effects of the hardware.
pub fn by_state(columns: &[&str], row: impl Fn(usize) -> Option<Vec<String>>) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header(columns));
    for group in &GROUPS {
        let states = states().enumerate().take(group.states.end).skip(group.states.start);
        let rows: Vec<_> = states.filter_map(|(index, info)| Some((info, row(index)?))).collect();
        if !rows.is_empty() {
            table.add_row([Cell::new(group.title)]);
        }
        for (info, cells) in rows {
            table.add_row(state_row(info, cells));
        }
    }
    trimmed(&table)
}

fn header(columns: &[&str]) -> Vec<Cell> {
    let ends = |text: &str| Cell::new(text);
    let numbers = columns.iter().map(|text| Cell::new(text).set_alignment(CellAlignment::Right));
    std::iter::once(ends("parameter")).chain(numbers).chain([ends("unit")]).collect()
}

fn state_row(info: &ParameterInfo, cells: Vec<String>) -> Vec<Cell> {
    let name = Cell::new(format!("  {}", info.name));
    let numbers = cells.into_iter().map(|text| Cell::new(text).set_alignment(CellAlignment::Right));
    std::iter::once(name).chain(numbers).chain([Cell::new(info.unit)]).collect()
}

/// A plain table of numbers, aligned on the right.
pub fn of_numbers(columns: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    aligned(columns, rows, CellAlignment::Right)
}

/// A plain table of words, aligned on the left.
pub fn of_words(columns: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    aligned(columns, rows, CellAlignment::Left)
}

fn aligned(columns: &[&str], rows: impl IntoIterator<Item = Vec<String>>, alignment: CellAlignment) -> String {
    let cell = |text: String| Cell::new(text).set_alignment(alignment);
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(columns.iter().map(|text| cell((*text).into())));
    for row in rows {
        table.add_row(row.into_iter().map(cell));
    }
    trimmed(&table)
}

fn trimmed(table: &Table) -> String {
    // Removes the padding of the table library at both edges.
    table.lines().map(|line| format!("{}\n", line.strip_prefix(' ').unwrap_or(&line).trim_end())).collect()
}

/// Estimates with sigmas, and with errors if the truth is known.
pub fn parameters(outcome: &Outcome, truth: Option<&ParameterTable>) -> String {
    let estimate = outcome.estimate();
    let (values, sigmas) = (quantity::values(&estimate.errors), quantity::sigmas(&estimate.sigmas));
    let columns: &[&str] = match truth {
        None => &["estimate", "sigma"],
        Some(_) => &["estimate", "sigma", "truth", "error", "error/sigma"],
    };
    by_parameter(columns, |index| {
        let sigma = sigmas[index];
        let mut cells = vec![rounded(values[index], sigma), significant(sigma)];
        if let Some(truth) = truth {
            let truth = truth.0[index].map(|truth| quantity::value(index, truth));
            let error = truth.map(|truth| quantity::error(index, values[index], truth));
            cells.extend([truth, error].map(|number| number_or_none(number, |number| rounded(number, sigma))));
            cells.push(number_or_none(error, |error| fixed(error / sigma, 2)));
        }
        outcome.is_estimated(index).then_some(cells)
    })
}

/// Estimates of the effects of the hardware and of the site that the run has seen, and the number of all that were
/// estimated; empty if there are none.
pub fn effects(outcome: &Outcome) -> String {
    let priors = outcome.setup.prior_sigmas();
    let prior = |name: &str| {
        states().zip(priors).find(|(info, _)| info.name == name).map_or(0.0, |(info, prior)| prior / info.unit_si)
    };
    let all = outcome.effects().count();
    let seen = outcome.effects().filter(|(info, _, sigma)| *sigma <= SEEN * prior(info.name));
    let row = |(info, value, sigma): (&ParameterInfo, f64, f64)| {
        let (value, sigma) = (rounded(value, sigma), significant(sigma));
        format!("  {} {value} +- {sigma} {} ({})\n", info.name, info.unit, configured(outcome, info, prior(info.name)))
    };
    let rows: String = seen.map(row).collect();
    let none = if rows.is_empty() { "  none\n" } else { "" };
    if all == 0 {
        return String::new();
    }
    format!("effects of the hardware: those that the run has seen, of {all} (--json has all)\n{rows}{none}\n")
}

/// What is configured of an effect: its size; of the site the value with its sigma.
fn configured(outcome: &Outcome, info: &ParameterInfo, prior: f64) -> String {
    let size = significant(prior);
    if info.name == EFFECT_INFO[effect::GRAVITY].name {
        format!("configured 0 +- {size}")
    } else if info.name != EFFECT_INFO[effect::LATITUDE].name {
        format!("configured {size}")
    } else if outcome.setup.knows_latitude() {
        format!("configured {} +- {size}", rounded(outcome.setup.site.latitude_rad / DEG, prior))
    } else {
        "not configured".into()
    }
}

/// Number of samples, stops and moves, and losses and other faults of the samples.
pub fn samples(outcome: &Outcome) -> String {
    let counts = &outcome.counts;
    let mut text = format!(
        "{} samples at {} Hz, {:.1} s; used: {} stops and {} moves\n",
        counts.admitted,
        (outcome.setup.rate_hz * 1e6).round() / 1e6,
        outcome.solution.duration_s,
        outcome.stops,
        outcome.moves
    );
    let oddities = [
        (u64::from(counts.gaps), "gaps"),
        (u64::from(counts.missing), "samples missing in gaps"),
        (u64::from(counts.repeated), "samples repeated"),
        (u64::from(counts.out_of_order), "samples out of order"),
        (u64::from(counts.non_finite), "samples not finite"),
        (u64::from(outcome.solution.left_out), "segments left out"),
    ];
    if let Some(LossCounts { overrun, bus, crc, status, unread, restarted }) = outcome.losses {
        text += &format!(
            "samples lost: overrun {overrun}, bus {bus}, crc {crc}, status {status}, unread {unread}, restarted {restarted}\n"
        );
    }
    let seen = oddities.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
    let seen: Vec<_> = seen.collect();
    if !seen.is_empty() {
        text += &format!("warning: {}\n", seen.join(", "));
    }
    text
}

/// Fit and verdict.
pub fn verdict(outcome: &Outcome) -> String {
    let solution = &outcome.solution;
    let largest = &solution.fit.largest;
    let mut text = format!(
        "{} method: chi-square {} with {} degrees of freedom, largest innovation {} sigma (segment {}, {}), \
         {} sweeps\n",
        outcome.setup.method.name(),
        fixed(solution.fit.chi_square, 1),
        solution.degrees_of_freedom,
        fixed(largest.normalized, 1),
        largest.segment,
        CHANNEL_NAMES[usize::from(largest.channel)],
        solution.sweeps
    );
    if outcome.setup.method == Method::Bai {
        text += "biases, scale-factor errors and non-perpendicularity are taken as zero by this method\n";
    }
    if solution.temperature_c.is_finite() {
        text += &format!("temperature {:.1} deg C\n", solution.temperature_c);
    }
    text += &format!("verdict: {}\n", outcome.verdict_name());
    if outcome.stored == Some(false) {
        text +=
            "accepted, but not stored: writing to the calibration store failed; the earlier calibration stays stored\n";
    }
    for reason in folded(outcome.reasons()) {
        text += &format!("  - {reason}\n");
    }
    if let Some(adapted) = adapted(outcome) {
        text += &format!("{adapted}\n");
    } else if let Some(Enlargement { key, unit, configured, found }) = &outcome.enlargement {
        let [configured, found] = [*configured, *found].map(significant);
        text +=
            &format!("`rins replay --adapt` solves once more with {key} = {found} in place of {configured} {unit}\n");
    }
    if let Some(code) = outcome.reason_codes().first() {
        text += &format!("{}\n", explained(code));
    }
    text
}

/// What `--adapt` has changed, or why it has changed nothing; `None` without `--adapt`.
pub fn adapted(outcome: &Outcome) -> Option<String> {
    let because = if outcome.setup.method == Method::Bai {
        "the method bai knows no effects of the hardware"
    } else if outcome.reason_codes().contains(&"hardware-effect") {
        "the effect that the verdict names is a motion of the axes or has its largest size already"
    } else {
        "the verdict names no effect of the hardware"
    };
    let change = match &outcome.enlargement {
        None => format!("no size of the hardware was enlarged, because {because}"),
        Some(Enlargement { key, unit, configured, found }) => format!(
            "{key} was enlarged from {} to {} {unit}, because the first verdict named it",
            significant(*configured),
            significant(*found)
        ),
    };
    outcome.setup.adapt.then(|| format!("--adapt: {change}"))
}

/// The reasons of a verdict as they are printed: equal reasons once, with their number.
pub fn folded<R: ToString>(reasons: impl IntoIterator<Item = R>) -> Vec<String> {
    let mut counts: Vec<(String, usize)> = Vec::new();
    for reason in reasons.into_iter().map(|reason| reason.to_string()) {
        match counts.iter_mut().find(|(known, _)| *known == reason) {
            Some((_, count)) => *count += 1,
            None => counts.push((reason, 1)),
        }
    }
    let printed = |(reason, count)| if count == 1 { reason } else { format!("{reason} ({count} times)") };
    counts.into_iter().map(printed).collect()
}

/// Says how the page of a code is shown.
pub fn explained(code: &str) -> String {
    format!("`rins explain {code}` explains what this code means and what to do")
}

/// A number, or a dash if it is missing.
pub fn number_or_none(value: Option<f64>, format: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| NONE.into(), format)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_reasons_are_printed_once_with_their_number() {
        assert_eq!(folded(["a", "b", "a", "c", "a"]), ["a (3 times)", "b", "c"]);
    }
}
