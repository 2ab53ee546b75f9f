//! The sensor and the unit that the name of a column gives.

/// The sensor of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Time.
    Time,
    /// Gyro of an axis, numbered 0 to 2.
    Gyro(usize),
    /// Accelerometer of an axis, numbered 0 to 2.
    Accel(usize),
    /// Encoder: 0 outer, 1 inner.
    Encoder(usize),
    /// Temperature.
    Temperature,
}

const TIMES: [&str; 10] = ["time", "t", "timestamp", "stamp", "tow", "sec", "seconds", "utc", "clock", "epoch"];
const OUTER: [&str; 5] = ["outer", "roll", "outside", "ring1", "gimbal1"];
const INNER: [&str; 6] = ["inner", "yaw", "azimuth", "inside", "ring2", "gimbal2"];
const GYROS: [&str; 8] = ["gyro", "gyr", "omega", "rate", "angvel", "dtheta", "wm", "w"];
const ACCELS: [&str; 8] = ["accel", "acc", "force", "sf", "vm", "dv", "f", "a"];

/// The sensor of a column of this name.
pub fn role(name: &str) -> Option<Role> {
    let name = name.to_lowercase();
    let words: Vec<&str> = name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let is = |known: &[&str]| words.iter().any(|word| known.contains(word));
    if words.iter().any(|word| word.starts_with("temp")) {
        return Some(Role::Temperature);
    }
    if let Some(encoder) = [&OUTER[..], &INNER[..]].iter().position(|known| is(known)) {
        return Some(Role::Encoder(encoder));
    }
    let triad = |known: &[&str]| words.iter().position(|word| known.contains(&stem(word)));
    let axis = || words.iter().find_map(|word| axis_of(word));
    match (triad(&GYROS), triad(&ACCELS), axis()) {
        (Some(_), _, Some(axis)) => Some(Role::Gyro(axis)),
        (None, Some(_), Some(axis)) => Some(Role::Accel(axis)),
        _ => is(&TIMES).then_some(Role::Time),
    }
}

/// A word without the letter or number of an axis.
fn stem(word: &str) -> &str {
    match axis_of(word) {
        Some(_) if word.len() > 1 => &word[..word.len() - 1],
        _ => word,
    }
}

fn axis_of(word: &str) -> Option<usize> {
    let last = word.chars().last()?;
    ["x1", "y2", "z3"].iter().position(|names| names.contains(last))
}

/// Units and how column names write them. A longer spelling comes before a shorter spelling that it contains.
const UNITS: [(&str, &[&str]); 14] = [
    ("deg/h", &["deg/h", "deg_h", "dph"]),
    ("deg/s", &["deg/s", "deg_s", "dps"]),
    ("rad/s", &["rad/s", "rad_s", "rps"]),
    ("m/s^2", &["m/s^2", "m/s2", "m_s2", "mps2"]),
    ("arcsec", &["arcsec"]),
    ("deg", &["deg"]),
    ("rad", &["rad"]),
    ("turns", &["turn", "rev"]),
    ("ms", &["_ms", "[ms]", "(ms)", "milli"]),
    ("us", &["_us", "[us]", "(us)", "micro"]),
    ("ns", &["_ns", "[ns]", "(ns)", "nano"]),
    ("mg", &["_mg", "[mg]", "(mg)"]),
    ("ug", &["_ug", "[ug]", "(ug)"]),
    ("g", &["_g", "[g]", "(g)"]),
];

/// The unit in a column name.
pub fn unit(name: &str) -> Option<&'static str> {
    let name = name.to_lowercase();
    UNITS.iter().find(|(_, ways)| ways.iter().any(|way| name.contains(way))).map(|(unit, _)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::COLUMNS;

    #[test]
    fn usual_names_are_understood() {
        use Role::{Accel, Encoder, Gyro, Temperature, Time};
        let all = [Time, Gyro(0), Gyro(1), Gyro(2), Accel(0), Accel(1), Accel(2), Encoder(0), Encoder(1)];
        assert_eq!(COLUMNS.map(role), all.map(Some));
        let known = [
            ("t [ms]", Time),
            ("wy", Gyro(1)),
            ("FZ (g)", Accel(2)),
            ("Roll/deg", Encoder(0)),
            ("imu temp", Temperature),
        ];
        assert_eq!(known.map(|(name, _)| role(name)), known.map(|(_, role)| Some(role)));
        assert_eq!([role("status"), role("x"), role("gyro"), role("")], [None; 4]);
    }

    #[test]
    fn units_in_names_are_read() {
        let known = [
            ("gyro_x_deg_h", "deg/h"),
            ("wx [deg/s]", "deg/s"),
            ("ax_m_s2", "m/s^2"),
            ("fz (mg)", "mg"),
            ("t_us", "us"),
        ];
        assert_eq!(known.map(|(name, _)| unit(name)), known.map(|(_, unit)| Some(unit)));
        assert_eq!(unit("outer"), None);
    }
}
