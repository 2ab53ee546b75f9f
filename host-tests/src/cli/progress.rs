//! Progress on the standard error: a live view on a terminal, else a line now and then.

use super::output::is_quiet;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt;
use std::io::Write;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Between two lines where the standard error is no terminal.
const TELL: Duration = Duration::from_secs(10);

/// Progress of a command. It vanishes when it is dropped.
pub struct Progress {
    bar: ProgressBar,
    unit: &'static str,
    begun: Instant,
    told: Mutex<Instant>,
}

/// A bar of `length` steps, counted in `unit`, with the time left, and below it what is told.
pub fn bar(length: u64, unit: &'static str) -> Progress {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}{{left}}\n{{wide_msg}}");
    Progress::new(ProgressBar::new(length), &template, unit)
}

/// For work of unknown length.
pub fn counter(unit: &'static str) -> Progress {
    Progress::new(ProgressBar::new_spinner(), &format!("{{spinner}} {{human_pos}} {unit}  {{wide_msg}}"), unit)
}

/// The time left, once something is done.
fn left(state: &ProgressState, text: &mut dyn fmt::Write) {
    if state.pos() > 0 {
        // A string takes all.
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

    /// So many steps are done.
    pub fn set_position(&self, position: u64) {
        self.bar.set_position(position);
        self.tell_if_due();
    }

    /// So many more steps are done.
    pub fn inc(&self, steps: u64) {
        self.bar.inc(steps);
        self.tell_if_due();
    }

    /// What is to be known beside it.
    pub fn set_message(&self, message: String) {
        self.bar.set_message(message);
    }

    /// A line that stays.
    pub fn warn(&self, line: &str) {
        if !is_quiet() {
            self.bar.suspend(|| eprintln!("{line}"));
        }
    }

    /// Does what writes to the terminal.
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

/// Says how long the computing took, on the standard error and behind all that went to the standard output.
pub fn wall_time(wall: Duration) {
    // If nobody reads on, the time is all that is left to say.
    let _ = std::io::stdout().flush();
    if !is_quiet() {
        eprintln!("wall time: {:.2} s", wall.as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_is_and_what_is_known() {
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
