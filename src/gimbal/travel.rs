//! The travel of an axis, and the turn on which the axis stands.
//!
//! An encoder gives the angle within one turn. An axis with slip rings has no ends, so that is enough. An axis with
//! cables or end stops has a limited travel, counted over whole turns, and a move in the wrong direction winds up its
//! cables. So such an axis does not move before its turn is known:
//!
//! | travel | the turn is known |
//! |---|---|
//! | continuous | at once: every turn is as good as any other |
//! | limited, [`TurnSource::Unique`] | when the encoder is read: one turn of the angle is within the travel |
//! | limited, [`TurnSource::Stored`] or [`TurnSource::Confirm`] | when [`Turn::locate`] is told where the axis stands |
//!
//! The turn is never guessed. An axis whose turn is unknown, or that stands outside of its travel, can be held but not
//! moved.
//!
//! The turn becomes unknown again if the encoder is lost for so long that the axis may have turned by half a turn
//! meanwhile. Only the reading tells the turn then, so an axis with a unique travel is found again by itself.

use crate::base::angle::{rad_to_ticks, ticks_to_rad};
use crate::base::units::{ARCSEC, DEG};
use crate::gimbal::fault::AXIS_NAMES;
use core::fmt;
use core::ops::RangeInclusive;
use serde::{Deserialize, Serialize};

/// Distance that every target keeps from the ends of a limited travel, rad. Overshoot and braking have room in it.
pub const TRAVEL_MARGIN_RAD: f64 = DEG;
/// Tolerance for comparing angles with the travel, rad. It covers rounding only.
pub const ROUNDING_RAD: f64 = 1e-9;
/// Farthest target of a continuous axis, rad: 10 000 turns.
const FARTHEST_RAD: f64 = 10_000.0 * 360.0 * DEG;

/// Travel of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Travel {
    /// The axis turns without end: it has slip rings, and nothing winds up.
    #[default]
    Continuous,
    /// The axis has cables or end stops.
    Limited {
        /// Lowest angle that the axis can reach, counted over whole turns, rad.
        lowest_rad: f64,
        /// Highest angle that the axis can reach, counted over whole turns, rad.
        highest_rad: f64,
        /// How the turn is known on which the axis stands after power-up.
        turn: TurnSource,
    },
}

/// How the turn is known on which an axis of limited travel stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TurnSource {
    /// By the reading of the encoder: the travel is at most 358 deg, so one turn at most is within it.
    Unique,
    /// By an angle that was stored when the axis was at rest before power-off.
    Stored,
    /// By the operator, after every power-up.
    Confirm,
}

impl Travel {
    /// The limited travel whose usable range is from `lowest_rad` to `highest_rad`.
    pub fn around(lowest_rad: f64, highest_rad: f64, turn: TurnSource) -> Self {
        Self::Limited { lowest_rad: lowest_rad - TRAVEL_MARGIN_RAD, highest_rad: highest_rad + TRAVEL_MARGIN_RAD, turn }
    }

    /// The angles that the axis can reach, rad. Infinite for a continuous travel.
    pub fn physical_rad(&self) -> RangeInclusive<f64> {
        match *self {
            Self::Continuous => f64::NEG_INFINITY..=f64::INFINITY,
            Self::Limited { lowest_rad, highest_rad, .. } => lowest_rad..=highest_rad,
        }
    }

    /// The permitted angles of targets, rad: [`TRAVEL_MARGIN_RAD`] inside of the physical travel. Schemes, parking and
    /// every other target stay within this range. Infinite for a continuous travel.
    pub fn usable_rad(&self) -> RangeInclusive<f64> {
        let (lowest_rad, highest_rad) = self.physical_rad().into_inner();
        lowest_rad + TRAVEL_MARGIN_RAD..=highest_rad - TRAVEL_MARGIN_RAD
    }

    /// Whether `angle_rad` is a permitted target. The tolerance covers rounding.
    pub fn permits(&self, angle_rad: f64) -> bool {
        let (lowest_rad, highest_rad) = self.targets_rad();
        (lowest_rad - ROUNDING_RAD..=highest_rad + ROUNDING_RAD).contains(&angle_rad)
    }

    /// The permitted target that is nearest to `angle_rad`, rad.
    pub fn nearest_rad(&self, angle_rad: f64) -> f64 {
        let (lowest_rad, highest_rad) = self.targets_rad();
        angle_rad.max(lowest_rad).min(highest_rad)
    }

    /// The lowest and the highest target, rad. Both are finite.
    fn targets_rad(&self) -> (f64, f64) {
        let (lowest_rad, highest_rad) = self.usable_rad().into_inner();
        (lowest_rad.max(-FARTHEST_RAD), highest_rad.min(FARTHEST_RAD))
    }

