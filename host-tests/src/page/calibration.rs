//! The report of a calibration as one self-contained page: verdict, certificate, correction as source text, figures.

use super::frame::{Section, document, shown};
use super::{figures, paste};
use crate::base::quantity::{self, fixed, rounded, significant};
use crate::calibration::Outcome;
use crate::files::hardware;
use crate::files::truth::ParameterTable;
use crate::inspect::turned;
use crate::result::comparison::Comparison;
use crate::result::report::{CONVENTION, CalibrationReport, correction};
use crate::result::saved::Saved;
use crate::result::signals::Signals;
use crate::result::table::{self, GROUPS};
use anyhow::Context;
use maud::{Markup, html};
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETER_INFO};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::segment::SegmentKind;
use std::path::Path;

/// Content of the page. Absent parts are left out.
#[derive(Clone, Copy)]
pub struct Content<'a> {
    /// The calibration.
    pub outcome: &'a Outcome,
    /// The true parameters that are known.
    pub truth: Option<&'a ParameterTable>,
    /// Signals of the IMU and the encoders.
    pub signals: Option<&'a Signals>,
    /// The scheme, for the plot of observability.
    pub scheme: Option<&'a Scheme>,
    /// Source of the samples, in words.
    pub source: &'a str,
    /// The earlier calibration to compare with.
    pub previous: Option<&'a Saved>,
}

impl Content<'_> {
    /// The scheme that was run, or the scheme that the log shows if the motion began near (0, 0).
    fn motion(&self) -> Option<Scheme> {
        self.scheme.cloned().or_else(|| scheme_seen(self.outcome, self.signals?))
    }
}

/// The scheme that the stops of a log show, with the default rate and acceleration.
fn scheme_seen(outcome: &Outcome, signals: &Signals) -> Option<Scheme> {
    /// Largest angle of a first stop that counts as (0, 0).
    const NEAR_RAD: f64 = 0.1;
    let mut begin_s = signals.points().first()?.time_s;
    let mut stops = Vec::new();
    for progress in &outcome.live {
        let end_s = progress.end_us as f64 * 1e-6;
        if progress.kind == SegmentKind::Stop {
            let angles = signals.points().iter().take_while(|point| point.time_s <= end_s).last()?.angles_rad;
            let at_zero = stops.is_empty() && angles.iter().all(|angle| angle.abs() < NEAR_RAD);
            stops.push(turned::stop(if at_zero { [0.0; 2] } else { angles }, end_s - begin_s));
        }
        begin_s = end_s;
    }
    let usual = Scheme::bai(1.0, 1);
    turned::scheme(&stops, [usual.rate_rad_s, usual.acceleration_rad_s2])
}

/// Writes the page.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_page(path: &Path, content: &Content) -> anyhow::Result<()> {
    std::fs::write(path, page(content)?.into_string()).with_context(|| path.display().to_string())
}

fn page(content: &Content) -> anyhow::Result<Markup> {
    let outcome = content.outcome;
    let mut sections = vec![
        Section::new("certificate", "Certificate", certificate(content)),
        Section::new("correction", "Correction", correction_text(outcome)),
    ];
    if let Some(signals) = content.signals {
        sections.push(Section::new("motion", "Motion and signals", motion(content, signals)?));
    }
    sections.push(Section::new("estimates", "Estimates", estimates(content)?));
    sections.push(Section::new("fit", "Fit", fit(outcome)?));
    if let Some(previous) = content.previous {
        sections.push(Section::new("comparison", "Comparison", comparison(outcome, previous)?));
    }
    sections.push(Section::new("result", "Result", result(outcome)?));
    Ok(document(&format!("RINS self-calibration: {}", outcome.verdict_name()), &verdict(outcome), &sections))
}

// ------------------------------------------------------------------------------------------------------------- verdict

fn verdict(outcome: &Outcome) -> Markup {
    let name = outcome.verdict_name();
    html! {
        header class={ "verdict " (name) } {
            h1 { "Self-calibration " (name) }
            p { (in_words(outcome)) }
            @if !outcome.verdict.accepted() {
                ul { @for reason in table::folded(outcome.reasons()) { li { (reason) } } }
            }
        }
    }
}

