//! The user's description of a unit and its site: UNIT.toml.
//!
//! ```toml
//! [site]
//! latitude_deg = 30.93041                # geodetic, -90 to 90; default 30.93041
//! height_m = 20.0                        # above the ellipsoid; default 20
//! gravity_m_s2 = 9.79398                 # measured; default: WGS-84 normal gravity
//! [noise]                                # default: the unit "navigation"
//! accel_vrw_ug_sqrt_hz = 10.0
//! gyro_arw_deg_sqrt_h = 0.001
//! encoder_repeatability_arcsec = 0.5     # per stop and axis
//! rate_reference_arcsec_sqrt_s = 0.0     # walk of the angle reading while turning
//! [sampling]
//! rate_hz = 200.0                        # default: from the log's time stamps; 200 for a virtual unit
//! [initial]
//! heading_deg = 137.0                    # known heading; default: unknown
//! heading_sigma_deg = 1.0                # its sigma; default 1
//! ```
//! A file may have the tables that only an instrument needs too: `commissioning`.

use super::toml_file::{TomlFile, TomlFileError};
use crate::base::quantity::significant;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_SQRT_H, MICRO_G};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// Noise of a unit's sensors and encoders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Velocity random walk of the accelerometers, ug/sqrt(Hz). Default 10.
    pub accel_vrw_ug_sqrt_hz: f64,
    /// Angle random walk of the gyros, deg/sqrt(h). Default 0.001.
    pub gyro_arw_deg_sqrt_h: f64,
    /// Encoder error per stop and axis, arcsec. Default 0.5.
    pub encoder_repeatability_arcsec: f64,
    /// Random walk of the encoder angle while its axis turns, arcsec/sqrt(s). It is zero again at the stop. Default 0.
    pub rate_reference_arcsec_sqrt_s: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self::navigation()
    }
}

impl fmt::Display for Noise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "accelerometers {} ug/sqrt(Hz), gyros {} deg/sqrt(h), encoders {} arcsec",
            significant(self.accel_vrw_ug_sqrt_hz),
            significant(self.gyro_arw_deg_sqrt_h),
            significant(self.encoder_repeatability_arcsec)
        )?;
        if self.rate_reference_arcsec_sqrt_s > 0.0 {
            let walk = significant(self.rate_reference_arcsec_sqrt_s);
            write!(f, " and {walk} arcsec/sqrt(s) while turning")?;
        }
        Ok(())
    }
}

impl Noise {
    /// A navigation grade unit.
    pub const fn navigation() -> Self {
        Self {
            accel_vrw_ug_sqrt_hz: 10.0,
            gyro_arw_deg_sqrt_h: 0.001,
            encoder_repeatability_arcsec: 0.5,
            rate_reference_arcsec_sqrt_s: 0.0,
        }
    }

    /// A tactical grade unit.
    pub const fn tactical() -> Self {
        Self {
            accel_vrw_ug_sqrt_hz: 60.0,
            gyro_arw_deg_sqrt_h: 0.05,
            encoder_repeatability_arcsec: 5.0,
            rate_reference_arcsec_sqrt_s: 0.0,
        }
    }

    /// Bai's simulation. A sample at 200 Hz has a noise of 30 ug, 0.2 arcsec/s, and 0.7 arcsec/s of the rate reference.
    /// The encoder error is 0.5 arcsec.
    pub fn bai() -> Self {
        let sqrt_rate = 200.0_f64.sqrt();
        Self {
            accel_vrw_ug_sqrt_hz: 30.0 / sqrt_rate,
            gyro_arw_deg_sqrt_h: 0.2 / sqrt_rate * ARCSEC / DEG_SQRT_H,
            encoder_repeatability_arcsec: 0.5,
            rate_reference_arcsec_sqrt_s: 0.7 / sqrt_rate,
        }
    }

    /// Sigma of one accelerometer sample, m/s^2.
    pub fn sigma_force_m_s2(&self, rate_hz: f64) -> f64 {
        self.accel_vrw_ug_sqrt_hz * MICRO_G * rate_hz.sqrt()
    }

    /// Sigma of one gyro sample, rad/s.
    pub fn sigma_omega_rad_s(&self, rate_hz: f64) -> f64 {
        self.gyro_arw_deg_sqrt_h * DEG_SQRT_H * rate_hz.sqrt()
    }

