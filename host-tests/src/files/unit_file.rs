//! The user's description of a unit and its site: UNIT.toml.
//!
//! ```toml
//! [site]
//! latitude_deg = 30.93041                # geodetic, -90 to 90; default: unknown, the gyros find it
//! latitude_sigma_deg = 0.02              # its sigma; default 0.02
//! height_m = 20.0                        # above the ellipsoid; default 0 with a sigma of 2000
//! height_sigma_m = 30.0                  # its sigma; default 30; not used if gravity is measured
//! gravity_m_s2 = 9.79398                 # measured; default: WGS-84 normal gravity
//! gravity_sigma_mgal = 20.0              # its sigma; default 20 for normal gravity, 1 for a measured one
//! [noise]                                # default: the unit "navigation"
//! accel_vrw_ug_sqrt_hz = 10.0
//! gyro_arw_deg_sqrt_h = 0.001
//! encoder_repeatability_arcsec = 0.5     # per stop and axis
//! rate_reference_arcsec_sqrt_s = 0.0     # walk of the angle reading while turning
//! accel_floor_ug = 2.0                   # Allan floor and bias walk; default: those of the hardware
//! accel_walk_ug_sqrt_h = 0.0
//! gyro_floor_deg_h = 0.002
//! gyro_walk_deg_h_sqrt_h = 0.0
//! [hardware]                             # imperfections: see `files::hardware`; default: the profile "navigation"
//! profile = "navigation"
//! [sampling]
//! rate_hz = 200.0                        # default: from the log's time stamps; 200 for a virtual unit
//! [initial]
//! heading_deg = 137.0                    # known heading; default: unknown
//! heading_sigma_deg = 1.0                # its sigma; default 1
//! [bai]                                  # P0 and Q of the method bai; R is that of [noise]
//! initial_sigma_arcsec = 10800.0         # sigma of each state before any data; default 10800
//! walk_arcsec_sqrt_s = 0.0               # random walk of each state; default 0: constants
//! ```
//! A file may have the tables that only an instrument needs too: `commissioning`.

