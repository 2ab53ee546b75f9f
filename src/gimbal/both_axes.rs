//! Both gimbal axes as one thing: the control interrupt calls [`Gimbal::control`] once a millisecond, the main loop gives
//! commands and looks at the status.
//!
//! ```text
//!                hold, move_to                       release
//!   Released ------------------> Obeying ---------------------------> Releasing --(both at rest)--> Released
//!      ^                         ^     |
//!      |            hold, move_to|     | a fault
//!      |                         |     v
//!      +-----------release------ Stopped(fault)
//! ```
//! Whatever fails, both axes stop. Each in the best way that is left to it:
//!
//! | fault | the axis that has it | the other one |
//! |---|---|---|
//! | following error, end of travel | brakes under control | brakes under control |
//! | stall, runaway, encoder | winding shorted: what it turns, it brakes | brakes under control |
//! | overcurrent, a bridge that takes no duty | winding open | brakes under control |
//!
//! An axis that turns on a tenth of a second after it was shorted is switched off: its bridge does not obey. An axis that
//! fails while it brakes, or for a second time, is shorted. The first fault stays until the next command, and
//! says axis, angle and number. Moves begin when both axes stand. Nothing is controlled before the first command.

use super::fault::{BridgeFault, EncoderFault, Fault, FaultKind};
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::gimbal::axis::{Axis, AxisLimits};
use crate::gimbal::servo::{Drive, MotorAndLoad, PERIOD_US};

/// What the axes shall do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionCommand {
    /// Come to rest and stay there, under control.
    Hold,
    /// Come to rest; then nothing is controlled, and the windings are shorted.
    Release,
    /// Go to these angles. Both axes start together.
    MoveTo {
        /// Outer and inner angle, counted over whole turns, rad.
        angles_rad: [f64; 2],
        /// Highest rate, rad/s.
        rate_rad_s: f64,
        /// Mean acceleration of a ramp, rad/s^2.
        acceleration_rad_s2: f64,
    },
}

/// What the control interrupt has read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GimbalInputs {
    /// Outer and inner encoder.
    pub encoders: [Result<Angle, EncoderFault>; 2],
    /// What the bridges of the outer and the inner motor have to say.
    pub bridges: [Result<(), BridgeFault>; 2],
}

/// How the axes are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GimbalStatus {
    /// Time of the last control period, us.
    pub time_us: u64,
    /// Commands that the control has taken since the start; wraps.
    pub commands: u16,
    /// Both stand where they were told to go.
    pub arrived: bool,
    /// Neither turns, as far as can be known.
    pub at_rest: bool,
    /// Nominal duration of the move under way, us.
    pub move_us: u64,
    /// What stopped them.
    pub fault: Option<Fault>,
}

/// A move to come.
#[derive(Clone, Copy, Debug)]
struct Move {
    angles_rad: [f64; 2],
    rate_rad_s: f64,
    acceleration_rad_s2: f64,
}

#[derive(Clone, Copy, Debug)]
enum State {
    Released,
    /// The move begins when both axes stand.
    Obeying(Option<Move>),
    Releasing,
    Stopped(Fault),
}

/// Both axes.
#[derive(Clone, Debug)]
pub struct Gimbal<T: Real> {
    axes: [Axis<T>; 2],
    state: State,
    time_us: Option<u64>,
    move_us: u64,
    /// Taken, dropped ones included; wraps.
    commands: u16,
    /// The control period since which there is a fault, us.
    fault_us: Option<u64>,
}

impl<T: Real> Gimbal<T> {
    /// Axes whose encoders have not been read yet.
    pub fn new(limits: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) -> Self {
        let ([outer, inner], [outer_motor, inner_motor]) = (limits, motors);
        Self {
            axes: [Axis::new(outer, outer_motor), Axis::new(inner, inner_motor)],
            state: State::Released,
            time_us: None,
            move_us: 0,
            commands: 0,
            fault_us: None,
        }
    }

    /// Takes other limits and motors, while the axes stand. Axes that are held stay held where they are; after a fault, or
    /// where they were let go, nothing is controlled.
    pub fn reconfigure(&mut self, limits: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        for ((axis, limits), motor) in self.axes.iter_mut().zip(limits).zip(motors) {
            *axis = axis.reconfigured(limits, motor);
        }
        if matches!(self.state, State::Obeying(_)) {
            self.state = State::Obeying(None);
            let now_us = self.time_us.unwrap_or(0);
            self.axes.iter_mut().for_each(|axis| axis.hold(now_us));
        }
    }

