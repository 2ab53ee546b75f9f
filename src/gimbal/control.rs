//! What the control interrupt does, once a millisecond: encoders -> gimbal -> bridges, and the angles into a history from
//! which the data-ready interrupt takes those of its sample.
//!
//! Three parties share it, on one processor: the control interrupt runs [`Control::on_period`], the data-ready interrupt
//! takes [`Control::view`], the main loop gives [`Control::command`]. Each does so in a critical section. That of the control
//! interrupt, which nothing may interrupt anyway, is the longest; the others last microseconds.
//!
//! Every sample carries the status that belongs to it, and a command takes effect [`COMMAND_DELAY_US`] after the status that
//! it was computed from: what a run does depends on its samples, and not on how fast the main loop was.

use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::base::loss::LossReason;
use crate::drivers::biss::{self, BissEncoder};
use crate::drivers::bridge::{self, Bridge};
use crate::gimbal::angle_history::AngleHistory;
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::{Drive, MotorAndLoad};
use crate::gimbal::{BridgeFault, EncoderFault, Gimbal, GimbalInputs, GimbalStatus, MotionCommand};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;
use embedded_hal::spi::SpiDevice;
use heapless::Deque;

/// From the status that a command was computed from until it takes effect, us: two sample intervals at 200 Hz. The main
/// loop needs less for a sample, but for those that store or solve, when nothing turns.
pub const COMMAND_DELAY_US: u64 = 10_000;
/// Commands that may wait: the main loop gives one per sample at most.
const COMMANDS: usize = 8;

/// The bridge of a motor, as the control has it.
pub trait MotorBridge {
    /// Drives the motor from now on; asked once in every control period.
    ///
    /// # Errors
    /// It does not, for the reason given.
    fn drive(&mut self, told: Drive<f32>) -> Result<(), BridgeFault>;
}

/// A bridge that is off is switched on first, and obeys from the next period on.
impl<P: SetDutyCycle, D: OutputPin, E: OutputPin, F: InputPin> MotorBridge for Bridge<P, D, E, F> {
    fn drive(&mut self, told: Drive<f32>) -> Result<(), BridgeFault> {
        let done = match told {
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

/// A command that waits.
#[derive(Clone, Copy, Debug)]
struct Pending {
    command: MotionCommand,
    seen_us: u64,
}

/// Encoders, control and bridges of (outer, inner).
pub struct Control<T: Real, S, B> {
    encoders: [BissEncoder<S>; 2],
    bridges: [B; 2],
    gimbal: Gimbal<T>,
    history: [AngleHistory; 2],
    /// Why the last bad reading of each encoder was none.
    losses: [LossReason; 2],
    driven: [Result<(), BridgeFault>; 2],
    pending: Deque<Pending, COMMANDS>,
    late_commands: u32,
}

impl<T: Real, S: SpiDevice, B: MotorBridge> Control<T, S, B> {
    /// Puts the devices of (outer, inner) together.
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

    /// One control period. The encoders are read one after the other, each at a time of its own, which `now_us` tells.
    pub fn on_period(&mut self, now_us: impl Fn() -> u64) {
        let start_us = now_us();
        self.take_commands(start_us);
        let [outer, inner] = [0, 1].map(|axis| self.read(axis, &now_us));
        let sensed = GimbalInputs { encoders: [outer, inner], bridges: self.driven };
        let drives = self.gimbal.control(start_us, &sensed);
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
                let (lost, known) = told(&fault);
                *loss = lost;
                Err(known)
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

    /// Takes a command that was computed from the status of the time `seen_us`.
    pub fn command(&mut self, command: MotionCommand, seen_us: u64) {
        let now_us = self.gimbal.status().time_us;
        self.late_commands =
            self.late_commands.saturating_add((seen_us.saturating_add(COMMAND_DELAY_US) < now_us).into());
        if self.pending.is_full()
            && let Some(oldest) = self.pending.pop_front()
        {
            self.gimbal.command_seen(oldest.command, oldest.seen_us);
        }
        // There is room now.
        let _ = self.pending.push_back(Pending { command, seen_us });
    }

    /// How the axes are.
    pub fn status(&self) -> GimbalStatus {
        self.gimbal.status()
    }

    /// The angles of (outer, inner) at a time, and how the axes are.
    ///
    /// # Errors
    /// An encoder has no angle for that time, for the reason of its last bad reading.
    pub fn view(&self, time_us: u64) -> Result<([Angle; 2], GimbalStatus), LossReason> {
        let [outer, inner] = &self.history;
        let [of_outer, of_inner] = self.losses;
        let angles = [outer.at(time_us).ok_or(of_outer)?, inner.at(time_us).ok_or(of_inner)?];
        Ok((angles, self.status()))
    }

    /// Takes other limits and motors, while the axes stand: [`Gimbal::reconfigure`].
    pub fn reconfigure(&mut self, limits: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        self.gimbal.reconfigure(limits, motors);
    }

    /// Commands that came too late to take effect when they should have.
    pub fn late_commands(&self) -> u32 {
        self.late_commands
    }
}

/// What a missing reading is to the sample and to the axis.
fn told<E>(fault: &biss::BissFault<E>) -> (LossReason, EncoderFault) {
    match fault {
        biss::BissFault::Bus(_) => (LossReason::Bus, EncoderFault::Silent),
        biss::BissFault::NoAnswer | biss::BissFault::NotReady => (LossReason::Status, EncoderFault::Silent),
        biss::BissFault::Framing | biss::BissFault::Crc => (LossReason::Crc, EncoderFault::Crc),
        biss::BissFault::Error => (LossReason::Status, EncoderFault::Alarm),
    }
}
