//! The IMU KVH 1750 on USART2. TIM3 requests its outputs, 200 a second.
//!
//! The time of a byte is that at which its interrupt reads it. Control keeps it waiting for some 0.06 ms at most, nearly all of
//! it to read the encoders: of 16 bytes that the port holds 6 come meanwhile, and a stamp that is late by so much costs 0.001
//! arcsec.

use super::{clock, pulses, view};
use crate::work::{Span, Work, count};
use crate::{Scalar, watchdog};
use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{PC6, PD6, TIM3, USART2};
use embassy_stm32::timer::simple_pwm::SimplePwm;
use embassy_stm32::usart::{Config, UartRx};
use embassy_stm32::{interrupt as handler, pac};
use rins_selfcal::acquisition::Streaming;
use rins_selfcal::drivers::kvh1750::{Kvh1750, Settings};
use rins_selfcal::liveness::Task;
use rins_selfcal::queue::SampleProducer;

/// A request is high for 60 us of 5 ms.
const REQUEST_THOUSANDTHS: u32 = 12;

/// Filled once at power-up, then used by the interrupt of the port only, which takes it out while it does: the control
/// interrupt may come into it.
static STREAMING: Mutex<Cell<Option<Streaming<'static, Scalar>>>> = Mutex::new(Cell::new(None));

/// What the IMU is connected to.
pub struct Wiring {
    pub timer: Peri<'static, TIM3>,
    pub request: Peri<'static, PC6>,
    pub port: Peri<'static, USART2>,
    pub rx: Peri<'static, PD6>,
}

/// What must stay as it is while the IMU is used.
pub struct Imu {
    _request: SimplePwm<'static, TIM3>,
    _port: UartRx<'static, Blocking>,
}

impl Imu {
    /// Opens the port; `None` if it cannot be set up so.
    pub fn start(wiring: Wiring, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let Wiring { timer, request, port, rx } = wiring;
        let settings = Settings::default();
        let mut config = Config::default();
        config.baudrate = settings.baud;
        let port = UartRx::new_blocking(port, rx, config).ok()?;
        let streaming = Streaming::new(Kvh1750::new(&settings), producer);
        critical_section::with(|cs| STREAMING.borrow(cs).set(Some(streaming)));
        let request = pulses(timer, request, settings.rate_hz as u32, REQUEST_THOUSANDTHS);
        Some(Self { _request: request, _port: port })
    }

    /// Lets its interrupt come, for bytes from here on.
    pub fn begin(&mut self) {
        pac::USART2.rqr().write(|request| request.set_rxfrq(true));
        pac::USART2.cr1().modify(|control| control.set_rxneie(true));
        interrupt::USART2.set_priority(Priority::P2);
        // Safety: everything the interrupt uses is in place.
        unsafe { interrupt::USART2.enable() };
    }
}

#[handler]
fn USART2() {
    let span = Span::start();
    let port = pac::USART2;
    if let Some(mut streaming) = critical_section::with(|cs| STREAMING.borrow(cs).take()) {
        while port.isr().read().rxne() {
            // A sample that is lost has been counted.
            let _ = streaming.on_byte(port.rdr().read().dr() as u8, clock::now_us(), view);
        }
        critical_section::with(|cs| STREAMING.borrow(cs).set(Some(streaming)));
    }
    // The CRC finds that bytes are missing.
    port.icr().write(|flags| flags.set_ore(true));
    watchdog::report(Task::Sampling, clock::now_us());
    count(Work::Acquire, &span);
    span.put_aside();
}
