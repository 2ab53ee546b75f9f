//! The state machine of a self-calibration run. It decides what to do next; the main loop carries the decision out.
//!
//! ```text
//!             the stored calibration is used
//!  PowerUp ------------------------------------------------------------> Correcting     StandBy (nothing to use)
//!     |                                                                      ^  ^
//!     v                                                                      |  |
//!  AwaitStill --> Turn --> Settle --> Dwell --(last leg)--> Compute --> Verdict --> Store
//!                  ^                    |         ^                      |
//!                  |        (early finish allowed) | enough               |
//!                  |                    v         |                      |
//!                  |                  Weigh ------+                      |
//!                  |                    |                                |
//!                  +----(next leg)------+                         rejected|
//!                                                                        v
//!  any state before Store --(abort)---+
//!  Store --(saved)--------------------+--> Stopping --(base and axes at rest)--> Parking --> Parked or Correcting
//!                                            |  |                                  |
//!                    (stop, nothing to park, |  +--(an axis cannot be trusted)--+  |
//!                     or the base moves)     v                                  v  v
//!                                         Stopped                             Stranded
//! ```
//! Time is an argument, in microseconds. Leg 0 is the move to the scheme's start at (0, 0) and the first stop. Leg k >
//! 0 is the scheme's k-th move and the stop after it. After a run the axes return to (0, 0), if this run has moved them
//! and if base and axes are well. An accepted run then ends in Correcting, every other run in Parked; in every case the
//! stored calibration of a run that was not accepted is unchanged. The command to stop brings the axes to rest from any
//! state, and no move follows. A command starts a run, in state AwaitStill, from Correcting, StandBy, Parked, Stopped
//! and Stranded.

use super::abort::AbortReason;
use crate::base::bounds::{Bounded, Unit};
use crate::run::policy::Decision;
use crate::run::state::State;
use crate::scheme::{Leg, SETTLING_S, Scheme};
use serde::{Deserialize, Serialize};

/// Base and axes must have been at rest for this long before the first move begins, us.
const STILL_US: u64 = 1_000_000;
/// Longest wait for base and axes to come to rest, us. After this time no move begins.
const STILL_TIMEOUT_US: u64 = 60_000_000;
/// Settling time between the arrival of the axes and the beginning of the dwell, us.
const SETTLE_US: u64 = (SETTLING_S * 1e6) as u64;
/// Shortest time that the axes are given to come to rest before they are parked, us.
const STOP_US: u64 = 1_000_000;
/// A move may exceed its nominal duration by this time, us.
const TURN_TIMEOUT_US: u64 = 10_000_000;

/// The limits on the duration of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pace {
    /// Number of disturbed stops that may be repeated in one run.
    pub stop_repeats: u8,
    /// Whether the run ends early: at the end of the first stop at which every required sigma is met and the fit is
    /// good.
    pub early_finish: bool,
    /// No further move begins after this time, s; `None` for no limit.
    pub longest_s: Option<f64>,
}

impl Default for Pace {
    /// Three repeated stops, no early finish, no time limit.
    fn default() -> Self {
        Self { stop_repeats: 3, early_finish: false, longest_s: None }
    }
}

/// The permitted range of every number of [`Pace`]. No limit is permitted too.
pub static PACE_BOUNDS: [Bounded<Pace>; 1] =
    [Bounded::new("longest time of a run", Unit::si("s"), [1e-3, 1e6], |pace| pace.longest_s.unwrap_or(1.0))];

/// What the sequencer needs to know at each step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Input {
    /// Time, us.
    pub now_us: u64,
    /// Answer to [`Action::Decide`]: what to do at power-up.
    pub decision: Option<Decision>,
    /// A run was requested.
    pub start: bool,
    /// Gyros and encoders show that base and axes are at rest.
    pub still: bool,
    /// Both axes have reached the commanded angles.
    pub arrived: bool,
    /// Neither axis turns.
    pub at_rest: bool,
    /// Nominal duration of the move under way, us.
    pub move_us: u64,
    /// The instrument was not at rest during the stop under way.
    pub disturbed: bool,
    /// The reason to end the run, if there is a reason.
    pub abort: Option<AbortReason>,
    /// Factor by which the dwell is longer than the scheme's, if above 1. The measured noise exceeds the configured
    /// noise.
    pub extension: f64,
    /// Answer to [`Action::Weigh`]: whether every requirement is met. `None` while the answer is not known yet.
    pub enough: Option<bool>,
    /// Answer to [`Action::Solve`]: the solution is complete.
    pub solved: bool,
    /// Answer to [`Action::Judge`]: whether the result is accepted.
    pub accepted: Option<bool>,
    /// Answer to [`Action::Save`]: writing has ended, with or without success.
    pub saved: bool,
}

