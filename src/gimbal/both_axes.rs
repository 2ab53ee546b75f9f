//! Both gimbal axes together. The control interrupt calls [`Gimbal::control`] once a millisecond; the main loop gives
//! commands and reads the status.
//!
//! ```text
//!                hold, move_to                      release
//!   Released ------------------> Controlled ------------------------> Releasing --(both at rest)--> Released
//!      ^                         ^     |
//!      |            hold, move_to|     | fault
//!      |                         |     v
//!      +-----------release------ Faulted(fault)
//! ```
//! After any fault both axes are brought to rest. Each axis uses the best means that is left:
//!
//! | fault | faulty axis | other axis |
//! |---|---|---|
//! | following error, travel limit | brakes under control | brakes under control |
//! | a move while the turn is unknown or the axis is outside of its travel | does not move | brakes under control |
//! | stall, runaway, encoder, duty not finite | winding shorted: the turning motor brakes itself | brakes under control |
//! | bridge fault, bridge refuses commands | winding open | brakes under control |
//!
//! If a shorted axis still turns after 0.1 s, its winding is opened, because the bridge ignores its commands. An axis
//! that has another fault after the first one is shorted. The first fault is reported until the next command; it
//! contains axis, angle and number. A move begins when both axes are at rest. No axis is controlled before the first
//! command. A move that is refused is a fault, too, and moves nothing.

use super::fault::{BridgeFault, EncoderFault, Fault, FaultKind};
use super::travel::{LocateError, TurnState};
use crate::base::angle::Angle;
use crate::base::linear::Real;
use crate::gimbal::axis::{Axis, AxisLimits};
use crate::gimbal::servo::{Drive, MotorAndLoad, PERIOD_US};

/// Command to both axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MotionCommand {
    /// Brake, then hold both axes at rest under control.
    Hold,
    /// Bring both axes to rest, then stop the control and short the windings.
    Release,
    /// Move to these angles. Both axes start together.
    MoveTo {
        /// Outer and inner angle, counted over whole turns, rad.
        angles_rad: [f64; 2],
        /// Highest rate, rad/s.
        rate_rad_s: f64,
        /// Mean acceleration of a ramp, rad/s^2.
        acceleration_rad_s2: f64,
    },
}

/// Inputs of one control period.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalInputs {
    /// Readings of the outer and the inner encoder.
    pub encoders: [Result<Angle, EncoderFault>; 2],
    /// Answers of the outer and the inner bridge to their last commands.
    pub bridges: [Result<(), BridgeFault>; 2],
}

/// Status of both axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalStatus {
    /// Time of the last control period, us.
    pub time_us: u64,
    /// Number of commands taken since the start; wraps.
    pub commands: u16,
    /// Both axes hold their target angles.
    pub arrived: bool,
    /// Both axes are at rest. An axis with a faulty encoder is assumed to be at rest after a fixed time.
    pub at_rest: bool,
    /// Nominal duration of the last move, us.
    pub move_us: u64,
    /// What is known of the turns on which the outer and the inner axis stand.
    pub turns: [TurnState; 2],
    /// The fault that stopped the motion, if any.
    pub fault: Option<Fault>,
}

/// A move that waits for both axes to be at rest.
#[derive(Clone, Copy, Debug)]
struct Move {
    angles_rad: [f64; 2],
    rate_rad_s: f64,
    acceleration_rad_s2: f64,
}

#[derive(Clone, Copy, Debug)]
enum State {
    Released,
    /// Both axes are controlled. A waiting move begins when both are at rest.
    Controlled(Option<Move>),
    Releasing,
    Faulted(Fault),
}

/// Both axes and their common state.
#[derive(Clone, Debug)]
pub struct Gimbal<T: Real> {
    axes: [Axis<T>; 2],
    state: State,
    time_us: Option<u64>,
    move_us: u64,
    /// Number of commands, ignored ones included; wraps.
    commands: u16,
    /// Time of the control period in which the current fault occurred, us.
    fault_us: Option<u64>,
}

impl<T: Real> Gimbal<T> {
    /// A gimbal before the first readings of its encoders.
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

    /// Applies other limits and motors. Both axes must be at rest. Held axes are held again at their angles; after a
    /// fault or a release nothing is controlled.
    pub fn reconfigure(&mut self, limits: &[AxisLimits; 2], motors: &[MotorAndLoad; 2]) {
        for ((axis, limits), motor) in self.axes.iter_mut().zip(limits).zip(motors) {
            *axis = axis.reconfigured(limits, motor);
        }
        if matches!(self.state, State::Controlled(_)) {
            self.state = State::Controlled(None);
            let now_us = self.time_us.unwrap_or(0);
            self.axes.iter_mut().for_each(|axis| axis.hold(now_us));
        }
    }

