//! The pins of the motor bridges, for the emulated board and for the host's bench. The host includes this file by its
//! path.

use super::wire::DUTY_STEPS;
use core::convert::Infallible;
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use rins_selfcal::drivers::bridge::Bridge;

/// State of the output pins of a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Outputs {
    /// Duty of the PWM, in [`DUTY_STEPS`].
    pub duty: u16,
    /// The direction pin is high.
    pub forward: bool,
    /// The enable pin is high.
    pub enabled: bool,
}

/// The other end of the pins.
pub trait BridgeLines {
    /// Changes output pins of the bridge of an axis (0 outer, 1 inner).
    fn change(&mut self, axis: usize, change: impl FnOnce(&mut Outputs));

    /// Whether the fault line of the bridge of an axis is high.
    fn fault_line(&mut self, axis: usize) -> bool;
}

#[derive(Clone, Copy)]
enum Role {
    Pwm,
    Direction,
    Enable,
    Fault,
}

/// A pin of a bridge.
pub struct BridgePin<L> {
    lines: L,
    axis: usize,
    role: Role,
}

/// A bridge on these pins.
pub type PinBridge<L> = Bridge<BridgePin<L>, BridgePin<L>, BridgePin<L>, BridgePin<L>>;

/// The bridge of an axis (0 outer, 1 inner).
pub fn bridge<L: BridgeLines + Clone>(lines: &L, axis: usize) -> PinBridge<L> {
    let [pwm, direction, enable, fault] = [Role::Pwm, Role::Direction, Role::Enable, Role::Fault]
        .map(|role| BridgePin { lines: lines.clone(), axis, role });
    Bridge::with_pins(pwm, direction, enable, fault)
}

impl<L: BridgeLines> BridgePin<L> {
    fn set(&mut self, high: bool) {
        let role = self.role;
        self.lines.change(self.axis, |outputs| match role {
            Role::Direction => outputs.forward = high,
            Role::Enable => outputs.enabled = high,
            Role::Pwm | Role::Fault => {}
        });
    }
}

impl<L> pwm::ErrorType for BridgePin<L> {
    type Error = Infallible;
}

impl<L: BridgeLines> SetDutyCycle for BridgePin<L> {
    fn max_duty_cycle(&self) -> u16 {
        DUTY_STEPS
    }
    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.lines.change(self.axis, |outputs| outputs.duty = duty);
        Ok(())
    }
}

impl<L> digital::ErrorType for BridgePin<L> {
    type Error = Infallible;
}

impl<L: BridgeLines> OutputPin for BridgePin<L> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl<L: BridgeLines> InputPin for BridgePin<L> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.lines.fault_line(self.axis))
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.lines.fault_line(self.axis))
    }
}
