//! Checks that the samples are in the expected units. The specific force is compared with gravity, and the rotation by
//! the gyros with the rotation by the encoders.
//!
//! A wrong unit gives the same factor in every stop or move. Other errors do not, and other checks find them.

use super::limits::VerdictLimits;
use crate::base::linear::{ComplexField, Real};
use crate::base::units::{DEG, DEG_H, STANDARD_GRAVITY_M_S2};
use crate::segment::{Segment, SegmentKind};
use core::fmt;
use serde::{Deserialize, Serialize};

/// A move with a smaller turn shows too little about the scale, rad.
const LEAST_TURN_RAD: f64 = 0.1;
/// Fastest plausible turn, rad/s. Drives can be commanded up to 2.147 rad/s; a useful move in degrees has a larger
/// number.
const FASTEST_TURN_RAD_S: f64 = 2.2;
/// A factor belongs to a unit if it differs from the unit's factor by less than this part. The tolerance exceeds the
/// errors of an instrument and is smaller than the distance to the next unit.
const UNIT_TOLERANCE: f64 = 0.15;

/// A scale that shows wrong units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WrongScale {
    /// The accelerometers measure this many times gravity at the stops.
    Force {
        /// Mean specific force over gravity.
        of_gravity: f64,
        /// Sample interval, s.
        interval_s: f64,
    },
    /// The gyros turn this many times as far as the encoders.
    Turn {
        /// Angle of the gyros over that of the encoders.
        of_encoders: f64,
        /// Sample interval, s.
        interval_s: f64,
    },
    /// Gyros and encoders agree that the axes turn at this rate, which the axes cannot reach, rad/s.
    Speed(f64),
}

impl WrongScale {
    /// The unit that explains the factor, and the right unit.
    fn unit(&self) -> Option<&'static str> {
        let named = |factor: f64, units: &[(f64, &'static str)]| {
            let fits = |unit: &&(f64, &str)| (factor / unit.0 - 1.0).abs() < UNIT_TOLERANCE;
            units.iter().find(fits).map(|(_, unit)| *unit)
        };
        match *self {
            Self::Force { of_gravity, interval_s } => named(
                of_gravity,
                &[
                    (1.0 / STANDARD_GRAVITY_M_S2, "g in place of m/s^2"),
                    (1000.0 / STANDARD_GRAVITY_M_S2, "mg in place of m/s^2"),
                    (1000.0, "mm/s^2 in place of m/s^2"),
                    (1.0 / 0.3048, "ft/s^2 in place of m/s^2"),
                    (interval_s, "increments in place of m/s^2"),
                    (interval_s / STANDARD_GRAVITY_M_S2, "increments of g in place of m/s^2"),
                ],
            ),
            Self::Turn { of_encoders, interval_s } => named(
                of_encoders,
                &[
                    (1.0 / DEG, "gyros in deg/s in place of rad/s"),
                    (1.0 / DEG_H, "gyros in deg/h in place of rad/s"),
                    (1000.0, "gyros in mrad/s in place of rad/s"),
                    (interval_s, "gyro increments in place of rad/s"),
                    (interval_s / DEG, "gyro increments in deg in place of rad/s"),
                    (DEG, "encoders in deg in place of rad"),
                ],
            ),
            Self::Speed(_) => Some("gyros and encoders in deg in place of rad"),
        }
    }
}

impl fmt::Display for WrongScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Force { of_gravity, .. } => {
                write!(f, "the accelerometers measure {} times gravity at the stops", Significant(of_gravity))
            }
            Self::Turn { of_encoders, .. } => {
                write!(f, "the gyros turn {} times as far as the encoders", Significant(of_encoders))
            }
            Self::Speed(rad_s) => write!(f, "the axes turn at {} rad/s", Significant(rad_s)),
        }?;
        match (self.unit(), self) {
            (Some(unit), _) => write!(f, "; probable cause: {unit}"),
            (None, Self::Turn { .. }) => {
                write!(f, "; probable cause: an unknown unit, a saturated sensor or lost samples")
            }
            (None, _) => write!(f, "; probable cause: an unknown unit or a saturated sensor"),
        }
    }
}

/// A number with at least three significant digits.
struct Significant(f64);

impl fmt::Display for Significant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.abs() {
            0.01..0.1 => write!(f, "{:.4}", self.0),
            0.1..10.0 => write!(f, "{:.3}", self.0),
            10.0..1e3 => write!(f, "{:.1}", self.0),
            1e3..1e6 => write!(f, "{:.0}", self.0),
            _ => write!(f, "{:.2e}", self.0),
        }
    }
}

/// What is wrong with the scale of the accelerometers, and with that of gyros and encoders.
pub fn wrong_scales<T: Real>(
    segments: &[Segment<T>],
    gravity_m_s2: f64,
    limits: &VerdictLimits,
) -> impl Iterator<Item = WrongScale> {
    [wrong_force(segments, gravity_m_s2, limits), wrong_turn(segments, limits)].into_iter().flatten()
}

