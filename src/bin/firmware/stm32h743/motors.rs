//! The PWM of both motors: TIM1, in one-pulse mode with its repetition counter. It stops 5 ms after it was last armed, and
//! each control period arms it. So no motor is driven any longer if the control interrupt dies.
//!
//! A bridge whose PWM has stopped shorts the winding of its motor, which brakes. The counter is not stopped when a
//! debugger halts the processor, so that then too the motors are not driven any longer.

use core::convert::Infallible;
use embassy_stm32::Peri;
use embassy_stm32::gpio::OutputType;
use embassy_stm32::pac;
use embassy_stm32::pac::common::{RW, Reg};
use embassy_stm32::pac::timer::regs::Ccr1ch;
use embassy_stm32::pac::timer::vals::OcmGp;
use embassy_stm32::peripherals::{PE9, PE11, TIM1};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use rins_selfcal::drivers::one_pulse::OnePulsePwm;
use rins_selfcal::gimbal::servo::PERIOD_US;

/// Above the audible range. A control period has 20 whole cycles and 0.4 of a cycle, so that arming cuts no pulse.
const PWM_HZ: u32 = 20_400;
/// Longest time that the motors are driven after they were last armed, us.
const LONGEST_US: u32 = 5000;
const _: () = assert!(LONGEST_US as u64 >= 4 * PERIOD_US, "a late control period must not stop the motors");

const PWM: OnePulsePwm = match OnePulsePwm::new(super::clock::TIMER_HZ, PWM_HZ, LONGEST_US) {
    Some(numbers) => numbers,
    None => panic!("these numbers do not fit into the timer"),
};

/// The PWM of one motor. A duty takes effect when the timer is armed.
pub struct MotorPwm(Reg<Ccr1ch, RW>);

impl ErrorType for MotorPwm {
    type Error = Infallible;
}

impl SetDutyCycle for MotorPwm {
    fn max_duty_cycle(&self) -> u16 {
        PWM.highest_duty()
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0.write(|compare| compare.set_ccr(PWM.compare(duty)));
        Ok(())
    }
}

/// Peripherals that must stay configured while the motors are used.
pub type Kept = SimplePwm<'static, TIM1>;

/// Sets the timer up, stopped and with zero duty. The channels are connected to their pins last.
pub fn start(
    timer: Peri<'static, TIM1>,
    outer: Peri<'static, PE9>,
    inner: Peri<'static, PE11>,
) -> (Kept, [MotorPwm; 2]) {
    let (outer, inner) = (PwmPin::new(outer, OutputType::PushPull), PwmPin::new(inner, OutputType::PushPull));
    let mode = CountingMode::EdgeAlignedUp;
    let kept = SimplePwm::new(timer, Some(outer), Some(inner), None, None, Hertz(PWM_HZ), mode);
    let timer = pac::TIM1;
    timer.cr1().modify(|control| {
        control.set_cen(false);
        control.set_opm(true);
    });
    timer.psc().write_value(0);
    timer.arr().write(|reload| reload.set_arr(PWM.reload()));
    timer.rcr().write(|repetitions| repetitions.set_rep(PWM.repetitions()));
    let mut motors = [MotorPwm(timer.ccr(0)), MotorPwm(timer.ccr(1))];
    for motor in &mut motors {
        let Ok(()) = motor.set_duty_cycle(0);
    }
    timer.ccmr_output(0).modify(|modes| [0, 1].map(|channel| modes.set_ocm(channel, OcmGp::PWM_MODE2)));
    // The update event makes the numbers effective.
    timer.egr().write(|event| event.set_ug(true));
    timer.ccer().modify(|enabled| [0, 1].map(|channel| enabled.set_cce(channel, true)));
    (kept, motors)
}

/// Arms the timer for another 5 ms, with the duties that have been set.
pub fn arm() {
    pac::TIM1.egr().write(|event| event.set_ug(true));
    // In one-pulse mode any update event may stop the counter, so it is started again.
    pac::TIM1.cr1().modify(|control| control.set_cen(true));
}
