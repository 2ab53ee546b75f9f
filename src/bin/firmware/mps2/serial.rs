//! The serial line: UART 0 of the machine. An option of the emulator chooses what it is connected to.

use super::register::Register;
use crate::inbox;

const DATA: Register = Register::at(0x4000_4000);
const STATE: Register = Register::at(0x4000_4004);
const CONTROL: Register = Register::at(0x4000_4008);
const INTERRUPT_CLEAR: Register = Register::at(0x4000_400c);
const DIVIDER: Register = Register::at(0x4000_4010);

/// Bit of `STATE`: the transmit buffer is full.
const FULL_TO_SEND: u32 = 1;
const RECEIVED: u32 = 2;
/// Bits of `CONTROL`: enable both directions and the receive interrupt.
const ENABLE: u32 = 0b1011;
const INTERRUPT_RECEIVED: u32 = 2;

/// Opens the line at its highest speed. The emulator needs no time for a byte.
pub fn start() {
    DIVIDER.write(16);
    CONTROL.write(ENABLE);
}

/// Handles the interrupt of a received byte.
pub fn on_received() {
    INTERRUPT_CLEAR.write(INTERRUPT_RECEIVED);
    while STATE.read() & RECEIVED != 0 {
        inbox::put(DATA.read() as u8);
    }
}

/// Sends bytes as far as there is room.
pub fn transmit(mut next: impl FnMut() -> Option<u8>) {
    while STATE.read() & FULL_TO_SEND == 0
        && let Some(byte) = next()
    {
        DATA.write(byte.into());
    }
}
