//! Lowest and highest permitted values of the numbers of a configuration.
//!
//! A type whose numbers are bounded has one table, with a row for each number: its name, its unit, its bounds, and how
//! the number is taken from the type. The check and its message both use that table. A row may also be a derived number,
//! such as the ratio of two fields.

use crate::base::units::{ARCSEC, DEG, DEG_H, MGAL, MICRO_G, PPM};
use core::fmt;

/// A unit of measurement of a bound.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Unit {
    /// Symbol, for messages.
    pub symbol: &'static str,
    /// Value of one unit in SI units and radians.
    pub si: f64,
}

impl Unit {
    /// A unit of SI.
    pub const fn si(symbol: &'static str) -> Self {
        Self { symbol, si: 1.0 }
    }
}

/// Degrees.
pub const DEGREES: Unit = Unit { symbol: "deg", si: DEG };
/// Degrees per second.
pub const DEGREES_PER_S: Unit = Unit { symbol: "deg/s", si: DEG };
/// Degrees per second squared.
pub const DEGREES_PER_S2: Unit = Unit { symbol: "deg/s^2", si: DEG };
/// Degrees per second cubed.
pub const DEGREES_PER_S3: Unit = Unit { symbol: "deg/s^3", si: DEG };
/// Arcseconds.
pub const ARCSECONDS: Unit = Unit { symbol: "arcsec", si: ARCSEC };
/// Milliseconds.
pub const MILLISECONDS: Unit = Unit { symbol: "ms", si: 1e-3 };

/// Degrees per hour.
pub const DEGREES_PER_H: Unit = Unit { symbol: "deg/h", si: DEG_H };
/// Parts per million.
pub const PARTS_PER_MILLION: Unit = Unit { symbol: "ppm", si: PPM };
/// Millionths of standard gravity.
pub const MICROGRAVITIES: Unit = Unit { symbol: "ug", si: MICRO_G };
/// Milligals.
pub const MILLIGALS: Unit = Unit { symbol: "mGal", si: MGAL };

/// Relative rounding error that a number may have after its conversion to SI units.
const ROUNDING: f64 = 1e-12;

/// Permitted range of a number. The number itself is finite in any case.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Bound {
    /// Name of the number, as messages print it after "the".
    pub name: &'static str,
    /// Unit of the bounds.
    pub unit: Unit,
    /// Lowest permitted value, in `unit`.
    pub lowest: f64,
    /// Highest permitted value, in `unit`. It may be infinite.
    pub highest: f64,
}

impl Bound {
    /// Whether `value`, in SI units and radians, is finite and within the bounds.
    pub fn permits(&self, value: f64) -> bool {
        let [lowest, highest] = [self.lowest, self.highest].map(|bound| bound * self.unit.si);
        let permitted = lowest - ROUNDING * size(lowest)..=highest + ROUNDING * size(highest);
        value.is_finite() && permitted.contains(&value)
    }
}

/// The range in words: "from 1 to 1e6 deg/s^3", "at least 4 encoder steps".
impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (lowest, highest) = (Short(self.lowest), Short(self.highest));
        if self.highest == f64::INFINITY {
            write!(f, "at least {lowest}")?;
        } else {
            write!(f, "from {lowest} to {highest}")?;
        }
        if self.unit.symbol.is_empty() { Ok(()) } else { write!(f, " {}", self.unit.symbol) }
    }
}

/// A number with a power of ten if it is large or small.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plain = self.0 == 0.0 || (1e-2..1e5).contains(&size(self.0));
        if plain { write!(f, "{}", self.0) } else { write!(f, "{:e}", self.0) }
    }
}

fn size(x: f64) -> f64 {
    x.max(-x)
}

/// A row of the table of a type: a number of the type and its bounds.
#[derive(Clone, Copy, Debug)]
pub struct Bounded<C> {
    /// The bounds.
    pub bound: Bound,
    /// The number, in SI units and radians.
    pub value: fn(&C) -> f64,
}

impl<C> Bounded<C> {
    /// The row of the number `value`, named `name`, which may be from `lowest` to `highest` in `unit`.
    pub const fn new(name: &'static str, unit: Unit, [lowest, highest]: [f64; 2], value: fn(&C) -> f64) -> Self {
        Self { bound: Bound { name, unit, lowest, highest }, value }
    }
}

/// The first row of the table whose number is outside its bounds, counted from 0.
pub fn first_outside<C>(table: &[Bounded<C>], of: &C) -> Option<u8> {
    let outside = |row: &Bounded<C>| !row.bound.permits((row.value)(of));
    (0_u8..).zip(table).find(|(_, row)| outside(row)).map(|(number, _)| number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const TABLE: [Bounded<[f64; 2]>; 2] = [
        Bounded::new("rate", DEGREES_PER_S, [0.1, 125.0], |numbers| numbers[0]),
        Bounded::new("inertia", Unit::si("kg m^2"), [-1e-5, 1e6], |numbers| numbers[1]),
    ];

    #[test]
    fn a_number_is_permitted_from_its_lowest_to_its_highest_value() {
        for (of, outside) in [
            ([0.1 * DEG, -1e-5], None),
            ([125.0 * DEG, 1e6], None),
            ([0.099 * DEG, 0.0], Some(0)),
            ([125.001 * DEG, 0.0], Some(0)),
            ([f64::NAN, 0.0], Some(0)),
            ([DEG, -1.1e-5], Some(1)),
            ([DEG, f64::INFINITY], Some(1)),
        ] {
            assert_eq!(first_outside(&TABLE, &of), outside, "{of:?}");
        }
    }

    #[test]
    fn a_range_is_printed_in_its_unit() {
        assert_eq!(TABLE.map(|row| row.bound.to_string()), ["from 0.1 to 125 deg/s", "from -1e-5 to 1e6 kg m^2"]);
        let ratio = Bound { name: "ratio", unit: Unit::si(""), lowest: 0.0, highest: 1.0 };
        assert_eq!(ratio.to_string(), "from 0 to 1");
        let open = Bound { highest: f64::INFINITY, unit: Unit::si("encoder steps"), ..ratio };
        assert_eq!(open.to_string(), "at least 0 encoder steps");
        assert!(open.permits(1e300) && !open.permits(f64::INFINITY));
    }
}
