//! The firmware image in an emulator, with the host as its bench: in QEMU, or on the machine of the board STM32H743.

pub mod debugger;
pub mod h743;
pub mod image;
mod machine;
mod run;

pub use machine::*;
pub use run::run;
