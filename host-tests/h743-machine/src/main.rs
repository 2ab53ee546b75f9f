//! Runs the unchanged firmware image of the board NUCLEO-H743ZI2 on a model of its chip, an STM32H743.
//!
//! The processor is unicorn's Cortex-M7. The peripherals are models of their registers, written from ST's reference
//! manual RM0433 and Arm's ARMv7-M manual and not from the firmware. The host simulates everything outside the chip,
//! and talks to this process by pipes as it talks to QEMU.
//!
//! ```text
//! host: bench  <- requests, answers: control periods, SPI ->  bench    \
//! host: reader <- telemetry: bytes of USART3, log: RTT    <-  machine   -> chip: registers, interrupts -> unicorn
//! host: tests  -> the command line; <- machine.json       <-  report   /
//! ```
//! An instruction takes one cycle of 480 MHz, a turn of a loop that delays one too, and an access to a register ten more. Caches, bus contention and
//! wait states of the flash are not modelled, so times are counts of instructions and not those of silicon.

mod bench;
mod chip;
mod cpu;
mod image;
mod options;
mod report;

use anyhow::Result;
use clap::Parser;

fn main() -> Result<()> {
    let options = options::Options::parse();
    let image = image::Image::read(&options.image)?;
    let mut machine = cpu::Machine::new(&options, &image)?;
    let ended = machine.run()?;
    machine.report(ended)?.write(&options.directory)
}
