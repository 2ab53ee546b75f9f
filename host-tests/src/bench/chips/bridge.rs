//! A motor bridge with PWM and direction pins, and its outputs.

use crate::bench::wire::DUTY_STEPS;
use crate::virtual_unit::plant::Output;

/// Control periods after which a PWM that was not set again has no output any longer.
pub const PWM_PERIODS: u32 = 5;

/// The bridge by the state of its pins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BridgeChip {
    /// Duty of the PWM, in [`DUTY_STEPS`].
    pub duty: u16,
    /// The direction pin is high.
    pub forward: bool,
    /// The enable pin is high.
    pub enabled: bool,
    /// An overcurrent was found. The outputs are open and the fault line is low until the enable pin goes low.
    pub overcurrent: bool,
    /// Number of times that the direction changed while the PWM was on.
    pub hard_turns: u32,
    /// Control periods since the pins were last set.
    pub idle_periods: u32,
}

impl BridgeChip {
    /// Sets the pins.
    pub fn set(&mut self, duty: u16, forward: bool, enabled: bool) {
        if forward != self.forward && self.duty > 0 && self.enabled {
            self.hard_turns += 1;
        }
        self.overcurrent &= enabled;
        (self.duty, self.forward, self.enabled) = (duty, forward, enabled);
        self.idle_periods = 0;
    }

    /// Begins a control period. A PWM that control does not set in every period stops by itself, as on the board.
    pub fn begin_period(&mut self) {
        self.idle_periods = self.idle_periods.saturating_add(1);
    }

    /// State of the outputs.
    pub fn output(&self) -> Output {
        let duty = if self.idle_periods > PWM_PERIODS { 0 } else { self.duty.min(DUTY_STEPS) };
        let part = f64::from(duty) / f64::from(DUTY_STEPS);
        match (self.enabled && !self.overcurrent, duty, self.forward) {
            (false, ..) => Output::Open,
            (true, 0, _) => Output::Shorted,
            (true, _, true) => Output::Driven(part),
            (true, _, false) => Output::Driven(-part),
        }
    }

    /// Whether the fault line is high.
    pub fn fault_line(&self) -> bool {
        !self.overcurrent
    }
}
