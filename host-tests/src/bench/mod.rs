//! The instrument's simulated devices, and the programs that run on them: the core in this process, or the firmware in
//! the emulator.

#[path = "../../../src/bin/firmware/mps2/bridge_pins.rs"]
mod bridge_pins;
mod bus;
pub mod chips;
mod devices;
pub mod emulator;
pub mod firmware_sizes;
pub mod gimbal_plant;
mod imu;
pub mod line;
pub mod memory;
pub mod power_up;
pub mod servo_bench;
#[path = "../../../src/bin/firmware/mps2/wire.rs"]
pub mod wire;

pub use bus::*;
pub use devices::*;
pub use imu::{Imu, Received};
