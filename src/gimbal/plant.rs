//! Two simulated motors under control, for tests of the closed loop.
//!
//! The winding's step is exact for a constant rate, the load's step is an Euler step. Encoders and duties are quantized.
//! An axis at rest breaks away at a fifth above its friction.

use super::both_axes::{Gimbal, GimbalInputs, MotionCommand};
use super::fault::EncoderFault;
use super::servo::{Drive, MotorAndLoad, PERIOD_S, PERIOD_US};
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::units::DEG;
use crate::gimbal::axis::AxisLimits;

const STEPS: u32 = 10;
const STEP_S: f64 = PERIOD_S / STEPS as f64;
const BREAKAWAY: f64 = 1.2;
const DUTY_STEPS: f64 = 8000.0;

/// A motor with its load and its encoder.
pub(super) struct Motor {
    pub data: MotorAndLoad,
    pub angle_rad: f64,
    pub rate_rad_s: f64,
    /// Torque from outside, N m.
    pub disturbance_nm: f64,
    current_a: f64,
}

impl Motor {
    pub fn new(data: MotorAndLoad, angle_rad: f64) -> Self {
        Self { data, angle_rad, rate_rad_s: 0.0, disturbance_nm: 0.0, current_a: 0.0 }
    }

    fn encoder(&self) -> Angle {
        let shift = 32 - u32::from(self.data.encoder_bits);
        Angle::from_ticks(Angle::from_rad(self.angle_rad).ticks() >> shift << shift)
    }

    fn period<T: Real>(&mut self, drive: Drive<T>) {
        (0..STEPS).for_each(|_| self.step(drive));
    }

    fn step<T: Real>(&mut self, drive: Drive<T>) {
        let MotorAndLoad { torque_constant_nm_a: k, resistance_ohm: r, .. } = self.data;
        let driven = |voltage_v: f64| {
            let end_a = (voltage_v - k * self.rate_rad_s) / r;
            let kept = if self.data.inductance_h > 0.0 { (-STEP_S * r / self.data.inductance_h).exp() } else { 0.0 };
            end_a + (self.current_a - end_a) * kept
        };
        self.current_a = match drive {
            Drive::Duty(duty) => {
                assert!(duty.widened().abs() <= 1.0, "duty {duty:?}");
                driven((duty.widened() * DUTY_STEPS).round() / DUTY_STEPS * self.data.supply_v)
            }
            Drive::Brake => driven(0.0),
            Drive::Off => 0.0,
        };
        self.turn(k * self.current_a + self.disturbance_nm);
    }

    fn turn(&mut self, torque_nm: f64) {
        let MotorAndLoad { coulomb_nm, viscous_nm_s, inertia_kg_m2, .. } = self.data;
        let turning = self.rate_rad_s != 0.0;
        if !turning && torque_nm.abs() <= BREAKAWAY * coulomb_nm {
            return;
        }
        let direction = if turning { self.rate_rad_s } else { torque_nm }.signum();
        // Implicit in the viscous friction, so that a large one is stable.
        let free = self.rate_rad_s + (torque_nm - direction * coulomb_nm) / inertia_kg_m2 * STEP_S;
        let after = free / (1.0 + viscous_nm_s / inertia_kg_m2 * STEP_S);
        let before =
            core::mem::replace(&mut self.rate_rad_s, if turning && after * direction < 0.0 { 0.0 } else { after });
        self.angle_rad += 0.5 * (before + self.rate_rad_s) * STEP_S;
    }
}

/// A gimbal on two motors.
pub(super) struct Plant<T: Real> {
    pub gimbal: Gimbal<T>,
    pub motors: [Motor; 2],
    /// Replaces the readings of an encoder while it is set.
    pub encoders: [Option<Result<Angle, EncoderFault>>; 2],
    pub now_us: u64,
    pub drives: [Drive<T>; 2],
    /// Highest duty, rate (rad/s) and angles (rad) of either axis since [`Plant::watch`].
    pub highest_duty: f64,
    pub highest_rate_rad_s: f64,
    pub range_rad: [f64; 2],
}

