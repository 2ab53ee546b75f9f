//! A rotation scheme as data: target angles, rates and stop times.

use super::limits::{MAX_LEGS, MAX_NAME_BYTES};
use crate::base::profile::Profile;
use core::fmt;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Time from the arrival of the axes until the duration of a stop begins to count, s.
pub const SETTLING_S: f64 = 0.3;

/// Longest nominal duration, s: one week. A longer scheme is a mistake, and after some years the time stamps would
/// overflow.
const LONGEST_S: f64 = 7.0 * 86_400.0;

/// One move and the stop after it. The first stop of a scheme is a leg to (0, 0) without a move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Leg {
    /// Target of the outer axis, counted over whole turns, rad.
    pub outer_rad: f64,
    /// Target of the inner axis, counted over whole turns, rad.
    pub inner_rad: f64,
    /// Duration of the stop after the move, s.
    pub stop_s: f64,
}

impl Leg {
    /// Angles by which the outer and the inner axis turn from the stop of another leg, rad.
    pub fn ways_from(&self, from: &Self) -> [f64; 2] {
        [self.outer_rad - from.outer_rad, self.inner_rad - from.inner_rad]
    }
}

/// Rate and acceleration of a turning axis.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Turning {
    /// Highest rate, rad/s.
    pub rate_rad_s: f64,
    /// Acceleration, rad/s^2.
    pub acceleration_rad_s2: f64,
}

impl Turning {
    /// Motion of one axis that turns by the angle `way_rad`, rad.
    pub fn profile(&self, way_rad: f64) -> Profile<f64> {
        Profile::trapezoid(way_rad, self.rate_rad_s, self.acceleration_rad_s2)
    }

    /// Nominal duration of a move from the stop of one leg to that of another leg, s. The axis that takes longer
    /// counts.
    pub fn move_s(&self, from: &Leg, to: &Leg) -> f64 {
        let [outer_s, inner_s] = to.ways_from(from).map(|way_rad| self.profile(way_rad).duration_s());
        outer_s.max(inner_s)
    }
}

/// A rotation scheme. It starts with a stop at (0, 0); each leg is a move followed by a stop.
///
/// ```
/// use rins_selfcal::scheme::{Leg, Scheme};
/// use rins_selfcal::base::units::DEG;
///
/// let leg = |outer: f64, inner: f64| Leg { outer_rad: outer * DEG, inner_rad: inner * DEG, stop_s: 8.0 };
/// let scheme = Scheme {
///     name: "mine".try_into().unwrap(),
///     rate_rad_s: 20.0 * DEG,
///     acceleration_rad_s2: 20.0 * DEG,
///     first_stop_s: 10.0,
///     legs: [leg(-90.0, 0.0), leg(-90.0, -90.0), leg(0.0, 0.0)].into_iter().collect(),
///     periods: 1,
/// };
/// assert_eq!(scheme.check(), Ok(()));
/// // Three legs with a quarter turn of 5.5 s each, ramps included. In the last leg both axes turn at the same time.
/// assert!((scheme.duration_s() - (10.0 + 3.0 * (5.5 + 8.0))).abs() < 1e-9);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scheme {
    /// Name, for reports.
    pub name: String<MAX_NAME_BYTES>,
    /// Rate of a turning axis, rad/s.
    pub rate_rad_s: f64,
    /// Acceleration at the start and the end of a move, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// Duration of the first stop, at (0, 0), s.
    pub first_stop_s: f64,
    /// Legs of one period. If there are several periods, each must end at (0, 0).
    pub legs: Vec<Leg, MAX_LEGS>,
    /// Number of periods.
    pub periods: u8,
}

/// Why a scheme is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SchemeError {
    /// The rate, the acceleration or the number of periods is not positive and finite.
    Motion,
    /// The duration of this stop is not positive and finite. Stop 0 is the first stop; stop n follows leg n.
    Stop(u8),
    /// An angle of this leg is not finite, or the leg moves neither axis. Legs are counted from 1.
    Leg(u8),
    /// The scheme has no legs.
    Legs,
    /// The scheme has several periods, but one period does not end at (0, 0).
    OpenPeriod,
    /// The scheme lasts longer than one week.
    Long,
}

impl SchemeError {
    /// Short name of the error. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Motion => "scheme-motion",
            Self::Stop(_) => "scheme-stop",
            Self::Leg(_) => "scheme-leg",
            Self::Legs => "scheme-legs",
            Self::OpenPeriod => "scheme-open-period",
            Self::Long => "scheme-long",
        }
    }
}

impl fmt::Display for SchemeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}] ", self.code())?;
        match self {
            Self::Motion => f.write_str("rate, acceleration and number of periods must be finite and positive"),
            Self::Stop(0) => f.write_str("the first stop must be finite and positive"),
            Self::Stop(leg) => write!(f, "the stop of leg {leg} must be finite and positive"),
            Self::Leg(leg) => write!(f, "leg {leg} has an angle that is not finite, or moves neither axis"),
            Self::Legs => f.write_str("the scheme has no legs"),
            Self::OpenPeriod => f.write_str("a scheme of several periods must end each period at the angles (0, 0)"),
            Self::Long => f.write_str("the scheme lasts longer than one week"),
        }
    }
}