    /// The noise in the form that the core needs, SI.
    pub fn psd(&self) -> rins_selfcal::segment::white_noise::Noise {
        rins_selfcal::segment::white_noise::Noise {
            accel_psd_sqrt: self.accel_vrw_ug_sqrt_hz * MICRO_G,
            gyro_psd_sqrt: self.gyro_arw_deg_sqrt_h * DEG_SQRT_H,
            encoder_sigma_rad: self.sigma_encoder_rad(),
            margin: 1.0,
        }
    }

    /// Sigma of an encoder's error at a stop, rad.
    pub fn sigma_encoder_rad(&self) -> f64 {
        self.encoder_repeatability_arcsec * ARCSEC
    }

    /// Sigma of the random walk of the angle reading from sample to sample while the axis turns, rad.
    pub fn sigma_reference_rad(&self, rate_hz: f64) -> f64 {
        self.rate_reference_arcsec_sqrt_s * ARCSEC / rate_hz.sqrt()
    }

    /// Checks that every number is finite and not negative.
    ///
    /// # Errors
    /// The key and what is wrong with its value.
    pub(crate) fn check(&self) -> Result<(), (&'static str, &'static str)> {
        let values = [
            ("accel_vrw_ug_sqrt_hz", self.accel_vrw_ug_sqrt_hz),
            ("gyro_arw_deg_sqrt_h", self.gyro_arw_deg_sqrt_h),
            ("encoder_repeatability_arcsec", self.encoder_repeatability_arcsec),
            ("rate_reference_arcsec_sqrt_s", self.rate_reference_arcsec_sqrt_s),
        ];
        match values.iter().find(|(_, value)| !value.is_finite() || *value < 0.0) {
            Some((key, _)) => Err((key, "must be finite and not negative")),
            None => Ok(()),
        }
    }
}

/// The keys of `[site]` that every calibration depends on.
const SITE_KEYS: [&str; 2] = ["latitude_deg", "height_m"];

/// `[site]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiteTable {
    /// Geodetic latitude, deg.
    pub latitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
    /// Measured gravity, m/s^2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_m_s2: Option<f64>,
}

impl Default for SiteTable {
    fn default() -> Self {
        let site = Site::default();
        Self { latitude_deg: 30.930_41, height_m: site.height_m, gravity_m_s2: site.measured_gravity_m_s2 }
    }
}

/// `[sampling]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SamplingTable {
    /// Sample rate, Hz. If absent, it comes from the log's time stamps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
}

/// `[initial]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InitialTable {
    /// Bearing of the b-frame's y axis, clockwise from north, deg. Unknown if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_deg: Option<f64>,
    /// Sigma of `heading_deg`, deg. Not used without `heading_deg`.
    pub heading_sigma_deg: f64,
}

impl Default for InitialTable {
    fn default() -> Self {
        Self { heading_deg: None, heading_sigma_deg: 1.0 }
    }
}

/// Contents of UNIT.toml.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnitConfig {
    /// Site of the unit.
    pub site: SiteTable,
    /// Noise of its sensors and encoders.
    pub noise: Noise,
    /// Its sampling.
    pub sampling: SamplingTable,
    /// What is known before the calibration.
    pub initial: InitialTable,
}

/// UNIT.toml with the tables that only an instrument needs, whose contents do not matter here.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct UnitFile {
    site: SiteTable,
    noise: Noise,
    sampling: SamplingTable,
    initial: InitialTable,
    #[serde(rename = "unit")]
    _unit: Option<IgnoredAny>,
    #[serde(rename = "outer")]
    _outer: Option<IgnoredAny>,
    #[serde(rename = "inner")]
    _inner: Option<IgnoredAny>,
    #[serde(rename = "power_up")]
    _power_up: Option<IgnoredAny>,
    #[serde(rename = "run")]
    _run: Option<IgnoredAny>,
}

impl UnitFile {
    fn config(self) -> UnitConfig {
        let Self { site, noise, sampling, initial, .. } = self;
        UnitConfig { site, noise, sampling, initial }
    }
}

/// Origin of the numbers of a unit: the keys that its file gives, if it has a file.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    file: Option<(PathBuf, toml::Table)>,
}

