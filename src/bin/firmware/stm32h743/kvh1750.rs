//! The IMU KVH 1750 on USART2. TIM3 requests its outputs, 200 a second.
//!
//! Neither the latency of the unit nor when a byte is read has a part in the stamps: a message has ended 0.6 ms after its
//! request, so the last edge on MSYNC is the one that it answers. Control keeps the interrupt waiting for some 0.06 ms at most,
//! nearly all of it to read the encoders: of 16 bytes that the port holds 6 come meanwhile.

use super::{OfImu, clock, on_imu, pulses, view};
use crate::Scalar;
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
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::drivers::kvh1750::{Kvh1750, Kvh1750Settings};

/// A request is high for 60 us of 5 ms.
const REQUEST_THOUSANDTHS: u32 = 12;
/// Within this time after it is asked the unit must send, us; it takes more than a second to start.
const START_US: u64 = 5_000_000;

/// The IMU on its way to the queue; and from a request to the last bit of its message, us.
type Receiver = (Streaming<'static, Scalar>, u64);

static RECEIVER: OfImu<Receiver> = Mutex::new(Cell::new(None));

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
    /// Opens the port, and waits for a message; `None` if none comes.
    pub fn start(wiring: Wiring, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let Wiring { timer, request, port, rx } = wiring;
        let settings = Kvh1750Settings::default();
        let mut config = Config::default();
        config.baudrate = settings.baud;
        let port = UartRx::new_blocking(port, rx, config).ok()?;
        let request = pulses(timer, request, settings.rate_hz as u32, REQUEST_THOUSANDTHS);
        if !answers(&mut Kvh1750::new(&settings)) {
            return None;
        }
        // A new one, which misses no message that is sent before the interrupt comes.
        let streaming = Streaming::new(Kvh1750::new(&settings), producer);
        critical_section::with(|cs| RECEIVER.borrow(cs).set(Some((streaming, settings.answer_us()))));
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

/// Whether a good message comes in time.
fn answers(imu: &mut Kvh1750) -> bool {
    let port = pac::USART2;
    let end_us = clock::now_us() + START_US;
    while clock::now_us() < end_us {
        port.icr().write(|flags| flags.set_ore(true));
        if port.isr().read().rxne()
            && let Some(Ok(_)) = imu.push::<Scalar>(port.rdr().read().dr() as u8, clock::now_us())
        {
            return true;
        }
    }
    false
}

/// Time of the last request, us. TIM3 counts from its edge.
fn requested_us() -> u64 {
    let (now_us, count) = critical_section::with(|_| (clock::now_us(), pac::TIM3.cnt().read().cnt()));
    let counts = u64::from(pac::TIM3.arr().read().arr()) + 1;
    let period_us = 1_000_000 / Kvh1750Settings::default().rate_hz as u64;
    now_us.saturating_sub(u64::from(count) * period_us / counts)
}

#[handler]
fn USART2() {
    let port = pac::USART2;
    on_imu(&RECEIVER, |(streaming, answer_us)| {
        while port.isr().read().rxne() {
            // A sample that is lost has been counted.
            let _ = streaming.on_byte(port.rdr().read().dr() as u8, requested_us() + *answer_us, view);
        }
    });
    // The CRC finds that bytes are missing.
    port.icr().write(|flags| flags.set_ore(true));
}
