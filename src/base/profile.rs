//! Motion profile of one axis: angle, rate and acceleration against time, from rest to rest, with limited rate,
//! acceleration and jerk.
//!
//! ```text
//! (p1) ramp from rest to rate V with acceleration A and jerk J:  Tj = A / J,  Ta = V / A + Tj     if V >= A Tj
//!                                                                Tj = sqrt(V / J),  Ta = 2 Tj     otherwise
//! (p2) path of both ramps = V Ta;  duration = path / V + Ta
//! (p3) rate reached on a path too short for V:
//!                                V^2 / A + V Tj = path,  or  V^3 = path^2 J / 4                    if V < A Tj
//! (p4) peak acceleration of a ramp that lasts V / A in spite of the jerk limit:
//!                                A' = J / 2 (V / A - sqrt((V / A)^2 - 4 V / J))
//! ```
//! With infinite jerk the rate is a trapezoid. A profile is symmetric in time. The second half is computed backwards
//! from the end, so the profile ends exactly at its target.

use crate::base::linear::{ComplexField, Real, real};
use serde::{Deserialize, Serialize};

/// Limits of a motion. All limits are positive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotionLimits {
    /// Highest rate, rad/s.
    pub rate_rad_s: f64,
    /// Highest acceleration, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// Highest jerk, rad/s^3. Infinite jerk gives a trapezoid of rates.
    pub jerk_rad_s3: f64,
}

impl MotionLimits {
    /// Limits for ramps with the mean acceleration `acceleration_rad_s2`. These ramps last as long as the ramps of a
    /// trapezoid with that acceleration. Returns `None` if the jerk is too low. (p4)
    pub fn with_mean_acceleration(rate_rad_s: f64, acceleration_rad_s2: f64, jerk_rad_s3: f64) -> Option<Self> {
        let ramp_s = rate_rad_s / acceleration_rad_s2;
        let least_s2 = 4.0 * rate_rad_s / jerk_rad_s3;
        let root_s = ComplexField::try_sqrt(ramp_s * ramp_s - least_s2)?;
        // J / 2 (T - sqrt(T^2 - 4 V / J)), written without the difference of two nearly equal numbers.
        let highest_rad_s2 = 2.0 * rate_rad_s / (ramp_s + root_s);
        highest_rad_s2.is_finite().then_some(Self { rate_rad_s, acceleration_rad_s2: highest_rad_s2, jerk_rad_s3 })
    }
}

/// State of a profile at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Point<T> {
    /// Angle relative to the start, rad.
    pub angle_rad: T,
    /// Rate, rad/s.
    pub rate_rad_s: T,
    /// Acceleration, rad/s^2.
    pub acceleration_rad_s2: T,
}

/// A motion from rest to rest: ramp, constant rate, ramp. A short motion has no part at constant rate.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Profile<T> {
    distance_rad: T,
    /// Rate between the ramps, with the sign of the distance, rad/s.
    rate_rad_s: T,
    /// Duration of each ramp, s.
    ramp_s: T,
    /// Duration of the growing acceleration at the start of a ramp, and of the falling acceleration at its end, s.
    jerk_s: T,
    cruise_s: T,
}

impl<T: Real> Profile<T> {
    /// Profile over `distance_rad`, which may have either sign.
    pub fn new(distance_rad: T, limits: &MotionLimits) -> Self {
        let path = distance_rad.abs();
        let [rate, acceleration] = [limits.rate_rad_s, limits.acceleration_rad_s2].map(real::<T>);
        let jerk_s: T = real(limits.acceleration_rad_s2 / limits.jerk_rad_s3);
        // (p1), (p2); `jerk_s` is 0 if the jerk is infinite.
        let (full_jerk_s, full_ramp_s) = Self::ramp(rate, acceleration, jerk_s);
        if path >= rate * full_ramp_s {
            let cruise_s = path / rate - full_ramp_s;
            let rate_rad_s = if distance_rad < T::zero() { -rate } else { rate };
            return Self { distance_rad, rate_rad_s, ramp_s: full_ramp_s, jerk_s: full_jerk_s, cruise_s };
        }
        let (jerk_s, ramp_s) = Self::ramp(Self::reached_rad_s(path, acceleration, jerk_s), acceleration, jerk_s);
        let rate_rad_s = if ramp_s > T::zero() { distance_rad / ramp_s } else { T::zero() };
        Self { distance_rad, rate_rad_s, ramp_s, jerk_s, cruise_s: T::zero() }
    }