    /// One control period: what the bridges of the outer and the inner motor are told until the next one.
    pub fn control(&mut self, now_us: u64, sensed: &GimbalInputs) -> [Drive<T>; 2] {
        let since_us = self.time_us.map_or(PERIOD_US, |before_us| now_us.saturating_sub(before_us));
        self.time_us = Some(now_us);
        for (axis, reading) in self.axes.iter_mut().zip(sensed.encoders) {
            axis.observe(reading, since_us.saturating_add(PERIOD_US / 2) / PERIOD_US);
        }
        self.watch(now_us, sensed);
        self.proceed(now_us);
        self.axes.each_mut().map(|axis| axis.drive(now_us))
    }

    /// Takes a command. It ends what was under way, and forgets the fault.
    pub fn command(&mut self, command: MotionCommand) {
        let now_us = self.time_us.unwrap_or(0);
        self.commands = self.commands.wrapping_add(1);
        self.state = match command {
            MotionCommand::Hold => State::Obeying(None),
            MotionCommand::Release => State::Releasing,
            MotionCommand::MoveTo { angles_rad, rate_rad_s, acceleration_rad_s2 } => {
                if let Some(fault) = self.out_of_reach(angles_rad) {
                    return self.stop(fault, now_us);
                }
                State::Obeying(Some(Move { angles_rad, rate_rad_s, acceleration_rad_s2 }))
            }
        };
        self.fault_us = None;
        if !matches!(self.state, State::Releasing) {
            self.axes.iter_mut().for_each(|axis| axis.hold(now_us));
        }
        self.proceed(now_us);
    }

    /// Takes a command that was computed from the status of the time `seen_us`. If a fault has come up since, the command
    /// only counts: it must not end what that fault has begun.
    pub fn command_seen(&mut self, command: MotionCommand, seen_us: u64) {
        if self.fault_us.is_none_or(|fault_us| fault_us <= seen_us) {
            self.command(command);
        } else {
            self.commands = self.commands.wrapping_add(1);
        }
    }

    /// How the axes are.
    pub fn status(&self) -> GimbalStatus {
        let now_us = self.time_us.unwrap_or(0);
        let waits = matches!(self.state, State::Obeying(Some(_)));
        GimbalStatus {
            time_us: now_us,
            arrived: !waits && self.axes.iter().all(|axis| axis.has_arrived(now_us)),
            at_rest: !waits && self.axes.iter().all(|axis| axis.is_at_rest(now_us)),
            move_us: self.move_us,
            commands: self.commands,
            fault: self.fault(),
        }
    }

    const fn fault(&self) -> Option<Fault> {
        if let State::Stopped(fault) = self.state { Some(fault) } else { None }
    }

    /// Looks for faults, and stops both axes for the first.
    fn watch(&mut self, now_us: u64, sensed: &GimbalInputs) {
        for (index, bridge) in (0_u8..).zip(sensed.bridges) {
            let Some(axis) = self.axes.get_mut(usize::from(index)) else { continue };
            let fault = axis.fault(now_us);
            // Of a bridge that drives nothing, nothing is to be said; but it is not switched on again to short a winding.
            if bridge.is_err() && !axis.is_controlled() {
                axis.free(Drive::Off, now_us);
            }
            let of_bridge = bridge.err().filter(|_| axis.is_controlled()).map(FaultKind::Bridge);
            let kind = of_bridge.or(fault);
            // An axis that brakes beyond the end of its travel is doing what it can.
            let stopping = matches!(self.state, State::Stopped(_));
            if let Some(kind) = kind.filter(|kind| !(stopping && matches!(kind, FaultKind::Travel { .. }))) {
                let angle_rad = axis.angle_rad() as f32;
                self.stop(Fault { axis: index, angle_rad, kind }, now_us);
            }
        }
        if matches!(self.state, State::Stopped(_) | State::Releasing) {
            self.axes.iter_mut().for_each(|axis| axis.open_if_it_turns(now_us));
        }
    }

    fn stop(&mut self, fault: Fault, now_us: u64) {
        let failed_again = matches!(self.state, State::Stopped(_));
        for (index, axis) in (0_u8..).zip(&mut self.axes) {
            if matches!(fault.kind, FaultKind::Bridge(_)) && fault.axis == index {
                axis.free(Drive::Off, now_us);
            } else if fault.axis == index && (failed_again || !fault.kind.is_controllable()) {
                axis.free(Drive::Brake, now_us);
            } else if !failed_again {
                axis.stop(now_us);
            }
        }
        if !failed_again {
            (self.state, self.fault_us) = (State::Stopped(fault), Some(now_us));
        }
    }