impl Origin {
    /// The keys of the site that have default values.
    pub fn default_site_keys(&self) -> Vec<&'static str> {
        SITE_KEYS.into_iter().filter(|key| !self.gives("site", key)).collect()
    }

    fn gives(&self, table: &str, key: &str) -> bool {
        let tables = self.file.as_ref().map(|(_, tables)| tables);
        tables.and_then(|tables| tables.get(table)).is_some_and(|table| table.get(key).is_some())
    }

    /// The origin of these keys of a table: the file, "default", or both.
    fn of(&self, table: &str, keys: &[&str]) -> String {
        let Some((path, _)) = &self.file else { return "default".into() };
        let missing: Vec<_> = keys.iter().copied().filter(|key| !self.gives(table, key)).collect();
        match missing.len() {
            0 => path.display().to_string(),
            all if all == keys.len() => "default".into(),
            _ => format!("{}, {} by default", path.display(), missing.join(" and ")),
        }
    }
}

impl UnitConfig {
    /// As [`UnitConfig::read`], with the keys that the file gives.
    ///
    /// # Errors
    /// One line that names file, line and key.
    pub fn read_with_origin(path: &Path) -> Result<(Self, Origin), TomlFileError> {
        let keys = TomlFile::read(path)?.parse()?;
        Ok((Self::read(path)?, Origin { file: Some((path.into(), keys)) }))
    }

    /// Site, noise and the heading if it is known, in words, each on a line with its origin.
    pub fn described(&self, origin: &Origin) -> String {
        let SiteTable { latitude_deg, height_m, gravity_m_s2 } = self.site;
        let source = if gravity_m_s2.is_some() { "measured" } else { "WGS-84" };
        let mut text = format!(
            "site: latitude {latitude_deg} deg, height {height_m} m, gravity {:.6} m/s^2 {source} ({})\n",
            self.site().gravity_m_s2(),
            origin.of("site", &SITE_KEYS)
        );
        let keys = ["accel_vrw_ug_sqrt_hz", "gyro_arw_deg_sqrt_h", "encoder_repeatability_arcsec"];
        text += &format!("noise: {} ({})\n", self.noise, origin.of("noise", &keys));
        if let Some(heading_deg) = self.initial.heading_deg {
            let keys = ["heading_deg", "heading_sigma_deg"];
            let sigma_deg = self.initial.heading_sigma_deg;
            text += &format!("heading: {heading_deg} +- {sigma_deg} deg ({})\n", origin.of("initial", &keys));
        }
        text
    }

    /// Reads a file and checks every number.
    ///
    /// # Errors
    /// One line that names file, line and key.
    pub fn read(path: &Path) -> Result<Self, TomlFileError> {
        let file = TomlFile::read(path)?;
        let config = file.parse::<UnitFile>()?.config();
        match config.check() {
            Ok(()) => Ok(config),
            Err((table, key, what)) => Err(file.wrong_value(table, key, what)),
        }
    }

    /// The site, SI.
    pub fn site(&self) -> Site {
        Site {
            latitude_rad: self.site.latitude_deg * DEG,
            height_m: self.site.height_m,
            measured_gravity_m_s2: self.site.gravity_m_s2,
        }
    }

    /// Finds the first wrong number: table, key, and what is wrong.
    fn check(&self) -> Result<(), (&'static str, &'static str, &'static str)> {
        let inside = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        if !inside(self.site.latitude_deg, -90.0, 90.0) {
            return Err(("site", "latitude_deg", "must be between -90 and 90"));
        }
        if !inside(self.site.height_m, -12_000.0, 100_000.0) {
            return Err(("site", "height_m", "must be between -12000 and 100000"));
        }
        if !self.site.gravity_m_s2.is_none_or(|gravity| inside(gravity, 9.0, 10.0)) {
            return Err(("site", "gravity_m_s2", "must be between 9 and 10"));
        }
        self.noise.check().map_err(|(key, what)| ("noise", key, what))?;
        if !self.sampling.rate_hz.is_none_or(|rate| inside(rate, 1.0, 100_000.0)) {
            return Err(("sampling", "rate_hz", "must be between 1 and 100000"));
        }
        if !self.initial.heading_deg.is_none_or(f64::is_finite) {
            return Err(("initial", "heading_deg", "must be finite"));
        }
        if !(self.initial.heading_sigma_deg.is_finite() && self.initial.heading_sigma_deg > 0.0) {
            return Err(("initial", "heading_sigma_deg", "must be finite and positive"));
        }
        Ok(())
    }
}