    /// Whether the axis can stand at `angle_rad`. The tolerance covers rounding.
    fn reaches(&self, angle_rad: f64) -> bool {
        let (lowest_rad, highest_rad) = self.physical_rad().into_inner();
        (lowest_rad - ROUNDING_RAD..=highest_rad + ROUNDING_RAD).contains(&angle_rad)
    }

    /// The ends of a limited travel, rad; zero for a continuous travel.
    pub(super) fn ends_rad(&self) -> [f64; 2] {
        match *self {
            Self::Continuous => [0.0; 2],
            Self::Limited { lowest_rad, highest_rad, .. } => [lowest_rad, highest_rad],
        }
    }

    /// Width of a limited travel, rad; `None` for a continuous travel.
    pub(super) fn width_rad(&self) -> Option<f64> {
        match *self {
            Self::Continuous => None,
            Self::Limited { lowest_rad, highest_rad, .. } => Some(highest_rad - lowest_rad),
        }
    }

    /// Whether one turn at most of each angle is within the travel.
    pub(super) fn is_unique(&self) -> bool {
        matches!(self, Self::Limited { turn: TurnSource::Unique, .. })
    }

    fn is_limited(&self) -> bool {
        matches!(self, Self::Limited { .. })
    }
}

/// What is known of the turn on which an axis stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TurnState {
    /// The encoder has not given three consistent readings yet.
    #[default]
    Searching,
    /// The turn is not known. The axis does not move before it has been located.
    Unknown,
    /// The axis stands outside of its physical travel and does not move.
    Outside,
    /// The angle counted over whole turns is known.
    Known,
}

/// Why an axis was not located.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LocateRefusal {
    /// The encoder has not given three consistent readings yet.
    Searching,
    /// The axis is moving under control.
    Moving,
    /// The encoder reading differs from the given angle by more than the tolerance; the difference within a turn, rad.
    Disagrees(f32),
    /// The axis would stand outside of its travel.
    Outside,
}

/// An axis that was not located, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LocateError {
    /// Axis: 0 is the outer axis, 1 the inner axis.
    pub axis: u8,
    /// The reason.
    pub refusal: LocateRefusal,
}

impl LocateError {
    /// Short name of the reason. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self.refusal {
            LocateRefusal::Searching => "locate-searching",
            LocateRefusal::Moving => "locate-moving",
            LocateRefusal::Disagrees(_) => "locate-disagrees",
            LocateRefusal::Outside => "locate-outside",
        }
    }
}

/// The [code](LocateError::code) in brackets, then the text in one line.
impl fmt::Display for LocateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = AXIS_NAMES.get(usize::from(self.axis)).copied().unwrap_or("?");
        write!(f, "[{}] ", self.code())?;
        match self.refusal {
            LocateRefusal::Searching => write!(f, "the encoder of the {name} axis gives no reliable angle yet"),
            LocateRefusal::Moving => write!(f, "the {name} axis is moving"),
            LocateRefusal::Disagrees(off_rad) => {
                let off_arcsec = f64::from(off_rad) / ARCSEC;
                write!(f, "the encoder of the {name} axis differs from the given angle by {off_arcsec:.1} arcsec")
            }
            LocateRefusal::Outside => write!(f, "the given angle is outside the travel of the {name} axis"),
        }
    }
}

/// The turn on which an axis stands, beside the count of its encoder.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Turn {
    travel: Travel,
    /// The angle counted over whole turns, less the count of the encoder, ticks: a number of whole turns. `None` while
    /// the turn is not known.
    offset_ticks: Option<i64>,
}

impl Turn {
    /// The turn of an axis whose encoder has not been read yet.
    pub fn new(travel: Travel) -> Self {
        Self { travel, offset_ticks: (!travel.is_limited()).then_some(0) }
    }

    /// The turn under another travel, at the encoder count `ticks`. A turn that was known under a limited travel is kept
    /// if the axis then stands within the new limited travel. A turn under a continuous travel says nothing about
    /// cables, so it is forgotten. `None` is an encoder that has not been found, and everything is forgotten.
    pub fn with_travel(&self, travel: Travel, ticks: Option<i64>) -> Self {
        let mut turn = Self::new(travel);
        let Some(ticks) = ticks else { return turn };
        let stays = |offset: &i64| travel.reaches(ticks_to_rad(ticks + offset));
        if travel.is_limited() && self.travel.is_limited() {
            turn.offset_ticks = self.offset_ticks.filter(stays);
        }
        turn.search(ticks);
        turn
    }

    /// Forgets the turn of a limited travel.
    pub fn forget(&mut self) {
        *self = Self::new(self.travel);
    }