/// What the main loop must do now.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Action {
    /// No change.
    Continue,
    /// Bring both axes to rest, then stop controlling them.
    Release,
    /// Decide what to do after power-up.
    Decide,
    /// Begin a run: forget the previous run, and hold both axes at their present angles.
    Begin,
    /// Hold both axes at their present angles.
    Hold,
    /// Move both axes to these angles, rad, counted over whole turns.
    MoveTo {
        /// Outer angle, rad.
        outer_rad: f64,
        /// Inner angle, rad.
        inner_rad: f64,
    },
    /// Begin to measure: the axes are at rest at the scheme's first stop.
    Measure,
    /// Discard the samples of this stop and measure the stop again: it was disturbed.
    RepeatStop,
    /// Close the stop and check whether every requirement is met. Each of these actions does one bounded piece of the
    /// work.
    Weigh,
    /// Close the last stop and process all segments. Each of these actions does one bounded piece of the work.
    Solve,
    /// Judge the solution.
    Judge,
    /// Store the accepted calibration.
    Save,
    /// Correct all samples from now on.
    Correct,
    /// Bring the axes to rest and end the run. The run was aborted for this reason; `None` if it was rejected. Parking
    /// follows.
    GiveUp(Option<AbortReason>),
}

/// The state machine.
#[derive(Clone, Debug)]
pub struct Sequencer {
    scheme: Scheme,
    state: State,
    since_us: u64,
    /// Nominal duration of the stop under way, us.
    dwell_us: u64,
    still_since_us: Option<u64>,
    measuring_since_us: u64,
    pace: Pace,
    /// Number of stops that may still be repeated.
    repeats_left: u8,
    /// The leg after which the time limit ended the run, if legs were left.
    cut_after: Option<u16>,
    /// Whether this run has moved the axes.
    moved: bool,
    ending: Ending,
    /// The result of this run is stored and in use.
    accepted: bool,
}

/// What follows when the axes have come to rest at the end of a run. A later ending never replaces an earlier one that
/// permits less.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Ending {
    /// The axes return to (0, 0).
    Park,
    /// The axes are held where they are.
    Hold,
    /// The axes are released, because an axis cannot be trusted.
    Release,
}

impl Sequencer {
    /// A sequencer at power-up.
    pub fn new(scheme: Scheme, pace: Pace) -> Self {
        Self {
            scheme,
            state: State::PowerUp,
            since_us: 0,
            dwell_us: 0,
            still_since_us: None,
            measuring_since_us: 0,
            pace,
            repeats_left: pace.stop_repeats,
            cut_after: None,
            moved: false,
            ending: Ending::Park,
            accepted: false,
        }
    }

    /// Where the run is.
    pub fn state(&self) -> State {
        self.state
    }

    /// The scheme being run.
    pub fn scheme(&self) -> &Scheme {
        &self.scheme
    }

    /// Number of legs of the whole run, including leg 0.
    pub fn legs(&self) -> u16 {
        self.scheme.moves() as u16 + 1
    }

    /// Changes scheme and pace, from the next run on.
    pub fn reconfigure(&mut self, scheme: Scheme, pace: Pace) {
        (self.scheme, self.pace) = (scheme, pace);
    }

    /// Nominal time until the last segment is measured, s, if no stop is repeated or extended; 0 if no segment is left
    /// to measure.
    pub fn left_s(&self, now_us: u64) -> f64 {
        let (leg, from_here_s) = match self.state {
            State::AwaitStill => (0, STILL_US as f64 * 1e-6 + SETTLING_S + self.leg(0).stop_s),
            State::Turn(leg) => (leg, self.leg_s(leg)),
            State::Settle(leg) => (leg, SETTLING_S + self.leg(leg).stop_s),
            State::Dwell(leg) | State::Weigh(leg) => (leg, self.leg(leg).stop_s),
            _ => return 0.0,
        };
        let elapsed_s = now_us.saturating_sub(self.since_us) as f64 * 1e-6;
        let later_s: f64 = (leg + 1..self.legs()).map(|leg| self.leg_s(leg)).sum();
        (from_here_s - elapsed_s).max(0.0) + later_s
    }

    /// Nominal duration of a leg's move, settling and stop, s. For leg 0 the move is not included, as its start is not
    /// known.
    fn leg_s(&self, leg: u16) -> f64 {
        let to = self.leg(leg);
        let from = self.leg(leg.saturating_sub(1));
        self.scheme.move_s(&from, &to) + SETTLING_S + to.stop_s
    }

