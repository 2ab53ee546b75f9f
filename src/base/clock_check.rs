//! The clock of the time stamps, compared with a second oscillator. The scale factors of the gyros take over every error
//! of this clock.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Greatest difference between the clock and the second oscillator, ppm. A watch crystal is off by up to 20 ppm, and by up
/// to 30 ppm more at the ends of its temperature range. An RC oscillator is off by a thousand ppm and more.
pub const TOLERANCE_PPM: f32 = 50.0;

/// What is wrong with the clock of the time stamps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockFault {
    /// The external oscillator does not run. The time stamps are those of an RC oscillator in the processor.
    Absent,
    /// The clock is faster than the second oscillator says by this many ppm.
    Off(f32),
    /// The second oscillator does not run, so nothing is known about the clock.
    Unchecked,
}

impl ClockFault {
    /// The fault of a clock that has counted `counted` while the second oscillator says `expected`; `None` if both agree
    /// to [`TOLERANCE_PPM`].
    pub fn of_counts(counted: u32, expected: u32) -> Option<Self> {
        let off = f64::from(counted) - f64::from(expected);
        let ppm = (1e6 * off / f64::from(expected.max(1))) as f32;
        (ppm.abs() > TOLERANCE_PPM).then_some(Self::Off(ppm))
    }

    /// Whether no result can be accepted with this fault. The scale of a clock that is not checked may be right.
    pub fn rejects(self) -> bool {
        self != Self::Unchecked
    }
}

impl fmt::Display for ClockFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("the external clock does not run, and the internal one is off by up to 1 %"),
            Self::Off(ppm) => write!(
                f,
                "the clock differs from the crystal of 32.768 kHz by {ppm:.0} ppm; at most {TOLERANCE_PPM:.0} are permitted"
            ),
            Self::Unchecked => f.write_str("the clock was not checked, because the crystal of 32.768 kHz does not run"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_within_the_tolerance_has_no_fault() {
        // An eighth of a second at 240 MHz.
        let expected = 30_000_000;
        for counted in [expected, expected + 1400, expected - 1400] {
            assert_eq!(ClockFault::of_counts(counted, expected), None, "{counted}");
        }
        for (counted, ppm) in [(expected + 1560, 52.0), (expected - 1560, -52.0), (expected + 120_000, 4000.0)] {
            assert_eq!(ClockFault::of_counts(counted, expected), Some(ClockFault::Off(ppm)));
        }
        assert_eq!(ClockFault::of_counts(0, expected), Some(ClockFault::Off(-1e6)), "a clock that stands");
        assert!(ClockFault::of_counts(1, 0).is_some_and(ClockFault::rejects), "no division by zero");
    }
}
