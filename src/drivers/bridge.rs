//! Driver for a motor bridge with a PWM input and a direction input. An enable line and a fault line are optional.
//!
//! Source: Texas Instruments, DRV8873 data sheet SLVSET1, PH/EN mode. Other bridges with such inputs behave alike.
//!
//! | EN (PWM) | PH (direction) | motor |
//! |---|---|---|
//! | low | any | winding shorted by the bridge: brakes |
//! | high | high | forward |
//! | high | low | backward |
//!
//! nSLEEP is the enable line. While it is low, the outputs are open and the motor coasts. Pulling it low also clears an
//! overcurrent that the bridge has latched. nFAULT is an open-drain output. It is low at overcurrent, over-temperature
//! or undervoltage. Assumed: the bridge is awake before the second command after [`Bridge::enable`], one millisecond
//! later.
//!
//! The direction changes only at zero duty. A command with the other sign first sets the duty to zero, and the next
//! command changes the direction. A PWM that takes over its duty at the end of a period has then reached zero. After
//! any fault the bridge is off until it is enabled again.

use core::convert::Infallible;
use embedded_hal::digital::{self, ErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};

/// Placeholder for a pin that the bridge does not have.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoPin;

impl ErrorType for NoPin {
    type Error = Infallible;
}

impl OutputPin for NoPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl InputPin for NoPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(false)
    }
}

/// Why a bridge is off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BridgeDriverFault {
    /// The bridge has not been enabled since power-on or since the last fault.
    Off,
    /// The fault line is low.
    Reported,
    /// The command is not a finite number.
    Command,
    /// The PWM failed.
    Pwm(pwm::ErrorKind),
    /// A pin failed.
    Pin(digital::ErrorKind),
}

/// Driver of the bridge of one motor.
#[derive(Debug)]
pub struct Bridge<P, D, E = NoPin, F = NoPin> {
    pwm: P,
    direction: D,
    enable: E,
    fault: F,
    on: bool,
    forward: bool,
    duty: u16,
}

impl<P: SetDutyCycle, D: OutputPin> Bridge<P, D> {
    /// A bridge without enable line and fault line. It is off, and no pin has been written yet.
    pub fn new(pwm: P, direction: D) -> Self {
        Self::with_pins(pwm, direction, NoPin, NoPin)
    }
}

impl<P: SetDutyCycle, D: OutputPin, E: OutputPin, F: InputPin> Bridge<P, D, E, F> {
    /// A bridge with an enable line (high: on) and a fault line (low: fault). It is off, and no pin has been written
    /// yet.
    pub fn with_pins(pwm: P, direction: D, enable: E, fault: F) -> Self {
        Self { pwm, direction, enable, fault, on: false, forward: true, duty: 0 }
    }

    /// Whether the bridge is on.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Switches the bridge on with zero duty in forward direction.
    ///
    /// # Errors
    /// A pin or the PWM failed. The bridge is off.
    pub fn enable(&mut self) -> Result<(), BridgeDriverFault> {
        let enabled = self.try_enable();
        self.off_unless(enabled)
    }

    /// Drives the motor with the fraction `part` of the supply voltage, -1 to 1; positive is forward. Larger values
    /// saturate.
    ///
    /// # Errors
    /// The bridge is off for the returned reason.
    pub fn command(&mut self, part: f32) -> Result<(), BridgeDriverFault> {
        if !self.on {
            return Err(BridgeDriverFault::Off);
        }
        let driven = self.try_command(part);
        self.off_unless(driven)
    }

    /// Switches the bridge off: zero duty, outputs open. Both steps are tried, even if the first one fails.
    ///
    /// # Errors
    /// A pin or the PWM failed. The motor may still be driven.
    pub fn off(&mut self) -> Result<(), BridgeDriverFault> {
        (self.on, self.duty) = (false, 0);
        let duty = self.pwm.set_duty_cycle(0).map_err(pwm_fault);
        let enable = self.enable.set_low().map_err(pin_fault);
        duty.and(enable)
    }