impl Scheme {
    /// Checks all numbers of the scheme.
    ///
    /// # Errors
    /// The first wrong number.
    pub fn check(&self) -> Result<(), SchemeError> {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !positive(self.rate_rad_s) || !positive(self.acceleration_rad_s2) || self.periods == 0 {
            return Err(SchemeError::Motion);
        }
        if !positive(self.first_stop_s) {
            return Err(SchemeError::Stop(0));
        }
        let mut from = (0.0, 0.0);
        for (number, leg) in (1_u8..).zip(&self.legs) {
            let to = (leg.outer_rad, leg.inner_rad);
            if !to.0.is_finite() || !to.1.is_finite() || to == from {
                return Err(SchemeError::Leg(number));
            }
            if !positive(leg.stop_s) {
                return Err(SchemeError::Stop(number));
            }
            from = to;
        }
        if self.legs.is_empty() {
            Err(SchemeError::Legs)
        } else if self.periods > 1 && from != (0.0, 0.0) {
            Err(SchemeError::OpenPeriod)
        } else if (0.0..=LONGEST_S).contains(&self.duration_s()) {
            Ok(())
        } else {
            Err(SchemeError::Long)
        }
    }

    /// Number of moves in all periods.
    pub fn moves(&self) -> usize {
        self.legs.len() * usize::from(self.periods)
    }

    /// Leg `index` of all periods, counted from 0; `None` after the last leg. Between two periods the axes stay at
    /// (0, 0), so the last stop of a period is extended by the first stop of the next period.
    pub fn leg(&self, index: usize) -> Option<Leg> {
        let position = index.checked_rem(self.legs.len())?;
        let mut leg = *self.legs.get(position)?;
        if index >= self.moves() {
            return None;
        }
        if position + 1 == self.legs.len() && index + 1 < self.moves() {
            leg.stop_s += self.first_stop_s;
        }
        Some(leg)
    }

    /// The stops of all periods; the first stop is a leg to (0, 0).
    pub fn stops(&self) -> impl Iterator<Item = Leg> {
        let first = Leg { stop_s: self.first_stop_s, ..Leg::default() };
        core::iter::once(first).chain((0..).map_while(|index| self.leg(index)))
    }

    /// Rate and acceleration of the moves.
    pub fn turning(&self) -> Turning {
        Turning { rate_rad_s: self.rate_rad_s, acceleration_rad_s2: self.acceleration_rad_s2 }
    }

    /// Nominal duration of a move from the stop of one leg to that of another leg, s.
    pub fn move_s(&self, from: &Leg, to: &Leg) -> f64 {
        self.turning().move_s(from, to)
    }

    /// Nominal duration of all stops and moves, s. The settling time [`SETTLING_S`] of each stop is not included.
    pub fn duration_s(&self) -> f64 {
        let mut from = Leg::default();
        let mut total = self.first_stop_s;
        for leg in (0..).map_while(|index| self.leg(index)) {
            total += self.move_s(&from, &leg) + leg.stop_s;
            from = leg;
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::DEG;

    #[test]
    fn bai_is_a_closed_period_of_64_7_minutes() {
        let scheme = Scheme::bai(200.0, 1);
        assert_eq!(scheme.check(), Ok(()));
        assert_eq!(scheme.legs.last().map(|leg| (leg.outer_rad, leg.inner_rad)), Some((0.0, 0.0)));
        assert!((scheme.duration_s() - (19.0 * 200.0 + 18.0 * 5.5)).abs() < 1e-9);
        assert!((Scheme::bai(200.0, 2).duration_s() - 2.0 * scheme.duration_s()).abs() < 1e-9);
        let outer = scheme.legs.iter().map(|leg| leg.outer_rad / DEG);
        assert_eq!(outer.fold((0.0, 0.0), |(low, high), x| (f64::min(low, x), f64::max(high, x))), (-360.0, 0.0));
    }

    #[test]
    fn wrong_schemes_are_refused_by_leg() {
        let mut scheme = Scheme::bai(10.0, 2);
        scheme.legs[3].stop_s = 0.0;
        assert_eq!(scheme.check(), Err(SchemeError::Stop(4)));
        let mut scheme = Scheme::bai(10.0, 2);
        scheme.legs[2].outer_rad = f64::NAN;
        assert_eq!(scheme.check(), Err(SchemeError::Leg(3)));
        let mut scheme = Scheme::bai(10.0, 2);
        scheme.legs.truncate(4);
        assert_eq!(scheme.check(), Err(SchemeError::OpenPeriod));
        scheme.legs.clear();
        assert_eq!(scheme.check(), Err(SchemeError::Legs));
        let long: [fn(&mut Scheme); 3] = [
            |scheme| scheme.legs[5].stop_s = 1e300,
            |scheme| scheme.rate_rad_s = 1e-300,
            |scheme| scheme.legs[5].outer_rad = 1e300,
        ];
        for spoil in long {
            let mut scheme = Scheme::bai(10.0, 1);
            spoil(&mut scheme);
            assert_eq!(scheme.check(), Err(SchemeError::Long));
        }
    }
}