    /// Processes one input. At most one transition is made.
    pub fn step(&mut self, input: &Input) -> Action {
        // If the clock went back, the time in this state is counted from 0 again.
        self.since_us = self.since_us.min(input.now_us);
        if let Some(reason) = input.abort {
            let command = self.abort(input.now_us, reason);
            if command != Action::Continue {
                return command;
            }
        }
        match self.state {
            State::PowerUp => self.power_up(input),
            State::AwaitStill => self.await_still(input),
            State::Turn(leg) => self.turn(input, leg),
            State::Settle(leg) => self.settle(input, leg),
            State::Dwell(leg) => self.dwell(input, leg),
            State::Weigh(leg) => match input.enough {
                None => Action::Weigh,
                Some(true) => self.enter(input, State::Compute, Action::Solve),
                Some(false) => self.next_leg(input, leg),
            },
            State::Compute if input.solved => self.enter(input, State::Verdict, Action::Judge),
            State::Compute => Action::Solve,
            State::Verdict => match input.accepted {
                Some(true) => self.enter(input, State::Store, Action::Save),
                Some(false) => self.give_up(input, None),
                None => Action::Continue,
            },
            State::Store if input.saved => {
                self.accepted = true;
                self.conclude(input, Action::Correct)
            }
            State::Stopping => self.stopping(input),
            State::Parking if self.is_overdue(input) => self.strand(input),
            State::Parking if input.arrived => self.end(input, State::Parked, Action::Hold),
            idle if idle.is_idle() && input.start => self.begin(input),
            // Store and Parking wait; idle states wait for a command.
            _ => Action::Continue,
        }
    }

    /// Ends the run for this reason, if a run is under way. A fault also ends the parking. If no run is under way, axes
    /// that have a fault are released. This function needs no samples.
    pub fn abort(&mut self, now_us: u64, reason: AbortReason) -> Action {
        let input = Input { now_us, ..Input::default() };
        match self.state {
            // An IMU may need more time to start than the longest permitted loss of samples.
            State::PowerUp if reason == AbortReason::SampleLoss => Action::Continue,
            State::Parking if reason.is_fault() => self.strand(&input),
            State::Parking => Action::Continue,
            State::Stopping => {
                self.ending = self.ending.max(Ending::after(reason));
                Action::Continue
            }
            quiet if quiet == State::Store || quiet.is_idle() => {
                if !matches!(reason, AbortReason::Gimbal(_)) {
                    return Action::Continue;
                }
                self.ending = Ending::Release;
                Action::Release
            }
            // A run is under way or about to begin.
            _ => self.give_up(&input, Some(reason)),
        }
    }

    /// Brings the axes to rest from any state and holds them. A run under way ends, and no move follows. Axes that were
    /// released because of a fault stay released. This function needs no samples.
    pub fn stop(&mut self, now_us: u64) -> Action {
        let input = Input { now_us, ..Input::default() };
        let held = self.ending.max(Ending::Hold);
        match self.state {
            State::Stranded => Action::Continue,
            idle if idle.is_idle() => Action::Hold,
            State::Store => {
                self.ending = held;
                Action::Hold
            }
            State::Stopping | State::Parking => {
                self.ending = if self.state == State::Parking { Ending::Hold } else { held };
                self.enter(&input, State::Stopping, Action::Hold)
            }
            // A run is under way or about to begin.
            _ => {
                self.ending = Ending::Hold;
                self.enter(&input, State::Stopping, Action::GiveUp(Some(AbortReason::Stopped)))
            }
        }
    }

    fn enter(&mut self, input: &Input, state: State, command: Action) -> Action {
        self.state = state;
        self.since_us = input.now_us;
        if let State::Dwell(leg) = state {
            self.dwell_us = (self.leg(leg).stop_s * 1e6) as u64;
        }
        command
    }

    fn elapsed_us(&self, input: &Input) -> u64 {
        input.now_us.saturating_sub(self.since_us)
    }

    /// Waits until base and axes are at rest. The base need not be at rest if no move follows.
    fn stopping(&mut self, input: &Input) -> Action {
        let at_rest = input.at_rest && self.elapsed_us(input) >= STOP_US;
        let still = self.has_been_still(input);
        match self.ending {
            Ending::Park if self.moved && self.elapsed_us(input) <= STILL_TIMEOUT_US => {
                if at_rest && still {
                    return self.enter(input, State::Parking, Action::MoveTo { outer_rad: 0.0, inner_rad: 0.0 });
                }
                Action::Continue
            }
            Ending::Park | Ending::Hold if at_rest => self.end(input, State::Stopped, Action::Continue),
            Ending::Release if at_rest => self.strand(input),
            Ending::Park | Ending::Hold | Ending::Release => Action::Continue,
        }
    }

    /// Ends the run in this state; an accepted run ends in [`State::Correcting`].
    fn end(&mut self, input: &Input, state: State, command: Action) -> Action {
        self.enter(input, if self.accepted { State::Correcting } else { state }, command)
    }

