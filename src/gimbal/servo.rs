//! Position and rate of one axis, held by a motor: a cascade of two loops at a fixed 1 kHz.
//!
//! ```text
//! rate    rate' = rate + a (step of the encoder / h - rate),  a = h / (h + filter)     the profile's rate likewise
//! (s1)    wanted rate  = profile rate + kp (profile angle - encoder angle)
//! (s2)    acceleration = profile acceleration + kv (e + ki integral of e),  e = wanted rate - rate
//! (s3)    torque       = inertia acceleration + viscous profile rate + coulomb sign(profile rate),  within its limit
//! (s4)    duty         = (torque resistance / Kt + Kt rate) / supply,  within -1..1
//! ```
//! There is no tachometer: the rate is the encoder's filtered step, late by half a period and the filter. The profile's rate
//! passes the same filter, so that a ramp leaves no error. There is no current loop either: (s4) inverts the motor at rest
//! in current, and the winding's time constant counts as delay. The integral stands still while the torque is at its limit
//! and would be driven further into it.
//!
//! Friction holds an axis that stands. So at rest, inside a band of a few encoder steps, position is no longer corrected:
//! an axis that stands well enough is left alone. Outside, a torque creeps up until the axis moves, and is taken back at
//! once: it goes the last arcseconds in small steps, and what is stored in the integral does not throw it beyond.
//!
//! Tuning, from motor and load:
//! ```text
//! (s5)    delay  T  = h / 2 (step) + filter + h / 2 (hold) + inductance / resistance,  filter = h
//! (s6)    kv        = 1 / (3 T): 64 deg of phase margin less those of kp and ki;  kp = ki = kv / 4
//! (s7)    kv       <= 2 % of (highest torque / inertia) / (0.17 encoder step / h): the encoder's steps shall not be heard
//! ```
//! 0.17 is the deviation of the filtered rate, in steps per period, of an encoder whose readings are off by anything up
//! to half a step: sqrt(2 a^2 / (2 - a) / 12) at a = 1/2.

use crate::base::angle::{TICKS_PER_TURN, ticks_to_rad};
use crate::base::linear::{Real, real};
use crate::base::profile::Point;
use crate::base::units::ARCSEC;
use core::f64::consts::TAU;
use serde::{Deserialize, Serialize};

/// Control period, us.
pub const PERIOD_US: u64 = 1000;
/// Control period, s.
pub const PERIOD_S: f64 = PERIOD_US as f64 * 1e-6;

/// Time constant of the filter on the rate, s.
const FILTER_S: f64 = PERIOD_S;
const FILTER_GAIN: f64 = PERIOD_S / (PERIOD_S + FILTER_S);
/// Deviation of the filtered rate, encoder steps per period. (s7)
const STEP_NOISE: f64 = 0.166_7;
/// Part of the highest torque that the encoder's steps may cause. (s7)
const HEARD: f64 = 0.02;
/// Bandwidth of the rate loop times the delay. (s6)
const DELAY_PHASE: f64 = 1.0 / 3.0;
/// Bandwidths of position loop and integral to that of the rate loop. (s6)
const POSITION_TO_RATE: f64 = 0.25;
const INTEGRAL_TO_RATE: f64 = 0.25;
/// Band within which an axis at rest is left alone, rad and encoder steps, whichever is more.
const QUIET_RAD: f64 = 0.05 * ARCSEC;
const QUIET_STEPS: f64 = 1.5;
/// Time in which the torque on an axis that sticks grows by its friction, s.
const CREEP_S: f64 = 0.05;
/// Most that it grows to, in frictions.
const MOST_CREEP: f64 = 3.0;
/// Rate at which an axis that stuck moves, encoder steps per period.
const MOVING_STEPS: f64 = 0.6;

/// One motor, its load and its encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorAndLoad {
    /// Everything that turns, kg m^2.
    pub inertia_kg_m2: f64,
    /// Dry friction, N m.
    pub coulomb_nm: f64,
    /// Friction in proportion to the rate, N m s/rad.
    pub viscous_nm_s: f64,
    /// Torque per current, N m/A; also voltage per rate, V s/rad.
    pub torque_constant_nm_a: f64,
    /// Of the winding and the bridge, ohm.
    pub resistance_ohm: f64,
    /// Of the winding, H.
    pub inductance_h: f64,
    /// At the bridge, V.
    pub supply_v: f64,
    /// What the motor may be driven with, A.
    pub highest_current_a: f64,
    /// Smallest step of the encoder, bits of a turn: 26 is 2^-26 turn.
    pub encoder_bits: u8,
}

