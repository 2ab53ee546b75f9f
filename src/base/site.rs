//! Normal gravity and Earth rotation at the site of the instrument, WGS-84.

use crate::base::bounds::{Bounded, DEGREES, Unit};
use crate::base::units::DEG;
use serde::{Deserialize, Serialize};

/// Earth rotation rate, rad/s (WGS-84).
pub const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// Sigma of a latitude that is given, deg.
pub const LATITUDE_SIGMA_DEG: f64 = 0.02;
/// Sigma of a latitude that is not given, deg. It is so wide that the gyros find the latitude.
pub const UNKNOWN_LATITUDE_SIGMA_DEG: f64 = 60.0;
/// Sigma of a height that is given, m.
pub const HEIGHT_SIGMA_M: f64 = 30.0;
/// Sigma of a height that is not given and taken as 0, m.
pub const UNKNOWN_HEIGHT_SIGMA_M: f64 = 2000.0;
/// Sigma of the difference between gravity and normal gravity at a known place, mGal.
pub const GRAVITY_SIGMA_MGAL: f64 = 20.0;
/// Sigma of a measured gravity, mGal.
pub const MEASURED_GRAVITY_SIGMA_MGAL: f64 = 1.0;
/// Decrease of gravity with height, mGal/m.
pub const GRAVITY_BY_HEIGHT_MGAL_M: f64 = 0.3086;

/// Location of the instrument. [`SITE_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Site {
    /// Geodetic latitude, rad.
    pub latitude_rad: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
    /// Measured gravity, m/s^2. If present, it replaces the normal gravity.
    pub measured_gravity_m_s2: Option<f64>,
}

/// The permitted range of every number of [`Site`]: heights from below the sea floor to where the series for normal gravity
/// ends, and gravity as it is on Earth at these heights.
pub static SITE_BOUNDS: [Bounded<Site>; 3] = [
    Bounded::new("latitude", DEGREES, [-90.0, 90.0], |site| site.latitude_rad),
    Bounded::new("height", Unit::si("m"), [-12_000.0, 100_000.0], |site| site.height_m),
    Bounded::new("gravity", Unit::si("m/s^2"), [9.0, 10.0], Site::gravity_m_s2),
];

impl Default for Site {
    /// Bai's laboratory: latitude 30.93041 deg north, height 20 m.
    fn default() -> Self {
        Self { latitude_rad: 30.930_41 * DEG, height_m: 20.0, measured_gravity_m_s2: None }
    }
}

impl Site {
    /// Gravity at the site, m/s^2: the measured value if there is one, otherwise normal gravity.
    pub fn gravity_m_s2(&self) -> f64 {
        self.measured_gravity_m_s2.unwrap_or_else(|| normal_gravity_m_s2(self.latitude_rad, self.height_m))
    }

    /// Earth rotation rate in the local level frame n (east, north, up), rad/s.
    pub fn earth_rate_n(&self) -> [f64; 3] {
        use crate::base::linear::ComplexField;
        let (sin, cos) = ComplexField::sin_cos(self.latitude_rad);
        [0.0, EARTH_RATE_RAD_S * cos, EARTH_RATE_RAD_S * sin]
    }
}

/// Derivative of normal gravity by the latitude, m/s^2/rad. The accuracy of some parts in a thousand is that of a
/// derivative in an iteration.
pub fn gravity_by_latitude(latitude_rad: f64) -> f64 {
    const STEP_RAD: f64 = 1e-4;
    let at = |latitude_rad: f64| normal_gravity_m_s2(latitude_rad, 0.0);
    (at(latitude_rad + STEP_RAD) - at(latitude_rad - STEP_RAD)) / (2.0 * STEP_RAD)
}

/// Normal gravity of WGS-84, m/s^2: Somigliana's closed formula on the ellipsoid, continued in height by the
/// second-order series (NIMA TR8350.2, 3rd ed., equations 4-1 and 4-3).
pub fn normal_gravity_m_s2(latitude_rad: f64, height_m: f64) -> f64 {
    use crate::base::linear::ComplexField;
    const EQUATOR_M_S2: f64 = 9.780_325_335_9;
    const SOMIGLIANA_K: f64 = 0.001_931_852_652_41;
    const ECCENTRICITY_SQUARED: f64 = 0.006_694_379_990_13;
    const SEMI_MAJOR_M: f64 = 6_378_137.0;
    const FLATTENING: f64 = 1.0 / 298.257_223_563;
    const CENTRIFUGAL_M: f64 = 0.003_449_786_506_84;
    let sin = ComplexField::sin(latitude_rad);
    let sin2 = sin * sin;
    let surface = EQUATOR_M_S2 * (1.0 + SOMIGLIANA_K * sin2) / ComplexField::sqrt(1.0 - ECCENTRICITY_SQUARED * sin2);
    let height = height_m / SEMI_MAJOR_M;
    surface
        * (1.0 - 2.0 * (1.0 + FLATTENING + CENTRIFUGAL_M - 2.0 * FLATTENING * sin2) * height + 3.0 * height * height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_of_wgs84() {
        // Equator and pole: the defining and derived constants of TR8350.2, table 3.4.
        assert!((normal_gravity_m_s2(0.0, 0.0) - 9.780_325_335_9).abs() < 1e-10);
        assert!((normal_gravity_m_s2(90.0 * DEG, 0.0) - 9.832_184_937_8).abs() < 1e-9);
        // Free-air gradient near the surface: 0.3086 mGal per metre.
        let gradient = (normal_gravity_m_s2(45.0 * DEG, 100.0) - normal_gravity_m_s2(45.0 * DEG, 0.0)) / 100.0;
        assert!((gradient + 3.086e-6).abs() < 1e-9);
    }

    #[test]
    fn measured_gravity_replaces_normal_gravity() {
        let site = Site { measured_gravity_m_s2: Some(9.8), ..Site::default() };
        assert_eq!(site.gravity_m_s2(), 9.8);
    }
}
