//! Angle, rate and acceleration of one axis against time: from rest to rest, limited in rate, acceleration and jerk.
//!
//! ```text
//! (p1) ramp from rest to rate V with acceleration A and jerk J:  Tj = A / J,  Ta = V / A + Tj     where V >= A Tj
//!                                                                Tj = sqrt(V / J),  Ta = 2 Tj     where it is less
//! (p2) way of both ramps = V Ta;  duration = way / V + Ta
//! (p3) way too short for V:       V^2 / A + V Tj = way,  or  V^3 = way^2 J / 4                    where V < A Tj
//! (p4) highest acceleration of a ramp that lasts V / A in spite of the limit in jerk:
//!                                 A' = J / 2 (V / A - sqrt((V / A)^2 - 4 V / J))
//! ```
//! The trapezoid of rates is the limit of infinite jerk. A profile is symmetric in time, and computed from whichever end is
//! nearer: it ends exactly where it shall.

use crate::base::linear::{ComplexField, Real, real};
use serde::{Deserialize, Serialize};

/// What a motion must keep to; all positive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionLimits {
    /// Highest rate, rad/s.
    pub rate_rad_s: f64,
    /// Highest acceleration, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// Highest jerk, rad/s^3; infinite for a trapezoid of rates.
    pub jerk_rad_s3: f64,
}

impl MotionLimits {
    /// With ramps of which `acceleration_rad_s2` is the mean, so that they last as long as those of a trapezoid.
    /// `None` where the jerk is too low for it. (p4)
    pub fn with_mean_acceleration(rate_rad_s: f64, acceleration_rad_s2: f64, jerk_rad_s3: f64) -> Option<Self> {
        let ramp_s = rate_rad_s / acceleration_rad_s2;
        let least_s2 = 4.0 * rate_rad_s / jerk_rad_s3;
        let root_s = ComplexField::try_sqrt(ramp_s * ramp_s - least_s2)?;
        // J / 2 (T - sqrt(T^2 - 4 V / J)) without the difference of what is nearly equal.
        let highest_rad_s2 = 2.0 * rate_rad_s / (ramp_s + root_s);
        highest_rad_s2.is_finite().then_some(Self { rate_rad_s, acceleration_rad_s2: highest_rad_s2, jerk_rad_s3 })
    }
}

/// A point of a profile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point<T> {
    /// Angle from the start, rad.
    pub angle_rad: T,
    /// Rate, rad/s.
    pub rate_rad_s: T,
    /// Acceleration, rad/s^2.
    pub acceleration_rad_s2: T,
}

/// A motion from rest to rest: ramp, constant rate, ramp; without the middle part where the way is short.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile<T> {
    distance_rad: T,
    /// Between the ramps, of the distance's sign.
    rate_rad_s: T,
    /// Duration of either ramp, s.
    ramp_s: T,
    /// Time in which its acceleration grows, and in which it vanishes, s.
    jerk_s: T,
    cruise_s: T,
}

impl<T: Real> Profile<T> {
    /// Over `distance_rad`, of either sign.
    pub fn new(distance_rad: T, limits: &MotionLimits) -> Self {
        let way = distance_rad.abs();
        let [rate, acceleration] = [limits.rate_rad_s, limits.acceleration_rad_s2].map(real::<T>);
        let jerk_s: T = real(limits.acceleration_rad_s2 / limits.jerk_rad_s3);
        // (p1), (p2); a trapezoid has no jerk to divide by.
        let (full_jerk_s, full_ramp_s) = Self::ramp(rate, acceleration, jerk_s);
        if way >= rate * full_ramp_s {
            let cruise_s = way / rate - full_ramp_s;
            let rate_rad_s = if distance_rad < T::zero() { -rate } else { rate };
            return Self { distance_rad, rate_rad_s, ramp_s: full_ramp_s, jerk_s: full_jerk_s, cruise_s };
        }
        let (jerk_s, ramp_s) = Self::ramp(Self::reached_rad_s(way, acceleration, jerk_s), acceleration, jerk_s);
        let rate_rad_s = if ramp_s > T::zero() { distance_rad / ramp_s } else { T::zero() };
        Self { distance_rad, rate_rad_s, ramp_s, jerk_s, cruise_s: T::zero() }
    }

    /// A trapezoid of rates, at no more than these positive rates and accelerations.
    pub fn trapezoid(distance_rad: T, rate_rad_s: f64, acceleration_rad_s2: f64) -> Self {
        Self::new(distance_rad, &MotionLimits { rate_rad_s, acceleration_rad_s2, jerk_rad_s3: f64::INFINITY })
    }