impl Default for MotorAndLoad {
    /// A torque motor of 0.6 N m on a gimbal of 0.06 kg m^2, with an encoder of 26 bit.
    fn default() -> Self {
        Self {
            inertia_kg_m2: 0.06,
            coulomb_nm: 0.05,
            viscous_nm_s: 0.02,
            torque_constant_nm_a: 0.3,
            resistance_ohm: 6.0,
            inductance_h: 3e-3,
            supply_v: 24.0,
            highest_current_a: 2.0,
            encoder_bits: 26,
        }
    }
}

impl MotorAndLoad {
    /// Whether every number is finite, what must be is positive, and the motor can overcome its friction.
    pub fn is_valid(&self) -> bool {
        let positive = [
            self.inertia_kg_m2,
            self.torque_constant_nm_a,
            self.resistance_ohm,
            self.supply_v,
            self.highest_current_a,
            self.highest_torque_nm() - self.coulomb_nm,
        ];
        let not_negative = [self.coulomb_nm, self.viscous_nm_s, self.inductance_h];
        positive.iter().all(|x| x.is_finite() && *x > 0.0)
            && not_negative.iter().all(|x| x.is_finite() && *x >= 0.0)
            && (8..=32).contains(&self.encoder_bits)
    }

    /// At rest, N m: what current and supply allow.
    pub fn highest_torque_nm(&self) -> f64 {
        self.torque_constant_nm_a * self.highest_current_a.min(self.supply_v / self.resistance_ohm)
    }

    /// Acceleration that is left over for a load whose friction is known, rad/s^2.
    pub fn highest_acceleration_rad_s2(&self) -> f64 {
        (self.highest_torque_nm() - self.coulomb_nm) / self.inertia_kg_m2
    }

    /// Step of the encoder, rad.
    pub fn encoder_step_rad(&self) -> f64 {
        (1_u64 << (32 - self.encoder_bits.min(32))) as f64 * (TAU / TICKS_PER_TURN)
    }

    /// Bandwidth of the rate loop, rad/s. (s5) to (s7)
    pub fn bandwidth_rad_s(&self) -> f64 {
        let delay_s = PERIOD_S + FILTER_S + self.inductance_h / self.resistance_ohm;
        let noise_rad_s = STEP_NOISE * self.encoder_step_rad() / PERIOD_S;
        let heard = HEARD * self.highest_torque_nm() / self.inertia_kg_m2 / noise_rad_s;
        (DELAY_PHASE / delay_s).min(heard)
    }
}

/// What the bridge of a motor is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive<T> {
    /// This part of the supply, -1..1; the sign is that of the torque, right-handed about the axis.
    Duty(T),
    /// The winding shorted: the motor brakes, and nothing drives it.
    Brake,
    /// The winding open.
    Off,
}

/// What the servo shall follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint<T> {
    /// Angle, counted over whole turns, ticks.
    pub ticks: i64,
    /// Rate and acceleration there; its angle is not looked at.
    pub point: Point<T>,
}

impl<T: Real> Setpoint<T> {
    /// Rest at an angle.
    pub fn rest(ticks: i64) -> Self {
        Self { ticks, point: Point::default() }
    }
}

/// The loops of one axis.
#[derive(Clone, Debug)]
pub struct Servo<T> {
    gains: Gains<T>,
    /// Of the encoder, filtered, rad/s.
    rate_rad_s: T,
    /// Of the profile, filtered, rad/s.
    wanted_rad_s: T,
    before_rad_s: T,
    /// The integral's part of the acceleration, rad/s^2.
    integral_rad_s2: T,
    /// Torque on an axis that sticks, N m.
    creep_nm: T,
}

#[derive(Clone, Debug)]
struct Gains<T> {
    position_per_s: T,
    rate_per_s: T,
    /// Of the integral, per control period.
    integral: T,
    inertia: T,
    viscous: T,
    coulomb: T,
    highest_torque: T,
    duty_per_torque: T,
    duty_per_rate: T,
    quiet_rad: T,
    moving_rad_s: T,
}