    /// Releases axes that cannot be trusted.
    fn strand(&mut self, input: &Input) -> Action {
        self.end(input, State::Stranded, Action::Release)
    }

    fn give_up(&mut self, input: &Input, reason: Option<AbortReason>) -> Action {
        self.ending = reason.map_or(Ending::Park, Ending::after);
        self.conclude(input, Action::GiveUp(reason))
    }

    /// Brings the axes to rest at the end of a run.
    fn conclude(&mut self, input: &Input, command: Action) -> Action {
        self.still_since_us = None;
        self.enter(input, State::Stopping, command)
    }

    fn power_up(&mut self, input: &Input) -> Action {
        match input.decision {
            None => Action::Decide,
            Some(Decision::Calibrate(_)) => self.begin(input),
            Some(Decision::UseStored(_)) => self.enter(input, State::Correcting, Action::Correct),
            Some(Decision::StandBy(_)) => self.enter(input, State::StandBy, Action::Hold),
        }
    }

    fn begin(&mut self, input: &Input) -> Action {
        self.still_since_us = None;
        self.repeats_left = self.pace.stop_repeats;
        self.cut_after = None;
        (self.moved, self.ending, self.accepted) = (false, Ending::Park, false);
        self.enter(input, State::AwaitStill, Action::Begin)
    }

    fn await_still(&mut self, input: &Input) -> Action {
        if self.has_been_still(input) {
            return self.turn_to(input, 0);
        }
        if self.elapsed_us(input) > STILL_TIMEOUT_US {
            return self.give_up(input, Some(AbortReason::NotStill));
        }
        Action::Continue
    }

    /// Whether base and axes have been at rest for [`STILL_US`].
    fn has_been_still(&mut self, input: &Input) -> bool {
        if !input.still {
            self.still_since_us = None;
            return false;
        }
        // If the clock went back, the time at rest is counted from 0 again.
        let since_us = self.still_since_us.get_or_insert(input.now_us);
        *since_us = input.now_us.min(*since_us);
        input.now_us - *since_us >= STILL_US
    }

    fn turn_to(&mut self, input: &Input, leg: u16) -> Action {
        self.moved = true;
        let Leg { outer_rad, inner_rad, .. } = self.leg(leg);
        self.enter(input, State::Turn(leg), Action::MoveTo { outer_rad, inner_rad })
    }

    fn turn(&mut self, input: &Input, leg: u16) -> Action {
        if self.is_overdue(input) {
            self.give_up(input, Some(AbortReason::TurnTimeout))
        } else if input.arrived {
            self.enter(input, State::Settle(leg), Action::Continue)
        } else {
            Action::Continue
        }
    }

    fn settle(&mut self, input: &Input, leg: u16) -> Action {
        if self.elapsed_us(input) < SETTLE_US {
            return Action::Continue;
        }
        if leg > 0 {
            return self.enter(input, State::Dwell(leg), Action::Continue);
        }
        self.measuring_since_us = input.now_us;
        self.enter(input, State::Dwell(leg), Action::Measure)
    }

    /// Whether the stop has lasted as long as planned.
    pub fn is_dwell_over(&self, now_us: u64) -> bool {
        matches!(self.state, State::Dwell(_)) && now_us.saturating_sub(self.since_us) >= self.dwell_us
    }

    fn dwell(&mut self, input: &Input, leg: u16) -> Action {
        if !self.is_dwell_over(input.now_us) {
            Action::Continue
        } else if input.disturbed && self.repeats_left > 0 {
            self.repeats_left -= 1;
            self.enter(input, State::Dwell(leg), Action::RepeatStop)
        } else if (self.elapsed_us(input) as f64) < self.dwell_us as f64 * input.extension
            && !self.is_late(input.now_us)
        {
            Action::Continue
        } else if self.pace.early_finish && leg + 1 < self.legs() {
            self.enter(input, State::Weigh(leg), Action::Weigh)
        } else {
            self.next_leg(input, leg)
        }
    }

    fn next_leg(&mut self, input: &Input, leg: u16) -> Action {
        if leg + 1 < self.legs() && !self.is_late(input.now_us) {
            self.turn_to(input, leg + 1)
        } else {
            self.cut_after = (leg + 1 < self.legs()).then_some(leg);
            self.enter(input, State::Compute, Action::Solve)
        }
    }

    /// The leg after which the run was cut because its longest permitted time was over.
    pub fn cut_after(&self) -> Option<u16> {
        self.cut_after
    }

    /// Whether the longest permitted time of the run is over.
    fn is_late(&self, now_us: u64) -> bool {
        let measured_us = now_us.saturating_sub(self.measuring_since_us);
        self.pace.longest_s.is_some_and(|longest_s| measured_us as f64 >= longest_s * 1e6)
    }