    /// Times of growing acceleration and of the whole ramp. (p1)
    fn ramp(rate: T, acceleration: T, jerk_s: T) -> (T, T) {
        let within = rate >= acceleration * jerk_s;
        let jerk_s = if within { jerk_s } else { (rate * jerk_s / acceleration).sqrt() };
        (jerk_s, if within { rate / acceleration + jerk_s } else { jerk_s + jerk_s })
    }

    /// Rate that can be reached on this way. (p3)
    fn reached_rad_s(way: T, acceleration: T, jerk_s: T) -> T {
        let four: T = real(4.0);
        let rate = real::<T>(0.5) * acceleration * ((jerk_s * jerk_s + four * way / acceleration).sqrt() - jerk_s);
        if rate >= acceleration * jerk_s { rate } else { (way * way * acceleration / (four * jerk_s)).cbrt() }
    }

    /// Duration, s.
    pub fn duration_s(&self) -> T {
        self.ramp_s + self.cruise_s + self.ramp_s
    }

    /// Where the motion is at a time from its start.
    pub fn at(&self, time_s: T) -> Point<T> {
        let left_s = self.duration_s() - time_s;
        if time_s <= left_s {
            return self.in_first_half(time_s.max(T::zero()));
        }
        let mirrored = self.in_first_half(left_s.max(T::zero()));
        Point {
            angle_rad: self.distance_rad - mirrored.angle_rad,
            rate_rad_s: mirrored.rate_rad_s,
            acceleration_rad_s2: -mirrored.acceleration_rad_s2,
        }
    }

    /// Before the middle.
    fn in_first_half(&self, time_s: T) -> Point<T> {
        let half: T = real(0.5);
        if time_s >= self.ramp_s {
            let angle_rad = self.rate_rad_s * (time_s - half * self.ramp_s);
            return Point { angle_rad, rate_rad_s: self.rate_rad_s, acceleration_rad_s2: T::zero() };
        }
        let left_s = self.ramp_s - time_s;
        if time_s <= left_s {
            return self.growing(time_s);
        }
        // The second half of a ramp is the first turned about its middle.
        let mirrored = self.growing(left_s);
        Point {
            angle_rad: mirrored.angle_rad + self.rate_rad_s * (time_s - half * self.ramp_s),
            rate_rad_s: self.rate_rad_s - mirrored.rate_rad_s,
            ..mirrored
        }
    }