impl<T: Real> Servo<T> {
    /// The loops for this motor and load, at rest.
    pub fn new(data: &MotorAndLoad) -> Self {
        let bandwidth = data.bandwidth_rad_s();
        let quiet_rad = QUIET_RAD.max(QUIET_STEPS * data.encoder_step_rad());
        Self {
            gains: Gains {
                position_per_s: real(POSITION_TO_RATE * bandwidth),
                rate_per_s: real(bandwidth),
                integral: real(INTEGRAL_TO_RATE * bandwidth * bandwidth * PERIOD_S),
                inertia: real(data.inertia_kg_m2),
                viscous: real(data.viscous_nm_s),
                coulomb: real(data.coulomb_nm),
                highest_torque: real(data.highest_torque_nm()),
                duty_per_torque: real(data.resistance_ohm / data.torque_constant_nm_a / data.supply_v),
                duty_per_rate: real(data.torque_constant_nm_a / data.supply_v),
                quiet_rad: real(quiet_rad),
                moving_rad_s: real(MOVING_STEPS * data.encoder_step_rad() / PERIOD_S),
            },
            rate_rad_s: T::zero(),
            wanted_rad_s: T::zero(),
            before_rad_s: T::zero(),
            integral_rad_s2: T::zero(),
            creep_nm: T::zero(),
        }
    }

    /// Takes in how far the encoder went in the last period, ticks.
    pub fn observe(&mut self, step_ticks: i64) {
        let step_rad_s = ticks_to_rad::<T>(step_ticks) * real(1.0 / PERIOD_S);
        self.rate_rad_s += (step_rad_s - self.rate_rad_s) * real(FILTER_GAIN);
    }

    /// Rate of the axis, rad/s: the filtered step of the encoder.
    pub fn rate_rad_s(&self) -> T {
        self.rate_rad_s
    }

    /// The rate as the profile has it, filtered as that of the encoder, rad/s.
    pub fn wanted_rate_rad_s(&self) -> T {
        self.wanted_rad_s
    }

    /// Begins anew with a profile that has this rate: nothing is left of the integral.
    pub fn restart(&mut self, rate_rad_s: T) {
        (self.wanted_rad_s, self.before_rad_s) = (rate_rad_s, rate_rad_s);
        (self.integral_rad_s2, self.creep_nm) = (T::zero(), T::zero());
    }

    /// Duty of the motor's bridge for the period that begins, -1..1.
    pub fn duty(&mut self, wanted: &Setpoint<T>, ticks: i64) -> T {
        let Point { rate_rad_s: profile_rad_s, acceleration_rad_s2, .. } = wanted.point;
        self.filter_wanted(profile_rad_s);
        let rests = profile_rad_s == T::zero();
        let gains = &self.gains;
        let error_rad: T = ticks_to_rad(wanted.ticks - ticks);
        let error_rad = if rests { beyond(error_rad, gains.quiet_rad) } else { error_rad };
        // (s1), (s2)
        let rate_error = gains.position_per_s * error_rad + self.wanted_rad_s - self.rate_rad_s;
        let acceleration = acceleration_rad_s2 + gains.rate_per_s * rate_error + self.integral_rad_s2;
        // (s3)
        self.creep_nm = if rests { self.creep(error_rad) } else { T::zero() };
        let friction = if rests { self.creep_nm } else { gains.coulomb.copysign(profile_rad_s) };
        let torque = gains.inertia * acceleration + gains.viscous * profile_rad_s + friction;
        let within = limited(torque, gains.highest_torque);
        let integrates = within == torque || (torque > within) != (rate_error > T::zero());
        if integrates && !(rests && error_rad == T::zero()) {
            self.integral_rad_s2 += gains.integral * rate_error;
        }
        // (s4)
        limited(within * gains.duty_per_torque + self.rate_rad_s * gains.duty_per_rate, T::one())
    }

    fn filter_wanted(&mut self, profile_rad_s: T) {
        let mean_rad_s = real::<T>(0.5) * (profile_rad_s + self.before_rad_s);
        self.before_rad_s = profile_rad_s;
        self.wanted_rad_s += (mean_rad_s - self.wanted_rad_s) * real(FILTER_GAIN);
    }

    /// Torque on an axis that may stick, this far from where it shall be.
    fn creep(&self, error_rad: T) -> T {
        let gains = &self.gains;
        if error_rad == T::zero() || self.rate_rad_s.abs() > gains.moving_rad_s {
            return T::zero();
        }
        let more = gains.coulomb.copysign(error_rad) * real(PERIOD_S / CREEP_S);
        limited(self.creep_nm + more, gains.coulomb * real(MOST_CREEP))
    }
}

/// What of `x` is beyond `-band..band`.
fn beyond<T: Real>(x: T, band: T) -> T {
    x - limited(x, band)
}

fn limited<T: Real>(x: T, limit: T) -> T {
    x.max(-limit).min(limit)
}