    fn off_unless(&mut self, done: Result<(), BridgeDriverFault>) -> Result<(), BridgeDriverFault> {
        if done.is_err() {
            // Report the first fault, not a later fault of switching off.
            let _ = self.off();
        }
        done
    }

    fn try_enable(&mut self) -> Result<(), BridgeDriverFault> {
        self.write_duty(0)?;
        self.set_direction(true)?;
        self.enable.set_high().map_err(pin_fault)?;
        self.on = true;
        Ok(())
    }

    fn try_command(&mut self, part: f32) -> Result<(), BridgeDriverFault> {
        if self.fault.is_low().map_err(pin_fault)? {
            return Err(BridgeDriverFault::Reported);
        }
        if !part.is_finite() {
            return Err(BridgeDriverFault::Command);
        }
        let (forward, duty) = (part > 0.0, self.duty_of(part));
        if duty == 0 || forward == self.forward {
            return self.write_duty(duty);
        }
        if self.duty > 0 {
            return self.write_duty(0);
        }
        self.set_direction(forward)?;
        self.write_duty(duty)
    }

    /// Duty nearest to the fraction `part` of the supply voltage.
    fn duty_of(&self, part: f32) -> u16 {
        let highest = self.pwm.max_duty_cycle();
        let duty = part.abs() * f32::from(highest) + 0.5;
        // The conversion from float to integer saturates.
        (duty as u16).min(highest)
    }

    fn write_duty(&mut self, duty: u16) -> Result<(), BridgeDriverFault> {
        self.pwm.set_duty_cycle(duty).map_err(pwm_fault)?;
        self.duty = duty;
        Ok(())
    }

    fn set_direction(&mut self, forward: bool) -> Result<(), BridgeDriverFault> {
        self.direction.set_state(forward.into()).map_err(pin_fault)?;
        self.forward = forward;
        Ok(())
    }
}

fn pwm_fault(error: impl pwm::Error) -> BridgeDriverFault {
    BridgeDriverFault::Pwm(error.kind())
}

