//! Servo of one axis: a position loop around a rate loop, at a fixed 1 kHz.
//!
//! ```text
//! rate    rate' = rate + a (encoder step / h - rate),  a = h / (h + filter)     the same filter for the profile's rate
//! (s1)    rate setpoint = profile rate + kp (profile angle - encoder angle)
//! (s2)    acceleration  = profile acceleration + kv (e + ki integral of e),  e = rate setpoint - rate
//! (s3)    torque        = inertia acceleration + viscous profile rate + coulomb sign(profile rate),  limited
//! (s4)    duty          = (torque resistance / Kt + Kt rate) / supply,  limited to -1..1
//! ```
//! There is no tachometer. The rate is the filtered step of the encoder and lags by half a control period plus the
//! filter. The profile's rate passes the same filter, so that a ramp causes no error. There is no current loop. (s4)
//! inverts the motor for a constant current, and the time constant of the winding counts as a delay. The integral is
//! held while the torque is at its limit and the integral would drive it further into the limit.
//!
//! Friction holds an axis at rest. So the position of an axis at rest is not corrected inside a band of a few encoder
//! steps. Outside this band an extra torque, the creep torque, grows until the axis moves, and is then removed at once.
//! The axis covers the last arcseconds in small steps, and the integral cannot throw it past the target.
//!
//! Tuning, from motor and load:
//! ```text
//! (s5)    delay  T  = h / 2 (step) + filter + h / 2 (hold) + inductance / resistance,  filter = h
//! (s6)    kv        = 1 / (3 T): phase margin of 64 deg, minus the phase of kp and ki;  kp = ki = kv / 4
//! (s7)    kv       <= 2 % of (highest torque / inertia) / (0.17 encoder step / h): keeps the encoder steps inaudible
//! ```
//! 0.17 encoder steps per period is the standard deviation of the filtered rate if the readings have rounding errors of
//! up to half a step: sqrt(2 a^2 / (2 - a) / 12) with a = 1/2.

use crate::base::angle::{TICKS_PER_TURN, ticks_to_rad};
use crate::base::bounds::{Bounded, DEGREES_PER_S2, MILLISECONDS, Unit};
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
/// Standard deviation of the filtered rate, encoder steps per control period. (s7)
const STEP_NOISE: f64 = 0.166_7;
/// Fraction of the highest torque that the encoder steps may cause; more would be audible. (s7)
const AUDIBLE_FRACTION: f64 = 0.02;
/// Product of rate-loop bandwidth and delay. (s6)
const DELAY_PHASE: f64 = 1.0 / 3.0;
/// Bandwidths of position loop and integral, relative to the bandwidth of the rate loop. (s6)
const POSITION_TO_RATE: f64 = 0.25;
const INTEGRAL_TO_RATE: f64 = 0.25;
/// Half width of the band in which an axis at rest is not corrected: the larger of the two values, in rad and in
/// encoder steps.
const REST_BAND_RAD: f64 = 0.05 * ARCSEC;
const REST_BAND_STEPS: f64 = 1.5;
/// Time in which the creep torque grows by the dry friction, s.
const CREEP_S: f64 = 0.05;
/// Limit of the creep torque, in multiples of the dry friction.
const HIGHEST_CREEP: f64 = 3.0;
/// Rate above which a sticking axis counts as moving, encoder steps per control period.
const MOVING_STEPS: f64 = 0.6;

/// Data of one motor, its load and its encoder. [`MOTOR_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotorAndLoad {
    /// Moment of inertia of all turning parts, kg m^2.
    pub inertia_kg_m2: f64,
    /// Dry friction torque, N m.
    pub coulomb_nm: f64,
    /// Viscous friction, N m s/rad.
    pub viscous_nm_s: f64,
    /// Torque constant, N m/A. The voltage constant has the same value, V s/rad.
    pub torque_constant_nm_a: f64,
    /// Resistance of the winding and the bridge, ohm.
    pub resistance_ohm: f64,
    /// Inductance of the winding, H.
    pub inductance_h: f64,
    /// Supply voltage of the bridge, V.
    pub supply_v: f64,
    /// Highest permitted current of the motor, A.
    pub highest_current_a: f64,
    /// Resolution of the encoder, bits per turn: with 26 the smallest step is 2^-26 turn.
    pub encoder_bits: u8,
}

