//! The core's gimbal control on two simulated motors, a millisecond at a time, with whatever may fail of them.

use crate::kinematics::Motion;
use crate::motor::{Mechanics, Motor};
use rins_selfcal::angle::Angle;
use rins_selfcal::axis::AxisLimits;
use rins_selfcal::gimbal::{BridgeFault, EncoderFault, Gimbal, GimbalStatus, MotionCommand, Sensed};
use rins_selfcal::linear::Real;
use rins_selfcal::servo::{Drive, MotorAndLoad, PERIOD_US};

/// What fails of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The encoder does not answer.
    EncoderSilent,
    /// Every so many frames one is damaged.
    EncoderCrc(u32),
    /// The encoder reports an error.
    EncoderAlarm,
    /// The encoder repeats its last angle, in good frames.
    EncoderFrozen,
    /// The encoder is off by this much, deg.
    EncoderSlip(f64),
    /// The encoder counts the other way.
    EncoderReversed,
    /// The axis is blocked.
    Jammed,
    /// The motor has this part of its torque.
    Weak(f64),
    /// The motor turns the other way.
    MotorReversed,
    /// The bridge keeps its last duty.
    BridgeStuck,
    /// The bridge gives all it has, whatever it is told, while it is not switched off.
    BridgeFull,
    /// The bridge reports too much current.
    Overcurrent,
    /// The bridge takes no commands, and drives nothing.
    BridgeSilent,
    /// Somebody pushes, N m.
    Pushed(f64),
}

/// One axis.
struct PlantAxis {
    motor: Motor,
    trouble: Option<Trouble>,
    /// What the encoder is off, rad.
    encoder_error_rad: f64,
    last_reading: Angle,
    drive: Drive<f64>,
    reads: u32,
}

impl PlantAxis {
    fn new(mechanics: Mechanics, angle_rad: f64) -> Self {
        let motor = Motor::new(mechanics, angle_rad);
        let last_reading = motor.encoder();
        Self { motor, trouble: None, encoder_error_rad: 0.0, last_reading, drive: Drive::Brake, reads: 0 }
    }

    fn read(&mut self) -> Result<Angle, EncoderFault> {
        self.reads = self.reads.wrapping_add(1);
        let mechanics = &self.motor.mechanics;
        let angle_rad = self.motor.angle_rad() + self.encoder_error_rad;
        let reading = match self.trouble {
            Some(Trouble::EncoderSilent) => return Err(EncoderFault::Silent),
            Some(Trouble::EncoderAlarm) => return Err(EncoderFault::Alarm),
            Some(Trouble::EncoderCrc(every)) if self.reads.is_multiple_of(every) => return Err(EncoderFault::Crc),
            Some(Trouble::EncoderFrozen) => self.last_reading,
            Some(Trouble::EncoderSlip(slip_deg)) => mechanics.encoder(angle_rad + slip_deg.to_radians()),
            Some(Trouble::EncoderReversed) => mechanics.encoder(-angle_rad),
            _ => mechanics.encoder(angle_rad),
        };
        self.last_reading = reading;
        Ok(reading)
    }

    fn bridge(&self) -> Result<(), BridgeFault> {
        match self.trouble {
            Some(Trouble::Overcurrent) => Err(BridgeFault::Overcurrent),
            Some(Trouble::BridgeSilent) => Err(BridgeFault::Silent),
            _ => Ok(()),
        }
    }

    /// What the motor gets of what the bridge is told.
    fn driven(&mut self, told: Drive<f64>) -> Drive<f64> {
        let (off, duty) = (told == Drive::Off, if let Drive::Duty(duty) = told { duty } else { 0.0 });
        self.drive = match self.trouble {
            Some(Trouble::BridgeStuck) if !off => self.drive,
            Some(Trouble::BridgeFull) if !off => Drive::Duty(1.0),
            Some(Trouble::BridgeSilent) => Drive::Off,
            Some(Trouble::Weak(part)) if !off => Drive::Duty(duty * part),
            Some(Trouble::MotorReversed) if !off => Drive::Duty(-duty),
            _ => told,
        };
        self.drive
    }
}