fn pin_fault(error: impl digital::Error) -> BridgeDriverFault {
    BridgeDriverFault::Pin(error.kind())
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Level};
    use embedded_hal_mock::eh1::pwm::{Mock as Pwm, Transaction as Duty};
    use proptest::prelude::*;
    use std::io::ErrorKind;

    const MAX: u16 = 1000;

    /// Expected writes of `enable` and `off`. A command asks for the highest duty first, see `asked`.
    fn duties(duties: &[u16]) -> Vec<Duty> {
        duties.iter().map(|duty| Duty::set_duty_cycle(*duty)).collect()
    }

    fn levels(levels: &[State]) -> Pin {
        Pin::new(&levels.iter().map(|level| Level::set(*level)).collect::<Vec<_>>())
    }

    fn asked(set: &[u16]) -> Vec<Duty> {
        set.iter().flat_map(|duty| [Duty::max_duty_cycle(MAX), Duty::set_duty_cycle(*duty)]).collect()
    }

    #[test]
    fn a_command_with_the_other_sign_first_sets_zero_duty() {
        let script = [duties(&[0]), asked(&[500, 0, 1000, 0, 0, 1])].concat();
        let (mut pwm, mut direction) = (Pwm::new(&script), levels(&[State::High, State::Low, State::High]));
        let mut bridge = Bridge::new(pwm.clone(), direction.clone());
        assert_eq!(bridge.command(0.5), Err(BridgeDriverFault::Off));
        bridge.enable().unwrap();
        for part in [0.5, -3.0, -3.0, 0.0, -0.0004, 0.0006] {
            bridge.command(part).unwrap();
        }
        pwm.done();
        direction.done();
    }

    #[test]
    fn a_low_fault_line_switches_off_until_enabled_again() {
        let (mut pwm, mut direction) = (Pwm::new(&duties(&[0, 0, 0])), levels(&[State::High, State::High]));
        let mut enable = levels(&[State::High, State::Low, State::High]);
        let mut fault = Pin::new(&[Level::get(State::Low)]);
        let mut bridge = Bridge::with_pins(pwm.clone(), direction.clone(), enable.clone(), fault.clone());
        bridge.enable().unwrap();
        assert_eq!(bridge.command(0.1), Err(BridgeDriverFault::Reported));
        assert_eq!(bridge.command(0.1), Err(BridgeDriverFault::Off));
        bridge.enable().unwrap();
        assert!(bridge.is_on());
        pwm.done();
        direction.done();
        enable.done();
        fault.done();
    }

    #[test]
    fn a_command_that_is_not_finite_switches_off() {
        for part in [f32::NAN, f32::INFINITY] {
            let (mut pwm, mut direction) = (Pwm::new(&duties(&[0, 0])), levels(&[State::High]));
            let mut bridge = Bridge::new(pwm.clone(), direction.clone());
            bridge.enable().unwrap();
            assert_eq!(bridge.command(part), Err(BridgeDriverFault::Command));
            assert!(!bridge.is_on());
            pwm.done();
            direction.done();
        }
    }

    #[test]
    fn a_failing_pwm_still_opens_the_outputs() {
        let broken = || Duty::set_duty_cycle(0).with_error(MockError::Io(ErrorKind::NotConnected));
        let script = [duties(&[0]), vec![Duty::max_duty_cycle(MAX)]].concat();
        let failing = Duty::set_duty_cycle(200).with_error(MockError::Io(ErrorKind::NotConnected));
        let mut pwm = Pwm::new(&[script, vec![failing, broken()]].concat());
        let (mut direction, mut enable) = (levels(&[State::High]), levels(&[State::High, State::Low]));
        let mut bridge = Bridge::with_pins(pwm.clone(), direction.clone(), enable.clone(), NoPin);
        bridge.enable().unwrap();
        assert_eq!(bridge.command(0.2), Err(BridgeDriverFault::Pwm(pwm::ErrorKind::Other)));
        assert!(!bridge.is_on());
        pwm.done();
        direction.done();
        enable.done();
    }

    /// Pins that record duty and direction.
    #[derive(Default)]
    struct Recorder {
        duty: u16,
        forward: bool,
        /// Duty at each write of the direction.
        at_turns: Vec<u16>,
    }

    struct Shared<'a>(&'a std::cell::RefCell<Recorder>);

    impl ErrorType for Shared<'_> {
        type Error = Infallible;
    }
    impl OutputPin for Shared<'_> {
        fn set_low(&mut self) -> Result<(), Infallible> {
            let mut recorder = self.0.borrow_mut();
            let duty = recorder.duty;
            recorder.at_turns.push(duty);
            recorder.forward = false;
            Ok(())
        }
        fn set_high(&mut self) -> Result<(), Infallible> {
            self.set_low()?;
            self.0.borrow_mut().forward = true;
            Ok(())
        }
    }
    impl pwm::ErrorType for Shared<'_> {
        type Error = Infallible;
    }
    impl SetDutyCycle for Shared<'_> {
        fn max_duty_cycle(&self) -> u16 {
            MAX
        }
        fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
            self.0.borrow_mut().duty = duty;
            Ok(())
        }
    }

    proptest! {
        #[test]
        fn the_direction_changes_at_zero_duty_and_matches_the_command(
            parts in prop::collection::vec(-1.5_f32..1.5, 1..100)
        ) {
            let recorder = std::cell::RefCell::new(Recorder::default());
            let mut bridge = Bridge::new(Shared(&recorder), Shared(&recorder));
            bridge.enable().unwrap();
            for part in parts {
                bridge.command(part).unwrap();
                let Recorder { duty, forward, .. } = *recorder.borrow();
                prop_assert!(duty == 0 || forward == (part > 0.0));
                // The duty is zero while the direction is about to change; otherwise it equals the command to half a
                // step.
                let driven = f32::from(duty) / f32::from(MAX);
                prop_assert!(duty == 0 || (driven - part.abs().min(1.0)).abs() <= 0.501 / f32::from(MAX));
            }
            prop_assert!(recorder.borrow().at_turns.iter().all(|duty| *duty == 0));
        }
    }
}