    /// Runs one control period. Returns the commands to the outer and the inner bridge until the next period.
    pub fn control(&mut self, now_us: u64, inputs: &GimbalInputs) -> [Drive<T>; 2] {
        let since_us = self.time_us.map_or(PERIOD_US, |before_us| now_us.saturating_sub(before_us));
        self.time_us = Some(now_us);
        for (axis, reading) in self.axes.iter_mut().zip(inputs.encoders) {
            axis.observe(reading, since_us.saturating_add(PERIOD_US / 2) / PERIOD_US, now_us);
        }
        self.check_faults(now_us, inputs);
        self.advance(now_us);
        let drives = self.axes.each_mut().map(|axis| axis.drive(now_us));
        for (axis, drive) in (0_u8..).zip(&drives) {
            if let Err(kind) = drive {
                self.react_to(self.fault_of(axis, *kind), now_us);
            }
        }
        drives.map(|drive| drive.unwrap_or(Drive::Brake))
    }

    /// Takes a command. The command replaces the current motion and clears the fault.
    pub fn command(&mut self, command: MotionCommand) {
        let now_us = self.time_us.unwrap_or(0);
        self.commands = self.commands.wrapping_add(1);
        self.state = match command {
            MotionCommand::Hold => State::Controlled(None),
            MotionCommand::Release => State::Releasing,
            MotionCommand::MoveTo { angles_rad, rate_rad_s, acceleration_rad_s2 } => {
                if let Some(fault) = self.refusal(angles_rad) {
                    return self.refuse(fault, now_us);
                }
                State::Controlled(Some(Move { angles_rad, rate_rad_s, acceleration_rad_s2 }))
            }
        };
        self.fault_us = None;
        if !matches!(self.state, State::Releasing) {
            self.axes.iter_mut().for_each(|axis| axis.hold(now_us));
        }
        self.advance(now_us);
    }

    /// Takes a command that was computed from the status at the time `seen_us`. If a fault has occurred since then, the
    /// command is only counted, so that it does not end the reaction to that fault.
    pub fn command_seen(&mut self, command: MotionCommand, seen_us: u64) {
        if self.fault_us.is_none_or(|fault_us| fault_us <= seen_us) {
            self.command(command);
        } else {
            self.commands = self.commands.wrapping_add(1);
        }
    }

    /// Status of both axes.
    pub fn status(&self) -> GimbalStatus {
        let now_us = self.time_us.unwrap_or(0);
        let move_waits = matches!(self.state, State::Controlled(Some(_)));
        GimbalStatus {
            time_us: now_us,
            arrived: !move_waits && self.axes.iter().all(|axis| axis.has_arrived(now_us)),
            at_rest: !move_waits && self.axes.iter().all(|axis| axis.is_at_rest(now_us)),
            move_us: self.move_us,
            commands: self.commands,
            turns: self.axes.each_ref().map(Axis::turn_state),
            fault: self.fault(),
        }
    }

    /// Angles of (outer, inner), counted over whole turns, rad. `None` unless the encoder works and the turn is known.
    pub fn angles_rad(&self) -> [Option<f64>; 2] {
        self.axes.each_ref().map(Axis::known_angle_rad)
    }

    /// Tells at which angles of (outer, inner), counted over whole turns, the axes stand: by a stored mark, or by the
    /// operator. The turn that is nearest to such an angle is taken if the encoder agrees within `tolerance_rad` and the
    /// axis then stands within its travel. Nothing moves. `None` leaves an axis as it is, and so does any angle for an
    /// axis of continuous travel.
    ///
    /// # Errors
    /// The first axis that was not located, and why. Its turn is as before. The other axis may have been located.
    pub fn locate(&mut self, angles_rad: [Option<f64>; 2], tolerance_rad: f64) -> Result<(), LocateError> {
        let mut located = Ok(());
        for ((axis, index), angle_rad) in self.axes.iter_mut().zip(0_u8..).zip(angles_rad) {
            let done = angle_rad.map_or(Ok(()), |angle_rad| axis.locate(angle_rad, tolerance_rad));
            located = located.and(done.map_err(|refusal| LocateError { axis: index, refusal }));
        }
        located
    }

    const fn fault(&self) -> Option<Fault> {
        if let State::Faulted(fault) = self.state { Some(fault) } else { None }
    }

