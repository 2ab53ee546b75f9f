//! The angle of one axis, followed from one encoder reading to the next and counted over whole turns.
//!
//! ```text
//!               three consistent readings
//!   searching -----------------------------> following
//!       ^                                        |
//!       +---- third period without a valid ------+
//!             reading: the encoder is lost
//! ```
//! Two readings are consistent if the axis can move from one to the other in the time between them. A single wrong
//! reading, also the first one, is therefore never taken for the angle of the axis.
//!
//! While the axis is followed, a reading is rejected if it is missing, or if it lies farther from the expected angle
//! than the axis can have moved. For up to two control periods the expected angle replaces a rejected reading. After
//! that the encoder is lost: the angle is frozen until the search ends, and the count then continues on the turn that is
//! nearest to the frozen angle.

use crate::base::angle::{Angle, rad_to_ticks, ticks_to_rad};
use crate::gimbal::fault::EncoderFault;
use crate::gimbal::servo::PERIOD_S;

/// Control periods without a valid reading for which the expected angle is used.
const BRIDGED_PERIODS: u32 = 2;
/// Consecutive consistent readings with which a search ends.
const CONSISTENT_READINGS: u8 = 3;
/// An axis is assumed to move between two readings at no more than this multiple of its rate limit.
const PLAUSIBLE_RATE: f64 = 2.0;
/// A movement of this many encoder steps is always possible, however low the rate limit is.
const PLAUSIBLE_STEPS: f64 = 3.0;
/// Longest time between two calls after which the axis is still followed, control periods.
const LONGEST_GAP: u32 = 1000;

/// What a control period has told of the angle.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Tracked {
    /// The axis is followed. It moved by this in a control period, ticks.
    Moved(i64),
    /// The encoder was lost in this control period.
    Lost,
    /// The encoder has not been found yet.
    Searching,
    /// The encoder was found in this control period.
    Found {
        /// Movement in a control period, ticks.
        step: f64,
        /// Time without a valid reading, s; zero at the first time.
        unseen_s: f64,
    },
}

/// Readings of a search that are consistent with each other.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Search {
    readings: u8,
    first: Angle,
    last: Angle,
    /// Control periods from the first of these readings to the last.
    periods: u32,
}

/// The angle of one axis and the search for it.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tracker {
    rate_rad_s: f64,
    least_ticks: i64,
    /// Angle counted over whole turns, ticks; `None` before the encoder was found for the first time.
    ticks: Option<i64>,
    /// Control periods since the last valid reading; since the start, if there was none.
    unseen: u32,
    /// The search under way; `None` while the axis is followed.
    search: Option<Search>,
    /// Reason of the last rejected reading.
    fault: EncoderFault,
}

impl Tracker {
    /// A tracker before the first reading, for an axis with this rate limit and an encoder with this smallest step.
    pub fn new(rate_rad_s: f64, step_rad: f64) -> Self {
        Self {
            rate_rad_s,
            least_ticks: rad_to_ticks(PLAUSIBLE_STEPS * step_rad),
            ticks: None,
            unseen: 0,
            search: Some(Search::default()),
            fault: EncoderFault::Silent,
        }
    }

    /// The same angle, for an axis with another rate limit and another encoder step.
    pub fn reconfigured(&self, rate_rad_s: f64, step_rad: f64) -> Self {
        let Self { rate_rad_s, least_ticks, .. } = Self::new(rate_rad_s, step_rad);
        Self { rate_rad_s, least_ticks, ..self.clone() }
    }

    /// Takes an encoder reading, `periods` control periods after the reading before it. `expected_step` is the movement
    /// in one control period at the present rate of the axis, ticks.
    pub fn observe(&mut self, reading: Result<Angle, EncoderFault>, periods: u64, expected_step: i64) -> Tracked {
        let periods = u32::try_from(periods).unwrap_or(u32::MAX).max(1);
        self.unseen = self.unseen.saturating_add(periods);
        match (self.search, self.ticks) {
            (None, Some(before)) => self.follow(reading, periods, before, expected_step),
            (search, _) => self.continue_search(reading, periods, search.unwrap_or_default()),
        }
    }