    /// Goes on where the axes have come to rest.
    fn proceed(&mut self, now_us: u64) {
        match self.state {
            State::Obeying(Some(next)) if self.axes.iter().all(Axis::is_holding) => {
                for (axis, target_rad) in self.axes.iter_mut().zip(next.angles_rad) {
                    let limits = axis.motion_limits(next.rate_rad_s, next.acceleration_rad_s2);
                    axis.move_to(target_rad, &limits, now_us);
                }
                self.move_us = self.axes.iter().map(Axis::move_us).max().unwrap_or(0);
                self.state = State::Obeying(None);
            }
            State::Releasing => {
                self.axes.iter_mut().for_each(|axis| axis.stop(now_us));
                if self.axes.iter().all(|axis| axis.is_at_rest(now_us)) {
                    let controlled = self.axes.iter_mut().filter(|axis| axis.is_controlled());
                    controlled.for_each(|axis| axis.free(Drive::Brake, now_us));
                    self.state = State::Released;
                }
            }
            State::Released | State::Obeying(_) | State::Stopped(_) => {}
        }
    }

    fn out_of_reach(&self, angles_rad: [f64; 2]) -> Option<Fault> {
        let mut targets = (0_u8..).zip(&self.axes).zip(angles_rad);
        let ((index, axis), target_rad) = targets.find(|((_, axis), target_rad)| !axis.reaches(*target_rad))?;
        let kind = FaultKind::Travel { limit_rad: axis.nearest_within(target_rad) as f32 };
        Some(Fault { axis: index, angle_rad: axis.angle_rad() as f32, kind })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::angle::rad_to_ticks;
    use crate::base::units::DEG;

    /// Whole periods in which the encoders show this, deg.
    fn periods(gimbal: &mut Gimbal<f64>, count: u64, angles_deg: [f64; 2]) -> [Drive<f64>; 2] {
        let encoders = angles_deg.map(|angle_deg| Ok(Angle::from_ticks(rad_to_ticks(angle_deg * DEG) as u32)));
        let mut drives = [Drive::Off; 2];
        for _ in 0..count {
            let now_us = gimbal.time_us.unwrap_or(0) + PERIOD_US;
            drives = gimbal.control(now_us, &GimbalInputs { encoders, bridges: [Ok(()); 2] });
        }
        drives
    }

    #[test]
    fn other_limits_leave_axes_where_they_are() {
        let (limits, motors) = ([AxisLimits::default(); 2], [MotorAndLoad::default(); 2]);
        let mut gimbal = Gimbal::<f64>::new(&limits, &motors);
        // The outer axis is turned by hand, at 20 deg/s and beyond a whole turn.
        periods(&mut gimbal, 1, [0.0, 30.0]);
        for tenths in 0..=4000 {
            periods(&mut gimbal, 5, [f64::from(tenths) * 0.1, 30.0]);
        }
        periods(&mut gimbal, 1000, [400.0, 30.0]);
        gimbal.command(MotionCommand::Hold);
        periods(&mut gimbal, 1000, [400.0, 30.0]);
        assert!(gimbal.status().arrived);
        gimbal.reconfigure(&limits, &motors);
        let drives = periods(&mut gimbal, 1000, [400.0, 30.0]);
        assert_eq!(gimbal.status().fault, None);
        assert!(drives.iter().all(|drive| matches!(drive, Drive::Duty(_))), "they are held");
        let close = |index: usize, deg: f64| (gimbal.axes[index].angle_rad() - deg * DEG).abs() < 1e-6;
        assert!(close(0, 400.0) && close(1, 30.0) && gimbal.status().arrived);
        gimbal.command(MotionCommand::Release);
        periods(&mut gimbal, 1000, [400.0, 30.0]);
        gimbal.reconfigure(&limits, &motors);
        assert_eq!(periods(&mut gimbal, 10, [400.0, 30.0]), [Drive::Brake; 2], "let go they stay");
    }

    #[test]
    fn a_bridge_at_fault_is_not_switched_on_again_to_short_a_winding() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        let hot =
            GimbalInputs { encoders: [Ok(Angle::default()); 2], bridges: [Err(BridgeFault::Overcurrent), Ok(())] };
        assert_eq!(gimbal.control(11 * PERIOD_US, &hot), [Drive::Off, Drive::Brake]);
        assert_eq!(periods(&mut gimbal, 100, [0.0; 2]), [Drive::Off, Drive::Brake]);
    }

