//! Gimbal angles as binary fractions of a turn.
//!
//! The core counts angles in ticks, as an encoder does: one turn is 2^32 ticks, one tick is 0.0003 arcsec. Differences
//! of ticks wrap at a whole turn without extra code, and the resolution is the same with `f32` and `f64`.

use crate::base::linear::{ComplexField, Real, real};
use serde::{Deserialize, Serialize};

/// Ticks of one turn.
pub const TICKS_PER_TURN: f64 = 4_294_967_296.0;

/// One tick, rad.
pub const RAD_PER_TICK: f64 = core::f64::consts::TAU / TICKS_PER_TURN;

/// Angle of one gimbal axis within one turn. Positive is right-handed about the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Angle(u32);

impl Angle {
    /// The angle of `ticks` / 2^32 turns.
    pub const fn from_ticks(ticks: u32) -> Self {
        Self(ticks)
    }

    /// Ticks from zero, 0 to 2^32 - 1.
    pub const fn ticks(self) -> u32 {
        self.0
    }

    /// The tick nearest to `angle_rad`, which may span any number of turns.
    pub fn from_rad(angle_rad: f64) -> Self {
        Self(rad_to_ticks(angle_rad) as u32)
    }

    /// This angle increased by `ticks`.
    pub const fn turned(self, ticks: i32) -> Self {
        Self(self.0.wrapping_add_signed(ticks))
    }

    /// Difference from `earlier` to this angle along the shorter arc, ticks.
    pub const fn since(self, earlier: Self) -> i32 {
        self.0.wrapping_sub(earlier.0) as i32
    }

    /// This angle in [-pi, pi), rad.
    pub fn rad<T: Real>(self) -> T {
        ticks_to_rad(i64::from(self.0 as i32))
    }

    /// Sine and cosine. The reduction to a quarter turn is exact, so both have rounding accuracy with `f32` too.
    pub fn sin_cos<T: Real>(self) -> (T, T) {
        let quarter = self.0.wrapping_add(1 << 29) >> 30;
        let rest: T = ticks_to_rad(i64::from(self.0.wrapping_sub(quarter << 30) as i32));
        let (sin, cos) = if rest == T::zero() { (T::zero(), T::one()) } else { rest.sin_cos() };
        match quarter {
            0 => (sin, cos),
            1 => (cos, -sin),
            2 => (-sin, -cos),
            _ => (-cos, sin),
        }
    }
}

/// Converts `ticks` to radians. `ticks` may span any number of turns.
pub fn ticks_to_rad<T: Real>(ticks: i64) -> T {
    // The processor converts a 32-bit integer in one instruction and a 64-bit integer in dozens.
    let ticks = i32::try_from(ticks).map_or_else(|_| ticks as f64, f64::from);
    // Multiplying in f64 rounds only once when the core uses f32.
    real(ticks * RAD_PER_TICK)
}

/// Converts radians to ticks. The angle may span any number of turns; the result saturates at 2^31 turns, and NaN gives
/// 0.
pub fn rad_to_ticks(angle_rad: f64) -> i64 {
    ComplexField::round(angle_rad * (TICKS_PER_TURN / core::f64::consts::TAU)) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;

    #[test]
    fn wrapped_and_continuous_angles_agree() {
        for degrees in [-810.0_f64, -270.0, 90.0, 450.0] {
            let wrapped = (degrees.to_radians() + PI).rem_euclid(2.0 * PI) - PI;
            assert_eq!(Angle::from_rad(degrees.to_radians()), Angle::from_rad(wrapped));
        }
    }

    #[test]
    fn difference_takes_the_shorter_way() {
        let a = Angle::from_rad(3.1);
        let b = Angle::from_rad(-3.1);
        assert!((ticks_to_rad::<f64>(b.since(a).into()) - (2.0 * PI - 6.2)).abs() < 1e-8);
        assert_eq!(a.turned(b.since(a)), b);
    }

    #[test]
    fn sine_and_cosine_match_the_library() {
        for step in 0..1000_u32 {
            let angle = Angle::from_ticks(step.wrapping_mul(4_293_001));
            let (sin, cos) = angle.sin_cos::<f64>();
            let rad = angle.rad::<f64>();
            assert!((sin - rad.sin()).abs() < 4e-16 && (cos - rad.cos()).abs() < 4e-16, "{rad}");
            let (sin32, cos32) = angle.sin_cos::<f32>();
            assert!((f64::from(sin32) - sin).abs() < 7e-8 && (f64::from(cos32) - cos).abs() < 7e-8, "{rad}");
        }
    }
}
