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

#[path = "../../../src/scheme/table.rs"]
mod table;

use super::toml_file::{TomlFile, TomlFileError};
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::library::NAMES;
use rins_selfcal::scheme::{Leg, MAX_LEGS, MAX_NAME_BYTES, Scheme, SchemeError};
use std::path::Path;
use table::{LegTable, SchemeTable};

/// The library's scheme of this name, or else the scheme in the file of this name. `stop_s` and `periods` replace the
/// scheme's own values.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn scheme_named(name: &str, stop_s: Option<f64>, periods: Option<u8>) -> Result<Scheme, TomlFileError> {
    let path = Path::new(name);
    let mut scheme = match Scheme::named(name) {
        Some(scheme) => scheme,
        None if !path.exists() => return Err(TomlFileError::Name { name: name.into(), known: NAMES }),
        None => read_scheme(path)?,
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
        let what = format!("{} legs, at most {MAX_LEGS} are allowed", table.legs.len());
        return Err(file.wrong_value("", "legs", &what));
    }
    let scheme = from_table(&table, path)
        .ok_or_else(|| file.wrong_value("", "name", &format!("longer than {MAX_NAME_BYTES} bytes")))?;
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
        outer_deg: rounded(leg.outer_rad / DEG),
        inner_deg: rounded(leg.inner_rad / DEG),
        stop_s: rounded(leg.stop_s),
    });
    let table = SchemeTable {
        name: scheme.name.as_str().into(),
        rate_deg_s: rounded(scheme.rate_rad_s / DEG),
        acceleration_deg_s2: rounded(scheme.acceleration_rad_s2 / DEG),
        first_stop_s: rounded(scheme.first_stop_s),
        periods: scheme.periods,
        legs: legs.collect(),
    };
    let io = |cause| TomlFileError::Io { path: path.into(), cause };
    let text = toml::to_string(&table).map_err(|error| io(std::io::Error::other(error)))?;
    std::fs::write(path, text).map_err(io)
}

fn from_table(table: &SchemeTable, path: &Path) -> Option<Scheme> {
    Some(Scheme {
        name: table.name_or(path).as_str().try_into().ok()?,
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

/// Rounds off the last digits, which are rounding errors of the conversion to radians and of sums. Negative zero
/// becomes zero.
fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9 + 0.0
}

fn key_of(scheme: &Scheme, error: SchemeError) -> &'static str {
    let positive = |x: f64| x.is_finite() && x > 0.0;
    match error {
        SchemeError::Motion if !positive(scheme.rate_rad_s) => "rate_deg_s",
        SchemeError::Motion if !positive(scheme.acceleration_rad_s2) => "acceleration_deg_s2",
        SchemeError::Motion | SchemeError::OpenPeriod => "periods",
        SchemeError::Stop(0) => "first_stop_s",
        SchemeError::Stop(_) | SchemeError::Leg(_) | SchemeError::Legs | SchemeError::Long => "legs",
    }
}