fn in_words(outcome: &Outcome) -> String {
    let solution = &outcome.solution;
    let sigmas = quantity::sigmas(&outcome.estimate().sigmas);
    let worst = (0..INSTALLATION_STATES).max_by(|a, b| sigmas[*a].total_cmp(&sigmas[*b])).unwrap_or_default();
    let freedom = f64::from(solution.degrees_of_freedom);
    let measured = format!(
        "After {:.0} s, the largest sigma of the twelve installation errors is {} arcsec ({}). Chi-square is {:.0}; with the \
         configured noise, {:.0} ± {:.0} is expected.",
        solution.duration_s,
        significant(sigmas[worst]),
        PARAMETER_INFO[worst].name,
        solution.fit.chi_square,
        freedom,
        (2.0 * freedom).sqrt()
    );
    match (outcome.verdict.accepted(), outcome.stored) {
        (true, Some(false)) => format!(
            "The result is good, but could not be stored. A calibration that was stored before stays in use. {measured}"
        ),
        (true, _) => format!("The result may be used. {measured}"),
        (false, _) => format!("Do not use this result. A calibration that was stored before stays in use. {measured}"),
    }
}

// --------------------------------------------------------------------------------------------------------- certificate

fn certificate(content: &Content) -> Markup {
    html! {
        div.scroll { (parameters(content)) }
        div.scroll { table { tbody { @for (name, value) in facts(content) { tr { th.text { (name) } td.wide { (value) } } } } } }
    }
}

fn parameters(Content { outcome, truth, .. }: &Content) -> Markup {
    let columns: &[&str] =
        if truth.is_some() { &["estimate", "sigma", "truth", "error", "error/sigma"] } else { &["estimate", "sigma"] };
    html! {
        table {
            thead { tr { th { "parameter" } @for column in columns { th { (column) } } th.text { "unit" } } }
            tbody {
                @for group in &GROUPS {
                    @let shown = || group.states.clone().filter(|index| *index < PARAMETER_INFO.len() && outcome.is_estimated(*index));
                    @if shown().next().is_some() { tr.group { th colspan="7" { (group.title) } } }
                    @for index in shown() { (parameter_row(outcome, *truth, index)) }
                }
                @for (info, value, sigma) in outcome.effects() {
                    tr {
                        td { (info.name) } td { (rounded(value, sigma)) } td { (significant(sigma)) }
                        @for _ in 2..columns.len() { td {} }
                        td.text { (info.unit) }
                    }
                }
            }
        }
    }
}

fn parameter_row(outcome: &Outcome, truth: Option<&ParameterTable>, index: usize) -> Markup {
    let (value, sigma) =
        (quantity::values(&outcome.estimate().errors)[index], quantity::sigmas(&outcome.estimate().sigmas)[index]);
    let info = &PARAMETER_INFO[index];
    html! {
        tr {
            td { (info.name) } td { (rounded(value, sigma)) } td { (significant(sigma)) }
            @if let Some(truth) = truth {
                @let truth = truth.0[index].map(|truth| quantity::value(index, truth));
                @let error = truth.map(|truth| quantity::error(index, value, truth));
                td { (table::number_or_none(truth, |truth| rounded(truth, sigma))) }
                td { (table::number_or_none(error, |error| rounded(error, sigma))) }
                td { (table::number_or_none(error, |error| fixed(error / sigma, 2))) }
            }
            td.text { (info.unit) }
        }
    }
}

/// Scheme of a log, with its name if the scheme is in the library.
fn found_scheme(content: &Content) -> String {
    let name = content.motion().map(|scheme| scheme.name).filter(|name| Scheme::named(name).is_some());
    name.map_or_else(|| "as found in the log".into(), |name| format!("as found in the log: {name}"))
}

/// Circumstances of the calibration: names and values for the certificate.
fn facts(content: &Content) -> Vec<(&'static str, String)> {
    let (outcome, solution) = (content.outcome, &content.outcome.solution);
    let site = &outcome.site();
    let temperature = Some(solution.temperature_c).filter(|temperature| temperature.is_finite());
    let latitude_deg = site.latitude_rad / rins_selfcal::base::units::DEG;
    vec![
        ("source", content.source.into()),
        ("method", outcome.setup.method.name().into()),
        ("scheme", outcome.setup.scheme.clone().unwrap_or_else(|| found_scheme(content))),
        ("stops, moves", format!("{}, {}", outcome.stops, outcome.moves)),
        ("duration", format!("{:.1} s", solution.duration_s)),
        ("samples", format!("{} at {} Hz", outcome.counts.admitted, significant(outcome.setup.rate_hz))),
        (
            "site",
            format!(
                "latitude {latitude_deg:.5} deg, height {} m, gravity {:.6} m/s²",
                site.height_m,
                site.gravity_m_s2()
            ),
        ),
        ("noise", outcome.setup.noise.to_string()),
        ("hardware", hardware::described(&outcome.setup.hardware)),
        (
            "temperature",
            temperature.map_or_else(|| "no sensor".into(), |temperature| format!("{temperature:.1} deg C")),
        ),
        ("arithmetic", format!("{:?}", outcome.setup.precision).to_lowercase()),
        ("software", format!("rins-selfcal {}", env!("CARGO_PKG_VERSION"))),
        ("convention", CONVENTION.into()),
    ]
}