/// A wrong scale of the accelerometers. Non-orthogonality and bias also change the length of a mean force.
fn wrong_force<T: Real>(segments: &[Segment<T>], gravity_m_s2: f64, limits: &VerdictLimits) -> Option<WrongScale> {
    let plausible = limits.scale + limits.installation_rad + limits.accel_bias_m_s2 / gravity_m_s2;
    let stops = segments.iter().filter_map(Segment::standing);
    let pairs = stops.map(|stop| (stop.force_a.norm().widened(), gravity_m_s2));
    let of_gravity = common_factor(pairs, plausible).filter(|factor| (factor - 1.0).abs() > plausible)?;
    Some(WrongScale::Force { of_gravity, interval_s: interval_s(segments) })
}

fn wrong_turn<T: Real>(segments: &[Segment<T>], limits: &VerdictLimits) -> Option<WrongScale> {
    let plausible = limits.scale + limits.installation_rad;
    let moves = segments.iter().filter(|segment| segment.kind() == SegmentKind::Move);
    let turns = moves.map(|segment| (segment, turn_rad(segment))).filter(|(_, turn)| *turn > LEAST_TURN_RAD);
    let of_encoders =
        common_factor(turns.clone().map(|(segment, turn)| (segment.rotation_g.norm().widened(), turn)), plausible)?;
    if (of_encoders - 1.0).abs() > plausible {
        return Some(WrongScale::Turn { of_encoders, interval_s: interval_s(segments) });
    }
    let seconds = turns.clone().map(|(segment, _)| segment.duration_s().widened()).sum::<f64>();
    let rate_rad_s = turns.map(|(_, turn)| turn).sum::<f64>() / seconds;
    (rate_rad_s > FASTEST_TURN_RAD_S).then_some(WrongScale::Speed(rate_rad_s))
}

/// Angle of a move by the encoders, rad. If both axes turn, it is the length of the sum of both turns, as the gyros
/// measure it. (M7)
fn turn_rad<T: Real>(segment: &Segment<T>) -> f64 {
    let turned = &segment.turned;
    let outer = ComplexField::hypot(turned.outer_cos_inner.widened(), turned.outer_sin_inner.widened());
    ComplexField::hypot(outer, turned.inner.widened())
}

/// The ratio of measured to expected values, if it is the same for all pairs within `spread`.
fn common_factor(pairs: impl Iterator<Item = (f64, f64)> + Clone, spread: f64) -> Option<f64> {
    let (measured, expected) = pairs.clone().fold((0.0, 0.0), |sums, pair| (sums.0 + pair.0, sums.1 + pair.1));
    let factor: f64 = measured / expected;
    let same = |(measured, expected): (f64, f64)| (measured - factor * expected).abs() <= spread * factor * expected;
    (factor > 0.0 && factor.is_finite() && pairs.into_iter().all(same)).then_some(factor)
}

fn interval_s<T: Real>(segments: &[Segment<T>]) -> f64 {
    let duration_us: u64 = segments.iter().map(|segment| segment.duration_us).sum();
    let samples: u64 = segments.iter().map(|segment| u64::from(segment.samples)).sum();
    duration_us as f64 * 1e-6 / samples.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn factors_name_their_units() {
        let force = |of_gravity| WrongScale::Force { of_gravity, interval_s: 0.005 }.to_string();
        assert_eq!(
            force(0.102),
            "the accelerometers measure 0.102 times gravity at the stops; probable cause: g in place of m/s^2"
        );
        assert_eq!(
            force(1004.0),
            "the accelerometers measure 1004 times gravity at the stops; probable cause: mm/s^2 in place of m/s^2"
        );
        assert!(
            force(0.005_02)
                .ends_with("5.02e-3 times gravity at the stops; probable cause: increments in place of m/s^2")
        );
        assert_eq!(
            force(1e7),
            "the accelerometers measure 1.00e7 times gravity at the stops; probable cause: an unknown unit or a saturated sensor"
        );
        let turn = |of_encoders| WrongScale::Turn { of_encoders, interval_s: 0.01 }.to_string();
        assert_eq!(
            turn(57.3),
            "the gyros turn 57.3 times as far as the encoders; probable cause: gyros in deg/s in place of rad/s"
        );
        assert!(turn(0.017_46).ends_with("encoders in deg in place of rad"));
        assert_eq!(
            turn(0.85),
            "the gyros turn 0.850 times as far as the encoders; probable cause: an unknown unit, a saturated sensor or lost samples"
        );
        assert!(turn(0.573).ends_with("; probable cause: gyro increments in deg in place of rad/s"));
        assert!(turn(0.010_02).ends_with("gyro increments in place of rad/s"));
        assert!(
            WrongScale::Speed(16.0)
                .to_string()
                .starts_with("the axes turn at 16.0 rad/s; probable cause: gyros and encoders in")
        );
    }
}
