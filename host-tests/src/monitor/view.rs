//! Text view of an instrument: a screen, or a line for each event.

use super::client::Event;
use crate::base::quantity;
use crate::result::table::{explained, folded};
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::units::DEG;
use rins_selfcal::estimator::Estimate;
use rins_selfcal::link::{Answer, Dropped, Hello, Status};
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS, block};
use rins_selfcal::run::abort::Abort;
use rins_selfcal::run::policy::{Decision, MotionLock};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::verdict::Verdict;

/// Widest progress bar, characters.
const BAR: usize = 32;
/// Columns of estimates on the screen.
const COLUMNS: usize = 2;
/// Width from which the screen shows full names and spaces, characters.
const WIDE: usize = 110;

/// State of an instrument as its messages and answers report it.
#[derive(Clone, Debug, Default)]
pub struct View {
    hello: Option<Hello>,
    status: Option<Status>,
    /// Largest remaining time that was reported since the run began, s.
    longest_s: f32,
    estimate: Option<(u16, Estimate)>,
    decision: Option<Decision>,
    verdict: Option<Verdict>,
    aborted: Option<Abort>,
    stored: Option<bool>,
    corrected: Option<[[f64; 3]; 2]>,
    under_way: bool,
    /// State of the instrument after the end of a run. It shows the end even if messages of the run were lost.
    ended_in: Option<State>,
    warnings: Vec<String>,
}

impl View {
    /// Updates the view with an event.
    pub fn note(&mut self, event: &Event) {
        match event {
            Event::Answer(_, Answer::Hello(hello)) => self.hello = Some(hello.clone()),
            Event::Answer(_, Answer::Status(status)) => self.note_status(status),
            Event::Answer(_, Answer::Estimate { segments, estimate }) => self.estimate = Some((*segments, *estimate)),
            Event::Answer(..) | Event::Corrected(_) => {}
            Event::Message(message) => self.note_message(message),
        }
    }

    fn note_status(&mut self, status: &Status) {
        let begins = self.status.is_none_or(|before| before.state.is_idle());
        self.longest_s = if begins { status.left_s } else { self.longest_s.max(status.left_s) };
        if status.state.is_idle() && self.under_way {
            self.ended_in = Some(status.state);
        }
        self.under_way |= status.state.is_under_way();
        self.status = Some(*status);
    }

    fn forget_run(&mut self) {
        (self.verdict, self.aborted, self.stored, self.estimate) = (None, None, None, None);
        (self.under_way, self.ended_in) = (true, None);
        self.warnings.clear();
    }

    fn note_message(&mut self, message: &Message) {
        match message {
            Message::State { state, legs, time_us } => {
                if *state == State::AwaitStill {
                    self.forget_run();
                }
                if let Some(status) = &mut self.status {
                    (status.state, status.legs, status.time_us) = (*state, *legs, *time_us);
                }
            }
            Message::Segment(progress) => self.estimate = Some((progress.segments, progress.estimate)),
            Message::Decided(decision) => self.decision = Some(*decision),
            Message::Judged(verdict) => self.verdict = Some(verdict.clone()),
            Message::Aborted(abort) => self.aborted = Some(*abort),
            Message::Saved(saved) => self.stored = Some(*saved),
            Message::Corrected { force_s, omega_is_s, .. } => self.corrected = Some([*force_s, *omega_is_s]),
            message => self.warnings.extend(warning(message)),
        }
    }

    /// Whether the run has ended with a result that was accepted and stored; `None` before the end of the run. An accepted
    /// run ends when the axes have returned.
    pub fn ended(&self) -> Option<bool> {
        match (&self.verdict, self.aborted, self.stored) {
            (_, Some(_), _) => Some(false),
            (Some(verdict), None, _) if !verdict.accepted() => Some(false),
            (Some(_), None, Some(stored)) => self.ended_in.map(|_| stored),
            _ => self.ended_in.map(|state| state == State::Correcting),
        }
    }

    /// Whether settings may be changed and calibrations erased.
    pub fn is_unlocked(&self) -> bool {
        self.status.is_some_and(|status| status.unlocked)
    }