    fn follow(&mut self, reading: Result<Angle, EncoderFault>, periods: u32, before: i64, step: i64) -> Tracked {
        let whole = i64::from(periods.min(LONGEST_GAP));
        let expected = before + step * whole;
        let checked = if periods > LONGEST_GAP { Err(self.fault) } else { self.check(reading, expected) };
        if checked.is_err_and(|_| self.unseen > BRIDGED_PERIODS) {
            self.lose(reading, checked);
            return Tracked::Lost;
        }
        let ticks = checked.unwrap_or(expected);
        if checked.is_ok() {
            self.unseen = 0;
        }
        self.fault = checked.err().unwrap_or(self.fault);
        self.ticks = Some(ticks);
        Tracked::Moved((ticks - before).checked_div(whole).unwrap_or(0))
    }

    /// The count of a valid reading.
    fn check(&self, reading: Result<Angle, EncoderFault>, expected: i64) -> Result<i64, EncoderFault> {
        let off = reading?.since(Angle::from_ticks(expected as u32));
        if self.is_possible(off, self.unseen) { Ok(expected + i64::from(off)) } else { Err(jump(off)) }
    }

    /// Whether the axis can move by `ticks` in this many control periods.
    fn is_possible(&self, ticks: i32, periods: u32) -> bool {
        let possible = rad_to_ticks(PLAUSIBLE_RATE * self.rate_rad_s * (f64::from(periods) * PERIOD_S));
        i64::from(ticks).abs() <= possible.max(self.least_ticks)
    }

    /// Begins a search, with the rejected reading if there is one.
    fn lose(&mut self, reading: Result<Angle, EncoderFault>, checked: Result<i64, EncoderFault>) {
        self.fault = checked.err().unwrap_or(self.fault);
        self.search = Some(reading.map_or(Search::default(), Search::from));
    }

    fn continue_search(&mut self, reading: Result<Angle, EncoderFault>, periods: u32, search: Search) -> Tracked {
        let next = match reading {
            Ok(angle) => self.with_reading(search, angle, periods),
            Err(fault) => {
                self.fault = fault;
                Search::default()
            }
        };
        if next.readings < CONSISTENT_READINGS {
            self.search = Some(next);
            return Tracked::Searching;
        }
        self.found(next)
    }

    /// The search with one more reading: continued if the reading is consistent with the one before, else begun anew.
    fn with_reading(&mut self, search: Search, angle: Angle, periods: u32) -> Search {
        if search.readings == 0 {
            return Search::from(angle);
        }
        let moved = angle.since(search.last);
        if !self.is_possible(moved, periods) {
            self.fault = jump(moved);
            return Search::from(angle);
        }
        let periods = search.periods.saturating_add(periods);
        Search { readings: search.readings + 1, last: angle, periods, ..search }
    }

    fn found(&mut self, search: Search) -> Tracked {
        let frozen = self.ticks.map(|frozen| frozen + i64::from(search.last.since(Angle::from_ticks(frozen as u32))));
        let unseen_s = self.ticks.map_or(0.0, |_| f64::from(self.unseen) * PERIOD_S);
        // The first count is from minus half a turn to half a turn.
        self.ticks = frozen.or(Some(i64::from(search.last.ticks() as i32)));
        (self.search, self.unseen) = (None, 0);
        let step = f64::from(search.last.since(search.first)) / f64::from(search.periods.max(1));
        Tracked::Found { step, unseen_s }
    }

    /// The angle counted over whole turns, ticks: the last one while the encoder is lost, zero before it was found for
    /// the first time.
    pub fn last_ticks(&self) -> i64 {
        self.ticks.unwrap_or(0)
    }

    /// The angle counted over whole turns, ticks. `None` while the encoder has not been found.
    pub fn ticks(&self) -> Option<i64> {
        self.ticks.filter(|_| self.search.is_none())
    }

    /// Why the encoder is lost, or why it was not found for the first time within the periods that this takes. `None`
    /// if the encoder works or is still in time.
    pub fn fault(&self) -> Option<EncoderFault> {
        let in_time = self.ticks.is_none() && self.unseen <= BRIDGED_PERIODS + u32::from(CONSISTENT_READINGS);
        (self.search.is_some() && !in_time).then_some(self.fault)
    }
}

impl From<Angle> for Search {
    fn from(angle: Angle) -> Self {
        Self { readings: 1, first: angle, last: angle, periods: 0 }
    }
}

fn jump(off_ticks: i32) -> EncoderFault {
    EncoderFault::Jump(ticks_to_rad::<f64>(off_ticks.into()) as f32)
}
