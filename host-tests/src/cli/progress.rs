//! Progress on the standard error: a live view on a terminal, otherwise a line every 10 s.

use super::output::is_quiet;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt;
use std::io::Write;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Time between two lines if the standard error is not a terminal.
const TELL: Duration = Duration::from_secs(10);

/// Progress of a command. The live view disappears when this value is dropped.
pub struct Progress {
    bar: ProgressBar,
    unit: &'static str,
    begun: Instant,
    told: Mutex<Instant>,
}

/// A bar of `length` steps, counted in `unit`, with the time left; the message is on the line below.
pub fn bar(length: u64, unit: &'static str) -> Progress {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}{{left}}\n{{wide_msg}}");
    Progress::new(ProgressBar::new(length), &template, unit)
}

/// A counter for work of unknown length.
pub fn counter(unit: &'static str) -> Progress {
    Progress::new(ProgressBar::new_spinner(), &format!("{{spinner}} {{human_pos}} {unit}  {{wide_msg}}"), unit)
}

/// Writes the time left, once the first step is done.
fn left(state: &ProgressState, text: &mut dyn fmt::Write) {
    if state.pos() > 0 {
        // Writing to a string cannot fail.
        let _ = write!(text, ", {:#} left", HumanDuration(state.eta()));
    }
}

impl Progress {
    fn new(bar: ProgressBar, template: &str, unit: &'static str) -> Self {
        let bar = if is_quiet() { ProgressBar::hidden() } else { bar };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let style = style.with_key("left", left);
        let now = Instant::now();
        Self { bar: bar.with_style(style), unit, begun: now, told: Mutex::new(now) }
    }

    /// Sets the number of steps that are done.
    pub fn set_position(&self, position: u64) {
        self.bar.set_position(position);
        self.tell_if_due();
    }

    /// Adds steps to those that are done.
    pub fn inc(&self, steps: u64) {
        self.bar.inc(steps);
        self.tell_if_due();
    }

    /// Sets the message that is shown with the progress.
    pub fn set_message(&self, message: String) {
        self.bar.set_message(message);
    }

    /// Prints a line that stays on the terminal.
    pub fn warn(&self, line: &str) {
        if !is_quiet() {
            self.bar.suspend(|| eprintln!("{line}"));
        }
    }

    /// Hides the live view while `write` prints to the terminal.
    pub fn suspend(&self, write: impl FnOnce()) {
        self.bar.suspend(write);
    }

    fn tell_if_due(&self) {
        if !self.bar.is_hidden() || is_quiet() {
            return;
        }
        let Ok(mut told) = self.told.lock() else { return };
        if told.elapsed() >= TELL {
            *told = Instant::now();
            eprintln!("{}", self.line());
        }
    }

    fn line(&self) -> String {
        let (position, unit, message) = (self.bar.position(), self.unit, self.bar.message());
        let rest = if message.is_empty() { message } else { format!("; {}", message.replace('\n', ", ")) };
        match self.bar.length().filter(|length| *length > 0 && position > 0) {
            Some(length) => {
                let part = length.saturating_sub(position) as f64 / position as f64;
                let left = HumanDuration(self.begun.elapsed().mul_f64(part));
                format!("{position} of {length} {unit}, {left} left{rest}")
            }
            None => format!("{position} {unit}{rest}"),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Prints the computing time on the standard error, after everything on the standard output.
pub fn wall_time(wall: Duration) {
    // An error is ignored: if the standard output is closed, the time can still be printed.
    let _ = std::io::stdout().flush();
    if !is_quiet() {
        eprintln!("wall time: {:.2} s", wall.as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_progress_line_has_position_time_left_and_message() {
        let mut progress = bar(100, "runs");
        progress.begun -= Duration::from_secs(30);
        progress.set_position(25);
        progress.set_message("worst 1.2\nleg 3".into());
        assert_eq!(progress.line(), "25 of 100 runs, 2 minutes left; worst 1.2, leg 3");
        let counter = counter("rows");
        counter.set_position(7);
        assert_eq!(counter.line(), "7 rows");
    }
}
