//! The IMU KVH 1750 on USART2. TIM3 requests 200 messages a second.
//!
//! The time stamps depend neither on the latency of the unit nor on the time when a byte is read. A message ends 0.6 ms
//! after its request, so it answers the last edge on MSYNC. The control interrupt delays this interrupt by at most
//! about
//! 0.06 ms, most of it to read the encoders. In that time 6 bytes arrive, and the port holds 16 bytes.

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
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::drivers::kvh1750::{Kvh1750, Kvh1750Settings};

/// The request line is high for 60 us of each 5 ms.
const REQUEST_THOUSANDTHS: u32 = 12;
/// The unit must send a message within this time after the first request, us. It needs more than a second to start.
const START_US: u64 = 5_000_000;

/// The receiver of the IMU's bytes, and the time from a request to the last bit of its message, us.
type Receiver = (Streaming<'static, Scalar>, u64);

static RECEIVER: OfImu<Receiver> = Mutex::new(Cell::new(None));

/// The peripherals and pins of the IMU.
pub struct Wiring {
    pub timer: Peri<'static, TIM3>,
    pub request: Peri<'static, PC6>,
    pub port: Peri<'static, USART2>,
    pub rx: Peri<'static, PD6>,
}

/// Peripherals that must stay configured while the IMU is used.
pub struct Imu {
    /// Product and serial number, if the driver knows them.
    pub identity: Option<ImuIdentity>,
    _request: SimplePwm<'static, TIM3>,
    _port: UartRx<'static, Blocking>,
}

impl Imu {
    /// Opens the port and waits for a message; `None` if no message arrives in time.
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
        // A new receiver, so that it misses no message that is sent before the interrupt is enabled.
        let streaming = Streaming::new(Kvh1750::new(&settings), producer);
        let identity = streaming.imu().identity();
        critical_section::with(|cs| RECEIVER.borrow(cs).set(Some((streaming, settings.answer_us()))));
        Some(Self { identity, _request: request, _port: port })
    }

    /// Enables the interrupt for all bytes from now on.
    pub fn begin(&mut self) {
        pac::USART2.rqr().write(|request| request.set_rxfrq(true));
        pac::USART2.cr1().modify(|control| control.set_rxneie(true));
        interrupt::USART2.set_priority(Priority::P2);
        // Safety: all data of the interrupt is in place.
        unsafe { interrupt::USART2.enable() };
    }
}

/// Whether an intact message arrives in time.
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

/// Time of the last request, us. TIM3 counts from the edge of the request.
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
            // The queue counts a lost sample, so the result is not needed.
            let _ = streaming.on_byte(port.rdr().read().dr() as u8, requested_us() + *answer_us, view);
        }
    });
    // The CRC of the message shows that bytes are missing.
    port.icr().write(|flags| flags.set_ore(true));
}
