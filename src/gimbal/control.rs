//! Work of the control interrupt, once a millisecond: encoders -> gimbal -> bridges. It also records the angles, from
//! which the IMU interrupt takes the angles of its samples.
//!
//! Three users share a [`Control`] on one processor: the control interrupt calls [`Control::on_period`], the IMU
//! interrupt calls [`Control::view`], and the main loop calls [`Control::command`]. Each call runs in a critical
//! section. The critical section of the control interrupt is the longest, but nothing may interrupt this interrupt
//! anyway; the others last microseconds.
//!
//! Every sample carries its own gimbal status, and a command takes effect [`COMMAND_DELAY_US`] after the status from
//! which it was computed. So a run depends only on its samples, and not on the speed of the main loop.

use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::loss::LossReason;
use crate::drivers::biss::{self, BissEncoder};
use crate::drivers::bridge::{self, Bridge};
use crate::gimbal::angle_history::AngleHistory;
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::{Drive, MotorAndLoad};
use crate::gimbal::{BridgeFault, EncoderFault, Gimbal, GimbalInputs, GimbalStatus, LocateError, MotionCommand};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;
use embedded_hal::spi::SpiDevice;
use heapless::Deque;

/// Delay from the status from which a command was computed until the command takes effect, us: two sample intervals at
/// 200 Hz. The main loop needs less time for a sample, except when it stores or solves; then both axes are at rest.
pub const COMMAND_DELAY_US: u64 = 10_000;
/// Capacity for waiting commands. The main loop gives at most one command per sample.
const COMMANDS: usize = 8;

/// Interface to the bridge of a motor.
pub trait MotorBridge {
    /// Applies a command to the motor from now on. The control calls this function once in every control period.
    ///
    /// # Errors
    /// The bridge refused the command, for the returned reason.
    fn drive(&mut self, drive: Drive<f32>) -> Result<(), BridgeFault>;
}

/// A bridge that is off is switched on first. It follows commands from the next control period on.
impl<P: SetDutyCycle, D: OutputPin, E: OutputPin, F: InputPin> MotorBridge for Bridge<P, D, E, F> {
    fn drive(&mut self, drive: Drive<f32>) -> Result<(), BridgeFault> {
        let done = match drive {
            Drive::Off => self.off(),
            Drive::Duty(part) if self.is_on() => self.command(part),
            Drive::Brake if self.is_on() => self.command(0.0),
            Drive::Duty(_) | Drive::Brake => self.enable(),
        };
        done.map_err(|fault| match fault {
            bridge::BridgeDriverFault::Reported => BridgeFault::Overcurrent,
            _ => BridgeFault::Silent,
        })
    }
}

/// A waiting command.
#[derive(Clone, Copy, Debug)]
struct Pending {
    command: MotionCommand,
    seen_us: u64,
}

/// Encoders, gimbal control and bridges. All arrays are in the order outer, inner.
pub struct Control<T: Real, S, B> {
    encoders: [BissEncoder<S>; 2],
    bridges: [B; 2],
    gimbal: Gimbal<T>,
    history: [AngleHistory; 2],
    /// Reason of the last rejected reading of each encoder.
    losses: [LossReason; 2],
    /// Answer of each bridge to its last command.
    driven: [Result<(), BridgeFault>; 2],
    pending: Deque<Pending, COMMANDS>,
    late_commands: u32,
}

impl<T: Real, S: SpiDevice, B: MotorBridge> Control<T, S, B> {
    /// Connects the devices of (outer, inner).
    pub fn new(encoders: [BissEncoder<S>; 2], bridges: [B; 2], gimbal: Gimbal<T>) -> Self {
        Self {
            encoders,
            bridges,
            gimbal,
            history: [AngleHistory::new(), AngleHistory::new()],
            losses: [LossReason::Status; 2],
            driven: [Ok(()); 2],
            pending: Deque::new(),
            late_commands: 0,
        }
    }

