//! Library of named schemes and their sources. All schemes use 20 deg/s and 20 deg/s^2.
//!
//! For schemes from the literature the source gives the positions. If the source does not give the duration of the
//! stops, the duration is a choice of this project. Some sources start at an attitude other than (0, 0); these schemes
//! begin with a stop at (0, 0) and a move to that attitude.
//!
//! The modulation schemes `8-position` and `16-position` cannot calibrate all parameters. Their half turns from level
//! reverse the sensor errors, so that the errors average out, but the inner axis stays vertical. Only the z
//! accelerometer measures gravity, so the x and y accelerometer scale factors are not observable, and gamma cannot be
//! separated from the gyro non-orthogonality. A run with these schemes is refused. If
//! [`refuse_unobserved`](crate::run::config::SelfCalibrationConfig::refuse_unobserved) is switched off, the run takes
//! place, and its verdict is a rejection with the parameters that were found.

use super::legs::{Leg, Scheme};
use crate::base::method::Method;
use crate::base::units::DEG;
use heapless::{String, Vec};

/// A scheme of the library.
#[derive(Clone, Copy, Debug)]
pub struct LibraryScheme {
    /// Name, as in a configuration.
    pub name: &'static str,
    /// Source.
    pub source: &'static str,
    /// Command that repeats the planning, for planned schemes.
    pub command: Option<&'static str>,
    stops: Stops,
}

