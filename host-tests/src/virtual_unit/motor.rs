//! A simulated motor with its load and its encoder.
//!
//! ```text
//! winding   L i' = u V - R i - K w              shorted u = 0; open i = 0
//! load      J w' = K i - b w - c (a - a0) - friction + disturbance
//! friction  F sign(w) while the axis turns; at rest the torque that holds the axis, up to the breakaway torque
//! ```
//! A step is far shorter than the control period and the time constant of the winding. The winding's step is exact for
//! a constant rate. The load's step is an Euler step. The duties of the bridge and the angles of the encoder are
//! quantized.

use rins_selfcal::base::angle::Angle;
use rins_selfcal::gimbal::servo::{Drive, MotorAndLoad};

/// Step of the integration, s.
const STEP_S: f64 = 1e-4;

/// The true parameters of a motor and its load. The controller may assume others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mechanics {
    /// The parameters that a controller knows.
    pub data: MotorAndLoad,
    /// Torque at which an axis at rest begins to move, as a multiple of the friction of a turning axis.
    pub breakaway: f64,
    /// Stiffness of the cables, N m/rad.
    pub spring_nm_rad: f64,
    /// Angle at which the cables exert no torque, rad.
    pub spring_rest_rad: f64,
    /// Number of duty steps from 0 to 1.
    pub duty_steps: f64,
    /// Torque from outside, N m.
    pub disturbance_nm: f64,
}

impl Mechanics {
    /// A motor with the data that the controller assumes, and with properties that the controller does not know: a
    /// breakaway torque a fifth above the friction, cables, and a bridge of 8000 duty steps (20 kHz from a timer of 160
    /// MHz).
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

    /// Reading of the encoder at an angle, rad.
    pub fn encoder(&self, angle_rad: f64) -> Angle {
        let shift = 32 - u32::from(self.data.encoder_bits);
        Angle::from_ticks(Angle::from_rad(angle_rad).ticks() >> shift << shift)
    }
}

/// State of a motor.
#[derive(Clone, Debug)]
pub struct Motor {
    /// The true parameters of motor and load.
    pub mechanics: Mechanics,
    /// Whether the shaft is blocked.
    pub jammed: bool,
    current_a: f64,
    angle_rad: f64,
    rate_rad_s: f64,
    /// Fraction of a current that is left after a step of the usual length.
    kept: f64,
}

impl Motor {
    /// A motor at rest at this angle, rad.
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

    /// Reading of the encoder.
    pub fn encoder(&self) -> Angle {
        self.mechanics.encoder(self.angle_rad)
    }

    /// Turns for `duration_s`. Seen from outside, the rate is linear over this time.
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
        // Friction stops the axis before the axis turns the other way.
        if turning && after * direction < 0.0 { 0.0 } else { after }
    }
}

/// Fraction of a current that is left in a shorted winding after a time, s.
fn kept(data: &MotorAndLoad, time_s: f64) -> f64 {
    if data.inductance_h > 0.0 { (-time_s * data.resistance_ohm / data.inductance_h).exp() } else { 0.0 }
}
