//! The report of a calibration as one self-contained page.

use crate::calibration::Outcome;
use crate::report::{CONVENTION, CalibrationReport};
use crate::table;
use crate::truth::ParameterTable;
use anyhow::Context;
use std::path::Path;

const STYLE: &str = "body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color-scheme:light dark}\
pre{overflow-x:auto;padding:1em;border:1px solid #8888;border-radius:4px}\
.accepted{color:#197a33}.rejected{color:#c62828}";

/// Writes the page: verdict, parameters, and the correction ready to paste.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn write_page(path: &Path, outcome: &Outcome, truth: Option<&ParameterTable>) -> anyhow::Result<()> {
    std::fs::write(path, page(outcome, truth)?).with_context(|| path.display().to_string())
}

fn page(outcome: &Outcome, truth: Option<&ParameterTable>) -> anyhow::Result<String> {
    let verdict = outcome.verdict_name();
    let result = serde_json::to_string_pretty(&CalibrationReport::from(outcome))?;
    let sections = [
        ("Data", table::samples(outcome)),
        ("Parameters", table::parameters(outcome, truth) + &table::optional_states(outcome)),
        ("Fit and verdict", table::verdict(outcome)),
        ("Convention", CONVENTION.replace(". ", ".\n")),
        ("Result with correction and correlation, as JSON", result),
    ];
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>RINS self-calibration</title>\
         <style>{STYLE}</style></head><body>\n<h1>Self-calibration: <span class=\"{verdict}\">{verdict}</span></h1>\n"
    );
    for (title, text) in sections {
        html += &format!("<h2>{title}</h2>\n<pre>{}</pre>\n", escaped(&text));
    }
    Ok(html + "</body></html>\n")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
