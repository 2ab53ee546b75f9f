//! The decision at power-up: calibrate, or correct with the stored calibration.

use crate::base::bounds::{Bounded, Unit};
use crate::base::imu_identity::ImuIdentity;
use crate::base::restart::Restart;
use core::fmt;
use serde::{Deserialize, Serialize};

/// When the instrument calibrates itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PowerUpPolicy {
    /// At every power-up.
    Always,
    /// Only on command.
    OnCommand,
    /// If there is no stored calibration, or if the stored calibration is no longer valid.
    WhenDue {
        /// Greatest age of the stored calibration, s; `None` for no limit.
        age_s: Option<u64>,
        /// Greatest difference between the IMU's temperature and that of the stored calibration, K; `None` for no
        /// limit.
        temperature_k: Option<f32>,
    },
    /// Never, not even on command.
    Never,
}

impl Default for PowerUpPolicy {
    /// Calibrate at every power-up.
    fn default() -> Self {
        Self::Always
    }
}

/// Why the instrument must not move its axes by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MotionLock {
    /// There is no valid configuration of this unit.
    NotCommissioned,
    /// The software started after a reset that nobody asked for: by the watchdog, a panic, a processor fault or a loss
    /// of supply. A command to start a run ends this lock.
    AfterReset,
}

impl MotionLock {
    /// The lock after a start of the software for this reason, if there is one. Power-on and the reset pin are what
    /// somebody asked for.
    pub fn after(restart: &Restart) -> Option<Self> {
        match restart {
            Restart::PowerOn | Restart::Pin => None,
            Restart::Stopped(_) | Restart::Watchdog | Restart::BrownOut | Restart::Unexplained => {
                Some(Self::AfterReset)
            }
        }
    }

    /// The cause of a decision that this lock forces.
    pub fn cause(self) -> Cause {
        match self {
            Self::NotCommissioned => Cause::NotCommissioned,
            Self::AfterReset => Cause::AfterReset,
        }
    }
}

/// The conditions of a calibration or of a power-up.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Conditions {
    /// Seconds since 1970-01-01 UTC; `None` if there is no clock.
    pub utc_s: Option<u64>,
    /// IMU temperature, deg C; not a number if there is no sensor.
    pub temperature_c: f32,
    /// The IMU; `None` if it does not tell which it is.
    pub imu: Option<ImuIdentity>,
}

impl Conditions {
    /// Whether both conditions name an IMU, and the IMUs are not the same.
    pub fn has_other_imu(&self, other: &Self) -> bool {
        self.imu.zip(other.imu).is_some_and(|(one, another)| one != another)
    }
}

/// The decision at power-up, and its cause.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Decision {
    /// A calibration begins.
    Calibrate(Cause),
    /// Samples are corrected with the stored calibration.
    UseStored(Cause),
    /// There is no calibration, and none begins.
    StandBy(Cause),
}

/// The cause of a decision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Cause {
    /// The policy permits no other decision.
    Policy,
    /// The operator or the navigation software gave the command.
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
    /// The temperature has changed too much since the stored calibration.
    Temperature {
        /// Present temperature minus that of the stored calibration, K.
        difference_k: f32,
        /// Greatest difference, K.
        limit_k: f32,
    },
    /// One of the temperatures is not known.
    TemperatureUnknown,
    /// The stored calibration belongs to another IMU, so it is not used.
    ImuExchanged,
    /// There is no valid configuration of this unit, so nothing may move.
    NotCommissioned,
    /// The software started after a reset that nobody asked for, so nothing may move.
    AfterReset,
}

