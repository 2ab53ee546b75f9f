//! The serial line: USART3, which the ST-LINK connects to the host as a serial port. Its interrupt moves bytes between
//! the FIFOs of the chip and the buffers. The main loop never waits.

use crate::inbox;
use core::cell::RefCell;
use critical_section::Mutex;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{PD8, PD9, USART3};
use embassy_stm32::usart::{Config, Uart};
use embassy_stm32::{Peri, interrupt as handler, pac};
use heapless::Deque;

const BAUD: u32 = 921_600;
/// The FIFO of 16 bytes is full after 174 us. The ADIS16495 is read in 98 us and the control interrupt takes 70 us, so
/// this interrupt comes before the one of the ADIS16495, whose time stamp does not depend on its interrupt. The port of a
/// KVH 1750 has the same FIFO at the same rate, and its bytes matter more.
const PRIORITY: Priority = if cfg!(feature = "kvh1750") { Priority::P3 } else { Priority::P2 };
/// Size of the transmit buffer, bytes. The line sends this in 11 ms, twice the time between two turns of the main loop.
const WAITING_BYTES: usize = 1024;

static WAITING: Mutex<RefCell<Deque<u8, WAITING_BYTES>>> = Mutex::new(RefCell::new(Deque::new()));

/// Opens the line. It stays open as long as the returned value exists.
pub fn start(
    port: Peri<'static, USART3>,
    rx: Peri<'static, PD9>,
    tx: Peri<'static, PD8>,
) -> Option<Uart<'static, Blocking>> {
    let mut config = Config::default();
    config.baudrate = BAUD;
    let uart = Uart::new_blocking(port, rx, tx, config).ok()?;
    pac::USART3.cr1().modify(|control| control.set_rxneie(true));
    interrupt::USART3.set_priority(PRIORITY);
    // Safety: all data of the interrupt is in place.
    unsafe { interrupt::USART3.enable() };
    Some(uart)
}

#[handler]
fn USART3() {
    let port = pac::USART3;
    while port.isr().read().rxne() {
        inbox::put(port.rdr().read().dr() as u8);
    }
    if port.isr().read().ore() {
        // The number of lost bytes is not known; it is at least one.
        port.icr().write(|flags| flags.set_ore(true));
        inbox::count_lost(1);
    }
    critical_section::with(|cs| {
        let Ok(mut waiting) = WAITING.borrow(cs).try_borrow_mut() else { return };
        while port.isr().read().txe()
            && let Some(byte) = waiting.pop_front()
        {
            port.tdr().write(|data| data.set_dr(byte.into()));
        }
        let more = !waiting.is_empty();
        port.cr1().modify(|control| control.set_txeie(more));
    });
}

/// Fills the transmit buffer as far as there is room. Interrupts are delayed by one byte at most.
pub fn transmit(mut next: impl FnMut() -> Option<u8>) {
    let put = |byte| critical_section::with(|cs| WAITING.borrow(cs).try_borrow_mut().ok()?.push_back(byte).ok());
    let is_full =
        || critical_section::with(|cs| WAITING.borrow(cs).try_borrow().is_ok_and(|waiting| waiting.is_full()));
    while !is_full()
        && let Some(byte) = next()
        && put(byte).is_some()
    {}
    // If there is nothing to send, the interrupt switches itself off.
    critical_section::with(|_| pac::USART3.cr1().modify(|control| control.set_txeie(true)));
}