    /// Takes the only turn of the encoder count `ticks` within a unique travel, if the turn is not known yet.
    pub fn search(&mut self, ticks: i64) {
        if self.offset_ticks.is_none() && self.travel.is_unique() {
            let [lowest_rad, highest_rad] = self.travel.ends_rad();
            let (offset_ticks, _) = nearest_turn(ticks, 0.5 * (lowest_rad + highest_rad));
            self.offset_ticks = self.travel.reaches(ticks_to_rad(ticks + offset_ticks)).then_some(offset_ticks);
        }
    }

    /// Takes the turn of the encoder count `ticks` that is nearest to `angle_rad`, at which somebody says that the axis
    /// stands. A continuous axis ignores this. A turn that was known is replaced.
    ///
    /// # Errors
    /// The reading differs from the angle by more than the tolerance, or the axis would stand outside of its travel.
    /// The turn is then as before.
    pub fn locate(&mut self, ticks: i64, angle_rad: f64, tolerance_rad: f64) -> Result<(), LocateRefusal> {
        if !self.travel.is_limited() {
            return Ok(());
        }
        let (offset_ticks, off_rad) = nearest_turn(ticks, angle_rad);
        if !angle_rad.is_finite() || !self.travel.reaches(ticks_to_rad(ticks.saturating_add(offset_ticks))) {
            return Err(LocateRefusal::Outside);
        }
        if !(-tolerance_rad..=tolerance_rad).contains(&off_rad) {
            return Err(LocateRefusal::Disagrees(off_rad as f32));
        }
        self.offset_ticks = Some(offset_ticks);
        Ok(())
    }

    /// What is known of the turn at the encoder count `ticks`; `None` is an encoder that has not been found.
    pub fn state(&self, ticks: Option<i64>) -> TurnState {
        match (ticks, self.offset_ticks) {
            (None, _) => TurnState::Searching,
            (Some(_), None) if self.travel.is_unique() => TurnState::Outside,
            (Some(_), None) => TurnState::Unknown,
            (Some(ticks), Some(offset)) if self.travel.reaches(ticks_to_rad(ticks + offset)) => TurnState::Known,
            (Some(_), Some(_)) => TurnState::Outside,
        }
    }

    /// The angle counted over whole turns, less the count of the encoder, ticks; zero while the turn is not known.
    pub fn offset_ticks(&self) -> i64 {
        self.offset_ticks.unwrap_or(0)
    }

    /// The travel.
    pub fn travel(&self) -> &Travel {
        &self.travel
    }

    /// The usable range, rad. Infinite while the turn is not known.
    pub fn known_usable_rad(&self) -> RangeInclusive<f64> {
        if self.offset_ticks.is_some() { self.travel.usable_rad() } else { Travel::Continuous.usable_rad() }
    }
}

/// The whole turns, in ticks, that bring the encoder count `ticks` nearest to `angle_rad`, and by how much the count is
/// then beyond that angle, rad.
fn nearest_turn(ticks: i64, angle_rad: f64) -> (i64, f64) {
    let away = rad_to_ticks(angle_rad).saturating_sub(ticks);
    let within_turn = i64::from(away as i32);
    (away.saturating_sub(within_turn), -ticks_to_rad::<f64>(within_turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usable_range_is_a_margin_inside_of_the_travel() {
        let travel = Travel::around(-1.0, 0.5, TurnSource::Stored);
        let (lowest_rad, highest_rad) = travel.usable_rad().into_inner();
        assert!((lowest_rad + 1.0).abs() < 1e-15 && (highest_rad - 0.5).abs() < 1e-15);
        assert!(travel.permits(-1.0) && travel.permits(0.5) && !travel.permits(0.500_001) && !travel.permits(f64::NAN));
        assert!(travel.reaches(0.5 + TRAVEL_MARGIN_RAD) && !travel.reaches(0.5 + 1.001 * TRAVEL_MARGIN_RAD));
        assert!((travel.nearest_rad(7.0) - 0.5).abs() < 1e-15);
        let continuous = Travel::Continuous;
        assert_eq!(continuous.usable_rad(), f64::NEG_INFINITY..=f64::INFINITY);
        assert!(continuous.permits(1e4) && !continuous.permits(1e300) && !continuous.permits(f64::INFINITY));
    }

    #[test]
    fn the_nearest_turn_is_found_across_many_turns() {
        for (reading_deg, said_deg, counted_deg) in
            [(170.0, -188.0, -190.0), (-10.0, 349.0, 350.0), (0.5, 7199.0, 7200.5)]
        {
            let ticks = rad_to_ticks(reading_deg * DEG);
            let (offset, off_rad) = nearest_turn(ticks, said_deg * DEG);
            assert_eq!(offset % (1 << 32), 0);
            assert!((ticks_to_rad::<f64>(ticks + offset) / DEG - counted_deg).abs() < 1e-6, "{reading_deg}");
            assert!((off_rad / DEG - (counted_deg - said_deg)).abs() < 1e-6, "{reading_deg}");
        }
    }
}
