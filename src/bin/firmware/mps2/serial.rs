//! The serial line: UART 0 of the machine, which the emulator connects to whatever it is told to.

use super::register::Register;
use crate::inbox;

const DATA: Register = Register::at(0x4000_4000);
const STATE: Register = Register::at(0x4000_4004);
const CONTROL: Register = Register::at(0x4000_4008);
const INTERRUPT_CLEAR: Register = Register::at(0x4000_400c);
const DIVIDER: Register = Register::at(0x4000_4010);

/// Bits of `STATE`.
const FULL_TO_SEND: u32 = 1;
const RECEIVED: u32 = 2;
/// Bits of `CONTROL`: both directions, and the interrupt of a byte that came in.
const ENABLE: u32 = 0b1011;
const INTERRUPT_RECEIVED: u32 = 2;

/// Opens the line, at the highest speed there is: nothing of it takes time here.
pub fn start() {
    DIVIDER.write(16);
    CONTROL.write(ENABLE);
}

/// A byte has come in.
pub fn on_received() {
    INTERRUPT_CLEAR.write(INTERRUPT_RECEIVED);
    while STATE.read() & RECEIVED != 0 {
        inbox::put(DATA.read() as u8);
    }
}

/// Sends what there is, as far as there is room.
pub fn transmit(mut next: impl FnMut() -> Option<u8>) {
    while STATE.read() & FULL_TO_SEND == 0
        && let Some(byte) = next()
    {
        DATA.write(byte.into());
    }
}