    /// Checks both axes for faults and reacts to the first one.
    fn check_faults(&mut self, now_us: u64, inputs: &GimbalInputs) {
        for (index, bridge) in (0_u8..).zip(inputs.bridges) {
            let Some(axis) = self.axes.get_mut(usize::from(index)) else { continue };
            let fault = axis.fault(now_us);
            // Do not report a fault of an idle bridge. But keep the bridge off, so that it is not switched on again to
            // short the winding.
            if bridge.is_err() && !axis.is_controlled() {
                axis.free(Drive::Off, now_us);
            }
            let of_bridge = bridge.err().filter(|_| axis.is_controlled()).map(FaultKind::Bridge);
            let kind = of_bridge.or(fault);
            // After a fault, an axis may brake beyond its travel limit; this is not a further fault.
            let faulted = matches!(self.state, State::Faulted(_));
            if let Some(kind) = kind.filter(|kind| !(faulted && matches!(kind, FaultKind::Travel { .. }))) {
                self.react_to(self.fault_of(index, kind), now_us);
            }
        }
        if matches!(self.state, State::Faulted(_) | State::Releasing) {
            self.axes.iter_mut().for_each(|axis| axis.open_if_turning(now_us));
        }
    }

    /// Reacts to a fault: opens or shorts the winding of the faulty axis or brakes it, and brings the other axis to
    /// rest.
    fn react_to(&mut self, fault: Fault, now_us: u64) {
        let failed_again = matches!(self.state, State::Faulted(_));
        for (index, axis) in (0_u8..).zip(&mut self.axes) {
            if matches!(fault.kind, FaultKind::Bridge(_)) && fault.axis == index {
                axis.free(Drive::Off, now_us);
            } else if fault.axis == index && (failed_again || !fault.kind.is_controllable()) {
                axis.free(Drive::Brake, now_us);
            } else if !failed_again {
                axis.bring_to_rest(now_us);
            }
        }
        if !failed_again {
            (self.state, self.fault_us) = (State::Faulted(fault), Some(now_us));
        }
    }

    /// Continues when the axes have come to rest: starts a waiting move, or completes a release.
    fn advance(&mut self, now_us: u64) {
        match self.state {
            State::Controlled(Some(next)) if self.axes.iter().all(Axis::is_holding) => {
                // The encoders may have been found since the command.
                if let Some(fault) = self.refusal(next.angles_rad) {
                    return self.refuse(fault, now_us);
                }
                for (axis, target_rad) in self.axes.iter_mut().zip(next.angles_rad) {
                    let limits = axis.motion_limits(next.rate_rad_s, next.acceleration_rad_s2);
                    axis.move_to(target_rad, &limits, now_us);
                }
                self.move_us = self.axes.iter().map(Axis::move_us).max().unwrap_or(0);
                self.state = State::Controlled(None);
            }
            State::Releasing => {
                self.axes.iter_mut().for_each(|axis| axis.bring_to_rest(now_us));
                if self.axes.iter().all(|axis| axis.is_at_rest(now_us)) {
                    let controlled = self.axes.iter_mut().filter(|axis| axis.is_controlled());
                    controlled.for_each(|axis| axis.free(Drive::Brake, now_us));
                    self.state = State::Released;
                }
            }
            State::Released | State::Controlled(_) | State::Faulted(_) => {}
        }
    }

    /// Why the axes do not move to these angles, if they do not.
    fn refusal(&self, angles_rad: [f64; 2]) -> Option<Fault> {
        let mut refusals = (0_u8..).zip(self.axes.iter().zip(angles_rad));
        refusals.find_map(|(index, (axis, target_rad))| Some(self.fault_of(index, axis.refusal(target_rad)?)))
    }

    /// Reports why a move does not begin. As every command, the move has ended the fault before.
    fn refuse(&mut self, fault: Fault, now_us: u64) {
        self.state = State::Controlled(None);
        self.react_to(fault, now_us);
    }

    fn fault_of(&self, axis: u8, kind: FaultKind) -> Fault {
        let angle_rad = self.axes.get(usize::from(axis)).map_or(0.0, Axis::angle_rad);
        Fault { axis, angle_rad: angle_rad as f32, kind }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::angle::rad_to_ticks;
    use crate::base::units::DEG;
    use crate::gimbal::{Travel, TurnSource};

    /// Runs `count` control periods with constant encoder angles, deg.
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
    fn reconfiguring_keeps_angles_and_turns() {
        let (limits, motors) = ([AxisLimits::default(); 2], [MotorAndLoad::default(); 2]);
        let mut gimbal = Gimbal::<f64>::new(&limits, &motors);
        // The outer axis is turned by hand at 20 deg/s, by more than one turn.
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
        assert!(drives.iter().all(|drive| matches!(drive, Drive::Duty(_))), "the axes are held");
        let close = |index: usize, deg: f64| (gimbal.axes[index].angle_rad() - deg * DEG).abs() < 1e-6;
        assert!(close(0, 400.0) && close(1, 30.0) && gimbal.status().arrived);
        gimbal.command(MotionCommand::Release);
        periods(&mut gimbal, 1000, [400.0, 30.0]);
        gimbal.reconfigure(&limits, &motors);
        assert_eq!(periods(&mut gimbal, 10, [400.0, 30.0]), [Drive::Brake; 2], "released axes are not controlled");
    }

    #[test]
    fn a_faulty_idle_bridge_is_not_switched_on_again() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        let overcurrent =
            GimbalInputs { encoders: [Ok(Angle::default()); 2], bridges: [Err(BridgeFault::Overcurrent), Ok(())] };
        assert_eq!(gimbal.control(11 * PERIOD_US, &overcurrent), [Drive::Off, Drive::Brake]);
        assert_eq!(periods(&mut gimbal, 100, [0.0; 2]), [Drive::Off, Drive::Brake]);
    }