    /// Lines of the screen, `width` characters wide. The most important lines come first, so that a low screen shows
    /// them too.
    pub fn screen(&self, width: usize, dropped: Dropped, missing: u32) -> Vec<String> {
        let mut lines = vec![self.hello.as_ref().map_or_else(|| "waiting for the instrument".into(), named)];
        if let Some(status) = &self.status {
            lines.push(format!("state    {}", state(status)));
            lines.push(format!("progress {}", self.bar(status)));
            lines.push(format!("angles   {}", angles(status)));
        }
        if let Some((segments, estimate)) = &self.estimate {
            lines.push(format!("worst    {} after {segments} segments", worst(estimate)));
        }
        if let Some([force, rate]) = self.corrected {
            let rate = rate.map(|rate| rate / DEG * 3600.0);
            lines.push(format!("force    {:+.5} {:+.5} {:+.5} m/s^2, corrected", force[0], force[1], force[2]));
            lines.push(format!("rate     {:+.3} {:+.3} {:+.3} deg/h, corrected", rate[0], rate[1], rate[2]));
        }
        lines.extend(self.conclusion());
        lines.extend(self.warnings.iter().map(|warning| format!("warning  {warning}")));
        lines.extend(self.losses(dropped, missing));
        lines.extend(self.estimate.iter().flat_map(|(_, estimate)| estimates(estimate, width)));
        lines
    }

    fn bar(&self, status: &Status) -> String {
        if status.state.is_idle() {
            return "no run under way".into();
        }
        let done = 1.0 - f64::from(status.left_s) / f64::from(self.longest_s.max(1e-3));
        let full = (done.clamp(0.0, 1.0) * BAR as f64).round() as usize;
        format!("[{}{}] {:.0} s left", "#".repeat(full), ".".repeat(BAR - full), status.left_s)
    }

    fn conclusion(&self) -> Vec<String> {
        let decision = self.decision.map(|decision| format!("decision {decision}"));
        let verdict = self.verdict.as_ref().map(verdict_lines).unwrap_or_default();
        let aborted = self.aborted.into_iter().flat_map(aborted);
        let stored = self.stored.map(stored);
        decision.into_iter().chain(verdict).chain(aborted).chain(stored).collect()
    }

    fn losses(&self, dropped: Dropped, missing: u32) -> Option<String> {
        let link = self.status.map(|status| (status.missing, status.link)).unwrap_or_default();
        let (samples, link) = link;
        let here = dropped.corrupt + dropped.version;
        let there = link.dropped.corrupt + link.dropped.version + link.not_understood;
        let any = here + there + missing + samples + link.overrun + link.unsent > 0;
        any.then(|| {
            format!(
                "lost     {samples} samples; frames: {here} damaged here, {there} at the instrument, {} not sent, {missing} messages \
                 missing; {} bytes overrun",
                link.unsent, link.overrun
            )
        })
    }
}

fn named(hello: &Hello) -> String {
    format!(
        "rins-selfcal {}, protocol {}, store format {}, f{}, {} states",
        hello.software.escape_debug(),
        hello.protocol,
        char::from(hello.store_format).escape_debug(),
        hello.scalar_bits,
        hello.states
    )
}

fn state(status: &Status) -> String {
    let time_s = status.time_us as f64 * 1e-6;
    let lock = match status.motion_lock {
        Some(MotionLock::NotCommissioned) => ", motion locked: not commissioned",
        Some(MotionLock::AfterReset) => ", motion locked after a reset",
        None => "",
    };
    let extra = [(status.correcting, ", correcting"), (status.unlocked, ", unlocked"), (true, lock)];
    let extra: String = extra.into_iter().filter_map(|(holds, text)| holds.then_some(text)).collect();
    format!("{}{extra}, {time_s:.1} s after power-up", stage(status.state, status.legs))
}

/// What the instrument does, with the number of legs.
fn stage(state: State, legs: u16) -> String {
    let of = state.leg().map_or_else(String::new, |_| format!(" of {}", legs.saturating_sub(1)));
    format!("{state}{of}")
}

fn angles(status: &Status) -> String {
    let [outer, inner] = status.angles_rad.map(|angle| f64::from(angle) / DEG);
    format!("outer {outer:+.4} deg, inner {inner:+.4} deg")
}

fn worst(estimate: &Estimate) -> String {
    let sigmas = quantity::sigmas(&estimate.sigmas);
    let worst = sigmas[..block::ACCEL_BIAS].iter().copied().fold(0.0, f64::max);
    format!("sigma of the 12: {} arcsec", quantity::significant(worst))
}

fn estimates(estimate: &Estimate, width: usize) -> Vec<String> {
    let (values, sigmas) = (quantity::values(&estimate.errors), quantity::sigmas(&estimate.sigmas));
    let cell = |index: usize| {
        let info = &PARAMETER_INFO[index];
        let sigma = quantity::rounded(sigmas[index], sigmas[index]);
        let value = quantity::rounded(values[index], sigmas[index]);
        if width >= WIDE {
            format!("{:<24} {value:>10} +- {sigma:<8} {:<6}", info.name, info.unit)
        } else {
            format!("{:<14.14}{value:>9} +-{sigma:<7}{:<6}", info.name, info.unit)
        }
    };
    let rows = PARAMETERS.div_ceil(COLUMNS);
    let row = |row: usize| (row..PARAMETERS).step_by(rows).map(cell).collect::<Vec<_>>().join(" ");
    (0..rows).map(|index| row(index).trim_end().to_owned()).collect()
}

