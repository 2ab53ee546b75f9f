//! An example of your own drivers: a board that maps an IMU, two encoders, two motor bridges and a battery-backed
//! memory into the address space. Replace these drivers with yours. The signatures show what the core needs.

use core::convert::Infallible;
use core::ptr::{addr_of, addr_of_mut, read_volatile, write_volatile};
use embedded_storage::{ReadStorage, Storage};
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::linear::Vector3;
use rins_selfcal::base::sample::RawSample;
use rins_selfcal::gimbal::servo::Drive;
use rins_selfcal::gimbal::{BridgeFault, EncoderFault, GimbalInputs};

const BYTES: usize = 8192;

/// The registers, in the layout of the board.
#[repr(C)]
struct Registers {
    /// Time stamp of the mean rates and forces, the middle of their interval, us; low word first.
    stamp_us: [u32; 2],
    /// Mean angular rates, unit 2^-31 of 20 rad/s, and mean specific forces, unit 2^-31 of 400 m/s^2.
    rates: [i32; 3],
    forces: [i32; 3],
    /// Temperature, unit 1/256 deg C.
    temperature: i32,
    /// Encoder angles at the stamp and at present, unit 2^-32 of a turn.
    angles: [u32; 2],
    angles_now: [u32; 2],
    /// Bits 0, 1: alarms of the encoders. Bits 2, 3: overcurrent of the bridges.
    alarms: u32,
    /// Bridges: duty, unit 2^-31, and mode: 0 duty, 1 shorted, 2 open.
    duties: [i32; 2],
    modes: [u32; 2],
    memory: [u8; BYTES],
}

/// The board.
#[derive(Clone, Copy)]
pub struct SensorBoard(*mut Registers);

// SAFETY: each register is read or written in one access. Each written register has one owner: the control interrupt
// writes the bridges, and the main loop writes the memory.
unsafe impl Send for SensorBoard {}

impl SensorBoard {
    /// The board at the external memory controller, which your start-up code has configured.
    pub const fn at_external_memory() -> Self {
        Self(0x6000_0000 as *mut Registers)
    }

    /// The sample that the data-ready edge has announced.
    pub fn sample(&self) -> RawSample<f64> {
        // SAFETY: the registers exist at this address.
        let (stamp, rates, forces, angles, temperature) = unsafe {
            (
                read_volatile(addr_of!((*self.0).stamp_us)),
                read_volatile(addr_of!((*self.0).rates)),
                read_volatile(addr_of!((*self.0).forces)),
                read_volatile(addr_of!((*self.0).angles)),
                read_volatile(addr_of!((*self.0).temperature)),
            )
        };
        let [outer, inner] = angles.map(Angle::from_ticks);
        RawSample {
            time_us: u64::from(stamp[0]) | u64::from(stamp[1]) << 32,
            omega_g: Vector3::from(rates.map(|count| f64::from(count) * (20.0 / 2_147_483_648.0))),
            force_a: Vector3::from(forces.map(|count| f64::from(count) * (400.0 / 2_147_483_648.0))),
            outer,
            inner,
            temperature_c: temperature as f32 / 256.0,
        }
    }

    /// The inputs of the gimbal control.
    pub fn sensed(&self) -> GimbalInputs {
        // SAFETY: the registers exist at this address.
        let (angles, alarms) =
            unsafe { (read_volatile(addr_of!((*self.0).angles_now)), read_volatile(addr_of!((*self.0).alarms))) };
        let is_on = |bit: usize| alarms >> bit & 1 == 1;
        let encoder =
            |axis: usize, count| if is_on(axis) { Err(EncoderFault::Alarm) } else { Ok(Angle::from_ticks(count)) };
        let bridge = |axis: usize| if is_on(2 + axis) { Err(BridgeFault::Overcurrent) } else { Ok(()) };
        let [outer, inner] = angles;
        GimbalInputs { encoders: [encoder(0, outer), encoder(1, inner)], bridges: [bridge(0), bridge(1)] }
    }

    /// Sets the duties and modes of the motor bridges.
    pub fn drive(&mut self, drives: [Drive<f64>; 2]) {
        let duties =
            drives.map(|drive| if let Drive::Duty(duty) = drive { (duty * 2_147_483_647.0) as i32 } else { 0 });
        let modes = drives.map(|drive| match drive {
            Drive::Duty(_) => 0,
            Drive::Brake => 1,
            Drive::Off => 2,
        });
        // SAFETY: the registers exist at this address, and only the control interrupt writes them.
        unsafe {
            write_volatile(addr_of_mut!((*self.0).duties), duties);
            write_volatile(addr_of_mut!((*self.0).modes), modes);
        }
    }

    fn byte(&self, at: usize) -> Option<*mut u8> {
        // SAFETY: the address is within the memory.
        (at < BYTES).then(|| unsafe { addr_of_mut!((*self.0).memory).cast::<u8>().add(at) })
    }
}

impl ReadStorage for SensorBoard {
    type Error = Infallible;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        for (at, byte) in (offset as usize..).zip(bytes) {
            // SAFETY: the address is within the memory, which only the main loop uses.
            *byte = self.byte(at).map_or(0xff, |from| unsafe { read_volatile(from) });
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl Storage for SensorBoard {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        for (at, byte) in (offset as usize..).zip(bytes) {
            if let Some(to) = self.byte(at) {
                // SAFETY: the address is within the memory, which only the main loop uses.
                unsafe { write_volatile(to, *byte) };
            }
        }
        Ok(())
    }
}