/// The permitted range of every number of [`MotorAndLoad`], from a small pan-tilt unit to a large rate table, and of the
/// numbers that follow from them and decide whether the servo can control the axis:
///
/// - The electrical time constant counts as a delay. The servo has no current loop, so it must be short.
/// - The acceleration is what the highest torque gives to the load beyond the friction.
/// - Friction that exceeds the inertia by far would throw the axis when it breaks away.
/// - The bandwidth is that of the rate loop; a coarse encoder on a heavy load makes it low.
pub static MOTOR_BOUNDS: [Bounded<MotorAndLoad>; 13] = [
    Bounded::new("moment of inertia", Unit::si("kg m^2"), [1e-5, 1e3], |motor| motor.inertia_kg_m2),
    Bounded::new("dry friction", Unit::si("N m"), [0.0, 1e3], |motor| motor.coulomb_nm),
    Bounded::new("viscous friction", Unit::si("N m s/rad"), [0.0, 1e3], |motor| motor.viscous_nm_s),
    Bounded::new("torque constant", Unit::si("N m/A"), [1e-3, 1e2], |motor| motor.torque_constant_nm_a),
    Bounded::new("resistance", Unit::si("ohm"), [0.01, 1e3], |motor| motor.resistance_ohm),
    Bounded::new("inductance", Unit::si("H"), [0.0, 1.0], |motor| motor.inductance_h),
    Bounded::new("supply voltage", Unit::si("V"), [1.0, 1e3], |motor| motor.supply_v),
    Bounded::new("highest current", Unit::si("A"), [0.01, 1e3], |motor| motor.highest_current_a),
    Bounded::new("encoder resolution", Unit::si("bits"), [16.0, 32.0], |motor| f64::from(motor.encoder_bits)),
    Bounded::new("electrical time constant", MILLISECONDS, [0.0, 10.0], |motor| {
        motor.inductance_h / motor.resistance_ohm
    }),
    Bounded::new("mechanical time constant", MILLISECONDS, [20.0, 1e8], |motor| {
        motor.inertia_kg_m2 * motor.resistance_ohm / (motor.torque_constant_nm_a * motor.torque_constant_nm_a)
    }),
    Bounded::new("acceleration at full torque", DEGREES_PER_S2, [1.0, 2e4], MotorAndLoad::highest_acceleration_rad_s2),
    Bounded::new("bandwidth of the rate loop", Unit::si("rad/s"), [10.0, 1e3], MotorAndLoad::bandwidth_rad_s),
];

impl Default for MotorAndLoad {
    /// A torque motor of 0.6 N m on a gimbal of 0.06 kg m^2, with a 26-bit encoder.
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
    /// Highest acceleration of the load at this rate, rad/s^2, against friction and the voltage that the motor generates.
    pub fn acceleration_at_rad_s2(&self, rate_rad_s: f64) -> f64 {
        let left_v = self.supply_v - self.torque_constant_nm_a * rate_rad_s;
        let current_a = self.highest_current_a.min(left_v / self.resistance_ohm);
        let friction_nm = self.coulomb_nm + self.viscous_nm_s * rate_rad_s;
        (self.torque_constant_nm_a * current_a - friction_nm) / self.inertia_kg_m2
    }

    /// Highest torque at rest, N m. Current limit and supply voltage determine it.
    pub fn highest_torque_nm(&self) -> f64 {
        self.torque_constant_nm_a * self.highest_current_a.min(self.supply_v / self.resistance_ohm)
    }

    /// Highest acceleration of the load after the dry friction has been overcome, rad/s^2.
    pub fn highest_acceleration_rad_s2(&self) -> f64 {
        (self.highest_torque_nm() - self.coulomb_nm) / self.inertia_kg_m2
    }

    /// Smallest step of the encoder, rad.
    pub fn encoder_step_rad(&self) -> f64 {
        (1_u64 << (32 - self.encoder_bits.min(32))) as f64 * (TAU / TICKS_PER_TURN)
    }

    /// Bandwidth of the rate loop, rad/s. (s5) to (s7)
    pub fn bandwidth_rad_s(&self) -> f64 {
        let delay_s = PERIOD_S + FILTER_S + self.inductance_h / self.resistance_ohm;
        let noise_rad_s = STEP_NOISE * self.encoder_step_rad() / PERIOD_S;
        let inaudible_rad_s = AUDIBLE_FRACTION * self.highest_torque_nm() / self.inertia_kg_m2 / noise_rad_s;
        (DELAY_PHASE / delay_s).min(inaudible_rad_s)
    }
}

/// Command to the bridge of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Drive<T> {
    /// Fraction of the supply voltage, -1 to 1. The sign is that of the torque, right-handed about the axis.
    Duty(T),
    /// Winding shorted: a turning motor brakes, and nothing drives it.
    Brake,
    /// Winding open.
    Off,
}

/// Setpoint of the servo.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setpoint<T> {
    /// Angle, counted over whole turns, ticks.
    pub ticks: i64,
    /// Rate and acceleration. The angle in this field is not used.
    pub point: Point<T>,
}

impl<T: Real> Setpoint<T> {
    /// Setpoint at rest at the angle `ticks`.
    pub fn rest(ticks: i64) -> Self {
        Self { ticks, point: Point::default() }
    }
}

/// Control loops of one axis.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Servo<T> {
    gains: Gains<T>,
    /// Filtered rate of the encoder, rad/s.
    rate_rad_s: T,
    /// Filtered rate of the profile, rad/s.
    setpoint_rad_s: T,
    /// Rate of the profile in the control period before, rad/s.
    last_profile_rad_s: T,
    /// Acceleration from the integral, rad/s^2.
    integral_rad_s2: T,
    /// Creep torque, N m.
    creep_nm: T,
}