    /// In the first half of the first ramp.
    fn growing(&self, time_s: T) -> Point<T> {
        let (half, third): (T, T) = (real(0.5), real(1.0 / 3.0));
        let highest = self.rate_rad_s / (self.ramp_s - self.jerk_s);
        if time_s < self.jerk_s {
            let acceleration_rad_s2 = highest * (time_s / self.jerk_s);
            let rate_rad_s = half * acceleration_rad_s2 * time_s;
            return Point { angle_rad: third * rate_rad_s * time_s, rate_rad_s, acceleration_rad_s2 };
        }
        let steady_s = time_s - self.jerk_s;
        let before = half * highest * self.jerk_s;
        Point {
            angle_rad: third * before * self.jerk_s + (before + half * highest * steady_s) * steady_s,
            rate_rad_s: before + highest * steady_s,
            acceleration_rad_s2: highest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::units::DEG;

    const LIMITS: MotionLimits =
        MotionLimits { rate_rad_s: 20.0 * DEG, acceleration_rad_s2: 20.0 * DEG, jerk_rad_s3: 100.0 * DEG };

    /// From ways that reach the rate to such that do not reach the acceleration.
    const WAYS_DEG: [f64; 7] = [360.0, -90.0, 24.0, -10.0, 0.9, 0.1, -0.001];

    #[test]
    fn every_way_is_covered_within_the_limits() {
        for way_deg in WAYS_DEG {
            let profile = Profile::<f64>::new(way_deg * DEG, &LIMITS);
            let end_s = profile.duration_s();
            let end = Point { angle_rad: way_deg * DEG, rate_rad_s: 0.0, acceleration_rad_s2: 0.0 };
            assert_eq!(profile.at(end_s), Point { acceleration_rad_s2: -0.0, ..end }, "{way_deg}");
            assert_eq!(profile.at(end_s + 1.0).angle_rad, way_deg * DEG);
            let step_s = end_s / 1000.0;
            let mut highest = [0.0_f64; 3];
            for step in 1..1000 {
                let [before, here, after] = [-1.0, 0.0, 1.0].map(|k| profile.at((f64::from(step) + k) * step_s));
                let jerk = (after.acceleration_rad_s2 - before.acceleration_rad_s2) / (2.0 * step_s);
                for (highest, value) in highest.iter_mut().zip([here.rate_rad_s, here.acceleration_rad_s2, jerk]) {
                    *highest = highest.max(value.abs());
                }
                // Each is the derivative of the one before; jerk times half a step is the worst at a corner.
                let slope = (after.angle_rad - before.angle_rad) / (2.0 * step_s);
                assert!((slope - here.rate_rad_s).abs() <= LIMITS.jerk_rad_s3 * step_s * step_s, "{way_deg}: {step}");
                let slope = (after.rate_rad_s - before.rate_rad_s) / (2.0 * step_s);
                assert!((slope - here.acceleration_rad_s2).abs() <= 0.51 * LIMITS.jerk_rad_s3 * step_s, "{way_deg}");
            }
            let limits = [LIMITS.rate_rad_s, LIMITS.acceleration_rad_s2, LIMITS.jerk_rad_s3];
            assert!(highest.iter().zip(limits).all(|(high, limit)| *high <= limit * (1.0 + 1e-9)), "{way_deg}");
            // It is in no less of a hurry than it may be: the jerk is used everywhere, and the rest where there is time.
            assert!(highest[2] > 0.99 * limits[2], "{way_deg}");
            assert_eq!(highest[1] > 0.99 * limits[1], way_deg.abs() > 8.0, "{way_deg}");
            assert_eq!(highest[0] > 0.99 * limits[0], way_deg.abs() > 23.9, "{way_deg}");
        }
    }

    #[test]
    fn a_trapezoid_is_the_limit_of_infinite_jerk() {
        for way in [1.5, -1.5, 0.2, -0.01] {
            let trapezoid = Profile::<f64>::trapezoid(way, 0.35, 0.35);
            let short = way.abs() < 0.35;
            let ramp_s = if short { (way.abs() / 0.35).sqrt() } else { 1.0 };
            let duration_s = if short { 2.0 * ramp_s } else { way.abs() / 0.35 + 1.0 };
            assert!((trapezoid.duration_s() - duration_s).abs() < 1e-12);
            let at = trapezoid.at(0.5 * ramp_s);
            assert!((at.rate_rad_s.abs() - 0.35 * 0.5 * ramp_s).abs() < 1e-12);
            assert!((at.angle_rad.abs() - 0.5 * 0.35 * 0.25 * ramp_s * ramp_s).abs() < 1e-12);
            let sharp = MotionLimits { rate_rad_s: 0.35, acceleration_rad_s2: 0.35, jerk_rad_s3: 1e6 };
            let sharp = Profile::new(way, &sharp);
            assert!((sharp.duration_s() - duration_s).abs() < 1e-6);
            assert!((sharp.at(0.3).angle_rad - trapezoid.at(0.3).angle_rad).abs() < 1e-6);
        }
    }

    #[test]
    fn ramps_of_a_mean_acceleration_last_as_long_as_those_of_a_trapezoid() {
        let limits = MotionLimits::with_mean_acceleration(20.0 * DEG, 20.0 * DEG, 1000.0 * DEG).expect("jerk enough");
        assert!((limits.acceleration_rad_s2 / DEG - 20.417).abs() < 1e-3);
        let (rounded, sharp) = (Profile::<f64>::new(1.5, &limits), Profile::trapezoid(1.5, 20.0 * DEG, 20.0 * DEG));
        assert!((rounded.duration_s() - sharp.duration_s()).abs() < 1e-12);
        assert!((rounded.at(2.0).angle_rad - sharp.at(2.0).angle_rad).abs() < 1e-12);
        assert_eq!(MotionLimits::with_mean_acceleration(20.0 * DEG, 20.0 * DEG, 79.0 * DEG), None);
        let infinite = MotionLimits::with_mean_acceleration(0.35, 0.7, f64::INFINITY).expect("any ramp");
        assert!((infinite.acceleration_rad_s2 - 0.7).abs() < 1e-15);
    }

    #[test]
    fn single_precision_ends_where_it_shall() {
        for way_deg in WAYS_DEG {
            let (single, double) =
                (Profile::<f32>::new((way_deg * DEG) as f32, &LIMITS), Profile::<f64>::new(way_deg * DEG, &LIMITS));
            assert_eq!(single.at(single.duration_s()).angle_rad, (way_deg * DEG) as f32);
            for part in [0.02, 0.3, 0.5, 0.9, 0.999] {
                let time_s = part * double.duration_s();
                let difference = f64::from(single.at(time_s as f32).angle_rad) - double.at(time_s).angle_rad;
                // Rounding of the time, 2^-24 of it, at the rate; and of the angle.
                let bound = 2e-7 * (time_s * LIMITS.rate_rad_s + (way_deg * DEG).abs());
                assert!(difference.abs() < bound, "{way_deg} {part}: {difference}");
            }
        }
    }
}
