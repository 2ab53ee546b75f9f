//! Rotation schemes as data: which way to turn, how fast, how long to stand.

use super::library::{BAI, LIBRARY, LibraryScheme, compiled_in, of_quarters};
use super::limits::{MAX_LEGS, MAX_NAME_BYTES};
use crate::base::method::Method;
use crate::base::profile::Profile;
use crate::base::units::DEG;
use core::fmt;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Standing time after arrival before a stop counts, s.
pub const SETTLING_S: f64 = 0.3;

/// Longest nominal duration, s: a week. What lasts longer is a mistake, and beyond some years times would overflow.
const LONGEST_S: f64 = 7.0 * 86_400.0;

/// One move and the stop after it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Outer angle to move to, rad, counted over whole turns.
    pub outer_rad: f64,
    /// Inner angle to move to, rad, counted over whole turns.
    pub inner_rad: f64,
    /// Time to stand there, s.
    pub stop_s: f64,
}

/// A rotation scheme: it starts with a stop at (0, 0); each leg is a move and a stop.
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
/// // Three quarter turns of 5.5 s each, their ramps included; in the last leg both axes turn at once.
/// assert!((scheme.duration_s() - (10.0 + 3.0 * (5.5 + 8.0))).abs() < 1e-9);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scheme {
    /// Name, for reports.
    pub name: String<MAX_NAME_BYTES>,
    /// Rate of a turning axis, rad/s.
    pub rate_rad_s: f64,
    /// Acceleration at the ends of a move, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// The first stop, at (0, 0), s.
    pub first_stop_s: f64,
    /// The legs of one period, which ends where it began.
    pub legs: Vec<Leg, MAX_LEGS>,
    /// How often the period is run.
    pub periods: u8,
}

/// Why a scheme is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SchemeError {
    /// Rate, acceleration or the number of periods is not positive and finite.
    Motion,
    /// A stop, counted from 0, is not positive and finite.
    Stop(u8),
    /// A leg, counted from 1, has an angle that is not finite, or moves nothing.
    Leg(u8),
    /// More legs than fit, or none.
    Legs,
    /// Several periods, and the first does not end where it began.
    OpenPeriod,
    /// All of it takes longer than a week, or forever.
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
            Self::Leg(leg) => write!(f, "leg {leg} has an angle that is not finite, or moves nothing"),
            Self::Legs => f.write_str("there are no legs"),
            Self::OpenPeriod => f.write_str("several periods, and the first does not end where it began"),
            Self::Long => f.write_str("it lasts longer than a week"),
        }
    }
}

impl Scheme {
    /// Scheme "bai": `periods` of 18 moves at 20 deg/s with 19 stops of `stop_s` each. Bai stands 200 s and runs two.
    pub fn bai(stop_s: f64, periods: u8) -> Self {
        Self {
            name: String::try_from("bai").unwrap_or_default(),
            rate_rad_s: 20.0 * DEG,
            acceleration_rad_s2: 20.0 * DEG,
            first_stop_s: stop_s,
            legs: of_quarters(&BAI, stop_s),
            periods,
        }
    }

    /// The scheme of this name: the one that was compiled in, or one of the library.
    pub fn named(name: &str) -> Option<Self> {
        let of_library = || LIBRARY.iter().find(|entry| entry.name == name).map(LibraryScheme::scheme);
        compiled_in().filter(|scheme| scheme.name == name).or_else(of_library)
    }

    /// What a method runs where no scheme is given: three minutes, or both of Bai's periods.
    pub fn default_for(method: Method) -> Self {
        match method {
            // It is in the library.
            Method::Joint => Self::named("fast-180").unwrap_or_else(|| Self::bai(10.0, 1)),
            Method::TwoStage => Self::bai(200.0, 2),
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first one that is wrong.
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

    /// Moves of all periods.
    pub fn moves(&self) -> usize {
        self.legs.len() * usize::from(self.periods)
    }

    /// Leg number `index` of all periods, from 0; `None` past the end. A period's first stop, at the origin, follows on
    /// the last stop of the period before: the axes stand there for both.
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

    /// Time of a trapezoidal (or, where it is short, triangular) move by `angle_rad`, s.
    pub fn move_s(&self, angle_rad: f64) -> f64 {
        Profile::trapezoid(angle_rad, self.rate_rad_s, self.acceleration_rad_s2).duration_s()
    }

    /// Nominal duration of all stops and moves, s, without settling beyond the stops' own time.
    pub fn duration_s(&self) -> f64 {
        let mut from = (0.0, 0.0);
        let mut total = self.first_stop_s;
        for leg in (0..).map_while(|index| self.leg(index)) {
            let longest = f64::max(self.move_s(leg.outer_rad - from.0), self.move_s(leg.inner_rad - from.1));
            total += longest + leg.stop_s;
            from = (leg.outer_rad, leg.inner_rad);
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