    /// Runs one control period. The encoders are read one after the other; `now_us` gives the time of each reading.
    pub fn on_period(&mut self, now_us: impl Fn() -> u64) {
        let start_us = now_us();
        self.take_commands(start_us);
        let [outer, inner] = [0, 1].map(|axis| self.read(axis, &now_us));
        let inputs = GimbalInputs { encoders: [outer, inner], bridges: self.driven };
        let drives = self.gimbal.control(start_us, &inputs);
        for ((driven, bridge), drive) in self.driven.iter_mut().zip(&mut self.bridges).zip(drives) {
            *driven = bridge.drive(match drive {
                Drive::Duty(duty) => Drive::Duty(duty.widened() as f32),
                Drive::Brake => Drive::Brake,
                Drive::Off => Drive::Off,
            });
        }
    }

    fn read(&mut self, axis: usize, now_us: &impl Fn() -> u64) -> Result<Angle, EncoderFault> {
        let (Some(encoder), Some(history), Some(loss)) =
            (self.encoders.get_mut(axis), self.history.get_mut(axis), self.losses.get_mut(axis))
        else {
            return Err(EncoderFault::Silent);
        };
        let latched_us = now_us();
        match encoder.read() {
            Ok(angle) => {
                history.push(latched_us, angle);
                Ok(angle)
            }
            Err(fault) => {
                let (reason, axis_fault) = loss_and_fault(&fault);
                *loss = reason;
                Err(axis_fault)
            }
        }
    }

    fn take_commands(&mut self, now_us: u64) {
        while let Some(Pending { command, seen_us }) = self.pending.front().copied()
            && seen_us.saturating_add(COMMAND_DELAY_US) <= now_us
        {
            let _ = self.pending.pop_front();
            self.gimbal.command_seen(command, seen_us);
        }
    }

    /// Takes a command that was computed from the status at the time `seen_us`.
    pub fn command(&mut self, command: MotionCommand, seen_us: u64) {
        let now_us = self.gimbal.status().time_us;
        self.late_commands =
            self.late_commands.saturating_add((seen_us.saturating_add(COMMAND_DELAY_US) < now_us).into());
        if self.pending.is_full()
            && let Some(oldest) = self.pending.pop_front()
        {
            self.gimbal.command_seen(oldest.command, oldest.seen_us);
        }
        // A full queue was made shorter above, so this push succeeds.
        let _ = self.pending.push_back(Pending { command, seen_us });
    }

    /// Status of both axes.
    pub fn status(&self) -> GimbalStatus {
        self.gimbal.status()
    }

    /// Angles of (outer, inner) at the time `time_us`, and the status of both axes.
    ///
    /// # Errors
    /// An encoder has no angle for that time. The returned reason is that of its last rejected reading.
    pub fn view(&self, time_us: u64) -> Result<([Angle; 2], GimbalStatus), LossReason> {
        let [outer, inner] = &self.history;
        let [of_outer, of_inner] = self.losses;
        let angles = [outer.at(time_us).ok_or(of_outer)?, inner.at(time_us).ok_or(of_inner)?];
        Ok((angles, self.status()))
    }

    /// Applies other limits and motors while both axes are at rest: see [`Gimbal::reconfigure`].
    pub fn reconfigure(&mut self, limits: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        self.gimbal.reconfigure(limits, motors);
    }

    /// Angles of (outer, inner), counted over whole turns, rad: see [`Gimbal::angles_rad`].
    pub fn angles_rad(&self) -> [Option<f64>; 2] {
        self.gimbal.angles_rad()
    }

    /// Tells, without the delay of a command, at which angles the axes stand: see [`Gimbal::locate`].
    ///
    /// # Errors
    /// The first axis that was not located, and why.
    pub fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
        self.gimbal.locate(angles_rad, tolerance_rad)
    }

    /// Number of commands that arrived later than [`COMMAND_DELAY_US`] after their status.
    pub fn late_commands(&self) -> u32 {
        self.late_commands
    }
}

/// Meaning of a failed encoder read for the sample and for the axis.
fn loss_and_fault<E>(fault: &biss::BissFault<E>) -> (LossReason, EncoderFault) {
    match fault {
        biss::BissFault::Bus(_) => (LossReason::Bus, EncoderFault::Silent),
        biss::BissFault::NoAnswer | biss::BissFault::NotReady => (LossReason::Status, EncoderFault::Silent),
        biss::BissFault::Framing | biss::BissFault::Crc => (LossReason::Crc, EncoderFault::Crc),
        biss::BissFault::Error => (LossReason::Status, EncoderFault::Alarm),
    }
}