    /// A leg of the run. Leg 0 is the start at (0, 0).
    fn leg(&self, leg: u16) -> Leg {
        let start = Leg { outer_rad: 0.0, inner_rad: 0.0, stop_s: self.scheme.first_stop_s };
        usize::from(leg).checked_sub(1).and_then(|index| self.scheme.leg(index)).unwrap_or(start)
    }

    /// Whether the move under way has exceeded its nominal duration by [`TURN_TIMEOUT_US`].
    fn is_overdue(&self, input: &Input) -> bool {
        self.elapsed_us(input) > input.move_us + TURN_TIMEOUT_US
    }
}

impl Ending {
    /// The ending of a run that was given up for this reason.
    fn after(reason: AbortReason) -> Self {
        match reason {
            AbortReason::NotMarked | AbortReason::Stopped => Self::Hold,
            reason if reason.allows_parking() => Self::Park,
            _ => Self::Release,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gimbal::{BridgeFault, EncoderFault, Fault, FaultKind};
    use crate::run::policy::Cause;
    use std::vec::Vec;

    /// Steps at 200 Hz for an hour. `input` makes the input from time and state. Returns the states entered and the
    /// actions.
    fn run(sequencer: &mut Sequencer, mut input: impl FnMut(u64, State) -> Input) -> Vec<(State, Action)> {
        let mut trace: Vec<(State, Action)> = Vec::new();
        for step in 0..720_000_u64 {
            let command = sequencer.step(&input(step * 5000, sequencer.state()));
            if trace.last().is_none_or(|last| last.0 != sequencer.state()) || command != Action::Continue {
                trace.push((sequencer.state(), command));
            }
        }
        trace
    }

    const PARK: Action = Action::MoveTo { outer_rad: 0.0, inner_rad: 0.0 };
    const FOLLOWING: AbortReason = gimbal(FaultKind::Following { error_rad: 0.02 });

    const fn gimbal(kind: FaultKind) -> AbortReason {
        AbortReason::Gimbal(Fault { axis: 1, angle_rad: 0.5, kind })
    }

    fn cooperative(now_us: u64, state: State) -> Input {
        Input {
            now_us,
            decision: Some(Decision::Calibrate(Cause::NothingStored)),
            start: false,
            still: true,
            arrived: true,
            at_rest: true,
            move_us: 5_500_000,
            disturbed: false,
            extension: 1.0,
            enough: None,
            abort: None,
            solved: state == State::Compute,
            accepted: (state == State::Verdict).then_some(true),
            saved: state == State::Store,
        }
    }

    #[test]
    fn a_good_run_visits_every_leg_and_ends_correcting() {
        let scheme = Scheme::bai(10.0, 2);
        let mut sequencer = Sequencer::new(scheme, Pace::default());
        let trace = run(&mut sequencer, cooperative);
        let dwells = trace.iter().filter(|(state, _)| matches!(state, State::Dwell(_))).count();
        assert_eq!(dwells, 37);
        let moves = trace.iter().filter(|(_, command)| matches!(command, Action::MoveTo { .. })).count();
        assert_eq!(moves, 38, "36 moves, the way to the start, and the way back");
        let end = [
            (State::Compute, Action::Solve),
            (State::Verdict, Action::Judge),
            (State::Store, Action::Save),
            (State::Stopping, Action::Correct),
            (State::Parking, PARK),
            (State::Correcting, Action::Hold),
        ];
        assert_eq!(trace[trace.len() - 6..], end);
    }

    #[test]
    fn a_decision_leads_to_its_state() {
        let decisions = [
            (Decision::UseStored(Cause::WithinLimits), Action::Correct, State::Correcting),
            (Decision::StandBy(Cause::Policy), Action::Hold, State::StandBy),
            (Decision::Calibrate(Cause::Policy), Action::Begin, State::AwaitStill),
        ];
        for (decision, command, state) in decisions {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            assert_eq!(sequencer.step(&Input::default()), Action::Decide);
            let input = Input { decision: Some(decision), ..Input::default() };
            assert_eq!((sequencer.step(&input), sequencer.state()), (command, state));
        }
    }

    #[test]
    fn a_run_may_be_started_where_none_is_under_way() {
        let cases = [
            (State::Correcting, cooperative as fn(u64, State) -> Input),
            (State::StandBy, |now_us, state| Input {
                decision: Some(Decision::StandBy(Cause::Policy)),
                ..cooperative(now_us, state)
            }),
            (State::Parked, |now_us, state| Input { accepted: Some(false), ..cooperative(now_us, state) }),
            (State::Stranded, |now_us, state| Input {
                accepted: Some(false),
                arrived: state != State::Parking,
                ..cooperative(now_us, state)
            }),
        ];
        for (state, input) in cases {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            run(&mut sequencer, input);
            assert_eq!(sequencer.state(), state);
            let now_us = 4_000_000_000;
            let started = sequencer.step(&Input { start: true, ..cooperative(now_us, state) });
            assert_eq!((started, sequencer.state()), (Action::Begin, State::AwaitStill));
            assert_eq!(
                sequencer.step(&cooperative(now_us, State::AwaitStill)),
                Action::Continue,
                "stillness counts anew"
            );
        }
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let eager = run(&mut sequencer, |now_us, state| Input {
            start: state != State::Correcting,
            ..cooperative(now_us, state)
        });
        assert_eq!(eager.iter().filter(|(_, command)| *command == Action::Begin).count(), 1);
    }

    #[test]
    fn a_rejected_run_is_parked_and_nothing_is_saved() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let reject = |now_us, state| Input { accepted: Some(false), saved: false, ..cooperative(now_us, state) };
        let trace = run(&mut sequencer, reject);
        assert_eq!(sequencer.state(), State::Parked);
        assert!(trace.iter().any(|(_, command)| *command == Action::GiveUp(None)));
        assert!(!trace.iter().any(|(_, command)| matches!(command, Action::Save | Action::Correct)));
    }

    /// The states in which a run can be aborted.
    const ABORTABLE: [State; 10] = [
        State::PowerUp,
        State::AwaitStill,
        State::Turn(0),
        State::Turn(18),
        State::Settle(7),
        State::Dwell(0),
        State::Dwell(18),
        State::Weigh(3),
        State::Compute,
        State::Verdict,
    ];
    const LATE: [State; 8] = [
        State::Stopped,
        State::Store,
        State::Correcting,
        State::StandBy,
        State::Stopping,
        State::Parking,
        State::Parked,
        State::Stranded,
    ];

    /// Aborts whenever the sequencer is in the state `aborted`.
    fn aborted_in(aborted: State, reason: AbortReason) -> (Sequencer, Vec<(State, Action)>) {
        let pace = Pace { early_finish: true, ..Pace::default() };
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), pace);
        let trace = run(&mut sequencer, |now_us, state| Input {
            enough: Some(false),
            abort: (state == aborted).then_some(reason),
            ..cooperative(now_us, state)
        });
        (sequencer, trace)
    }

    #[test]
    fn abort_from_every_state_before_storing_parks_what_this_run_has_moved() {
        for state in ABORTABLE {
            for reason in [AbortReason::Commanded, FOLLOWING] {
                let (_, trace) = aborted_in(state, reason);
                let given_up = (State::Stopping, Action::GiveUp(Some(reason)));
                let moved = [given_up, (State::Parking, PARK), (State::Parked, Action::Hold)];
                let unmoved = [given_up, (State::Stopped, Action::Continue)];
                let end: &[_] = if matches!(state, State::PowerUp | State::AwaitStill) { &unmoved } else { &moved };
                assert!(trace.ends_with(end), "from {state:?}: {:?}", &trace[trace.len() - 3..]);
            }
        }
    }

    #[test]
    fn stop_brings_the_axes_to_rest_from_every_state_and_no_move_follows() {
        for state in ABORTABLE.into_iter().chain(LATE) {
            let pace = Pace { early_finish: true, ..Pace::default() };
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), pace);
            (sequencer.state, sequencer.moved) = (state, true);
            let action = sequencer.stop(0);
            let expected = match state {
                // The axes are released because of a fault.
                State::Stranded => Action::Continue,
                _ if ABORTABLE.contains(&state) => Action::GiveUp(Some(AbortReason::Stopped)),
                _ => Action::Hold,
            };
            assert_eq!(action, expected, "{state:?}");
            let trace = run(&mut sequencer, |now_us, state| Input { decision: None, ..cooperative(now_us, state) });
            assert!(!trace.iter().any(|(_, action)| matches!(action, Action::MoveTo { .. })), "{state:?}: {trace:?}");
            let end = match state {
                State::Correcting | State::StandBy | State::Parked | State::Stranded => state,
                // The result is stored and in use.
                State::Store => State::Correcting,
                _ => State::Stopped,
            };
            assert_eq!(sequencer.state(), end);
        }
    }

    #[test]
    fn an_axis_that_cannot_be_trusted_is_released_after_a_stop_too() {
        let stall = gimbal(FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: 0.3 });
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        (sequencer.state, sequencer.moved) = (State::Turn(3), true);
        let _ = sequencer.abort(0, stall);
        let _ = sequencer.stop(1000);
        assert_eq!(run(&mut sequencer, cooperative).last(), Some(&(State::Stranded, Action::Release)));
    }

    #[test]
    fn nothing_turns_on_a_moving_base() {
        let begins_to_move = |from_us: u64| {
            move |now_us, state| Input {
                still: now_us < from_us,
                abort: (state == State::Dwell(3)).then_some(AbortReason::Commanded),
                ..cooperative(now_us, state)
            }
        };
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let trace = run(&mut sequencer, begins_to_move(0));
        assert!(!trace.iter().any(|(_, action)| matches!(action, Action::MoveTo { .. })), "{trace:?}");
        assert_eq!(sequencer.state(), State::Stopped);
        // The base begins to move after the first move. The axes stay where they are when the run is aborted.
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let trace = run(&mut sequencer, begins_to_move(2_000_000));
        assert!(!trace.iter().any(|(state, _)| *state == State::Parking), "{trace:?}");
        assert_eq!(sequencer.state(), State::Stopped);
    }

    #[test]
    fn an_accepted_run_ends_in_correction_wherever_the_axes_stay() {
        type Change = fn(State) -> Input;
        let cases: [(Change, Action); 3] = [
            (
                |state| Input { abort: (state == State::Parking).then_some(FOLLOWING), ..Input::default() },
                Action::Release,
            ),
            (|state| Input { arrived: state != State::Parking, ..Input::default() }, Action::Release),
            (|state| Input { still: state != State::Stopping, ..Input::default() }, Action::Continue),
        ];
        for (change, last) in cases {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            let trace = run(&mut sequencer, |now_us, state| {
                let Input { abort, arrived, still, .. } = change(state);
                let usual = cooperative(now_us, state);
                match state {
                    State::Parking => Input { abort, arrived, ..usual },
                    State::Stopping => Input { still: still || last != Action::Continue, ..usual },
                    _ => usual,
                }
            });
            assert_eq!(trace.last(), Some(&(State::Correcting, last)));
        }
    }

    #[test]
    fn an_abort_from_storing_on_leaves_the_state_as_it_is() {
        for state in LATE.into_iter().filter(|state| *state != State::Parking) {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            sequencer.state = state;
            for reason in [AbortReason::Commanded, AbortReason::SampleLoss, AbortReason::TurnTimeout] {
                assert_eq!((sequencer.abort(0, reason), sequencer.state()), (Action::Continue, state));
            }
            // Axes at rest that do not follow are released.
            let following = sequencer.abort(0, FOLLOWING);
            let expected = if state == State::Stopping { Action::Continue } else { Action::Release };
            assert_eq!((following, sequencer.state()), (expected, state));
        }
    }

    #[test]
    fn parking_begins_when_the_axes_are_at_rest() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        (sequencer.state, sequencer.moved) = (State::Stopping, true);
        let after = |now_us, at_rest| Input { at_rest, ..cooperative(now_us, State::Stopping) };
        assert_eq!(sequencer.step(&after(0, false)), Action::Continue);
        assert_eq!(sequencer.step(&after(STILL_US, false)), Action::Continue);
        assert_eq!(sequencer.step(&after(STOP_US - 1, true)), Action::Continue);
        assert_eq!(sequencer.step(&after(STOP_US, true)), PARK);
    }

    #[test]
    fn axes_that_cannot_be_trusted_are_not_parked() {
        let kinds = [
            FaultKind::Encoder(EncoderFault::Crc),
            FaultKind::Bridge(BridgeFault::Overcurrent),
            FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: 0.3 },
            FaultKind::Runaway { rate_rad_s: 1.0, wanted_rad_s: 0.3 },
        ];
        for kind in kinds {
            let (sequencer, trace) = aborted_in(State::Turn(3), gimbal(kind));
            assert_eq!(sequencer.state(), State::Stranded);
            let end = [(State::Stopping, Action::GiveUp(Some(gimbal(kind)))), (State::Stranded, Action::Release)];
            assert_eq!(trace[trace.len() - 2..], end);
            // The same holds if the fault is found while the axes are being stopped for another reason.
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            let trace = run(&mut sequencer, |now_us, state| Input {
                abort: match state {
                    State::Turn(3) => Some(AbortReason::Commanded),
                    State::Stopping => Some(gimbal(kind)),
                    _ => None,
                },
                ..cooperative(now_us, state)
            });
            assert_eq!(trace.last(), Some(&(State::Stranded, Action::Release)));
        }
    }

    #[test]
    fn a_slow_start_of_the_imu_causes_no_action() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        assert_eq!(sequencer.abort(2_000_000, AbortReason::SampleLoss), Action::Continue);
        assert_eq!(sequencer.state(), State::PowerUp);
    }

    #[test]
    fn a_run_ends_early_only_if_early_finish_is_on() {
        for (early_finish, dwells) in [(true, 6), (false, 19)] {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace { early_finish, ..Pace::default() });
            let mut looks = 0;
            let trace = run(&mut sequencer, |now_us, state| {
                looks += u32::from(matches!(state, State::Weigh(_)));
                // The answer is ready at every third call.
                let enough = looks.is_multiple_of(3).then_some(state == State::Weigh(5));
                Input { enough, ..cooperative(now_us, state) }
            });
            assert_eq!(trace.iter().filter(|(state, _)| matches!(state, State::Dwell(_))).count(), dwells);
            assert_eq!(sequencer.state(), State::Correcting);
        }
    }

    #[test]
    fn a_stop_lasts_longer_where_there_is_noise_and_time() {
        let dwell_us = |extension, longest_s| {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace { longest_s, ..Pace::default() });
            let mut dwells_us = 0;
            run(&mut sequencer, |now_us, state| {
                dwells_us += if matches!(state, State::Dwell(_)) { 5000 } else { 0 };
                Input { extension, ..cooperative(now_us, state) }
            });
            dwells_us
        };
        assert_eq!(dwell_us(1.0, None), 19 * 10_000_000);
        assert_eq!(dwell_us(1.5, None), 19 * 15_000_000);
        // The time limit cuts the third stop, but not below the scheme's duration.
        assert_eq!(dwell_us(1.5, Some(33.0)) / 1_000_000, 15 + 15 + 10);
    }

    #[test]
    fn gimbals_that_cannot_be_parked_stay_where_they_came_to_rest() {
        let rejected = |now_us, state| Input { accepted: Some(false), ..cooperative(now_us, state) };
        let faulty = |now_us, state: State| Input {
            abort: (state == State::Parking).then_some(FOLLOWING),
            ..rejected(now_us, state)
        };
        let slow = |now_us, state: State| Input { arrived: state != State::Parking, ..rejected(now_us, state) };
        let asked = |now_us, state: State| Input {
            abort: (state == State::Parking).then_some(AbortReason::Commanded),
            ..rejected(now_us, state)
        };
        let sequencer = || Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let end = |trace: Vec<(State, Action)>| trace.last().copied();
        assert_eq!(end(run(&mut sequencer(), faulty)), Some((State::Stranded, Action::Release)));
        assert_eq!(end(run(&mut sequencer(), slow)), Some((State::Stranded, Action::Release)));
        assert_eq!(end(run(&mut sequencer(), asked)), Some((State::Parked, Action::Hold)));
    }

    #[test]
    fn a_clock_that_goes_back_does_not_delay_the_run() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let jump_us = 100_000_000;
        let trace = run(&mut sequencer, |now_us, state| {
            let now_us = if now_us < jump_us { now_us } else { now_us - jump_us };
            Input { abort: (now_us == 0).then_some(AbortReason::SampleLoss), ..cooperative(now_us, state) }
        });
        assert_eq!(trace.last(), Some(&(State::Parked, Action::Hold)));
    }

    #[test]
    fn computing_goes_on_until_it_is_done_and_can_be_aborted() {
        for abort_at in [None, Some(7)] {
            let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
            let mut computing = 0;
            let trace = run(&mut sequencer, |now_us, state| {
                computing += u32::from(state == State::Compute);
                let abort = (Some(computing) == abort_at).then_some(AbortReason::Commanded);
                Input { abort, solved: computing >= 10, ..cooperative(now_us, state) }
            });
            let solved = trace.iter().filter(|(_, command)| *command == Action::Solve).count();
            assert_eq!(solved, if abort_at.is_some() { 7 } else { 10 }, "one on entering, one while it is not done");
            let end = if abort_at.is_some() { State::Parked } else { State::Correcting };
            assert_eq!(sequencer.state(), end);
        }
    }

    #[test]
    fn a_disturbed_stop_is_repeated_up_to_the_limit() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let disturbed = |now_us, state| Input { disturbed: state == State::Dwell(5), ..cooperative(now_us, state) };
        let trace = run(&mut sequencer, disturbed);
        assert_eq!(trace.iter().filter(|(_, command)| *command == Action::RepeatStop).count(), 3);
        assert_eq!(sequencer.state(), State::Correcting);
    }

    #[test]
    fn a_base_in_motion_and_a_stuck_axis_end_the_run() {
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let trace = run(&mut sequencer, |now_us, state| Input { still: false, ..cooperative(now_us, state) });
        assert!(trace.iter().any(|(_, command)| *command == Action::GiveUp(Some(AbortReason::NotStill))));
        let mut sequencer = Sequencer::new(Scheme::bai(10.0, 1), Pace::default());
        let stuck = |now_us, state| Input { arrived: state != State::Turn(3), ..cooperative(now_us, state) };
        let trace = run(&mut sequencer, stuck);
        assert!(trace.iter().any(|(_, command)| *command == Action::GiveUp(Some(AbortReason::TurnTimeout))));
        assert_eq!(sequencer.state(), State::Parked);
    }
}
