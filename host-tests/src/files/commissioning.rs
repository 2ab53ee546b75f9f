//! What a unit is commissioned with: the tables of UNIT.toml that only an instrument needs.
//!
//! ```toml
//! [unit]
//! name = "RINS 7"                        # up to 32 bytes
//! serial = "0007"                        # up to 16 bytes
//! [outer]                                # and [inner] likewise
//! travel_deg = [-365.0, 5.0]             # where the axis can stand, counted over whole turns; or "continuous"
//! turn = "stored"                        # how its turn is known: "unique", "stored" or "confirm"
//! rate_deg_s = 60.0                      # the rest is optional: what the instrument has stays
//! acceleration_deg_s2 = 60.0
//! jerk_deg_s3 = 1000.0
//! arrived_arcsec = 2.0
//! following_error_deg = 1.0
//! runaway_deg_s = 5.0
//! [outer.motor]                          # all keys
//! inertia_kg_m2 = 0.06
//! coulomb_nm = 0.05
//! viscous_nm_s = 0.02
//! torque_constant_nm_a = 0.3
//! resistance_ohm = 6.0
//! inductance_h = 0.003
//! supply_v = 24.0
//! highest_current_a = 2.0
//! encoder_bits = 26
//! [power_up]
//! policy = "always"                      # "always", "when-due", "on-command" or "never"; default "always"
//! age_h = 24.0                           # of "when-due"
//! temperature_k = 5.0                    # of "when-due"
//! [run]
//! scheme = "fast-180"                    # a name of the library, or a file beside this one
//! ```

use super::hardware::HardwareTable;
use super::scheme_file::scheme_named;
use super::toml_file::{TomlFile, TomlFileError};
use super::unit_file::{BaiTable, InitialTable, Noise, SamplingTable, SiteTable, UnitConfig};
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::estimator::HeadingSource;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::travel::{Travel, TurnSource};
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::unit::UnitName;
use serde::Deserialize;
use std::path::Path;

/// All tables of UNIT.toml.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct UnitTables {
    unit: Option<UnitTable>,
    site: Option<SiteTable>,
    noise: Option<Noise>,
    hardware: Option<HardwareTable>,
    #[serde(rename = "sampling")]
    _sampling: SamplingTable,
    #[serde(rename = "initial")]
    _initial: InitialTable,
    #[serde(rename = "bai")]
    _bai: BaiTable,
    outer: Option<AxisTable>,
    inner: Option<AxisTable>,
    power_up: Option<PowerUpTable>,
    run: RunTable,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct UnitTable {
    name: String,
    serial: String,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisTable {
    travel_deg: TravelKey,
    turn: Option<TurnKey>,
    rate_deg_s: Option<f64>,
    acceleration_deg_s2: Option<f64>,
    jerk_deg_s3: Option<f64>,
    arrived_arcsec: Option<f64>,
    following_error_deg: Option<f64>,
    runaway_deg_s: Option<f64>,
    motor: MotorAndLoad,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "two angles, or \"continuous\"")]