use super::hardware::{self, HardwareTable};
use super::toml_file::{TomlFile, TomlFileError};
use crate::base::quantity::significant;
use rins_selfcal::base::bounds::Bound;
use rins_selfcal::base::hardware::{Hardware, HardwareSize};
use rins_selfcal::base::site::{
    GRAVITY_BY_HEIGHT_MGAL_M, GRAVITY_SIGMA_MGAL, HEIGHT_SIGMA_M, LATITUDE_SIGMA_DEG, MEASURED_GRAVITY_SIGMA_MGAL,
    SITE_BOUNDS, Site, UNKNOWN_HEIGHT_SIGMA_M, UNKNOWN_LATITUDE_SIGMA_DEG,
};
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_SQRT_H, MGAL, MICRO_G};
use rins_selfcal::estimator::{BaiTuning, TUNING_BOUNDS};
use rins_selfcal::model::effects::{SITE_SIGMA_BOUNDS, SiteSigmas};
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
    /// Allan floor of the accelerometers, ug. Default: that of the hardware.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accel_floor_ug: Option<f64>,
    /// Random walk of the accelerometer biases, ug/sqrt(h). Default: that of the hardware.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accel_walk_ug_sqrt_h: Option<f64>,
    /// Allan floor of the gyros, deg/h. Default: that of the hardware.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_floor_deg_h: Option<f64>,
    /// Random walk of the gyro biases, deg/h/sqrt(h). Default: that of the hardware.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_walk_deg_h_sqrt_h: Option<f64>,
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
    /// No noise; Allan floors and walks are those of the hardware.
    pub const NONE: Self = Self {
        accel_vrw_ug_sqrt_hz: 0.0,
        gyro_arw_deg_sqrt_h: 0.0,
        encoder_repeatability_arcsec: 0.0,
        rate_reference_arcsec_sqrt_s: 0.0,
        accel_floor_ug: None,
        accel_walk_ug_sqrt_h: None,
        gyro_floor_deg_h: None,
        gyro_walk_deg_h_sqrt_h: None,
    };

    /// A navigation grade unit.
    pub const fn navigation() -> Self {
        Self { accel_vrw_ug_sqrt_hz: 10.0, gyro_arw_deg_sqrt_h: 0.001, encoder_repeatability_arcsec: 0.5, ..Self::NONE }
    }

    /// A tactical grade unit.
    pub const fn tactical() -> Self {
        Self { accel_vrw_ug_sqrt_hz: 60.0, gyro_arw_deg_sqrt_h: 0.05, encoder_repeatability_arcsec: 5.0, ..Self::NONE }
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
            ..Self::NONE
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

    /// Allan floors and walks, which are sizes of the hardware too: their keys, which are the same there, and values.
    fn sizes_of_hardware(&self) -> [(&'static str, Option<f64>); 4] {
        [
            ("accel_floor_ug", self.accel_floor_ug),
            ("accel_walk_ug_sqrt_h", self.accel_walk_ug_sqrt_h),
            ("gyro_floor_deg_h", self.gyro_floor_deg_h),
            ("gyro_walk_deg_h_sqrt_h", self.gyro_walk_deg_h_sqrt_h),
        ]
    }

    /// The same noise, with the Allan floors and walks that this hardware has.
    #[must_use]
    pub fn with_sizes_of(self, hardware: &Hardware) -> Self {
        let of = |key: &str| HardwareSize::named(key).map(|size| hardware::in_unit(size, hardware));
        Self {
            accel_floor_ug: of("accel_floor_ug"),
            accel_walk_ug_sqrt_h: of("accel_walk_ug_sqrt_h"),
            gyro_floor_deg_h: of("gyro_floor_deg_h"),
            gyro_walk_deg_h_sqrt_h: of("gyro_walk_deg_h_sqrt_h"),
            ..self
        }
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
        let given = self.sizes_of_hardware().map(|(key, value)| (key, value.unwrap_or(0.0)));
        if let Some((key, _)) = values.iter().chain(&given).find(|(_, value)| !value.is_finite() || *value < 0.0) {
            return Err((key, "must be finite and not negative"));
        }
        let largest = |key: &str| HardwareSize::named(key).map_or(f64::INFINITY, |size| size.largest);
        match self.sizes_of_hardware().iter().find(|(key, value)| value.is_some_and(|value| value > largest(key))) {
            Some((key, _)) => Err((key, "is larger than a size of the hardware can be")),
            None => Ok(()),
        }
    }
}

/// The keys of `[site]` that every calibration depends on.
const SITE_KEYS: [&str; 2] = ["latitude_deg", "height_m"];

/// `[site]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiteTable {
    /// Geodetic latitude, deg. Unknown if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latitude_deg: Option<f64>,
    /// Sigma of the latitude, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latitude_sigma_deg: Option<f64>,
    /// Height above the ellipsoid, m. If absent, it is taken as 0 with a large sigma.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_m: Option<f64>,
    /// Sigma of the height, m. Not used if gravity is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_sigma_m: Option<f64>,
    /// Measured gravity, m/s^2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_m_s2: Option<f64>,
    /// Sigma of gravity beside that of the height, mGal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_sigma_mgal: Option<f64>,
}

impl SiteTable {
    /// Bai's laboratory, where a virtual unit stands unless its description says otherwise.
    pub fn laboratory() -> Self {
        Self { latitude_deg: Some(30.930_41), height_m: Some(Site::default().height_m), ..Self::default() }
    }