    #[test]
    fn a_bridge_that_ignores_commands_is_switched_off_during_a_release() {
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
    fn a_target_beyond_the_travel_is_a_fault_at_once() {
        let travel = Travel::around(-1.0, 1.0, TurnSource::Unique);
        let limits = [AxisLimits { travel, ..AxisLimits::default() }; 2];
        let mut gimbal = Gimbal::<f64>::new(&limits, &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        let seen_us = gimbal.status().time_us;
        let move_to = MotionCommand::MoveTo { angles_rad: [0.0, 2.0], rate_rad_s: 0.3, acceleration_rad_s2: 0.3 };
        gimbal.command_seen(move_to, seen_us);
        assert!(gimbal.status().fault.is_some());
        gimbal.command_seen(MotionCommand::Hold, seen_us - PERIOD_US);
        assert!(gimbal.status().fault.is_some(), "a command from before the fault does not clear it");
        gimbal.command_seen(MotionCommand::Hold, seen_us);
        assert_eq!(gimbal.status().fault, None);
    }

    #[test]
    fn a_command_from_before_a_fault_is_only_counted() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        periods(&mut gimbal, 10, [0.0; 2]);
        gimbal.command(MotionCommand::Hold);
        let before = gimbal.status();
        let overcurrent =
            GimbalInputs { encoders: [Ok(Angle::default()); 2], bridges: [Err(BridgeFault::Overcurrent), Ok(())] };
        gimbal.control(11 * PERIOD_US, &overcurrent);
        gimbal.command_seen(MotionCommand::Hold, before.time_us);
        assert!(gimbal.status().fault.is_some() && gimbal.status().commands == 2);
        gimbal.command_seen(MotionCommand::Hold, gimbal.status().time_us);
        assert!(gimbal.status().fault.is_none() && gimbal.status().commands == 3);
    }

    /// The outer axis continues at 20 deg/s until its bridge is switched off.
    #[test]
    fn a_bridge_that_ignores_commands_is_switched_off() {
        let mut gimbal = Gimbal::<f64>::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2]);
        gimbal.command(MotionCommand::Hold);
        let (mut angle_rad, mut shorted_us, mut open_us) = (0.0, None, None);
        for period in 1..1000 {
            let (now_us, turned) = (period * PERIOD_US, Angle::from_ticks(rad_to_ticks(angle_rad) as u32));
            let inputs = GimbalInputs { encoders: [Ok(turned), Ok(Angle::default())], bridges: [Ok(()); 2] };
            let [outer, _] = gimbal.control(now_us, &inputs);
            match outer {
                Drive::Off => open_us = open_us.or(Some(now_us)),
                // Before that the encoder is searched for.
                Drive::Brake if period > 100 => shorted_us = shorted_us.or(Some(now_us)),
                Drive::Brake | Drive::Duty(_) => {}
            }
            if period > 100 && outer != Drive::Off {
                angle_rad += 20.0 * DEG * 1e-3;
            }
        }
        let fault = gimbal.status().fault.expect("the fault is reported");
        assert!(fault.axis == 0 && matches!(fault.kind, FaultKind::Runaway { .. }), "{fault}");
        let (shorted_us, open_us) =
            (shorted_us.expect("the winding is shorted first"), open_us.expect("then the winding is opened"));
        assert_eq!(open_us - shorted_us, 100_000);
        gimbal.command(MotionCommand::Release);
        let standing = GimbalInputs {
            encoders: [Ok(Angle::from_ticks(rad_to_ticks(angle_rad) as u32)), Ok(Angle::default())],
            bridges: [Ok(()); 2],
        };
        let last = (1000..3000).map(|period| gimbal.control(period * PERIOD_US, &standing)).last();
        assert_eq!(last, Some([Drive::Off, Drive::Brake]), "the winding stays open after a release");
    }
}