impl<T: Real> Plant<T> {
    /// Motors at rest at these angles. Motors and control agree on the data.
    pub fn new(limits: [AxisLimits; 2], data: [MotorAndLoad; 2], at_deg: [f64; 2]) -> Self {
        let [outer, inner] = at_deg.map(|at| at * DEG);
        let mut plant = Self {
            gimbal: Gimbal::new(&limits, &data),
            motors: [Motor::new(data[0], outer), Motor::new(data[1], inner)],
            encoders: [None; 2],
            now_us: 0,
            drives: [Drive::Brake; 2],
            highest_duty: 0.0,
            highest_rate_rad_s: 0.0,
            range_rad: [0.0; 2],
        };
        plant.watch();
        plant
    }

    /// Default motors.
    pub fn usual(limits: [AxisLimits; 2], at_deg: [f64; 2]) -> Self {
        Self::new(limits, [MotorAndLoad::default(); 2], at_deg)
    }

    /// Forgets the highest values so far.
    pub fn watch(&mut self) {
        (self.highest_duty, self.highest_rate_rad_s) = (0.0, 0.0);
        self.range_rad = [f64::INFINITY, f64::NEG_INFINITY];
    }

    /// Runs `count` control periods.
    pub fn run(&mut self, count: u32) {
        (0..count).for_each(|_| self.period());
    }

    fn period(&mut self) {
        self.now_us += PERIOD_US;
        let encoders = [0, 1].map(|axis: usize| self.encoders[axis].unwrap_or(Ok(self.motors[axis].encoder())));
        self.drives = self.gimbal.control(self.now_us, &GimbalInputs { encoders, bridges: [Ok(()); 2] });
        for (motor, drive) in self.motors.iter_mut().zip(self.drives) {
            if let Drive::Duty(duty) = drive {
                self.highest_duty = self.highest_duty.max(duty.widened().abs());
            }
            motor.period(drive);
            self.highest_rate_rad_s = self.highest_rate_rad_s.max(motor.rate_rad_s.abs());
            self.range_rad = [self.range_rad[0].min(motor.angle_rad), self.range_rad[1].max(motor.angle_rad)];
        }
    }

    /// Gives a command and runs the axes for half a second.
    pub fn hold(&mut self) {
        self.gimbal.command(MotionCommand::Hold);
        self.run(500);
    }

    /// Begins a move at 20 deg/s.
    pub fn begin_move(&mut self, outer_deg: f64, inner_deg: f64) {
        self.gimbal.command(MotionCommand::MoveTo {
            angles_rad: [outer_deg * DEG, inner_deg * DEG],
            rate_rad_s: 20.0 * DEG,
            acceleration_rad_s2: 20.0 * DEG,
        });
    }

    /// Moves and waits until both axes have arrived, at most 80 s, or until there is a fault.
    pub fn move_to(&mut self, outer_deg: f64, inner_deg: f64) {
        self.begin_move(outer_deg, inner_deg);
        for _ in 0..80_000 {
            self.period();
            if self.gimbal.status().arrived || self.gimbal.status().fault.is_some() {
                break;
            }
        }
        self.run(300);
    }

    /// Turns an axis by hand, at 30 deg/s.
    pub fn push_to(&mut self, axis: usize, to_deg: f64) {
        while (self.motors[axis].angle_rad / DEG - to_deg).abs() > 0.02 {
            self.motors[axis].angle_rad += (0.03 * DEG).copysign(to_deg * DEG - self.motors[axis].angle_rad);
            self.run(1);
        }
        self.run(100);
    }

    /// True angles, deg.
    pub fn at_deg(&self) -> [f64; 2] {
        self.motors.each_ref().map(|motor| motor.angle_rad / DEG)
    }

    /// Whether both axes are held within 5 arcsec of these true angles, deg, with or without a fault.
    pub fn is_held_at(&self, at_deg: [f64; 2]) -> bool {
        let near = self.at_deg().iter().zip(at_deg).all(|(at, wanted)| (at - wanted).abs() < 1.5e-3);
        near && self.drives.iter().all(|drive| matches!(drive, Drive::Duty(_)))
    }

    /// Whether both axes are held within 5 arcsec of these true angles, deg, without a fault.
    pub fn is_at(&self, outer_deg: f64, inner_deg: f64) -> bool {
        self.is_held_at([outer_deg, inner_deg]) && self.gimbal.status().fault.is_none()
    }
}