    /// Whether nothing is said of the site.
    pub fn is_unknown(&self) -> bool {
        *self == Self::default()
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

/// `[bai]`: P0 and Q of the paper's method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaiTable {
    /// Sigma of each of the twelve states before any data, arcsec.
    pub initial_sigma_arcsec: f64,
    /// Random walk of each of the twelve states, arcsec/sqrt(s).
    pub walk_arcsec_sqrt_s: f64,
}

impl BaiTable {
    /// SI. The default is that of the core to the last bit.
    pub fn tuning(&self) -> BaiTuning {
        if *self == Self::default() {
            return BaiTuning::STATED;
        }
        BaiTuning {
            initial_sigma_rad: self.initial_sigma_arcsec * ARCSEC,
            walk_rad_sqrt_s: self.walk_arcsec_sqrt_s * ARCSEC,
        }
    }
}

impl Default for BaiTable {
    fn default() -> Self {
        Self { initial_sigma_arcsec: 10_800.0, walk_arcsec_sqrt_s: 0.0 }
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
    /// Imperfections of its hardware.
    pub hardware: HardwareTable,
    /// P0 and Q of the paper's method.
    pub bai: BaiTable,
}

/// UNIT.toml with the tables that only an instrument needs, whose contents do not matter here.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct UnitFile {
    site: SiteTable,
    noise: Noise,
    sampling: SamplingTable,
    initial: InitialTable,
    hardware: HardwareTable,
    bai: BaiTable,
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
        let Self { site, noise, sampling, initial, hardware, bai, .. } = self;
        UnitConfig { site, noise, sampling, initial, hardware, bai }
    }
}

/// Origin of the numbers of a unit: the keys that its file gives, if it has a file.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    file: Option<(PathBuf, toml::Table)>,
    noise: Option<String>,
}

