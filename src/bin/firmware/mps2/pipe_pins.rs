//! The data that the control interrupt exchanges with the host once a period: the pins of the motor bridges, and the
//! encoders.
//!
//! The outputs of a period are latched and sent to the host when the next period begins. The same transfer returns the
//! inputs and the bytes of the encoders, because a transfer costs far more time than its bytes.
//! [`PERIOD_BYTES`] describes the layout.

use super::bridge_pins::{BridgeLines, Outputs};
use super::pipe_spi::{PipeBus, PipeFault};
use super::wire::{PERIOD_BYTES, input, pin};
use core::cell::Cell;
use critical_section::Mutex;
use embedded_hal::spi::{self, Operation, SpiDevice};
use rins_selfcal::drivers::biss::CAPTURE_BYTES;

/// Written by the control interrupt, and once at power-up.
static OUTPUTS: Mutex<Cell<[Outputs; 2]>> =
    Mutex::new(Cell::new([Outputs { duty: 0, forward: false, enabled: false }; 2]));
/// The last bytes from the host. Written by the control interrupt.
static RECEIVED: Mutex<Cell<[u8; PERIOD_BYTES]>> = Mutex::new(Cell::new([0xff; PERIOD_BYTES]));

/// Lets the host simulate one control period. Returns the inputs at its end; `None` if the instrument is switched off.
pub fn period(bus: PipeBus) -> Option<u8> {
    let [outer, inner] = critical_section::with(|cs| OUTPUTS.borrow(cs).get()).map(|outputs| {
        let [low, high] = outputs.duty.to_le_bytes();
        [low, high, (u8::from(outputs.forward) * pin::DIRECTION) | (u8::from(outputs.enabled) * pin::ENABLE)]
    });
    let mut frame = [0; PERIOD_BYTES];
    for (place, byte) in frame.iter_mut().zip(outer.into_iter().chain(inner)) {
        *place = byte;
    }
    let on = bus.period(&mut frame);
    critical_section::with(|cs| RECEIVED.borrow(cs).set(frame));
    let [inputs, ..] = frame;
    on.then_some(inputs)
}

/// The line of an encoder. Its bytes are those of the beginning of the period.
pub struct EncoderSpi {
    /// 0 for the outer axis, 1 for the inner axis.
    pub axis: usize,
}

impl spi::ErrorType for EncoderSpi {
    type Error = PipeFault;
}

impl SpiDevice for EncoderSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), PipeFault> {
        let received = critical_section::with(|cs| RECEIVED.borrow(cs).get());
        let mut line = received.into_iter().skip(1 + self.axis * CAPTURE_BYTES).take(CAPTURE_BYTES);
        for operation in operations {
            match operation {
                Operation::Read(bytes) => bytes.iter_mut().for_each(|byte| *byte = line.next().unwrap_or(0xff)),
                _ => return Err(PipeFault::TooLong),
            }
        }
        Ok(())
    }
}

/// The bridges' pins on this board.
#[derive(Clone, Copy)]
pub struct LatchedLines;

impl BridgeLines for LatchedLines {
    fn change(&mut self, axis: usize, change: impl FnOnce(&mut Outputs)) {
        critical_section::with(|cs| {
            let mut all = OUTPUTS.borrow(cs).get();
            if let Some(outputs) = all.get_mut(axis) {
                change(outputs);
            }
            OUTPUTS.borrow(cs).set(all);
        });
    }

    fn fault_line(&mut self, axis: usize) -> bool {
        let [inputs, ..] = critical_section::with(|cs| RECEIVED.borrow(cs).get());
        input::FAULT.get(axis).is_some_and(|fault| inputs & fault != 0)
    }
}