    /// Profile with a trapezoid of rates. The limits of rate and acceleration are positive.
    pub fn trapezoid(distance_rad: T, rate_rad_s: f64, acceleration_rad_s2: f64) -> Self {
        Self::new(distance_rad, &MotionLimits { rate_rad_s, acceleration_rad_s2, jerk_rad_s3: f64::INFINITY })
    }

    /// Duration of the growing acceleration, and duration of the whole ramp, s. (p1)
    fn ramp(rate: T, acceleration: T, jerk_s: T) -> (T, T) {
        let within = rate >= acceleration * jerk_s;
        let jerk_s = if within { jerk_s } else { (rate * jerk_s / acceleration).sqrt() };
        (jerk_s, if within { rate / acceleration + jerk_s } else { jerk_s + jerk_s })
    }

    /// Highest rate on a path too short for the rate limit, rad/s. (p3)
    fn reached_rad_s(path: T, acceleration: T, jerk_s: T) -> T {
        let four: T = real(4.0);
        let rate = real::<T>(0.5) * acceleration * ((jerk_s * jerk_s + four * path / acceleration).sqrt() - jerk_s);
        if rate >= acceleration * jerk_s { rate } else { (path * path * acceleration / (four * jerk_s)).cbrt() }
    }

    /// Duration, s.
    pub fn duration_s(&self) -> T {
        self.ramp_s + self.cruise_s + self.ramp_s
    }

    /// State at `time_s` after the start.
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

    /// State in the first half of the motion.
    fn in_first_half(&self, time_s: T) -> Point<T> {
        let half: T = real(0.5);
        if time_s >= self.ramp_s {
            let angle_rad = self.rate_rad_s * (time_s - half * self.ramp_s);
            return Point { angle_rad, rate_rad_s: self.rate_rad_s, acceleration_rad_s2: T::zero() };
        }
        let left_s = self.ramp_s - time_s;
        if time_s <= left_s {
            return self.in_half_ramp(time_s);
        }
        // The second half of a ramp is the point reflection of its first half.
        let mirrored = self.in_half_ramp(left_s);
        Point {
            angle_rad: mirrored.angle_rad + self.rate_rad_s * (time_s - half * self.ramp_s),
            rate_rad_s: self.rate_rad_s - mirrored.rate_rad_s,
            ..mirrored
        }
    }