impl PowerUpPolicy {
    /// Decides at the conditions `now`. `stored` holds the conditions of the stored calibration, if there is one. A
    /// calibration of another IMU counts as none. With a `lock` no calibration begins.
    pub fn decide(self, stored: Option<Conditions>, now: Conditions, lock: Option<MotionLock>) -> Decision {
        let exchanged = stored.is_some_and(|stored| stored.has_other_imu(&now));
        let stored = stored.filter(|_| !exchanged);
        if let Some(lock) = lock {
            return if stored.is_some() { Decision::UseStored(lock.cause()) } else { Decision::StandBy(lock.cause()) };
        }
        match (self, stored) {
            (Self::Always, _) => Decision::Calibrate(Cause::Policy),
            (Self::OnCommand | Self::Never, Some(_)) => Decision::UseStored(Cause::Policy),
            (Self::OnCommand | Self::Never, None) if exchanged => Decision::StandBy(Cause::ImuExchanged),
            (Self::OnCommand | Self::Never, None) => Decision::StandBy(Cause::Policy),
            (Self::WhenDue { .. }, None) if exchanged => Decision::Calibrate(Cause::ImuExchanged),
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
}

/// The permitted range of every number of [`PowerUpPolicy`]. No limit is permitted too.
pub static POLICY_BOUNDS: [Bounded<PowerUpPolicy>; 1] =
    [Bounded::new("temperature limit of the power-up policy", Unit::si("K"), [0.0, 1000.0], |policy| match policy {
        PowerUpPolicy::WhenDue { temperature_k: Some(limit), .. } => f64::from(*limit),
        _ => 0.0,
    })];

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
            Self::Policy => write!(f, "the policy permits no other decision"),
            Self::Commanded => write!(f, "a command was given"),
            Self::NothingStored => write!(f, "nothing is stored"),
            Self::WithinLimits => write!(f, "it is within the limits of the policy"),
            Self::Age { age_s, limit_s } => {
                write!(f, "the stored calibration is {} h old, and the limit is {} h", age_s / HOUR_S, limit_s / HOUR_S)
            }
            Self::AgeUnknown => write!(f, "the age of the stored calibration is not known"),
            Self::Temperature { difference_k, limit_k } => {
                write!(
                    f,
                    "the temperature differs by {difference_k:+.1} K from that of the stored calibration, and the \
                     limit is {limit_k:.1} K"
                )
            }
            Self::TemperatureUnknown => {
                write!(f, "the present temperature or that of the stored calibration is not known")
            }
            Self::ImuExchanged => write!(f, "the stored calibration belongs to another IMU"),
            Self::NotCommissioned => {
                write!(
                    f,
                    "the unit is not commissioned, so nothing moves; write its configuration and power it up again"
                )
            }
            Self::AfterReset => write!(
                f,
                "the software was reset and nobody asked for it, so nothing moves; a command to start a run ends this lock"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STORED: Conditions = Conditions { utc_s: Some(1_000_000), temperature_c: 30.0, imu: None };

    fn due(age_s: Option<u64>, temperature_k: Option<f32>, stored: Option<Conditions>, now: Conditions) -> Decision {
        PowerUpPolicy::WhenDue { age_s, temperature_k }.decide(stored, now, None)
    }

    #[test]
    fn policies_without_a_choice() {
        let decide = |policy: PowerUpPolicy, stored| policy.decide(stored, STORED, None);
        assert_eq!(decide(PowerUpPolicy::Always, Some(STORED)), Decision::Calibrate(Cause::Policy));
        for policy in [PowerUpPolicy::Never, PowerUpPolicy::OnCommand] {
            assert_eq!(decide(policy, Some(STORED)), Decision::UseStored(Cause::Policy));
            assert_eq!(decide(policy, None), Decision::StandBy(Cause::Policy));
        }
    }

    #[test]
    fn a_calibration_is_due_by_age_or_temperature() {
        let at = |utc_s, temperature_c| Conditions { utc_s: Some(utc_s), temperature_c, imu: None };
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
        let unknown = Conditions { utc_s: None, temperature_c: f32::NAN, imu: None };
        for (stored, now) in [(STORED, unknown), (unknown, STORED)] {
            let by_age = due(Some(3600), None, Some(stored), now);
            assert_eq!(by_age, Decision::Calibrate(Cause::AgeUnknown));
            let by_temperature = due(None, Some(5.0), Some(stored), now);
            assert_eq!(by_temperature, Decision::Calibrate(Cause::TemperatureUnknown));
        }
        let from_the_future = Conditions { utc_s: Some(1), ..STORED };
        assert_eq!(due(Some(3600), None, Some(STORED), from_the_future), Decision::Calibrate(Cause::AgeUnknown));
    }

    #[test]
    fn a_calibration_of_another_imu_counts_as_none() {
        let imu = |serial| Conditions { imu: Some(ImuIdentity { product: 16495, serial }), ..STORED };
        let cases = [
            (PowerUpPolicy::WhenDue { age_s: None, temperature_k: None }, Decision::Calibrate(Cause::ImuExchanged)),
            (PowerUpPolicy::OnCommand, Decision::StandBy(Cause::ImuExchanged)),
            (PowerUpPolicy::Never, Decision::StandBy(Cause::ImuExchanged)),
            (PowerUpPolicy::Always, Decision::Calibrate(Cause::Policy)),
        ];
        for (policy, decision) in cases {
            assert_eq!(policy.decide(Some(imu(1)), imu(2), None), decision);
        }
        for now in [imu(1), STORED] {
            assert_eq!(due(None, None, Some(imu(1)), now), Decision::UseStored(Cause::WithinLimits));
        }
    }

    #[test]
    fn no_calibration_begins_while_motion_is_locked() {
        for lock in [MotionLock::NotCommissioned, MotionLock::AfterReset] {
            let decide = |stored| PowerUpPolicy::Always.decide(stored, STORED, Some(lock));
            assert_eq!(decide(Some(STORED)), Decision::UseStored(lock.cause()));
            assert_eq!(decide(None), Decision::StandBy(lock.cause()));
        }
    }
}
