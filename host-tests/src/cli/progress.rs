//! Progress on the standard error, invisible where that is no terminal.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::time::Duration;

/// A bar of `length` steps, counted in `unit`.
pub fn bar(length: u64, unit: &str) -> ProgressBar {
    let template = format!("{{bar:32}} {{pos}}/{{len}} {unit}, {{eta}} left  {{msg}}");
    ProgressBar::new(length).with_style(style(ProgressStyle::with_template(&template)))
}

/// For work of unknown length.
pub fn counter(unit: &str) -> ProgressBar {
    let template = format!("{{spinner}} {{human_pos}} {unit}  {{msg}}");
    ProgressBar::new_spinner().with_style(style(ProgressStyle::with_template(&template)))
}

/// Says how long the computing took, on the standard error and behind all that went to the standard output.
pub fn wall_time(wall: Duration) {
    // If nobody reads on, the time is all that is left to say.
    let _ = std::io::stdout().flush();
    eprintln!("wall time: {:.2} s", wall.as_secs_f64());
}

fn style<E>(style: Result<ProgressStyle, E>) -> ProgressStyle {
    style.unwrap_or_else(|_| ProgressStyle::default_bar())
}