#[derive(Clone, Copy, Debug)]
enum Stops {
    /// Stops of equal duration. The positions are in quarter turns (outer, inner) and begin with the second stop.
    Quarters { stop_s: f64, positions: &'static [(i8, i8)] },
    /// First stop, s; then for each leg the outer angle, deg, the inner angle, deg, and its stop, s.
    Legs { first_stop_s: f64, legs: &'static [(f64, f64, f64)] },
}

/// Bai's 18 moves: quarter turns of (outer, inner) at each stop after the first. (Bai, section 4: three steps, one
/// period)
const BAI: [(i8, i8); 18] = [
    (-1, 0),
    (-2, 0),
    (-3, 0),
    (-2, 0),
    (-1, 0),
    (-1, -1),
    (-2, -1),
    (-3, -1),
    (-4, -1),
    (-3, -1),
    (-2, -1),
    (-1, -1),
    (-1, -2),
    (-1, -3),
    (-1, -2),
    (-1, -1),
    (-1, 0),
    (0, 0),
];

/// Bai's moves from a start at one negative quarter turn of the outer axis, where the inner axis is level.
const BAI_Y: [(i8, i8); 19] = {
    let mut positions = [(-1, 0); 19];
    let mut leg = 0;
    while leg < BAI.len() {
        positions[leg + 1] = (BAI[leg].0 - 1, BAI[leg].1);
        leg += 1;
    }
    positions
};

const POSITIONS_19: [(i8, i8); 19] = [
    (-1, 0),
    (0, 0),
    (1, 0),
    (2, 0),
    (1, 0),
    (0, 0),
    (-1, 0),
    (-1, 1),
    (0, 1),
    (1, 1),
    (2, 1),
    (1, 1),
    (0, 1),
    (-1, 1),
    (-1, 2),
    (-1, 3),
    (-1, 2),
    (-1, 1),
    (-1, 0),
];

const POSITIONS_8: [(i8, i8); 8] = [(0, 2), (2, 2), (2, 0), (0, 0), (2, 0), (2, 2), (0, 2), (0, 0)];

const POSITIONS_16: [(i8, i8); 16] = {
    let mut positions = [(0, 0); 16];
    let mut leg = 0;
    while leg < POSITIONS_8.len() {
        let (outer, inner) = POSITIONS_8[leg];
        positions[leg] = (outer, inner);
        positions[leg + 8] = (-outer, -inner);
        leg += 1;
    }
    positions
};

const PLANNED: &str = "planned by `rins plan`; outer axis within -360..0 deg, inner axis within -270..0 deg, stops at \
                       multiples of 45 deg, noise and hardware of navigation grade";

const PLANNED_FOR_IDEAL: &str = "planned by `rins plan`, best of several random seeds; outer axis within -360..0 deg, \
                                 inner axis within -270..0 deg, noise of navigation grade, ideal hardware";

/// Names of all schemes, for messages.
pub const NAMES: &str = "bai, bai-y, 19-position, 8-position, 16-position, \
                         fast-60, fast-90, fast-120, fast-180, fast-300, \
                         ideal-60, ideal-90, ideal-120, ideal-180, ideal-300";

/// All schemes of the library.
pub const LIBRARY: [LibraryScheme; 15] = [
    LibraryScheme {
        name: "bai",
        source: "Bai et al., Sensors 2019, 19, 4005, section 4; our reading: the inner axis is z, and the \
                 axes return along the path that they came",
        command: None,
        stops: Stops::Quarters { stop_s: 200.0, positions: &BAI },
    },
    LibraryScheme {
        name: "bai-y",
        source: "the scheme `bai` with the inner axis read as y, which is level at the start: our outer angle -90 deg",
        command: None,
        stops: Stops::Quarters { stop_s: 200.0, positions: &BAI_Y },
    },
    LibraryScheme {
        name: "19-position",
        source: "Xie et al., Multiposition calibration method of laser gyro SINS, 2011, as in Yan's PSINS toolbox \
                 (there the stops last 20 s and the first stop 60 s); y of the source is our outer axis, and both axes \
                 are level at the start: our outer angle -90 deg",
        command: None,
        stops: Stops::Quarters { stop_s: 20.0, positions: &POSITIONS_19 },
    },
    LibraryScheme {
        name: "8-position",
        source: "dual-axis rotation modulation by half turns, each position followed by its reverse (the cycle of \
                 Levinson and Majure, Navigation 34, 1987, as commonly cited); averages sensor errors, cannot calibrate them",
        command: None,
        stops: Stops::Quarters { stop_s: 30.0, positions: &POSITIONS_8 },
    },
    LibraryScheme {
        name: "16-position",
        source: "the scheme `8-position`, then the same with every turn reversed (after Yuan, Liao and Han, \
                 Meas. Sci. Technol. 23, 2012, 115102, as commonly cited)",
        command: None,
        stops: Stops::Quarters { stop_s: 30.0, positions: &POSITIONS_16 },
    },
    LibraryScheme {
        name: "fast-60",
        source: PLANNED,
        command: Some(
            "rins plan --time 60 --limits=-360..0,-270..0 --angles 45 --evaluations 200000 --out fast-60.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 2.645,
            legs: &[
                (-90.0, 0.0, 4.355),
                (-90.0, -90.0, 4.57),
                (-45.0, -135.0, 1.735),
                (-90.0, -180.0, 3.86),
                (-180.0, -90.0, 2.32),
                (-270.0, -90.0, 3.135),
                (-315.0, -135.0, 3.205),
            ],
        },
    },
    LibraryScheme {
        name: "fast-90",
        source: PLANNED,
        command: Some(
            "rins plan --time 90 --limits=-360..0,-270..0 --angles 45 --evaluations 200000 --out fast-90.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 5.78,
            legs: &[
                (-90.0, 0.0, 9.915),
                (-180.0, -90.0, 3.205),
                (-90.0, -90.0, 6.71),
                (-90.0, -180.0, 9.135),
                (0.0, -180.0, 4.83),
                (-90.0, -270.0, 6.41),
                (-180.0, -270.0, 3.09),
            ],
        },
    },
    LibraryScheme {
        name: "fast-120",
        source: PLANNED,
        command: Some(
            "rins plan --time 120 --limits=-360..0,-270..0 --angles 45 --evaluations 200000 --out fast-120.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 6.68,
            legs: &[
                (-90.0, 0.0, 7.54),
                (-90.0, -90.0, 5.4),
                (-90.0, -180.0, 9.745),
                (-45.0, -225.0, 4.325),
                (-90.0, -270.0, 4.4),
                (-135.0, -270.0, 1.58),
                (-180.0, -225.0, 8.52),
                (-270.0, -270.0, 3.45),
                (-315.0, -225.0, 4.2),
                (-270.0, -180.0, 3.415),
                (-315.0, -135.0, 3.515),
                (-225.0, -90.0, 3.045),
            ],
        },
    },
    LibraryScheme {
        name: "fast-180",
        source: PLANNED,
        command: Some(
            "rins plan --time 180 --limits=-360..0,-270..0 --angles 45 --evaluations 200000 --out fast-180.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 10.45,
            legs: &[
                (-135.0, 0.0, 5.425),
                (-90.0, -90.0, 5.59),
                (-90.0, -135.0, 4.08),
                (-180.0, -90.0, 8.795),
                (-270.0, -90.0, 6.345),
                (-270.0, -45.0, 5.265),
                (-360.0, -135.0, 6.51),
                (-315.0, -180.0, 4.23),
                (-270.0, -180.0, 7.235),
                (-180.0, -180.0, 7.06),
                (-90.0, -270.0, 7.745),
                (-90.0, -180.0, 11.495),
                (-90.0, -90.0, 8.485),
                (-90.0, 0.0, 6.505),
            ],
        },
    },
    LibraryScheme {
        name: "fast-300",
        source: PLANNED,
        command: Some(
            "rins plan --time 300 --limits=-360..0,-270..0 --angles 45 --evaluations 200000 --out fast-300.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 11.78,
            legs: &[
                (-135.0, 0.0, 5.815),
                (-225.0, 0.0, 4.475),
                (-270.0, 0.0, 6.24),
                (-180.0, -45.0, 7.335),
                (-90.0, 0.0, 8.09),
                (-45.0, -45.0, 4.61),
                (-90.0, -90.0, 8.6),
                (-90.0, -180.0, 10.105),
                (-90.0, -270.0, 11.145),
                (-225.0, -270.0, 4.675),
                (-270.0, -270.0, 9.645),
                (-270.0, -180.0, 8.765),
                (-270.0, -90.0, 13.535),
                (-180.0, -180.0, 8.855),
                (-90.0, -90.0, 7.245),
                (0.0, -180.0, 9.005),
                (-45.0, -180.0, 4.395),
                (-135.0, -90.0, 6.02),
                (-225.0, -90.0, 7.675),
                (-270.0, 0.0, 6.86),
                (-360.0, -90.0, 7.36),
                (-270.0, -180.0, 6.565),
            ],
        },
    },
    LibraryScheme {
        name: "ideal-60",
        source: PLANNED_FOR_IDEAL,
        command: Some(
            "rins plan --time 60 --limits=-360..0,-270..0 --evaluations 300000 --hardware ideal --out ideal-60.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 6.245,
            legs: &[(-90.2, -14.6, 8.775), (-98.8, -117.9, 7.64), (0.0, -186.9, 5.69), (-103.0, -249.1, 6.375)],
        },
    },
    LibraryScheme {
        name: "ideal-90",
        source: PLANNED_FOR_IDEAL,
        command: Some(
            "rins plan --time 90 --limits=-360..0,-270..0 --evaluations 300000 --seed 2 --hardware ideal \
             --out ideal-90.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 2.7,
            legs: &[
                (-71.2, -29.4, 10.855),
                (-139.9, -102.3, 14.255),
                (-254.1, -131.9, 10.605),
                (-112.4, -237.5, 10.405),
                (-42.0, -167.1, 10.845),
            ],
        },
    },
    LibraryScheme {
        name: "ideal-120",
        source: PLANNED_FOR_IDEAL,
        command: Some(
            "rins plan --time 120 --limits=-360..0,-270..0 --evaluations 300000 --hardware ideal --out ideal-120.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 6.315,
            legs: &[
                (-79.0, -9.2, 12.78),
                (-144.7, -74.9, 10.555),
                (-105.6, -114.0, 13.325),
                (-43.5, -176.1, 14.165),
                (-117.7, -242.1, 15.765),
                (-249.2, -110.6, 6.415),
                (-302.5, -163.9, 6.015),
            ],
        },
    },
    LibraryScheme {
        name: "ideal-180",
        source: PLANNED_FOR_IDEAL,
        command: Some(
            "rins plan --time 180 --limits=-360..0,-270..0 --evaluations 300000 --hardware ideal --out ideal-180.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 9.735,
            legs: &[
                (-84.7, 0.0, 20.805),
                (-159.5, -74.9, 15.745),
                (-111.1, -123.3, 7.9),
                (-78.8, -91.0, 20.22),
                (-48.6, -181.4, 20.935),
                (-111.6, -239.5, 23.475),
                (-170.2, -191.2, 8.29),
                (-288.3, -135.1, 13.645),
            ],
        },
    },
    LibraryScheme {
        name: "ideal-300",
        source: PLANNED_FOR_IDEAL,
        command: Some(
            "rins plan --time 300 --limits=-360..0,-270..0 --evaluations 300000 --seed 2 --hardware ideal \
             --out ideal-300.toml",
        ),
        stops: Stops::Legs {
            first_stop_s: 17.75,
            legs: &[
                (-78.4, -16.7, 39.055),
                (-136.9, -83.3, 43.99),
                (-62.0, -135.2, 32.68),
                (-82.5, -176.2, 12.69),
                (-46.7, -212.0, 23.25),
                (-110.0, -265.9, 33.025),
                (-152.2, -200.6, 20.275),
                (-249.2, -103.6, 16.425),
                (-305.5, -159.9, 19.895),
            ],
        },
    },
];

impl LibraryScheme {
    /// The scheme with its angles in radians.
    pub fn scheme(&self) -> Scheme {
        let (first_stop_s, legs) = match self.stops {
            Stops::Quarters { stop_s, positions } => (stop_s, of_quarters(positions, stop_s)),
            Stops::Legs { first_stop_s, legs } => (first_stop_s, of_degrees(legs)),
        };
        Scheme {
            name: String::try_from(self.name).unwrap_or_default(),
            rate_rad_s: 20.0 * DEG,
            acceleration_rad_s2: 20.0 * DEG,
            first_stop_s,
            legs,
            periods: 1,
        }
    }
}

impl Scheme {
    /// Scheme "bai": `periods` periods of 18 moves at 20 deg/s and 19 stops of `stop_s` each. Bai uses two periods with
    /// stops of 200 s.
    pub fn bai(stop_s: f64, periods: u8) -> Self {
        Self {
            name: String::try_from("bai").unwrap_or_default(),
            rate_rad_s: 20.0 * DEG,
            acceleration_rad_s2: 20.0 * DEG,
            first_stop_s: stop_s,
            legs: of_quarters(&BAI, stop_s),
            periods,
        }
    }

    /// The scheme with this name: the compiled-in scheme if it has this name, otherwise the scheme of the library.
    pub fn named(name: &str) -> Option<Self> {
        let of_library = || LIBRARY.iter().find(|entry| entry.name == name).map(LibraryScheme::scheme);
        compiled_in().filter(|scheme| scheme.name == name).or_else(of_library)
    }

    /// Default scheme of a method: three minutes for the joint method, both of Bai's periods for Bai's method.
    pub fn default_for(method: Method) -> Self {
        match method {
            // `fast-180` is in the library; a test checks every name.
            Method::Joint => Self::named("fast-180").unwrap_or_else(|| Self::bai(10.0, 1)),
            Method::Bai => Self::bai(200.0, 2),
        }
    }
}

/// The scheme that `build.rs` compiled in from a file, if any.
pub fn compiled_in() -> Option<Scheme> {
    include!(concat!(env!("OUT_DIR"), "/compiled_scheme.rs"))
}

/// The scheme with the numbers of its file; `rates_deg` holds the rate, deg/s, and the acceleration, deg/s^2.
#[allow(dead_code, reason = "used where a scheme is compiled in")]
fn of_file(name: &str, rates_deg: [f64; 2], first_stop_s: f64, periods: u8, legs: &[(f64, f64, f64)]) -> Scheme {
    let [rate_rad_s, acceleration_rad_s2] = rates_deg.map(|rate| rate * DEG);
    let name = String::try_from(name).unwrap_or_default();
    Scheme { name, rate_rad_s, acceleration_rad_s2, first_stop_s, legs: of_degrees(legs), periods }
}

// `take` drops no legs: a test counts the legs of every library scheme, and `build.rs` checks the number of legs in a
// file.

fn of_quarters<const LEGS: usize>(positions: &[(i8, i8)], stop_s: f64) -> Vec<Leg, LEGS> {
    let rad = |quarters: i8| f64::from(quarters) * 90.0 * DEG;
    let leg = |&(outer, inner): &(i8, i8)| Leg { outer_rad: rad(outer), inner_rad: rad(inner), stop_s };
    positions.iter().map(leg).take(LEGS).collect()
}

fn of_degrees<const LEGS: usize>(legs: &[(f64, f64, f64)]) -> Vec<Leg, LEGS> {
    let leg = |&(outer_deg, inner_deg, stop_s): &(f64, f64, f64)| Leg {
        outer_rad: outer_deg * DEG,
        inner_rad: inner_deg * DEG,
        stop_s,
    };
    legs.iter().map(leg).take(LEGS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scheme_is_valid_and_found_by_its_name() {
        for entry in &LIBRARY {
            let scheme = Scheme::named(entry.name).expect("by its name");
            assert_eq!(scheme.check(), Ok(()), "{}", entry.name);
            assert_eq!(scheme.name, entry.name);
            let legs = match entry.stops {
                Stops::Quarters { positions, .. } => positions.len(),
                Stops::Legs { legs, .. } => legs.len(),
            };
            assert_eq!(scheme.legs.len(), legs, "{}", entry.name);
            assert!(!entry.source.is_empty());
        }
        assert_eq!(Scheme::named("bai"), Some(Scheme::bai(200.0, 1)));
        assert_eq!(Scheme::named("bay"), None);
        let names: std::vec::Vec<_> = LIBRARY.iter().map(|entry| entry.name).collect();
        assert_eq!(names.join(", "), NAMES);
    }

    #[test]
    fn bai_y_is_bai_shifted_by_a_quarter_turn() {
        let (bai, bai_y) = (Scheme::bai(200.0, 1), Scheme::named("bai-y").expect("in the library"));
        for (there, here) in bai.legs.iter().zip(&bai_y.legs[1..]) {
            assert!((there.outer_rad - 90.0 * DEG - here.outer_rad).abs() < 1e-12 && there.inner_rad == here.inner_rad);
        }
    }
}
