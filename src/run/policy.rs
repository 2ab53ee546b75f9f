//! Whether to calibrate at power-up, or to correct with the calibration in store.

use core::fmt;
use serde::{Deserialize, Serialize};

/// When the instrument calibrates itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum PowerUpPolicy {
    /// At every power-up.
    Always,
    /// Only when told to.
    OnCommand,
    /// Whenever there is no calibration in store, or it is not good any more.
    WhenDue {
        /// Greatest age of the stored calibration, s; `None` for any.
        age_s: Option<u64>,
        /// Greatest difference of the IMU's temperature from that of the stored calibration, K; `None` for any.
        temperature_k: Option<f32>,
    },
    /// Never, not even when told to.
    Never,
}

impl Default for PowerUpPolicy {
    /// When there is no calibration in store.
    fn default() -> Self {
        Self::WhenDue { age_s: None, temperature_k: None }
    }
}

/// The conditions of a calibration or of a power-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Seconds since 1970-01-01 UTC; `None` where there is no clock.
    pub utc_s: Option<u64>,
    /// IMU temperature, deg C; not a number where there is no sensor.
    pub temperature_c: f32,
}

/// What is done at power-up, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Decision {
    /// A calibration begins.
    Calibrate(Cause),
    /// The stored calibration corrects.
    UseStored(Cause),
    /// There is no calibration, and none begins.
    StandBy(Cause),
}

/// What a decision rests on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Cause {
    /// The policy leaves no choice.
    Policy,
    /// The operator or the navigation software asked for it.
    Commanded,
    /// Nothing is stored.
    NothingStored,
    /// The stored calibration is within all limits.
    WithinLimits,
    /// The stored calibration is too old.
    Age {
        /// Its age, s.
        age_s: u64,
        /// Greatest age, s.
        limit_s: u64,
    },
    /// The age of the stored calibration is not known, or negative.
    AgeUnknown,
    /// The temperature is another one.
    Temperature {
        /// Temperature less that of the stored calibration, K.
        difference_k: f32,
        /// Greatest difference, K.
        limit_k: f32,
    },
    /// One of the temperatures is not known.
    TemperatureUnknown,
}

impl PowerUpPolicy {
    /// Decides at `now`; `stored` is the conditions of the calibration in store.
    pub fn decide(self, stored: Option<Conditions>, now: Conditions) -> Decision {
        match (self, stored) {
            (Self::Always, _) => Decision::Calibrate(Cause::Policy),
            (Self::OnCommand | Self::Never, Some(_)) => Decision::UseStored(Cause::Policy),
            (Self::OnCommand | Self::Never, None) => Decision::StandBy(Cause::Policy),
            (Self::WhenDue { .. }, None) => Decision::Calibrate(Cause::NothingStored),
            (Self::WhenDue { age_s, temperature_k }, Some(stored)) => {
                let due = age_s.and_then(|limit| too_old(stored, now, limit));
                match due.or_else(|| temperature_k.and_then(|limit| too_different(stored, now, limit))) {
                    Some(cause) => Decision::Calibrate(cause),
                    None => Decision::UseStored(Cause::WithinLimits),
                }
            }
        }
    }

    /// Whether every number is finite and not negative.
    pub fn is_valid(self) -> bool {
        match self {
            Self::WhenDue { temperature_k: Some(limit), .. } => limit.is_finite() && limit >= 0.0,
            _ => true,
        }
    }
}

fn too_old(stored: Conditions, now: Conditions, limit_s: u64) -> Option<Cause> {
    let age_s = now.utc_s.zip(stored.utc_s).and_then(|(now, then)| now.checked_sub(then));
    match age_s {
        None => Some(Cause::AgeUnknown),
        Some(age_s) => (age_s > limit_s).then_some(Cause::Age { age_s, limit_s }),
    }
}