/// Both axes and their control.
pub struct GimbalPlant<T: Real> {
    gimbal: Gimbal<T>,
    axes: [PlantAxis; 2],
    now_us: u64,
    readings: [Result<Angle, EncoderFault>; 2],
}

impl<T: Real> GimbalPlant<T> {
    /// At rest at these angles of (outer, inner), rad. The control takes the motors for `assumed`.
    pub fn new(
        limits: &[AxisLimits; 2],
        assumed: &[MotorAndLoad; 2],
        mechanics: [Mechanics; 2],
        angles_rad: [f64; 2],
    ) -> Self {
        let [outer, inner] = mechanics;
        Self {
            gimbal: Gimbal::new(limits, assumed),
            axes: [PlantAxis::new(outer, angles_rad[0]), PlantAxis::new(inner, angles_rad[1])],
            now_us: 0,
            readings: [Err(EncoderFault::Silent); 2],
        }
    }

    /// Lets something fail of an axis, or mends it.
    pub fn set_trouble(&mut self, axis: usize, trouble: Option<Trouble>) {
        let plant = &mut self.axes[axis];
        plant.trouble = trouble;
        plant.motor.jammed = trouble == Some(Trouble::Jammed);
        plant.motor.mechanics.disturbance_nm = if let Some(Trouble::Pushed(torque)) = trouble { torque } else { 0.0 };
    }

    /// What the encoders are off from here on, rad.
    pub fn set_encoder_errors(&mut self, errors_rad: [f64; 2]) {
        for (axis, error_rad) in self.axes.iter_mut().zip(errors_rad) {
            axis.encoder_error_rad = error_rad;
        }
    }

    /// Passes on a command.
    pub fn command(&mut self, command: MotionCommand) {
        self.gimbal.command(command);
    }

    /// As the control has it.
    pub fn status(&self) -> GimbalStatus {
        self.gimbal.status()
    }

    /// What the encoders read in the last control period.
    pub fn readings(&self) -> [Result<Angle, EncoderFault>; 2] {
        self.readings
    }

    /// Time, us.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// True angles, rad.
    pub fn angles_rad(&self) -> [f64; 2] {
        self.axes.each_ref().map(|axis| axis.motor.angle_rad())
    }

    /// True rates, rad/s.
    pub fn rates_rad_s(&self) -> [f64; 2] {
        self.axes.each_ref().map(|axis| axis.motor.rate_rad_s())
    }

    /// Goes on until a time, us, which is not later than the next control period's begin; if it is that, its control is
    /// done. Returns how the axes moved.
    pub fn advance_to(&mut self, time_us: u64) -> Motion {
        let duration_s = (time_us - self.now_us) as f64 * 1e-6;
        let (angles_rad, from_rad_s) = (self.angles_rad(), self.rates_rad_s());
        for axis in &mut self.axes {
            axis.motor.advance(axis.drive, duration_s);
        }
        self.now_us = time_us;
        if time_us.is_multiple_of(PERIOD_US) {
            self.control();
        }
        Motion { angles_rad, from_rad_s, to_rad_s: self.rates_rad_s(), duration_s }
    }

    /// One control period more.
    pub fn period(&mut self) {
        self.advance_to((self.now_us / PERIOD_US + 1) * PERIOD_US);
    }

    /// The control's next look at the axes, us.
    pub fn next_control_us(&self) -> u64 {
        (self.now_us / PERIOD_US + 1) * PERIOD_US
    }

    fn control(&mut self) {
        self.readings = self.axes.each_mut().map(PlantAxis::read);
        let sensed = Sensed { encoders: self.readings, bridges: self.axes.each_ref().map(PlantAxis::bridge) };
        let drives = self.gimbal.control(self.now_us, &sensed);
        for (axis, drive) in self.axes.iter_mut().zip(drives) {
            let told = match drive {
                Drive::Duty(duty) => Drive::Duty(duty.widened()),
                Drive::Brake => Drive::Brake,
                Drive::Off => Drive::Off,
            };
            axis.driven(told);
        }
    }
}
