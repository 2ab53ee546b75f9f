//! A motor, its load and its encoder, in numbers only.
//!
//! ```text
//! winding   L i' = u V - R i - K w              shorted u = 0; open i = 0
//! load      J w' = K i - b w - c (a - a0) - friction + disturbance
//! friction  F sign(w) while it turns; at rest whatever holds it, up to the breakaway torque
//! ```
//! A step is far below the control period and the winding's time constant: the winding's is exact for a constant rate, the
//! load's is Euler's. The bridge knows a number of duties, the encoder a number of angles.

use rins_selfcal::base::angle::Angle;
use rins_selfcal::gimbal::servo::{Drive, MotorAndLoad};

/// Step of the integration, s.
const STEP_S: f64 = 1e-4;

/// What a motor and its load are, whatever the controller takes them for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mechanics {
    /// The part that a controller knows.
    pub data: MotorAndLoad,
    /// Torque at which an axis at rest begins to move, to the friction of one that turns.
    pub breakaway: f64,
    /// Of the cables, N m/rad.
    pub spring_nm_rad: f64,
    /// Angle at which the cables are at ease, rad.
    pub spring_rest_rad: f64,
    /// Duties from 0 to 1.
    pub duty_steps: f64,
    /// Torque from outside, N m.
    pub disturbance_nm: f64,
}

impl Mechanics {
    /// As the controller takes it, with what it does not know: breakaway a fifth above the friction, cables, a bridge of
    /// 8000 duties, as of 20 kHz from a timer of 160 MHz.
    pub fn of(data: MotorAndLoad) -> Self {
        Self {
            data,
            breakaway: 1.2,
            spring_nm_rad: 0.004,
            spring_rest_rad: 0.3,
            duty_steps: 8000.0,
            disturbance_nm: 0.0,
        }
    }

    /// What the encoder reads at an angle, rad.
    pub fn encoder(&self, angle_rad: f64) -> Angle {
        let shift = 32 - u32::from(self.data.encoder_bits);
        Angle::from_ticks(Angle::from_rad(angle_rad).ticks() >> shift << shift)
    }
}

/// A motor that turns.
#[derive(Clone, Debug)]
pub struct Motor {
    /// What it is.
    pub mechanics: Mechanics,
    /// Its shaft does not turn.
    pub jammed: bool,
    current_a: f64,
    angle_rad: f64,
    rate_rad_s: f64,
    /// What is left of a current after a usual step.
    kept: f64,
}

impl Motor {
    /// At rest at this angle, rad.
    pub fn new(mechanics: Mechanics, angle_rad: f64) -> Self {
        let kept = kept(&mechanics.data, STEP_S);
        Self { mechanics, jammed: false, current_a: 0.0, angle_rad, rate_rad_s: 0.0, kept }
    }

    /// Angle, rad.
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// Rate, rad/s.
    pub fn rate_rad_s(&self) -> f64 {
        self.rate_rad_s
    }

    /// Current, A.
    pub fn current_a(&self) -> f64 {
        self.current_a
    }

    /// What its encoder reads.
    pub fn encoder(&self) -> Angle {
        self.mechanics.encoder(self.angle_rad)
    }

    /// Turns for `duration_s`. From outside it is as if the rate had gone linearly from one end to the other.
    pub fn advance(&mut self, drive: Drive<f64>, duration_s: f64) {
        let steps = (duration_s / STEP_S - 1e-6).ceil().max(1.0);
        let (start_rad, start_rad_s) = (self.angle_rad, self.rate_rad_s);
        for _ in 0..steps as u32 {
            self.step(drive, duration_s / steps);
        }
        self.angle_rad = start_rad + 0.5 * (start_rad_s + self.rate_rad_s) * duration_s;
    }

    fn step(&mut self, drive: Drive<f64>, step_s: f64) {
        self.current_a = self.current_after(drive, step_s);
        let before_rad_s = self.rate_rad_s;
        self.rate_rad_s = if self.jammed { 0.0 } else { self.rate_after(step_s) };
        self.angle_rad += 0.5 * (before_rad_s + self.rate_rad_s) * step_s;
    }

    fn current_after(&self, drive: Drive<f64>, step_s: f64) -> f64 {
        let Mechanics { data, duty_steps, .. } = &self.mechanics;
        let duty = match drive {
            Drive::Duty(duty) => (duty.clamp(-1.0, 1.0) * duty_steps).round() / duty_steps,
            Drive::Brake => 0.0,
            Drive::Off => return 0.0,
        };
        let end_a = (duty * data.supply_v - data.torque_constant_nm_a * self.rate_rad_s) / data.resistance_ohm;
        end_a + (self.current_a - end_a) * if (step_s - STEP_S).abs() < 1e-12 { self.kept } else { kept(data, step_s) }
    }

    fn rate_after(&self, step_s: f64) -> f64 {
        let Mechanics { data, breakaway, spring_nm_rad, spring_rest_rad, disturbance_nm, .. } = &self.mechanics;
        let torque_nm = data.torque_constant_nm_a * self.current_a
            - data.viscous_nm_s * self.rate_rad_s
            - spring_nm_rad * (self.angle_rad - spring_rest_rad)
            + disturbance_nm;
        let turning = self.rate_rad_s != 0.0;
        if !turning && torque_nm.abs() <= data.coulomb_nm * breakaway {
            return 0.0;
        }
        let direction = if turning { self.rate_rad_s } else { torque_nm }.signum();
        let after = self.rate_rad_s + (torque_nm - direction * data.coulomb_nm) / data.inertia_kg_m2 * step_s;
        // It comes to rest before it turns the other way.
        if turning && after * direction < 0.0 { 0.0 } else { after }
    }
}

/// What a shorted winding leaves of a current after a time, s.
fn kept(data: &MotorAndLoad, time_s: f64) -> f64 {
    if data.inductance_h > 0.0 { (-time_s * data.resistance_ohm / data.inductance_h).exp() } else { 0.0 }
}