fn too_different(stored: Conditions, now: Conditions, limit_k: f32) -> Option<Cause> {
    let difference_k = now.temperature_c - stored.temperature_c;
    if difference_k.is_finite() {
        (difference_k.abs() > limit_k).then_some(Cause::Temperature { difference_k, limit_k })
    } else {
        Some(Cause::TemperatureUnknown)
    }
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Calibrate(cause) => write!(f, "calibrating: {cause}"),
            Self::UseStored(cause) => write!(f, "correcting with the stored calibration: {cause}"),
            Self::StandBy(cause) => write!(f, "standing by without a calibration: {cause}"),
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const HOUR_S: u64 = 3600;
        match self {
            Self::Policy => write!(f, "the policy says so"),
            Self::Commanded => write!(f, "commanded"),
            Self::NothingStored => write!(f, "nothing is stored"),
            Self::WithinLimits => write!(f, "it is within the limits"),
            Self::Age { age_s, limit_s } => {
                write!(f, "the stored one is {} h old, limit {} h", age_s / HOUR_S, limit_s / HOUR_S)
            }
            Self::AgeUnknown => write!(f, "the age of the stored one is not known"),
            Self::Temperature { difference_k, limit_k } => {
                write!(f, "{difference_k:+.1} K from the temperature of the stored one, limit {limit_k:.1} K")
            }
            Self::TemperatureUnknown => write!(f, "the temperature now or of the stored one is not known"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STORED: Conditions = Conditions { utc_s: Some(1_000_000), temperature_c: 30.0 };

    fn due(age_s: Option<u64>, temperature_k: Option<f32>, stored: Option<Conditions>, now: Conditions) -> Decision {
        PowerUpPolicy::WhenDue { age_s, temperature_k }.decide(stored, now)
    }

    #[test]
    fn policies_without_a_choice() {
        let decide = |policy: PowerUpPolicy, stored| policy.decide(stored, STORED);
        assert_eq!(decide(PowerUpPolicy::Always, Some(STORED)), Decision::Calibrate(Cause::Policy));
        for policy in [PowerUpPolicy::Never, PowerUpPolicy::OnCommand] {
            assert_eq!(decide(policy, Some(STORED)), Decision::UseStored(Cause::Policy));
            assert_eq!(decide(policy, None), Decision::StandBy(Cause::Policy));
        }
    }

    #[test]
    fn a_calibration_is_due_by_age_or_temperature() {
        let at = |utc_s, temperature_c| Conditions { utc_s: Some(utc_s), temperature_c };
        let (limit_s, limit_k) = (Some(3600), Some(5.0));
        assert_eq!(due(None, None, None, STORED), Decision::Calibrate(Cause::NothingStored));
        assert_eq!(due(None, None, Some(STORED), at(9, 90.0)), Decision::UseStored(Cause::WithinLimits));
        let within = due(limit_s, limit_k, Some(STORED), at(1_003_600, 25.0));
        assert_eq!(within, Decision::UseStored(Cause::WithinLimits));
        let old = Cause::Age { age_s: 3601, limit_s: 3600 };
        assert_eq!(due(limit_s, limit_k, Some(STORED), at(1_003_601, 30.0)), Decision::Calibrate(old));
        let cold = Cause::Temperature { difference_k: -5.5, limit_k: 5.0 };
        assert_eq!(due(limit_s, limit_k, Some(STORED), at(1_000_000, 24.5)), Decision::Calibrate(cold));
    }

    #[test]
    fn what_is_not_known_does_not_count_as_good() {
        let unknown = Conditions { utc_s: None, temperature_c: f32::NAN };
        for (stored, now) in [(STORED, unknown), (unknown, STORED)] {
            let by_age = due(Some(3600), None, Some(stored), now);
            assert_eq!(by_age, Decision::Calibrate(Cause::AgeUnknown));
            let by_temperature = due(None, Some(5.0), Some(stored), now);
            assert_eq!(by_temperature, Decision::Calibrate(Cause::TemperatureUnknown));
        }
        let from_the_future = Conditions { utc_s: Some(1), ..STORED };
        assert_eq!(due(Some(3600), None, Some(STORED), from_the_future), Decision::Calibrate(Cause::AgeUnknown));
    }
}