// ---------------------------------------------------------------------------------------------------------- correction

fn correction_text(outcome: &Outcome) -> Markup {
    let correction = correction(&outcome.estimate().errors);
    html! {
        p { "Apply to every sample, in SI units: specific force " code { "f_s = force_matrix_sa (f_a - accel_bias_a)" }
            ", angular rate " code { "w_s = rate_matrix_sg (w_g - gyro_bias_g)" } "." }
        @for (number, (language, text)) in paste::snippets(&correction).enumerate() {
            details open[number == 0] { summary { (language) } pre { (text) } }
        }
        details { summary { "JSON" } pre { (serde_json::to_string_pretty(&correction).unwrap_or_default()) } }
    }
}

// ------------------------------------------------------------------------------------------------------------- figures

fn motion(content: &Content, signals: &Signals) -> anyhow::Result<Markup> {
    let base = &content.outcome.estimate().errors;
    Ok(html! {
        (shown(figures::angles(signals), "angles", "Angles are continuous over whole turns from the first reading.")?)
        (shown(figures::gyros(signals), "gyros", "Outputs along the gyros' own axes, averaged between points.")?)
        (shown(figures::accelerometers(signals), "accelerometers", "Outputs along the accelerometers' own axes, averaged between points.")?)
        @if let Some(scheme) = content.motion() {
            @let [values, rank] = figures::singular_values(&scheme, &content.outcome.site(), base);
            (shown(values, "singular-values", "Singular values for Bai's twelve states along one period of the scheme; values that count as zero are drawn on the axis.")?)
            (shown(rank, "rank", "Rank as the measurements are added: stops by (B11), moves by (B13) of Bai et al.")?)
        }
    })
}

fn estimates(content: &Content) -> anyhow::Result<Markup> {
    let outcome = content.outcome;
    Ok(html! {
        p { "Live estimates after every segment against time in seconds, with a band of three sigmas. The last point is the final estimate. "
            @if content.truth.is_some() { "The dashed line is the true value." } }
        div.small {
            @for (index, info) in PARAMETER_INFO.iter().enumerate().filter(|(index, _)| outcome.is_estimated(*index)) {
                (shown(figures::estimate(outcome, index, content.truth), &format!("estimate-{}", info.name), "")?)
            }
        }
        (shown(figures::contributions(outcome), "contributions",
            "Information of every segment, from left to right, about every parameter. The darkest cells are three bits or more: sigma falls to an eighth or less.")?)
        (shown(figures::correlation(outcome), "correlation", "Correlations of the estimates: orange is positive, blue is negative.")?)
    })
}

fn fit(outcome: &Outcome) -> anyhow::Result<Markup> {
    Ok(html! {
        pre { (table::samples(outcome)) (table::verdict(outcome)) }
        (shown(figures::innovations(outcome), "innovations",
            "Each measurement minus its prediction in the last sweep, in sigmas. By chance, one in 370 lies outside the dashed lines.")?)
    })
}

fn comparison(outcome: &Outcome, previous: &Saved) -> anyhow::Result<Markup> {
    let comparison = Comparison::new(previous, &Saved::of(outcome));
    let changes = PARAMETER_INFO.iter().zip(&comparison.changes);
    let changes = changes.filter_map(|(info, change)| Some((info.name, change.as_ref()?.normalized())));
    let (names, changes): (Vec<&str>, Vec<f64>) = changes.unzip();
    Ok(html! {
        p { "Comparison with " (previous.path.display()) ": they " (comparison.in_words()) "." }
        @if !comparison.notes.is_empty() { ul { @for note in &comparison.notes { li { (note) } } } }
        (shown(figures::changes(&names, &changes, comparison.limit), "changes",
            "A bar beyond the dashed lines means that the unit has changed or that one of the results is wrong. Attitude and heading belong to the vehicle and do not count.")?)
    })
}

fn result(outcome: &Outcome) -> anyhow::Result<Markup> {
    let result = serde_json::to_string_pretty(&CalibrationReport::from(outcome))?;
    Ok(html! { details { summary { "All numbers, as JSON" } pre { (result) } } })
}