enum TravelKey {
    Limited([f64; 2]),
    Continuous(ContinuousKey),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ContinuousKey {
    Continuous,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum TurnKey {
    Unique,
    Stored,
    Confirm,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PowerUpTable {
    policy: PolicyKey,
    age_h: Option<f64>,
    temperature_k: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum PolicyKey {
    Always,
    WhenDue,
    OnCommand,
    Never,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RunTable {
    scheme: Option<String>,
}

/// Reads UNIT.toml and puts it over the configuration that an instrument has. Returns the name of the unit too.
///
/// # Errors
/// One line that names the file and the key: a table that commissioning needs is missing, or a number is wrong.
pub fn commissioned(
    path: &Path,
    present: &SelfCalibrationConfig,
) -> Result<(UnitName, SelfCalibrationConfig), TomlFileError> {
    let (file, unit) = (TomlFile::read(path)?, UnitConfig::read(path)?);
    let tables: UnitTables = file.parse()?;
    let missing = |table: &str| file.wrong_value("", table, "this table is needed to commission a unit");
    let mut config = present.clone();
    let estimator = &mut config.calibrator.estimator;
    tables.site.ok_or_else(|| missing("site"))?;
    (estimator.site, estimator.site_sigmas) = (unit.site(), unit.site_sigmas());
    if tables.noise.is_some() {
        estimator.noise = unit.noise.psd();
    }
    if tables.noise.is_some() || tables.hardware.is_some() {
        estimator.hardware = unit.hardware();
    }
    if let Some(heading_deg) = unit.initial.heading_deg {
        let sigma_rad = unit.initial.heading_sigma_deg * DEG;
        estimator.heading = HeadingSource::Configured { heading_rad: heading_deg * DEG, sigma_rad };
    }
    config.calibrator.rate_hz = unit.sampling.rate_hz.unwrap_or(present.calibrator.rate_hz);
    for (index, (name, table)) in [("outer", &tables.outer), ("inner", &tables.inner)].into_iter().enumerate() {
        let table = table.as_ref().ok_or_else(|| missing(name))?;
        config.axes[index] =
            table.limits(&present.axes[index]).map_err(|(key, what)| file.wrong_value(name, key, what))?;
        config.motors[index] = table.motor;
    }
    if let Some(power_up) = &tables.power_up {
        config.policy = power_up.policy().map_err(|(key, what)| file.wrong_value("power_up", key, what))?;
    }
    if let Some(scheme) = &tables.run.scheme {
        config.scheme = scheme_beside(path, scheme)?;
    }
    let name = tables.unit.ok_or_else(|| missing("unit"))?;
    Ok((name.name().map_err(|(key, what)| file.wrong_value("unit", key, what))?, config))
}

/// The key and what is wrong with it.
type Wrong = (&'static str, &'static str);

fn scheme_beside(path: &Path, scheme: &str) -> Result<rins_selfcal::scheme::Scheme, TomlFileError> {
    let beside = path.parent().map(|folder| folder.join(scheme)).filter(|file| file.exists());
    let name = beside.as_deref().and_then(Path::to_str).unwrap_or(scheme);
    scheme_named(name, None, None)
}

impl UnitTable {
    fn name(&self) -> Result<UnitName, Wrong> {
        Ok(UnitName {
            name: self.name.as_str().try_into().map_err(|_| ("name", "is longer than 32 bytes"))?,
            serial: self.serial.as_str().try_into().map_err(|_| ("serial", "is longer than 16 bytes"))?,
        })
    }
}

impl AxisTable {
    fn limits(&self, present: &AxisLimits) -> Result<AxisLimits, Wrong> {
        let or = |key: Option<f64>, unit: f64, present: f64| key.map_or(present, |value| value * unit);
        Ok(AxisLimits {
            rate_rad_s: or(self.rate_deg_s, DEG, present.rate_rad_s),
            acceleration_rad_s2: or(self.acceleration_deg_s2, DEG, present.acceleration_rad_s2),
            jerk_rad_s3: or(self.jerk_deg_s3, DEG, present.jerk_rad_s3),
            arrived_rad: or(self.arrived_arcsec, ARCSEC, present.arrived_rad),
            following_error_rad: or(self.following_error_deg, DEG, present.following_error_rad),
            runaway_rad_s: or(self.runaway_deg_s, DEG, present.runaway_rad_s),
            travel: self.travel()?,
        })
    }

    fn travel(&self) -> Result<Travel, Wrong> {
        let turn = self.turn.map(|turn| match turn {
            TurnKey::Unique => TurnSource::Unique,
            TurnKey::Stored => TurnSource::Stored,
            TurnKey::Confirm => TurnSource::Confirm,
        });
        match (&self.travel_deg, turn) {
            (TravelKey::Continuous(_), None) => Ok(Travel::Continuous),
            (TravelKey::Continuous(_), Some(_)) => Err(("turn", "a continuous axis has no turn to know")),
            (TravelKey::Limited(_), None) => Err(("travel_deg", "a limited travel needs the key turn")),
            (TravelKey::Limited([low, high]), Some(turn)) => {
                Ok(Travel::Limited { lowest_rad: low * DEG, highest_rad: high * DEG, turn })
            }
        }
    }
}

impl PowerUpTable {
    fn policy(&self) -> Result<PowerUpPolicy, Wrong> {
        if self.policy != PolicyKey::WhenDue && (self.age_h.is_some() || self.temperature_k.is_some()) {
            return Err(("policy", "age_h and temperature_k belong to \"when-due\""));
        }
        if !self.age_h.is_none_or(|age_h| (0.0..=1e6).contains(&age_h)) {
            return Err(("age_h", "must be between 0 and 1000000"));
        }
        Ok(match self.policy {
            PolicyKey::Always => PowerUpPolicy::Always,
            PolicyKey::OnCommand => PowerUpPolicy::OnCommand,
            PolicyKey::Never => PowerUpPolicy::Never,
            PolicyKey::WhenDue => PowerUpPolicy::WhenDue {
                age_s: self.age_h.map(|age_h| (age_h * 3600.0) as u64),
                temperature_k: self.temperature_k,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::run::assignment::Assignment;

    const UNIT: &str = r#"
[unit]
name = "RINS 7"
serial = "0007"
[site]
latitude_deg = 52.0
[outer]
travel_deg = [-365.0, 5.0]
turn = "stored"
rate_deg_s = 40.0
[outer.motor]
inertia_kg_m2 = 0.05
coulomb_nm = 0.05
viscous_nm_s = 0.02
torque_constant_nm_a = 0.3
resistance_ohm = 6.0
inductance_h = 0.003
supply_v = 24.0
highest_current_a = 2.0
encoder_bits = 24
[inner]
travel_deg = "continuous"
motor = { inertia_kg_m2 = 0.05, coulomb_nm = 0.05, viscous_nm_s = 0.02, torque_constant_nm_a = 0.3, resistance_ohm = 6.0, inductance_h = 0.003, supply_v = 24.0, highest_current_a = 2.0, encoder_bits = 24 }
[power_up]
policy = "when-due"
age_h = 24
[run]
scheme = "fast-60"
"#;

    fn read(text: &str) -> Result<(UnitName, SelfCalibrationConfig), String> {
        let Assignment::SelfCalibrate(present) = Assignment::default() else { unreachable!("the default calibrates") };
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(&file, text).expect("written");
        commissioned(file.path(), &present).map_err(|error| error.to_string())
    }

    #[test]
    fn a_unit_file_is_put_over_the_present_configuration() {
        let (name, config) = read(UNIT).expect("a good file");
        assert_eq!((name.name.as_str(), name.serial.as_str()), ("RINS 7", "0007"));
        let [outer, inner] = config.axes;
        let (lowest_rad, highest_rad) = (-365.0 * DEG, 5.0 * DEG);
        assert_eq!(outer.travel, Travel::Limited { lowest_rad, highest_rad, turn: TurnSource::Stored });
        assert_eq!((inner.travel, outer.rate_rad_s), (Travel::Continuous, 40.0 * DEG));
        assert_eq!((inner.rate_rad_s, config.motors[1].encoder_bits), (AxisLimits::default().rate_rad_s, 24));
        assert_eq!(config.policy, PowerUpPolicy::WhenDue { age_s: Some(86_400), temperature_k: None });
        assert_eq!(
            (config.scheme.name.as_str(), config.calibrator.estimator.site.latitude_rad),
            ("fast-60", 52.0 * DEG)
        );
    }

    #[test]
    fn what_commissioning_needs_is_named_if_it_is_missing() {
        let without = |from: &str, to: &str| {
            let (start, end) = (UNIT.find(from).expect("there"), UNIT.find(to).expect("there"));
            read(&format!("{}{}", &UNIT[..start], &UNIT[end..])).expect_err("it is missing")
        };
        for (from, to, table) in
            [("[unit]", "[site]", "unit"), ("[site]", "[outer]", "site"), ("[inner]", "[power_up]", "inner")]
        {
            let error = without(from, to);
            assert!(error.ends_with(&format!("{table}: this table is needed to commission a unit")), "{error}");
        }
        let cases = [
            ("turn = \"stored\"\n", "", "travel_deg: a limited travel needs the key turn"),
            ("\"continuous\"", "\"continuous\"\nturn = \"unique\"", "turn: a continuous axis has no turn to know"),
            ("\"when-due\"", "\"always\"", "policy: age_h and temperature_k belong to \"when-due\""),
            ("latitude_deg = 52.0", "latitude_deg = 152.0", "latitude_deg: must be from -90 to 90 deg"),
            ("serial = \"0007\"", "serial = \"00000000000000000007\"", "serial: is longer than 16 bytes"),
        ];
        for (old, new, message) in cases {
            let error = read(&UNIT.replace(old, new)).expect_err("it is wrong");
            assert!(error.ends_with(message), "{error}");
        }
    }
}
