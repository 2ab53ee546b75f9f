//! The servo on a simulated motor: step, ramp, move and hold, and the figures that measure its quality.

use crate::virtual_unit::motor::{Mechanics, Motor};
use rins_selfcal::base::angle::{rad_to_ticks, ticks_to_rad};
use rins_selfcal::base::linear::Real;
use rins_selfcal::base::profile::{MotionLimits, Point, Profile};
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::gimbal::servo::{Drive, MotorAndLoad, PERIOD_S, Servo, Setpoint};

/// The usual limits of moves: 20 deg/s with ramps of a second, and a jerk of 1000 deg/s^3.
pub fn usual_limits() -> MotionLimits {
    MotionLimits::with_mean_acceleration(20.0 * DEG, 20.0 * DEG, 1000.0 * DEG).expect("jerk enough")
}

/// A servo, its motor and the encoder between them.
pub struct ServoBench<T> {
    servo: Servo<T>,
    motor: Motor,
    ticks: i64,
}

/// Values of one control period.
#[derive(Clone, Copy, Debug)]
pub struct Trace {
    /// Start of the period, s.
    pub time_s: f64,
    /// True angle less the wanted angle, rad.
    pub error_rad: f64,
    /// True rate, rad/s.
    pub rate_rad_s: f64,
    /// Duty.
    pub duty: f64,
}

impl<T: Real> ServoBench<T> {
    /// A motor at rest at angle zero, and a servo that assumes the motor data `assumed`.
    pub fn new(assumed: &MotorAndLoad, mechanics: Mechanics) -> Self {
        Self { servo: Servo::new(assumed), motor: Motor::new(mechanics, 0.0), ticks: 0 }
    }

    /// Follows the wanted motion for `duration_s`.
    pub fn follow(&mut self, duration_s: f64, wanted: impl Fn(f64) -> Point<T>) -> Vec<Trace> {
        let periods = (duration_s / PERIOD_S).round() as u32;
        (0..periods).map(|period| self.period(f64::from(period) * PERIOD_S, &wanted)).collect()
    }

    fn period(&mut self, time_s: f64, wanted: &impl Fn(f64) -> Point<T>) -> Trace {
        let encoder = self.motor.encoder();
        let step = encoder.since(rins_selfcal::base::angle::Angle::from_ticks(self.ticks as u32));
        self.ticks += i64::from(step);
        self.servo.observe(step.into());
        let point = wanted(time_s);
        let ticks = rad_to_ticks(point.angle_rad.widened());
        let duty = self.servo.duty(&Setpoint { ticks, point }, self.ticks).expect("a finite duty").widened();
        let trace = Trace {
            time_s,
            error_rad: self.motor.angle_rad() - ticks_to_rad::<f64>(ticks),
            rate_rad_s: self.motor.rate_rad_s(),
            duty,
        };
        self.motor.advance(Drive::Duty(duty), PERIOD_S);
        trace
    }

    /// Turns by `way_deg` and stays at rest for `rest_s`.
    pub fn move_by(&mut self, way_deg: f64, rest_s: f64) -> (f64, Vec<Trace>) {
        let from_rad = ticks_to_rad::<f64>(self.ticks);
        let profile = Profile::<T>::new(T::rounded(way_deg * DEG), &usual_limits());
        let end_s = profile.duration_s().widened();
        let trace = self.follow(end_s + rest_s, |time_s| {
            let point = profile.at(T::rounded(time_s));
            Point { angle_rad: point.angle_rad + T::rounded(from_rad), ..point }
        });
        (end_s, trace)
    }
}

/// Figures of a move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MoveFigures {
    /// Largest deviation from the profile during the move, arcsec.
    pub following_arcsec: f64,
    /// Largest angle beyond the target, arcsec.
    pub overshoot_arcsec: f64,
    /// Time from the end of the profile until the error stays within 2 arcsec, s.
    pub settling_s: f64,
    /// RMS deviation from the target, from 0.5 s after the end of the profile on, arcsec.
    pub hold_rms_arcsec: f64,
    /// Highest duty.
    pub duty: f64,
}

impl MoveFigures {
    /// Figures of the trace of a move by `way_deg` whose profile ends at `end_s`.
    pub fn new(way_deg: f64, end_s: f64, trace: &[Trace]) -> Self {
        let (moving, resting) = trace.split_at(trace.partition_point(|at| at.time_s < end_s));
        let largest = |part: &[Trace], of: &dyn Fn(&Trace) -> f64| part.iter().map(of).fold(0.0, f64::max);
        let late = resting.iter().rev().find(|at| at.error_rad.abs() > 2.0 * ARCSEC);
        let held: Vec<_> = resting.iter().filter(|at| at.time_s > end_s + 0.5).map(|at| at.error_rad).collect();
        let mean_square = held.iter().map(|error| error * error).sum::<f64>() / held.len() as f64;
        Self {
            following_arcsec: largest(moving, &|at| at.error_rad.abs()) / ARCSEC,
            overshoot_arcsec: largest(resting, &|at| at.error_rad * way_deg.signum()) / ARCSEC,
            settling_s: late.map_or(0.0, |at| at.time_s + PERIOD_S - end_s),
            hold_rms_arcsec: mean_square.sqrt() / ARCSEC,
            duty: largest(trace, &|at| at.duty.abs()),
        }
    }

    /// The worse value of both for each figure.
    #[must_use]
    pub fn worse(&self, other: &Self) -> Self {
        Self {
            following_arcsec: self.following_arcsec.max(other.following_arcsec),
            overshoot_arcsec: self.overshoot_arcsec.max(other.overshoot_arcsec),
            settling_s: self.settling_s.max(other.settling_s),
            hold_rms_arcsec: self.hold_rms_arcsec.max(other.hold_rms_arcsec),
            duty: self.duty.max(other.duty),
        }
    }
}