impl Origin {
    /// The same origin, but for noise of this name on the command line.
    #[must_use]
    pub fn with_noise(self, name: Option<&str>) -> Self {
        Self { noise: name.map(|name| format!("--noise {name}")), ..self }
    }

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
        if let Some(noise) = self.noise.as_ref().filter(|_| table == "noise") {
            return noise.clone();
        }
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
        Ok((Self::read(path)?, Origin { file: Some((path.into(), keys)), noise: None }))
    }

    /// Site, noise and the heading if it is known, in words, each on a line with its origin.
    pub fn described(&self, origin: &Origin) -> String {
        let SiteTable { latitude_deg, height_m, gravity_m_s2, .. } = self.site;
        let height_m = height_m.unwrap_or(0.0);
        let mut text = match (latitude_deg, gravity_m_s2) {
            (None, None) => format!("site: latitude unknown, the gyros find it and gravity; height {height_m} m"),
            (None, Some(gravity)) => {
                format!("site: latitude unknown, the gyros find it; gravity {gravity:.6} m/s^2 measured")
            }
            (Some(latitude_deg), _) => {
                let source = if gravity_m_s2.is_some() { "measured" } else { "WGS-84" };
                let gravity = self.site().gravity_m_s2();
                format!("site: latitude {latitude_deg} deg, height {height_m} m, gravity {gravity:.6} m/s^2 {source}")
            }
        };
        let sigma_ppm = self.site_sigmas().gravity_m_s2 / 9.8 * 1e6;
        text += &format!(", known to {} ppm ({})\n", significant(sigma_ppm), origin.of("site", &SITE_KEYS));
        let keys = ["accel_vrw_ug_sqrt_hz", "gyro_arw_deg_sqrt_h", "encoder_repeatability_arcsec"];
        text += &format!("noise: {} ({})\n", self.noise, origin.of("noise", &keys));
        text += &format!("hardware: {}\n", hardware::described(&self.hardware()));
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
            Err((table, key, what)) => Err(file.wrong_value(table, key, &what)),
        }
    }

    /// An ideal unit at the site of the literature, all of which is known exactly.
    pub fn ideal() -> Self {
        let hardware = HardwareTable(Hardware::IDEAL);
        Self { site: SiteTable::laboratory(), hardware, ..Self::default() }
    }

    /// The same unit at Bai's laboratory if nothing is said of its site.
    #[must_use]
    pub fn somewhere(self) -> Self {
        if self.site.is_unknown() { Self { site: SiteTable::laboratory(), ..self } } else { self }
    }

    /// The site, SI. An unknown latitude is zero here.
    pub fn site(&self) -> Site {
        Site {
            latitude_rad: self.site.latitude_deg.unwrap_or(0.0) * DEG,
            height_m: self.site.height_m.unwrap_or(0.0),
            measured_gravity_m_s2: self.site.gravity_m_s2,
        }
    }

    /// How well the site is known. Of ideal hardware, what is given is known exactly.
    pub fn site_sigmas(&self) -> SiteSigmas {
        let site = &self.site;
        let given = |given: bool, [known, unknown]: [f64; 2]| match (given, self.hardware() == Hardware::IDEAL) {
            (false, _) => unknown,
            (true, true) => 0.0,
            (true, false) => known,
        };
        let latitude_deg = given(site.latitude_deg.is_some(), [LATITUDE_SIGMA_DEG, UNKNOWN_LATITUDE_SIGMA_DEG]);
        let is_measured = site.gravity_m_s2.is_some();
        let of_height = given(site.height_m.is_some(), [HEIGHT_SIGMA_M, UNKNOWN_HEIGHT_SIGMA_M]);
        let height_m = if is_measured { 0.0 } else { site.height_sigma_m.unwrap_or(of_height) };
        let gravity_mgal =
            given(true, [if is_measured { MEASURED_GRAVITY_SIGMA_MGAL } else { GRAVITY_SIGMA_MGAL }, 0.0]);
        let height_mgal = height_m * GRAVITY_BY_HEIGHT_MGAL_M;
        SiteSigmas {
            latitude_rad: site.latitude_sigma_deg.unwrap_or(latitude_deg) * DEG,
            gravity_m_s2: site.gravity_sigma_mgal.unwrap_or(gravity_mgal).hypot(height_mgal) * MGAL,
        }
    }

    /// The imperfections of the hardware, with Allan floors and walks as the noise gives them.
    pub fn hardware(&self) -> Hardware {
        let mut hardware = self.hardware.0;
        for (key, value) in self.noise.sizes_of_hardware() {
            if let (Some(size), Some(value)) = (HardwareSize::named(key), value) {
                size.set(&mut hardware, value * size.unit_si);
            }
        }
        hardware
    }

    /// Finds the first wrong number: table, key, and what is wrong.
    fn check(&self) -> Result<(), (&'static str, &'static str, String)> {
        let inside = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        let [latitude, height, gravity] = SITE_BOUNDS.each_ref().map(|row| row.bound);
        let [latitude_sigma, gravity_sigma] = SITE_SIGMA_BOUNDS.each_ref().map(|row| row.bound);
        let SiteTable { latitude_deg, latitude_sigma_deg, height_m, height_sigma_m, gravity_m_s2, gravity_sigma_mgal } =
            self.site;
        let site = [
            ("latitude_deg", latitude_deg, latitude),
            ("latitude_sigma_deg", latitude_sigma_deg, latitude_sigma),
            ("height_m", height_m, height),
            ("height_sigma_m", height_sigma_m, Bound { lowest: 0.0, ..height }),
            ("gravity_m_s2", gravity_m_s2, gravity),
            ("gravity_sigma_mgal", gravity_sigma_mgal, gravity_sigma),
        ];
        for (key, value, bound) in site {
            if !value.is_none_or(|value| bound.permits(value * bound.unit.si)) {
                return Err(("site", key, format!("must be {bound}")));
            }
        }
        if self.site.latitude_deg.is_none() && self.site.latitude_sigma_deg.is_some() {
            return Err(("site", "latitude_sigma_deg", "needs latitude_deg".into()));
        }
        if self.site.height_m.is_none() && self.site.height_sigma_m.is_some() && self.site.gravity_m_s2.is_none() {
            return Err(("site", "height_sigma_m", "needs height_m".into()));
        }
        self.noise.check().map_err(|(key, what)| ("noise", key, what.into()))?;
        if !self.sampling.rate_hz.is_none_or(|rate| inside(rate, 1.0, 100_000.0)) {
            return Err(("sampling", "rate_hz", "must be between 1 and 100000".into()));
        }
        if !self.initial.heading_deg.is_none_or(f64::is_finite) {
            return Err(("initial", "heading_deg", "must be finite".into()));
        }
        if !(self.initial.heading_sigma_deg.is_finite() && self.initial.heading_sigma_deg > 0.0) {
            return Err(("initial", "heading_sigma_deg", "must be finite and positive".into()));
        }
        for (key, row) in ["initial_sigma_arcsec", "walk_arcsec_sqrt_s"].into_iter().zip(&TUNING_BOUNDS) {
            if !row.bound.permits((row.value)(&self.bai.tuning())) {
                return Err(("bai", key, format!("must be {}", row.bound)));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sigmas(site: &str) -> SiteSigmas {
        let config: UnitConfig = toml::from_str(site).expect("a unit description");
        config.check().expect("valid");
        config.site_sigmas()
    }

    #[test]
    fn sigmas_of_the_site_are_those_of_what_is_given() {
        let near = |found: SiteSigmas, latitude_rad: f64, gravity_m_s2: f64| {
            (found.latitude_rad - latitude_rad).abs() < 1e-9 && (found.gravity_m_s2 / gravity_m_s2 - 1.0).abs() < 5e-3
        };
        let given = "site = { latitude_deg = 48.0, height_m = 500.0 }";
        assert!(near(sigmas(given), SiteSigmas::GIVEN.latitude_rad, SiteSigmas::GIVEN.gravity_m_s2));
        assert!(near(sigmas(""), SiteSigmas::UNKNOWN.latitude_rad, SiteSigmas::UNKNOWN.gravity_m_s2));
        let measured =
            "site = { latitude_deg = 48.0, latitude_sigma_deg = 1.0, height_sigma_m = 900.0, gravity_m_s2 = 9.81 }";
        assert!(near(sigmas(measured), DEG, MGAL), "the height does not matter: {:?}", sigmas(measured));
        let high = "site = { latitude_deg = 48.0, height_m = 500.0, height_sigma_m = 900.0, gravity_sigma_mgal = 0.0 }";
        assert!(near(sigmas(high), 0.02 * DEG, 277.7 * MGAL), "{:?}", sigmas(high));
    }

    #[test]
    fn the_default_of_the_papers_filter_is_what_the_core_states() {
        let BaiTable { initial_sigma_arcsec, walk_arcsec_sqrt_s } = BaiTable::default();
        assert!((initial_sigma_arcsec * ARCSEC / BaiTuning::STATED.initial_sigma_rad - 1.0).abs() < 1e-15);
        assert_eq!(walk_arcsec_sqrt_s, BaiTuning::STATED.walk_rad_sqrt_s);
        let described = |bai: &str| -> UnitConfig { toml::from_str(bai).expect("a unit description") };
        let walking = described("bai = { walk_arcsec_sqrt_s = 0.5 }");
        assert_eq!((walking.check(), walking.bai.tuning().walk_rad_sqrt_s), (Ok(()), 0.5 * ARCSEC));
        let negative = described("bai = { walk_arcsec_sqrt_s = -0.5 }").check();
        assert_eq!(negative.map_err(|(table, key, _)| (table, key)), Err(("bai", "walk_arcsec_sqrt_s")));
    }

    #[test]
    fn a_sigma_of_a_latitude_that_is_not_given_is_refused() {
        let config: UnitConfig = toml::from_str("site = { latitude_sigma_deg = 1.0 }").expect("a unit description");
        assert_eq!(config.check(), Err(("site", "latitude_sigma_deg", "needs latitude_deg".to_string())));
    }
}
