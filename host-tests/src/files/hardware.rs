//! The imperfections of the hardware in a unit description.
//!
//! ```toml
//! [hardware]
//! profile = "navigation"                 # "ideal", "navigation", "tactical" or "mems"; default "navigation"
//! accel_quadratic_ug_g2 = 20.0           # any size, in place of that of the profile
//! ```
//! On the command line the same may be a profile's name, a file with this table, or keys in one line.

use super::toml_file::{TomlFile, TomlFileError};
use crate::base::quantity::significant;
use rins_selfcal::base::hardware::{HARDWARE, Hardware, HardwareSize};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::path::Path;

/// `[hardware]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HardwareTable(pub Hardware);

impl Default for HardwareTable {
    fn default() -> Self {
        Self(Hardware::NAVIGATION)
    }
}

/// Value of a key: the name of the profile, or a size in the unit of its key.
#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "a number, or the name of a profile")]
enum Value {
    Size(f64),
    Profile(String),
}

const PROFILE: &str = "profile";

impl<'de> Deserialize<'de> for HardwareTable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = BTreeMap::<String, Value>::deserialize(deserializer)?;
        let mut hardware = match table.get(PROFILE) {
            None => Hardware::NAVIGATION,
            Some(Value::Profile(name)) => Hardware::named(name)
                .ok_or_else(|| Error::custom(format!("`{PROFILE}`: unknown '{name}'; known: {}", profiles())))?,
            Some(_) => return Err(Error::custom(format!("`{PROFILE}` must be the name of a profile: {}", profiles()))),
        };
        for (key, value) in table.iter().filter(|(key, _)| *key != PROFILE) {
            let size = HardwareSize::named(key).ok_or_else(|| {
                let known: Vec<_> = HARDWARE.iter().map(|size| size.key).collect();
                Error::custom(format!("unknown field `{key}`, expected one of `{PROFILE}`, `{}`", known.join("`, `")))
            })?;
            let value = match value {
                Value::Size(value) => *value,
                Value::Profile(_) => return Err(Error::custom(format!("`{key}` must be a number, in {}", size.unit))),
            };
            if !(0.0..=size.largest).contains(&value) {
                return Err(Error::custom(format!("`{key}` must be from 0 to {} {}", size.largest, size.unit)));
            }
            size.set(&mut hardware, value * size.unit_si);
        }
        Ok(Self(hardware))
    }
}

impl Serialize for HardwareTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (name, profile) = nearest_profile(&self.0);
        let mut table = BTreeMap::from([(PROFILE, Value::Profile(name.into()))]);
        for size in &HARDWARE {
            let value = size.get(&self.0);
            if value != size.get(&profile) {
                let shown = significant(value / size.unit_si).parse().unwrap_or(value / size.unit_si);
                table.insert(size.key, Value::Size(shown));
            }
        }
        table.serialize(serializer)
    }
}

/// A size in its unit, with the digits that its single precision is worth.
pub fn in_unit(size: &HardwareSize, hardware: &Hardware) -> f64 {
    let value = size.get(hardware) / size.unit_si;
    format!("{value:.6e}").parse().unwrap_or(value)
}

/// The profile that shares most sizes with the hardware.
pub fn nearest_profile(hardware: &Hardware) -> (&'static str, Hardware) {
    let shared = |profile: &Hardware| HARDWARE.iter().filter(|size| size.get(profile) == size.get(hardware)).count();
    let nearest = Hardware::PROFILES.into_iter().max_by_key(|(_, profile)| shared(profile));
    nearest.unwrap_or(("ideal", Hardware::IDEAL))
}

/// Names of the profiles.
pub fn profiles() -> String {
    Hardware::PROFILES.map(|(name, _)| name).join(", ")
}

