//! The IMU ADIS16495 on SPI1. TIM3 clocks its samples. TIM2, the board's clock, captures the time of each data-ready
//! edge, so a delay of the interrupt does not change the time stamps.

use super::clock::{self, Delay};
use super::{Bus, OfImu, on_imu, pulses, spi_config, view};
use crate::Scalar;
use core::cell::Cell;
use critical_section::Mutex;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::timer::vals::CcmrInputCcs;
use embassy_stm32::peripherals::{PA5, PA6, PB5, PB11, PC6, PD14, SPI1, TIM2, TIM3};
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::timer::input_capture::{CapturePin, Ch4};
use embassy_stm32::timer::simple_pwm::SimplePwm;
use embassy_stm32::{interrupt as handler, pac};
use embedded_hal_bus::spi::ExclusiveDevice;
use rins_selfcal::acquisition::Acquisition;
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::drivers::adis16495::{Adis16495, Adis16495Settings};

type BoardAcquisition = Acquisition<'static, Scalar, ExclusiveDevice<Bus, Output<'static>, Delay>>;

static ACQUISITION: OfImu<BoardAcquisition> = Mutex::new(Cell::new(None));

/// The peripherals and pins of the IMU.
pub struct Wiring {
    pub timer: Peri<'static, TIM3>,
    pub clock: Peri<'static, PC6>,
    pub bus: Peri<'static, SPI1>,
    pub sclk: Peri<'static, PA5>,
    pub din: Peri<'static, PB5>,
    pub dout: Peri<'static, PA6>,
    pub select: Peri<'static, PD14>,
    pub data_ready: Peri<'static, PB11>,
}

/// Peripherals that must stay configured while the IMU is used.
pub struct Imu {
    /// Product and serial number.
    pub identity: Option<ImuIdentity>,
    _clock: SimplePwm<'static, TIM3>,
    _data_ready: CapturePin<'static, TIM2, Ch4>,
}

impl Imu {
    /// Initializes the IMU; `None` if the IMU does not answer.
    pub fn start(wiring: Wiring, producer: SampleProducer<'static, Scalar>) -> Option<Self> {
        let Wiring { timer, clock, bus, sclk, din, dout, select, data_ready } = wiring;
        let clock = pulses(timer, clock, 4000, 500);
        let bus = Spi::new_blocking(bus, sclk, din, dout, spi_config(spi::MODE_3, 3_750_000));
        let device = ExclusiveDevice::new(bus, Output::new(select, Level::High, Speed::VeryHigh), Delay).ok()?;
        let imu = Adis16495::start_cold(device, &mut Delay, &Adis16495Settings::default()).ok()?;
        let identity = Some(imu.identity());
        critical_section::with(|cs| ACQUISITION.borrow(cs).set(Some(Acquisition::new(imu, producer))));
        Some(Self { identity, _clock: clock, _data_ready: CapturePin::new(data_ready, Pull::Down) })
    }

    /// Enables the interrupt, which comes when channel 4 captures the time of a rising edge.
    pub fn begin(&mut self) {
        pac::TIM2.ccmr_input(1).modify(|mode| mode.set_ccs(1, CcmrInputCcs::TI4));
        pac::TIM2.ccer().modify(|enabled| enabled.set_cce(3, true));
        pac::TIM2.dier().modify(|enabled| enabled.set_ccie(3, true));
        interrupt::TIM2.set_priority(Priority::P3);
        // Safety: all data of the interrupt is in place.
        unsafe { interrupt::TIM2.enable() };
    }
}

/// Time of the last captured edge, us; `None` if there was no edge since the last call.
fn captured_us() -> Option<u64> {
    if !pac::TIM2.sr().read().ccif(3) {
        return None;
    }
    // The read clears the flag.
    let captured = pac::TIM2.ccr(3).read();
    let now = clock::now_us();
    Some(now.saturating_sub(u64::from((now as u32).wrapping_sub(captured))))
}

#[handler]
fn TIM2() {
    on_imu(&ACQUISITION, |acquisition| {
        // The queue counts a lost sample, so the result is not needed.
        let _ = captured_us().map(|edge_us| acquisition.on_data_ready(edge_us, view));
    });
}