    #[test]
    fn a_bridge_that_does_not_obey_is_switched_off_while_the_axes_are_let_go() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        gimbal.command(MotionCommand::Hold);
        let (mut angle_deg, mut since_fault, mut last) = (0.0, 0, [Drive::Off; 2]);
        for _ in 0..500 {
            last = periods(&mut gimbal, 1, [angle_deg, 0.0]);
            if last[0] != Drive::Off {
                angle_deg += 20.0 * 1e-3;
            }
            since_fault += u32::from(gimbal.status().fault.is_some());
            if since_fault == 15 {
                gimbal.command(MotionCommand::Release);
                since_fault += 1;
            }
        }
        assert!(since_fault == 16 && last[0] == Drive::Off, "{since_fault} {last:?}");
    }

    #[test]
    fn a_target_out_of_reach_is_a_fault_at_once() {
        let limits = [AxisLimits { lowest_rad: -1.0, highest_rad: 1.0, ..AxisLimits::default() }; 2];
        let mut gimbal = Gimbal::<f64>::new(&limits, &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        let seen_us = gimbal.status().time_us;
        let move_to = MotionCommand::MoveTo { angles_rad: [0.0, 2.0], rate_rad_s: 0.3, acceleration_rad_s2: 0.3 };
        gimbal.command_seen(move_to, seen_us);
        assert!(gimbal.status().fault.is_some());
        gimbal.command_seen(MotionCommand::Hold, seen_us - PERIOD_US);
        assert!(gimbal.status().fault.is_some(), "what was computed before does not end it");
        gimbal.command_seen(MotionCommand::Hold, seen_us);
        assert_eq!(gimbal.status().fault, None);
    }

    #[test]
    fn a_command_from_before_a_fault_only_counts() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        gimbal.command(MotionCommand::Hold);
        let before = gimbal.status();
        let hot =
            GimbalInputs { encoders: [Ok(Angle::default()); 2], bridges: [Err(BridgeFault::Overcurrent), Ok(())] };
        gimbal.control(11 * PERIOD_US, &hot);
        gimbal.command_seen(MotionCommand::Hold, before.time_us);
        assert!(gimbal.status().fault.is_some() && gimbal.status().commands == 2);
        gimbal.command_seen(MotionCommand::Hold, gimbal.status().time_us);
        assert!(gimbal.status().fault.is_none() && gimbal.status().commands == 3);
    }

    /// An outer axis that goes on at 20 deg/s whatever its bridge is told, until it is switched off.
    #[test]
    fn a_bridge_that_does_not_obey_is_switched_off() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        gimbal.command(MotionCommand::Hold);
        let (mut angle_rad, mut shorted_us, mut open_us) = (0.0, None, None);
        for period in 1..1000 {
            let (now_us, turned) = (period * PERIOD_US, Angle::from_ticks(rad_to_ticks(angle_rad) as u32));
            let sensed = GimbalInputs { encoders: [Ok(turned), Ok(Angle::default())], bridges: [Ok(()); 2] };
            let [outer, _] = gimbal.control(now_us, &sensed);
            match outer {
                Drive::Off => open_us = open_us.or(Some(now_us)),
                Drive::Brake => shorted_us = shorted_us.or(Some(now_us)),
                Drive::Duty(_) => {}
            }
            if period > 100 && outer != Drive::Off {
                angle_rad += 20.0 * DEG * 1e-3;
            }
        }
        let fault = gimbal.status().fault.expect("it is noticed");
        assert!(fault.axis == 0 && matches!(fault.kind, FaultKind::Runaway { .. }), "{fault}");
        let (shorted_us, open_us) = (shorted_us.expect("it is shorted first"), open_us.expect("it is switched off"));
        assert_eq!(open_us - shorted_us, 100_000);
        gimbal.command(MotionCommand::Release);
        let standing = GimbalInputs {
            encoders: [Ok(Angle::from_ticks(rad_to_ticks(angle_rad) as u32)), Ok(Angle::default())],
            bridges: [Ok(()); 2],
        };
        let last = (1000..3000).map(|period| gimbal.control(period * PERIOD_US, &standing)).last();
        assert_eq!(last, Some([Drive::Off, Drive::Brake]), "and stays so when it is let go");
    }
}
