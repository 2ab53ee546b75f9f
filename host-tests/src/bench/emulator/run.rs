//! A run of an image on the machine of its board.

use super::h743;
use super::image::Board;
use super::machine::{MachineSetup, Run, run_in_qemu};
use crate::bench::devices::Bench;
use crate::virtual_unit::plant::Plant;
use anyhow::Result;
use rins_selfcal::run::telemetry::Message;

/// Runs an image on a bench until the plant is exhausted and the firmware has ended. `on_log` gets each line of the
/// firmware's log, and `on_message` gets each message.
///
/// # Errors
/// The emulator cannot be started, or the firmware faults, hangs, or ends without its report.
pub fn run<P: Plant>(
    setup: &MachineSetup<'_>,
    bench: &mut Bench<P>,
    on_log: impl FnMut(&str),
    on_message: impl FnMut(&Message),
) -> Result<Run> {
    match setup.image.board {
        Board::Stm32h743 => h743::run(setup, bench, on_log, on_message)?.run(),
        Board::Mps2An500 | Board::Mps2An386 => run_in_qemu(setup, bench, on_log, on_message),
    }
}
