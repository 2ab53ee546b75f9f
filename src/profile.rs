//! Angle and rate of one axis against time.

use crate::linear::{Real, real};

/// Angle and rate against time: constant acceleration, constant rate, constant deceleration; without the middle part
/// where the way is short.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile<T> {
    direction: T,
    acceleration: T,
    ramp_s: T,
    cruise_s: T,
}

impl<T: Real> Profile<T> {
    /// Over `distance_rad`, of either sign, at no more than these positive rates and accelerations.
    pub fn new(distance_rad: T, rate_rad_s: T, acceleration_rad_s2: T) -> Self {
        let distance = distance_rad.abs();
        let full_ramp_s = rate_rad_s / acceleration_rad_s2;
        let short = distance < rate_rad_s * full_ramp_s;
        let ramp_s = if short { (distance / acceleration_rad_s2).sqrt() } else { full_ramp_s };
        let cruise_s = if short { T::zero() } else { distance / rate_rad_s - full_ramp_s };
        let direction = if distance_rad < T::zero() { -T::one() } else { T::one() };
        Self { direction, acceleration: acceleration_rad_s2, ramp_s, cruise_s }
    }

    /// Duration, s.
    pub fn duration_s(&self) -> T {
        self.ramp_s + self.cruise_s + self.ramp_s
    }

    /// Angle from the start (rad) and rate (rad/s) at a time from the start.
    pub fn at(&self, time_s: T) -> (T, T) {
        let half: T = real(0.5);
        let time = time_s.max(T::zero()).min(self.duration_s());
        let rising = time.min(self.ramp_s);
        let cruising = (time - self.ramp_s).max(T::zero()).min(self.cruise_s);
        let falling = (time - self.ramp_s - self.cruise_s).max(T::zero());
        let top = self.acceleration * self.ramp_s;
        let angle = half * self.acceleration * rising * rising + top * cruising + top * falling
            - half * self.acceleration * falling * falling;
        let rate = self.acceleration * (rising - falling);
        (self.direction * angle, self.direction * rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profile_covers_the_way_with_and_without_cruise() {
        for distance in [1.5, -1.5, 0.2, -0.01] {
            let profile = Profile::<f64>::new(distance, 0.35, 0.35);
            let end = profile.duration_s();
            assert!((profile.at(end).0 - distance).abs() < 1e-15 && profile.at(end).1.abs() < 1e-15);
            let (middle, rate) = profile.at(end / 2.0);
            assert!((middle - distance / 2.0).abs() < 1e-15 && rate.abs() <= 0.35 && rate * distance > 0.0);
            // The rate is the derivative of the angle.
            for k in 1..20 {
                let t = end * f64::from(k) / 20.0;
                let slope = (profile.at(t + 1e-6).0 - profile.at(t - 1e-6).0) / 2e-6;
                assert!((slope - profile.at(t).1).abs() < 1e-6);
            }
        }
    }
}