fn verdict_lines(verdict: &Verdict) -> Vec<String> {
    let name = if verdict.accepted() { "accepted" } else { "rejected" };
    let reasons = folded(&verdict.reasons).into_iter().map(|reason| format!("  - {reason}"));
    let hint = verdict.reasons.first().map(|reason| explained(reason.code()));
    let changes = folded(&verdict.changes).into_iter().map(|change| format!("  changed: {change}"));
    std::iter::once(format!("verdict  {name}")).chain(reasons).chain(hint).chain(changes).collect()
}

fn aborted(abort: Abort) -> [String; 2] {
    [format!("verdict  aborted: {abort}"), explained(abort.reason.code())]
}

fn stored(stored: bool) -> String {
    format!("stored   {}", if stored { "yes" } else { "NO: the earlier calibration stays stored" })
}

/// Warning of a message, if it has one.
fn warning(message: &Message) -> Option<String> {
    match message {
        Message::Store { fault: true, .. } => Some("the calibration memory does not work".into()),
        Message::Store { damaged: true, found, .. } => {
            let rest = if *found { "an older calibration is used" } else { "there is no intact calibration" };
            Some(format!("a stored calibration is damaged; {rest}"))
        }
        Message::Store { other_version: Some(version), .. } => {
            let format = char::from(*version);
            Some(format!(
                "there are stored calibrations of format {format}, which the instrument's software does not read"
            ))
        }
        Message::Released => Some("the axes are brought to rest, and then no longer controlled".into()),
        Message::Fault(fault) => Some(fault.to_string()),
        Message::Restarted(restart) if *restart != Restart::PowerOn => Some(restart.to_string()),
        Message::Refused(error) => Some(format!("the configuration is refused: {error}; {}", explained(error.code()))),
        _ => None,
    }
}

/// Lines for an event; none for an event that is not shown.
pub fn lines(event: &Event) -> Vec<String> {
    let message = match event {
        Event::Answer(0, Answer::Hello(hello)) => return vec![named(hello)],
        Event::Answer(..) | Event::Corrected(_) => return Vec::new(),
        Event::Message(message) => message,
    };
    let line = match message {
        Message::State { time_us, state, legs } => {
            format!("{:.1} s: {}", *time_us as f64 * 1e-6, stage(*state, *legs))
        }
        Message::Segment(progress) => format!("segment {}: worst {}", progress.segments, worst(&progress.estimate)),
        Message::Decided(decision) => format!("decision: {decision}"),
        Message::Judged(verdict) => return verdict_lines(verdict),
        Message::Aborted(abort) => return aborted(*abort).into(),
        Message::Saved(saved) => stored(*saved),
        message => return warning(message).map(|warning| format!("warning  {warning}")).into_iter().collect(),
    };
    vec![line]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::model::error_model::InstrumentErrors;
    use rins_selfcal::run::telemetry::Progress;
    use rins_selfcal::segment::SegmentKind;

    #[test]
    fn all_estimates_fit_on_a_screen_of_80_by_24() {
        let errors = InstrumentErrors { heading: -1e-3, ..InstrumentErrors::default() };
        // Prior sigmas are the longest numbers.
        let estimate = Estimate { errors, sigmas: PARAMETER_INFO.map(|info| 10_800.0 * info.unit_si) };
        let progress = Progress { segments: 1, kind: SegmentKind::Stop, end_us: 1, estimate };
        let mut view = View::default();
        view.note(&Event::Message(Message::Segment(progress)));
        view.note(&Event::Message(Message::Judged(Verdict::default())));
        let screen = view.screen(80, Dropped::default(), 0);
        // The lines of state, progress, angles and keys are not in this screen and need four more.
        assert!(screen.len() + 4 < 24 && screen.iter().all(|line| line.len() <= 80), "{screen:#?}");
        let of_estimates = &screen[screen.len() - PARAMETERS / COLUMNS..];
        assert!(of_estimates.iter().all(|line| line.matches("+-10800").count() == COLUMNS), "{of_estimates:#?}");
        assert!(screen[..4].iter().any(|line| line == "verdict  accepted"), "{screen:#?}");
    }
}