    /// State in the first half of the first ramp.
    fn in_half_ramp(&self, time_s: T) -> Point<T> {
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

    /// From paths that reach the highest rate to paths that do not reach the highest acceleration.
    const PATHS_DEG: [f64; 7] = [360.0, -90.0, 24.0, -10.0, 0.9, 0.1, -0.001];

    #[test]
    fn every_profile_covers_its_path_within_the_limits() {
        for path_deg in PATHS_DEG {
            let profile = Profile::<f64>::new(path_deg * DEG, &LIMITS);
            let end_s = profile.duration_s();
            let end = Point { angle_rad: path_deg * DEG, rate_rad_s: 0.0, acceleration_rad_s2: 0.0 };
            assert_eq!(profile.at(end_s), Point { acceleration_rad_s2: -0.0, ..end }, "{path_deg}");
            assert_eq!(profile.at(end_s + 1.0).angle_rad, path_deg * DEG);
            let step_s = end_s / 1000.0;
            let mut highest = [0.0_f64; 3];
            for step in 1..1000 {
                let [before, here, after] = [-1.0, 0.0, 1.0].map(|k| profile.at((f64::from(step) + k) * step_s));
                let jerk = (after.acceleration_rad_s2 - before.acceleration_rad_s2) / (2.0 * step_s);
                for (highest, value) in highest.iter_mut().zip([here.rate_rad_s, here.acceleration_rad_s2, jerk]) {
                    *highest = highest.max(value.abs());
                }
                // Each quantity is the derivative of the one before. At a corner of the acceleration the difference
                // quotient is off by up to half a step times the jerk.
                let slope = (after.angle_rad - before.angle_rad) / (2.0 * step_s);
                assert!((slope - here.rate_rad_s).abs() <= LIMITS.jerk_rad_s3 * step_s * step_s, "{path_deg}: {step}");
                let slope = (after.rate_rad_s - before.rate_rad_s) / (2.0 * step_s);
                assert!((slope - here.acceleration_rad_s2).abs() <= 0.51 * LIMITS.jerk_rad_s3 * step_s, "{path_deg}");
            }
            let limits = [LIMITS.rate_rad_s, LIMITS.acceleration_rad_s2, LIMITS.jerk_rad_s3];
            assert!(highest.iter().zip(limits).all(|(high, limit)| *high <= limit * (1.0 + 1e-9)), "{path_deg}");
            // The profile uses its limits fully: always the jerk, and on long paths the acceleration and the rate.
            assert!(highest[2] > 0.99 * limits[2], "{path_deg}");
            assert_eq!(highest[1] > 0.99 * limits[1], path_deg.abs() > 8.0, "{path_deg}");
            assert_eq!(highest[0] > 0.99 * limits[0], path_deg.abs() > 23.9, "{path_deg}");
        }
    }

    #[test]
    fn a_trapezoid_is_the_limit_of_infinite_jerk() {
        for path in [1.5, -1.5, 0.2, -0.01] {
            let trapezoid = Profile::<f64>::trapezoid(path, 0.35, 0.35);
            let short = path.abs() < 0.35;
            let ramp_s = if short { (path.abs() / 0.35).sqrt() } else { 1.0 };
            let duration_s = if short { 2.0 * ramp_s } else { path.abs() / 0.35 + 1.0 };
            assert!((trapezoid.duration_s() - duration_s).abs() < 1e-12);
            let at = trapezoid.at(0.5 * ramp_s);
            assert!((at.rate_rad_s.abs() - 0.35 * 0.5 * ramp_s).abs() < 1e-12);
            assert!((at.angle_rad.abs() - 0.5 * 0.35 * 0.25 * ramp_s * ramp_s).abs() < 1e-12);
            let sharp = MotionLimits { rate_rad_s: 0.35, acceleration_rad_s2: 0.35, jerk_rad_s3: 1e6 };
            let sharp = Profile::new(path, &sharp);
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
    fn single_precision_ends_at_the_target() {
        for path_deg in PATHS_DEG {
            let (single, double) =
                (Profile::<f32>::new((path_deg * DEG) as f32, &LIMITS), Profile::<f64>::new(path_deg * DEG, &LIMITS));
            assert_eq!(single.at(single.duration_s()).angle_rad, (path_deg * DEG) as f32);
            for part in [0.02, 0.3, 0.5, 0.9, 0.999] {
                let time_s = part * double.duration_s();
                let difference = f64::from(single.at(time_s as f32).angle_rad) - double.at(time_s).angle_rad;
                // The error is the rounding of the time (relative 2^-24) times the rate, plus the rounding of the
                // angle.
                let bound = 2e-7 * (time_s * LIMITS.rate_rad_s + (path_deg * DEG).abs());
                assert!(difference.abs() < bound, "{path_deg} {part}: {difference}");
            }
        }
    }
}
