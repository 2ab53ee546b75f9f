//! The clocks of the chip, and the time since power-up.

use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::pac;
use embassy_stm32::pac::rcc::vals::Lsedrv;
use embassy_stm32::pac::timer::vals::CcmrInputCcs;
use embassy_stm32::peripherals::{TIM2, TIM16};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, LsConfig, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;
use embedded_hal::delay::DelayNs;
use rins_selfcal::base::clock_check::ClockFault;

/// Clock of the processor, Hz.
pub const CORE_HZ: u32 = 480_000_000;
/// Clock of the timers on APB1, Hz.
pub const TIMER_HZ: u32 = 240_000_000;

/// Where the processor's clock comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// 8 MHz at the pin PH0: from the ST-LINK, or from an oscillator in its place.
    External,
    /// The RC oscillator of the chip, 64 MHz to 1 %.
    Internal,
}

impl Source {
    /// Number of times that the external clock is looked for, once in 10 us.
    const LOOKS: u32 = 10_000;

    /// Starts the external clock, and waits for it for at most 0.1 s. The chip runs on its RC oscillator meanwhile.
    pub fn find() -> Self {
        pac::RCC.cr().modify(|control| control.set_hsebyp(true));
        pac::RCC.cr().modify(|control| control.set_hseon(true));
        for _ in 0..Self::LOOKS {
            if pac::RCC.cr().read().hserdy() {
                return Self::External;
            }
            cortex_m::asm::delay(640);
        }
        pac::RCC.cr().modify(|control| control.set_hseon(false));
        Self::Internal
    }
}

/// 480 MHz for the processor, 240 MHz for the buses, 120 MHz for the peripherals.
pub fn configuration(source: Source) -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    let rcc = &mut config.rcc;
    let (source, prediv) = match source {
        Source::External => {
            rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Bypass });
            (PllSource::HSE, PllPreDiv::DIV1)
        }
        Source::Internal => (PllSource::HSI, PllPreDiv::DIV8),
    };
    // The crystal of 32.768 kHz is started by `start_crystal`, which does not wait for it.
    rcc.ls = LsConfig::off();
    rcc.pll1 = Some(Pll {
        source,
        prediv,
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

/// Starts the crystal of 32.768 kHz.
pub fn start_crystal() {
    pac::PWR.cr1().modify(|control| control.set_dbp(true));
    pac::RCC.bdcr().modify(|domain| {
        domain.set_lsedrv(Lsedrv::MEDIUM_HIGH);
        domain.set_lseon(true);
    });
}

/// Edges of the crystal from one capture to the next. At 240 MHz the 16 bits of the timer hold them.
const EDGES: u32 = 8;
/// Number of captures: an eighth of a second.
const CAPTURES: u32 = 512;
/// Time after power-up until which the crystal must run, us.
const CRYSTAL_US: u64 = 2_000_000;

/// Compares the clock with the crystal of 32.768 kHz, if the crystal runs within 2 s after power-up. Takes an eighth of a
/// second, in which the caller must not be interrupted for longer than 0.2 ms.
pub fn check(_timer: Peri<'static, TIM16>) -> Option<ClockFault> {
    while !pac::RCC.bdcr().read().lserdy() {
        if now_us() > CRYSTAL_US {
            return Some(ClockFault::Unchecked);
        }
        Delay.delay_ms(1);
    }
    embassy_stm32::rcc::enable_and_reset::<TIM16>();
    let timer = pac::TIM16;
    // Input 1 of the timer is the crystal: RM0433, TIM16_TISEL.
    timer.tisel().write(|inputs| inputs.set_tisel(0, 2));
    timer.ccmr_input(0).write(|mode| {
        mode.set_ccs(0, CcmrInputCcs::TI4);
        mode.set_icpsc(0, 3);
    });
    timer.ccer().write(|enabled| enabled.set_cce(0, true));
    timer.cr1().write(|control| control.set_cen(true));
    let fault = match counted(CAPTURES) {
        Some(counted) => {
            let expected = u64::from(TIMER_HZ) * u64::from(EDGES * CAPTURES) / 32_768;
            ClockFault::of_counts(counted, expected as u32)
        }
        None => Some(ClockFault::Unchecked),
    };
    timer.cr1().write(|control| control.set_cen(false));
    fault
}

/// Counts of the timer over this many captures; `None` if the crystal stops.
fn counted(captures: u32) -> Option<u32> {
    const LONGEST_US: u64 = 1000;
    let next = || {
        let end_us = now_us() + LONGEST_US;
        while !pac::TIM16.sr().read().ccif(0) {
            if now_us() > end_us {
                return None;
            }
        }
        // The read clears the flag.
        Some(pac::TIM16.ccr(0).read().ccr())
    };
    let (mut last, mut sum) = (next()?, 0);
    for _ in 0..captures {
        let now = next()?;
        sum += u32::from(now.wrapping_sub(last));
        last = now;
    }
    Some(sum)
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