/// The hardware in words: the profile, and the sizes that differ from it.
pub fn described(hardware: &Hardware) -> String {
    let (name, profile) = nearest_profile(hardware);
    let others = HARDWARE.iter().filter(|size| size.get(hardware) != size.get(&profile));
    let others = others.map(|size| format!(", {} = {}", size.key, significant(size.get(hardware) / size.unit_si)));
    format!("{name}{}", others.collect::<String>())
}

/// The hardware of this name: a profile, a file with the table `[hardware]` alone, or keys in one line such as
/// `profile = "ideal", accel_floor_ug = 2.0`.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn hardware_named(name: &str) -> Result<Hardware, TomlFileError> {
    if let Some(hardware) = Hardware::named(name) {
        return Ok(hardware);
    }
    let path = Path::new(name);
    let file = if path.exists() {
        TomlFile::read(path)?
    } else if name.contains('=') {
        TomlFile::of_keys("--hardware", "hardware", name)
    } else {
        return Err(TomlFileError::Name { name: name.into(), known: "ideal, navigation, tactical, mems" });
    };
    Ok(file.only_table::<HardwareTable>("hardware")?.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::units::{ARCSEC, MICRO_G};

    #[test]
    fn hardware_is_a_profile_with_sizes_of_its_own() {
        assert_eq!(hardware_named("ideal").unwrap(), Hardware::IDEAL);
        let found = hardware_named("profile = \"ideal\", accel_floor_ug = 3, encoder_harmonic_2_arcsec = 1.5").unwrap();
        let expected = Hardware {
            accel_floor: (3.0 * MICRO_G) as f32,
            encoder_harmonics: [0.0, (1.5 * ARCSEC) as f32, 0.0, 0.0],
            ..Hardware::IDEAL
        };
        assert_eq!(found, expected);
        assert_eq!(described(&found), "ideal, accel_floor_ug = 3.00, encoder_harmonic_2_arcsec = 1.50");
        let written = toml::to_string(&HardwareTable(found)).unwrap();
        assert_eq!(toml::from_str::<HardwareTable>(&written).unwrap().0, found, "{written}");
        assert_eq!(toml::from_str::<HardwareTable>("").unwrap().0, Hardware::NAVIGATION);
    }

    #[test]
    fn wrong_hardware_is_refused_in_words() {
        let message = |name: &str| hardware_named(name).unwrap_err().to_string();
        assert!(message("perfect").starts_with("unknown 'perfect'; known: ideal, navigation, tactical, mems"));
        assert!(message("accel_quadric = 1.0").contains("unknown field `accel_quadric`"));
        assert!(message("accel_floor_ug = -1.0").contains("`accel_floor_ug` must be from 0 to 1000 ug"));
        assert!(message("profile = \"best\"").contains("unknown 'best'"));
        assert_eq!(message("accel_floor_ug = \"high\""), "--hardware: `accel_floor_ug` must be a number, in ug");
        let missing = "there is no file 'units/7.toml'; names in place of a file: ideal, navigation, tactical, mems";
        assert_eq!(message("units/7.toml"), missing);
    }

    #[test]
    fn a_file_of_the_hardware_has_its_table_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hardware.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let read = hardware_named(path.to_str().unwrap());
            read.map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
        };
        assert_eq!(read("[hardware]\nprofile = \"mems\"\n"), Ok(Hardware::MEMS));
        let message = |text: &str| read(text).unwrap_err();
        let bare = message("# sizes\naccel_floor_ug = 3.0\n");
        assert_eq!(bare, "hardware.toml:2: accel_floor_ug: is outside of a table; write [hardware] above it");
        let whole = message("[hardware]\nprofile = \"mems\"\n[site]\nlatitude_deg = 48.0\n");
        let way_out = "this file may have the table [hardware] only; give a whole unit description as --config";
        assert_eq!(whole, format!("hardware.toml:3: site: {way_out}"));
        assert_eq!(message(""), "hardware.toml:1: the table [hardware] is missing");
        assert!(
            message("[hardware]\n\naccel_floor = 3.0\n").starts_with("hardware.toml:3: unknown field `accel_floor`")
        );
    }
}
