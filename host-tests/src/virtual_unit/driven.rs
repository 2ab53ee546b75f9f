//! The virtual RINS with motors on its axes, in closed loop.
//!
//! The windings drive the motors against friction and cables. The encoders read the angles with their errors. The IMU
//! senses the mean of the true motion over its interval, including all motion that a servo causes.

use super::kinematics::{Motion, Sensed};
use super::motor::{Mechanics, Motor};
use super::plant::{Plant, Reading, Tick};
use super::unit::VirtualUnit;
use super::vec3::{Vec3, add_scaled, scale};
use super::virtual_rins::VirtualRins;
use crate::virtual_unit::plant::Output;
use rins_selfcal::gimbal::servo::{Drive, MotorAndLoad, PERIOD_S, PERIOD_US};

/// A unit with its motors.
pub struct DrivenRins {
    rins: VirtualRins,
    motors: [Motor; 2],
    now_us: u64,
    /// Integral of the sensors' input over the present interval.
    felt: Sensed<Vec3>,
    /// Encoder readings at the middle of the interval, rad.
    at_stamp_rad: [f64; 2],
}

impl DrivenRins {
    /// Puts a unit into operation with its axes at rest at (0, 0). Every random number comes from `seed`.
    pub fn new(unit: &VirtualUnit, seed: u64) -> Self {
        Self::with_mechanics(unit, seed, [Mechanics::of(MotorAndLoad::default()); 2])
    }

    /// As [`DrivenRins::new`], with these motors and loads.
    pub fn with_mechanics(unit: &VirtualUnit, seed: u64, mechanics: [Mechanics; 2]) -> Self {
        Self {
            rins: VirtualRins::with_encoder_rate(unit, seed, PERIOD_S.recip()),
            motors: mechanics.map(|mechanics| Motor::new(mechanics, 0.0)),
            now_us: 0,
            felt: NOTHING,
            at_stamp_rad: [0.0; 2],
        }
    }

    /// Starts with the axes at rest at these angles of (outer, inner), rad, in place of (0, 0).
    #[must_use]
    pub fn standing_at(mut self, angles_rad: [f64; 2]) -> Self {
        for (motor, angle_rad) in self.motors.iter_mut().zip(angles_rad) {
            *motor = Motor::new(motor.mechanics, angle_rad);
        }
        Self { rins: self.rins.standing_at(angles_rad), ..self }
    }

    /// As [`VirtualRins::expect_moves`].
    pub fn expect_moves(&mut self, durations_s: &[f64]) {
        self.rins.expect_moves(durations_s);
    }

    /// The unit without its motors.
    pub fn rins(&self) -> &VirtualRins {
        &self.rins
    }

    /// The motor of an axis.
    pub fn motor_mut(&mut self, axis: usize) -> &mut Motor {
        &mut self.motors[axis]
    }

    /// True angles of (outer, inner), rad.
    pub fn true_angles_rad(&self) -> [f64; 2] {
        self.motors.each_ref().map(Motor::angle_rad)
    }

    /// True rates of (outer, inner), rad/s.
    pub fn true_rates_rad_s(&self) -> [f64; 2] {
        self.motors.each_ref().map(Motor::rate_rad_s)
    }

    /// End of the IMU's present interval, us.
    fn interval_end_us(&self) -> u64 {
        ((self.rins.samples + 1) as f64 * self.rins.interval_s * 1e6).round() as u64
    }

    fn stamp_us(&self) -> u64 {
        ((self.rins.samples as f64 + 0.5) * self.rins.interval_s * 1e6).round() as u64
    }

    /// Advances the motors to a time, us, at most to the end of the interval.
    fn turn_until(&mut self, drives: [Drive<f64>; 2], time_us: u64) {
        let duration_s = (time_us - self.now_us) as f64 * 1e-6;
        let (angles_rad, from_rad_s) = (self.true_angles_rad(), self.true_rates_rad_s());
        for (motor, drive) in self.motors.iter_mut().zip(drives) {
            motor.advance(drive, duration_s);
        }
        let motion = Motion { angles_rad, from_rad_s, to_rad_s: self.true_rates_rad_s(), duration_s };
        let stamp_us = self.stamp_us();
        if (self.now_us..time_us).contains(&stamp_us) {
            let part = (stamp_us - self.now_us) as f64 / (time_us - self.now_us) as f64;
            self.at_stamp_rad = self.rins.seen_rad(motion.angles_at(part));
        }
        let felt = self.rins.feel(&motion, (self.now_us as f64 * 1e-6) + 0.5 * duration_s);
        self.felt = Sensed {
            force_a: add_scaled(self.felt.force_a, felt.force_a, duration_s),
            omega_g: add_scaled(self.felt.omega_g, felt.omega_g, duration_s),
        };
        self.now_us = time_us;
    }

    fn reading(&mut self) -> Reading {
        let [outer_rad, inner_rad] = self.at_stamp_rad;
        let felt = std::mem::replace(&mut self.felt, NOTHING);
        let mean = |integral| scale(integral, self.rins.interval_s.recip());
        let mean = Sensed { force_a: mean(felt.force_a), omega_g: mean(felt.omega_g) };
        Reading { outer_rad, inner_rad, ..self.rins.measured(mean) }
    }
}

const NOTHING: Sensed<Vec3> = Sensed { force_a: [0.0; 3], omega_g: [0.0; 3] };

impl Plant for DrivenRins {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        let drives = outputs.map(Drive::from);
        let end_us = self.now_us + PERIOD_US;
        let mut reading = None;
        while self.now_us < end_us {
            let interval_end_us = self.interval_end_us();
            self.turn_until(drives, end_us.min(interval_end_us));
            if self.now_us == interval_end_us {
                reading = Some(self.reading());
            }
        }
        self.rins.encoder.step(self.true_rates_rad_s());
        Some(Tick { encoders_rad: self.rins.seen_rad(self.true_angles_rad()), reading })
    }
}