#[derive(Clone, Debug)]
struct Gains<T> {
    position_per_s: T,
    rate_per_s: T,
    /// Gain of the integral per control period.
    integral: T,
    inertia: T,
    viscous: T,
    coulomb: T,
    highest_torque: T,
    duty_per_torque: T,
    duty_per_rate: T,
    rest_band_rad: T,
    moving_rad_s: T,
}

impl<T: Real> Servo<T> {
    /// Control loops for this motor and load, at rest.
    pub fn new(data: &MotorAndLoad) -> Self {
        let bandwidth = data.bandwidth_rad_s();
        let rest_band_rad = REST_BAND_RAD.max(REST_BAND_STEPS * data.encoder_step_rad());
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
                rest_band_rad: real(rest_band_rad),
                moving_rad_s: real(MOVING_STEPS * data.encoder_step_rad() / PERIOD_S),
            },
            rate_rad_s: T::zero(),
            setpoint_rad_s: T::zero(),
            last_profile_rad_s: T::zero(),
            integral_rad_s2: T::zero(),
            creep_nm: T::zero(),
        }
    }

    /// Takes the movement of the encoder in the last control period, ticks.
    pub fn observe(&mut self, step_ticks: i64) {
        let step_rad_s = ticks_to_rad::<T>(step_ticks) * real(1.0 / PERIOD_S);
        self.rate_rad_s += (step_rad_s - self.rate_rad_s) * real(FILTER_GAIN);
    }

    /// Rate of the axis, rad/s: the filtered encoder step.
    pub fn rate_rad_s(&self) -> T {
        self.rate_rad_s
    }

    /// Rate of the profile, passed through the same filter as the rate of the axis, rad/s.
    pub fn setpoint_rate_rad_s(&self) -> T {
        self.setpoint_rad_s
    }

    /// Forgets everything and begins at this rate of the encoder, rad/s.
    pub fn reset(&mut self, rate_rad_s: T) {
        self.rate_rad_s = rate_rad_s;
        self.restart(T::zero());
    }

    /// Prepares for a new profile with the initial rate `rate_rad_s` and clears the integral.
    pub fn restart(&mut self, rate_rad_s: T) {
        (self.setpoint_rad_s, self.last_profile_rad_s) = (rate_rad_s, rate_rad_s);
        (self.integral_rad_s2, self.creep_nm) = (T::zero(), T::zero());
    }

    /// Duty of the motor bridge for the control period that begins, -1 to 1. `None` if a number of the loop is not
    /// finite; a limited duty would not show that.
    pub fn duty(&mut self, setpoint: &Setpoint<T>, ticks: i64) -> Option<T> {
        let Point { rate_rad_s: profile_rad_s, acceleration_rad_s2, .. } = setpoint.point;
        self.filter_setpoint(profile_rad_s);
        let at_rest = profile_rad_s == T::zero();
        let gains = &self.gains;
        let error_rad: T = ticks_to_rad(setpoint.ticks - ticks);
        let error_rad = if at_rest { outside_band(error_rad, gains.rest_band_rad) } else { error_rad };
        // (s1), (s2)
        let rate_error = gains.position_per_s * error_rad + self.setpoint_rad_s - self.rate_rad_s;
        let acceleration = acceleration_rad_s2 + gains.rate_per_s * rate_error + self.integral_rad_s2;
        // (s3)
        self.creep_nm = if at_rest { self.creep(error_rad) } else { T::zero() };
        let friction = if at_rest { self.creep_nm } else { gains.coulomb.copysign(profile_rad_s) };
        let torque = gains.inertia * acceleration + gains.viscous * profile_rad_s + friction;
        let limited_torque = limited(torque, gains.highest_torque);
        let integrates = limited_torque == torque || (torque > limited_torque) != (rate_error > T::zero());
        if integrates && !(at_rest && error_rad == T::zero()) {
            self.integral_rad_s2 += gains.integral * rate_error;
        }
        // (s4)
        let duty = limited_torque * gains.duty_per_torque + self.rate_rad_s * gains.duty_per_rate;
        (torque.is_finite() && duty.is_finite()).then(|| limited(duty, T::one()))
    }

    fn filter_setpoint(&mut self, profile_rad_s: T) {
        let mean_rad_s = real::<T>(0.5) * (profile_rad_s + self.last_profile_rad_s);
        self.last_profile_rad_s = profile_rad_s;
        self.setpoint_rad_s += (mean_rad_s - self.setpoint_rad_s) * real(FILTER_GAIN);
    }

    /// Creep torque for an axis that is `error_rad` away from its setpoint.
    fn creep(&self, error_rad: T) -> T {
        let gains = &self.gains;
        if error_rad == T::zero() || self.rate_rad_s.abs() > gains.moving_rad_s {
            return T::zero();
        }
        let more = gains.coulomb.copysign(error_rad) * real(PERIOD_S / CREEP_S);
        limited(self.creep_nm + more, gains.coulomb * real(HIGHEST_CREEP))
    }
}

/// The part of `x` outside of `-band..band`.
fn outside_band<T: Real>(x: T, band: T) -> T {
    x - limited(x, band)
}

fn limited<T: Real>(x: T, limit: T) -> T {
    x.max(-limit).min(limit)
}
