//! The clocks of the chip, and the time since power-up.

use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::pac;
use embassy_stm32::peripherals::TIM2;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;
use embedded_hal::delay::DelayNs;

/// Clock of the processor, Hz.
pub const CORE_HZ: u32 = 480_000_000;
/// Clock of the timers on APB1, Hz.
pub const TIMER_HZ: u32 = 240_000_000;

/// From the ST-LINK's 8 MHz: 480 MHz for the processor, 240 MHz for the buses, 120 MHz for the peripherals.
pub fn configuration() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    let rcc = &mut config.rcc;
    rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Bypass });
    rcc.pll1 = Some(Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV1,
        mul: PllMul::MUL120,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        divq: Some(PllDiv::DIV8),
        divr: None,
    });
    rcc.sys = Sysclk::PLL1_P;
    rcc.ahb_pre = AHBPrescaler::DIV2;
    rcc.apb1_pre = APBPrescaler::DIV2;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc.apb3_pre = APBPrescaler::DIV2;
    rcc.apb4_pre = APBPrescaler::DIV2;
    rcc.voltage_scale = VoltageScale::Scale0;
    config
}

/// Time at the last call of [`now_us`], us. It is called at least ten times a second, so no wrap of the 32-bit timer is
/// missed.
static CLOCK: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

/// Sets the timer to count microseconds.
pub fn start(_timer: Peri<'static, TIM2>) {
    embassy_stm32::rcc::enable_and_reset::<TIM2>();
    pac::TIM2.psc().write_value((TIMER_HZ / 1_000_000 - 1) as u16);
    pac::TIM2.arr().write_value(u32::MAX);
    // An update event makes the new prescaler effective.
    pac::TIM2.egr().write(|event| event.set_ug(true));
    pac::TIM2.cr1().modify(|control| control.set_cen(true));
}

/// Time since power-up, us.
pub fn now_us() -> u64 {
    critical_section::with(|cs| {
        let clock = CLOCK.borrow(cs);
        let now = clock.get() + u64::from(pac::TIM2.cnt().read().wrapping_sub(clock.get() as u32));
        clock.set(now);
        now
    })
}

defmt::timestamp!("{=u64:us}", now_us());

/// Delays that count cycles of the processor.
#[derive(Clone, Copy)]
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        // In two parts, so that the products fit into 32 bits.
        cortex_m::asm::delay((ns / 1000).saturating_mul(CORE_HZ / 1_000_000));
        cortex_m::asm::delay((ns % 1000).saturating_mul(CORE_HZ / 1_000_000).div_ceil(1000));
    }
}
