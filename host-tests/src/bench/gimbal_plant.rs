//! The core's gimbal control and its drivers on two simulated motors, in steps of a millisecond.

use super::devices::{Bench, BenchControl, SharedBench, Trouble, control};
use crate::virtual_unit::motor::{Mechanics, Motor};
use crate::virtual_unit::plant::{Output, Plant, Tick};
use rins_selfcal::base::linear::Real;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::{MotorAndLoad, PERIOD_S};
use rins_selfcal::gimbal::{Gimbal, GimbalStatus, LocateError, MotionCommand};
use std::cell::RefCell;
use std::rc::Rc;

/// Two motors without an IMU.
struct Motors([Motor; 2]);

impl Plant for Motors {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        for (motor, output) in self.0.iter_mut().zip(outputs) {
            motor.advance(output.into(), PERIOD_S);
        }
        Some(Tick { encoders_rad: self.0.each_ref().map(Motor::angle_rad), reading: None })
    }
}

/// Both axes and their control.
pub struct GimbalPlant<T: Real> {
    bench: SharedBench<Motors>,
    control: BenchControl<T, Motors>,
}

impl<T: Real> GimbalPlant<T> {
    /// Axes at rest at these angles of (outer, inner), rad. The control assumes the motor data `assumed`.
    pub fn new(
        limits: &[AxisLimits; 2],
        assumed: &[MotorAndLoad; 2],
        [outer, inner]: [Mechanics; 2],
        angles_rad: [f64; 2],
    ) -> Self {
        let motors = Motors([Motor::new(outer, angles_rad[0]), Motor::new(inner, angles_rad[1])]);
        let bench = Rc::new(RefCell::new(Bench::new(motors)));
        let control = control(&bench, Gimbal::new(limits, assumed));
        Self { bench, control }
    }

    /// Sets the fault of an axis' encoder or bridge. `None` repairs the axis.
    pub fn set_trouble(&mut self, axis: usize, trouble: Option<Trouble>) {
        self.bench.borrow_mut().set_trouble(axis, trouble);
    }

    /// Changes the motor of an axis.
    pub fn with_motor(&mut self, axis: usize, change: impl FnOnce(&mut Motor)) {
        change(&mut self.bench.borrow_mut().plant_mut().0[axis]);
    }

    /// Passes on a command.
    pub fn command(&mut self, command: MotionCommand) {
        self.control.command(command, self.control.status().time_us);
    }

    /// Tells the control at which angles of (outer, inner) the axes stand, within 1 arcmin, rad.
    ///
    /// # Errors
    /// The axis that was not located, and why.
    pub fn locate(&mut self, angles_rad: [f64; 2]) -> Result<(), LocateError> {
        self.control.locate(angles_rad.map(Some), 60.0 * ARCSEC)
    }

    /// Status of the gimbal as the control reports it.
    pub fn status(&self) -> GimbalStatus {
        self.control.status()
    }

    /// True angles of (outer, inner), rad.
    pub fn angles_rad(&self) -> [f64; 2] {
        self.bench.borrow().plant().0.each_ref().map(Motor::angle_rad)
    }

    /// True rates of (outer, inner), rad/s.
    pub fn rates_rad_s(&self) -> [f64; 2] {
        self.bench.borrow().plant().0.each_ref().map(Motor::rate_rad_s)
    }

    /// Number of times that a direction changed while its PWM was on.
    pub fn hard_turns(&self) -> u32 {
        self.bench.borrow().hard_turns()
    }

    /// Advances by a control period.
    pub fn period(&mut self) {
        self.bench.borrow_mut().period();
        let now_us = self.bench.borrow().now_us();
        self.control.on_period(|| now_us);
    }
}
