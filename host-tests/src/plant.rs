//! What an instrument is to the bench: something that yields a reading per data-ready edge and takes rate commands.

use std::cell::RefCell;
use std::rc::Rc;

/// What the IMU and the encoders report after one data-ready edge, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Middle of the interval over which rates and forces are means, us; the angles are those at that time.
    pub time_us: u64,
    /// Gyro outputs, rad/s.
    pub omega_g: [f64; 3],
    /// Accelerometer outputs, m/s^2.
    pub force_a: [f64; 3],
    /// Outer encoder, rad, continuous or wrapped.
    pub outer_rad: f64,
    /// Inner encoder, rad, continuous or wrapped.
    pub inner_rad: f64,
    /// IMU temperature, deg C; not a number where there is no sensor.
    pub temperature_c: f32,
}

/// An instrument, virtual or recorded.
pub trait Plant {
    /// Advances to the next data-ready edge; `None` when there are no more.
    fn next_reading(&mut self) -> Option<Reading>;

    /// Rates of (outer, inner) that the drives shall reach by the next edge, rad/s. A recording ignores them.
    fn command_rates(&mut self, rates_rad_s: [f64; 2]);
}

/// An instrument that others look at while it is on the bench.
impl<P: Plant> Plant for Rc<RefCell<P>> {
    fn next_reading(&mut self) -> Option<Reading> {
        self.borrow_mut().next_reading()
    }

    fn command_rates(&mut self, rates_rad_s: [f64; 2]) {
        self.borrow_mut().command_rates(rates_rad_s);
    }
}
