//! Rotation schemes by name and from files.
//!
//! ```toml
//! name = "mine"                   # up to 32 bytes; default: the start of the file's name
//! rate_deg_s = 20.0               # default 20
//! acceleration_deg_s2 = 20.0      # default 20
//! first_stop_s = 10.0
//! periods = 1                     # default 1
//! legs = [
//!     { outer_deg = -90.0, inner_deg = 0.0, stop_s = 10.0 },
//! ]
//! ```

use crate::toml_file::{TomlFile, TomlFileError};
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme, SchemeError};
use rins_selfcal::units::DEG;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Stops of the scheme "bai" where nothing else is asked for, s.
pub const BAI_STOP_S: f64 = 200.0;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SchemeTable {
    #[serde(default)]
    name: String,
    #[serde(default = "twenty")]
    rate_deg_s: f64,
    #[serde(default = "twenty")]
    acceleration_deg_s2: f64,
    first_stop_s: f64,
    #[serde(default = "once")]
    periods: u8,
    legs: Vec<LegTable>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LegTable {
    outer_deg: f64,
    inner_deg: f64,
    stop_s: f64,
}

fn twenty() -> f64 {
    20.0
}

fn once() -> u8 {
    1
}

/// The scheme of this name, "bai", or else in this file; `stop_s` and `periods` take the place of the scheme's own.
/// Without them "bai" stands 200 s at each stop and runs one period.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn scheme_named(name: &str, stop_s: Option<f64>, periods: Option<u8>) -> Result<Scheme, TomlFileError> {
    let path = Path::new(name);
    let mut scheme = match name {
        "bai" => Scheme::bai(BAI_STOP_S, 1),
        _ if !path.exists() => return Err(TomlFileError::Name { name: name.into(), known: "bai" }),
        _ => read_scheme(path)?,
    };
    if let Some(stop_s) = stop_s {
        scheme.first_stop_s = stop_s;
        scheme.legs.iter_mut().for_each(|leg| leg.stop_s = stop_s);
    }
    scheme.periods = periods.unwrap_or(scheme.periods);
    let invalid =
        |error: SchemeError| TomlFileError::Content { path: path.into(), line: 1, message: error.to_string() };
    scheme.check().map_err(invalid).map(|()| scheme)
}

/// Reads a scheme file and checks every number.
///
/// # Errors
/// One line that names file, line and key.
pub fn read_scheme(path: &Path) -> Result<Scheme, TomlFileError> {
    let file = TomlFile::read(path)?;
    let table: SchemeTable = file.parse()?;
    if table.legs.len() > MAX_LEGS {
        return Err(file.wrong_value("", "legs", &format!("{} legs, at most {MAX_LEGS} fit", table.legs.len())));
    }
    let scheme = from_table(&table, path).ok_or_else(|| file.wrong_value("", "name", "longer than 32 bytes"))?;
    match scheme.check() {
        Ok(()) => Ok(scheme),
        Err(error) => Err(file.wrong_value("", key_of(&scheme, error), &error.to_string())),
    }
}

/// Writes a scheme file.
///
/// # Errors
/// The file cannot be written.
pub fn write_scheme(path: &Path, scheme: &Scheme) -> Result<(), TomlFileError> {
    let legs = scheme.legs.iter().map(|leg| LegTable {
        outer_deg: rounded_deg(leg.outer_rad),
        inner_deg: rounded_deg(leg.inner_rad),
        stop_s: leg.stop_s,
    });
    let table = SchemeTable {
        name: scheme.name.as_str().into(),
        rate_deg_s: rounded_deg(scheme.rate_rad_s),
        acceleration_deg_s2: rounded_deg(scheme.acceleration_rad_s2),
        first_stop_s: scheme.first_stop_s,
        periods: scheme.periods,
        legs: legs.collect(),
    };
    let io = |cause| TomlFileError::Io { path: path.into(), cause };
    let text = toml::to_string(&table).map_err(|error| io(std::io::Error::other(error)))?;
    std::fs::write(path, text).map_err(io)
}

fn from_table(table: &SchemeTable, path: &Path) -> Option<Scheme> {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    // Eight characters are at most 32 bytes.
    let name = if table.name.is_empty() { stem.chars().take(8).collect() } else { table.name.clone() };
    Some(Scheme {
        name: name.as_str().try_into().ok()?,
        rate_rad_s: table.rate_deg_s * DEG,
        acceleration_rad_s2: table.acceleration_deg_s2 * DEG,
        first_stop_s: table.first_stop_s,
        legs: table.legs.iter().map(leg_rad).collect(),
        periods: table.periods,
    })
}

fn leg_rad(leg: &LegTable) -> Leg {
    Leg { outer_rad: leg.outer_deg * DEG, inner_rad: leg.inner_deg * DEG, stop_s: leg.stop_s }
}

/// Degrees without the rounding of the way through radians.
fn rounded_deg(angle_rad: f64) -> f64 {
    (angle_rad / DEG * 1e9).round() / 1e9
}

fn key_of(scheme: &Scheme, error: SchemeError) -> &'static str {
    let positive = |x: f64| x.is_finite() && x > 0.0;
    match error {
        SchemeError::Motion if !positive(scheme.rate_rad_s) => "rate_deg_s",
        SchemeError::Motion if !positive(scheme.acceleration_rad_s2) => "acceleration_deg_s2",
        SchemeError::Motion | SchemeError::OpenPeriod => "periods",
        SchemeError::Stop(0) => "first_stop_s",
        SchemeError::Stop(_) | SchemeError::Leg(_) | SchemeError::Legs => "legs",
    }
}
