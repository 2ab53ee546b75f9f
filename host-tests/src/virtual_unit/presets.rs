//! Errors and noise by name, from files and drawn at random.
//!
//! A file of errors holds parameters in report units and effects. Both are optional:
//! ```toml
//! [parameters]
//! Sgxy = -233.615
//! [effects]
//! lever_arm_m = [0.02, -0.01, 0.03]
//! ```
//! The contents may also be given in one line in place of a file's name, with commas between the keys:
//! `parameters.Sgxy = -233.615, effects.hunting_hz = 1.5`.
//! A file of noise holds the table `[noise]` of UNIT.toml.

use super::unit::Effects;
use crate::base::bai::{TABLE_1, TABLE_3, Twelve};
use crate::base::quantity::parameter;
use crate::files::toml_file::{TomlFile, TomlFileError};
use crate::files::truth::ParameterTable;
use crate::files::unit_file::Noise;
use rand_distr::{Distribution, Normal, Uniform};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G, PPM};
use rins_selfcal::model::error_model::{InstrumentErrors, block};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::path::Path;

/// The errors of a unit and its other effects.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnitErrors {
    /// The 28 true errors, SI.
    pub errors: InstrumentErrors<f64>,
    /// Effects beyond the 28 errors.
    pub effects: Effects,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ErrorsFile {
    parameters: ParameterTable,
    effects: Effects,
}

/// The errors of this name (`table1`, `table3` or `real`), or else the errors in this file or text. The heading of
/// `real` is drawn from `seed`.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn errors_named(name: &str, seed: u64) -> Result<UnitErrors, TomlFileError> {
    let plain = |errors| Ok(UnitErrors { errors, effects: Effects::default() });
    match name {
        "table1" => plain(table1()),
        "table3" => plain(table3()),
        "real" => plain(real(seed)),
        _ if Path::new(name).exists() => {
            let file = TomlFile::read(Path::new(name))?;
            errors_of(&file, file.parse()?)
        }
        _ if name.contains('=') => {
            let keys = TomlFile::of_keys("--errors", "errors", name);
            errors_of(&keys, keys.only_table("errors")?)
        }
        _ => Err(TomlFileError::Name { name: name.into(), known: "table1, table3, real" }),
    }
}

fn errors_of(file: &TomlFile, contents: ErrorsFile) -> Result<UnitErrors, TomlFileError> {
    let ErrorsFile { parameters, effects } = contents;
    if let Some(parameter) = parameters.not_finite() {
        return Err(file.wrong_value("parameters", parameter, "must be finite"));
    }
    effects.check().map_err(|(key, what)| file.wrong_value("effects", &key, &what))?;
    Ok(UnitErrors { errors: parameters.to_errors(), effects })
}

/// The noise of this name (`bai`, `navigation` or `tactical`), or else the noise in this file.
///
/// # Errors
/// One line that names the file and, for its contents, line and key.
pub fn noise_named(name: &str) -> Result<Noise, TomlFileError> {
    match name {
        "bai" => Ok(Noise::bai()),
        "navigation" => Ok(Noise::navigation()),
        "tactical" => Ok(Noise::tactical()),
        _ if !Path::new(name).exists() => {
            Err(TomlFileError::Name { name: name.into(), known: "bai, navigation, tactical" })
        }
        _ => {
            let file = TomlFile::read(Path::new(name))?;
            let noise = file.only_table::<Noise>("noise")?;
            noise.check().map_err(|(key, what)| file.wrong_value("noise", key, what)).map(|()| noise)
        }
    }
}

/// Bai's simulated unit: the twelve errors of Table 1, all other errors zero.
pub fn table1() -> InstrumentErrors<f64> {
    installation(&TABLE_1)
}

/// Bai's laboratory unit: the twelve errors of Table 3, all other errors zero.
pub fn table3() -> InstrumentErrors<f64> {
    installation(&TABLE_3)
}

/// Parameters by name, in report units.
pub type Listed = [(&'static str, f64)];
/// Accelerometer biases of the unit `real`.
pub const REAL_ACCEL_BIAS: &Listed = &[("accel_bias_x", 30.0), ("accel_bias_y", -30.0), ("accel_bias_z", 30.0)];
/// Its accelerometer scale-factor errors.
pub const REAL_ACCEL_SCALE: &Listed = &[("accel_scale_x", -100.0), ("accel_scale_y", 100.0), ("accel_scale_z", 100.0)];
/// Its gyro biases.
pub const REAL_GYRO_BIAS: &Listed = &[("gyro_bias_x", 0.005), ("gyro_bias_y", 0.005), ("gyro_bias_z", -0.005)];
/// Its gyro scale-factor errors.
pub const REAL_GYRO_SCALE: &Listed = &[("gyro_scale_x", 20.0), ("gyro_scale_y", -20.0), ("gyro_scale_z", 20.0)];
/// Non-perpendicularity of its axes.
pub const REAL_AXES: &Listed = &[("axis_nonperpendicularity", 4.0)];
/// Tilt of its base.
pub const REAL_BASE: &Listed = &[("base_roll", 1.7), ("base_pitch", -2.3)];

/// A realistic unit: the twelve errors of Table 3, biases and scale-factor errors of mixed signs, axes that are not
/// perpendicular, a base that is not level, and a heading drawn from the seed.
pub fn real(seed: u64) -> InstrumentErrors<f64> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut table = installation_table(&TABLE_3);
    let groups = [REAL_ACCEL_BIAS, REAL_ACCEL_SCALE, REAL_GYRO_BIAS, REAL_GYRO_SCALE, REAL_AXES, REAL_BASE];
    for (name, value) in groups.into_iter().flatten() {
        table.0[parameter(name).expect("a parameter of the core")] = Some(*value);
    }
    InstrumentErrors { heading: uniform(&mut rng, 0.0, TAU), ..table.to_errors() }
}

/// Common magnitude of the parameters of a group, which differ in sign.
fn size(group: &Listed) -> f64 {
    group[0].1.abs()
}

fn installation(arcsec: &Twelve) -> InstrumentErrors<f64> {
    installation_table(arcsec).to_errors()
}

fn installation_table(arcsec: &Twelve) -> ParameterTable {
    let mut table = ParameterTable::default();
    table.0[..12].copy_from_slice(&arcsec.map(Some));
    table
}

/// Sizes of random errors. A size is the standard deviation of a normal distribution, except for the tilt of the base.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RandomErrors {
    /// The six installation errors of the gyros, arcsec.
    pub gyro_non_orthogonality_arcsec: f64,
    /// The three installation errors of the accelerometers, arcsec.
    pub accel_non_orthogonality_arcsec: f64,
    /// alpha, beta, gamma, arcsec.
    pub mounting_arcsec: f64,
    /// Accelerometer biases, ug.
    pub accel_bias_ug: f64,
    /// Accelerometer scale-factor errors, ppm.
    pub accel_scale_ppm: f64,
    /// Gyro biases, deg/h.
    pub gyro_bias_deg_h: f64,
    /// Gyro scale-factor errors, ppm.
    pub gyro_scale_ppm: f64,
    /// Non-perpendicularity of the axes, arcsec.
    pub axis_non_perpendicularity_arcsec: f64,
    /// Roll and pitch of the base are uniform between minus and plus this angle, deg.
    pub base_tilt_within_deg: f64,
}

impl Default for RandomErrors {
    /// The sizes of Bai's Table 3, by the root mean square of each group. All other sizes are those of the unit `real`.
    fn default() -> Self {
        let group =
            |from: usize, to: usize| (TABLE_3[from..to].iter().map(|x| x * x).sum::<f64>() / (to - from) as f64).sqrt();
        Self {
            gyro_non_orthogonality_arcsec: group(block::GYRO_NON_ORTHOGONALITY, block::ACCEL_NON_ORTHOGONALITY),
            accel_non_orthogonality_arcsec: group(block::ACCEL_NON_ORTHOGONALITY, block::MOUNTING),
            mounting_arcsec: group(block::MOUNTING, block::ACCEL_BIAS),
            accel_bias_ug: size(REAL_ACCEL_BIAS),
            accel_scale_ppm: size(REAL_ACCEL_SCALE),
            gyro_bias_deg_h: size(REAL_GYRO_BIAS),
            gyro_scale_ppm: size(REAL_GYRO_SCALE),
            axis_non_perpendicularity_arcsec: size(REAL_AXES),
            base_tilt_within_deg: 5.0,
        }
    }
}

impl RandomErrors {
    /// The same sizes, with all twelve installation errors of this size, deg.
    #[must_use]
    pub fn with_installation_deg(self, size_deg: f64) -> Self {
        let arcsec = size_deg * DEG / ARCSEC;
        Self {
            gyro_non_orthogonality_arcsec: arcsec,
            accel_non_orthogonality_arcsec: arcsec,
            mounting_arcsec: arcsec,
            ..self
        }
    }

    /// All sizes multiplied by `factor`, except the tilt of the base.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            gyro_non_orthogonality_arcsec: self.gyro_non_orthogonality_arcsec * factor,
            accel_non_orthogonality_arcsec: self.accel_non_orthogonality_arcsec * factor,
            mounting_arcsec: self.mounting_arcsec * factor,
            accel_bias_ug: self.accel_bias_ug * factor,
            accel_scale_ppm: self.accel_scale_ppm * factor,
            gyro_bias_deg_h: self.gyro_bias_deg_h * factor,
            gyro_scale_ppm: self.gyro_scale_ppm * factor,
            axis_non_perpendicularity_arcsec: self.axis_non_perpendicularity_arcsec * factor,
            ..self
        }
    }

    /// Draws the errors of one unit. The heading is uniform over the full turn.
    pub fn draw(&self, seed: u64) -> InstrumentErrors<f64> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let tilt = self.base_tilt_within_deg * DEG;
        InstrumentErrors {
            gyro_non_orthogonality: normals(&mut rng, self.gyro_non_orthogonality_arcsec * ARCSEC),
            accel_non_orthogonality: normals(&mut rng, self.accel_non_orthogonality_arcsec * ARCSEC),
            mounting: normals(&mut rng, self.mounting_arcsec * ARCSEC),
            accel_bias_a: normals(&mut rng, self.accel_bias_ug * MICRO_G),
            accel_scale: normals(&mut rng, self.accel_scale_ppm * PPM),
            gyro_bias_g: normals(&mut rng, self.gyro_bias_deg_h * DEG_H),
            gyro_scale: normals(&mut rng, self.gyro_scale_ppm * PPM),
            axis_non_perpendicularity: normals::<1>(&mut rng, self.axis_non_perpendicularity_arcsec * ARCSEC)[0],
            base_roll: uniform(&mut rng, -tilt, tilt),
            base_pitch: uniform(&mut rng, -tilt, tilt),
            heading: uniform(&mut rng, 0.0, TAU),
        }
    }
}

fn normals<const N: usize>(rng: &mut Xoshiro256PlusPlus, sigma: f64) -> [f64; N] {
    let distribution = Normal::new(0.0, sigma).expect("sizes are finite");
    std::array::from_fn(|_| distribution.sample(rng))
}

pub(crate) fn uniform(rng: &mut Xoshiro256PlusPlus, low: f64, high: f64) -> f64 {
    Uniform::new_inclusive(low, high).expect("bounds are finite and in order").sample(rng)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_unit::imperfections::Imperfections;
    use rins_selfcal::base::hardware::Hardware;

    #[test]
    fn bai_noise_is_the_stated_one_per_sample_at_200_hz() {
        let noise = Noise::bai();
        assert!((noise.sigma_force_m_s2(200.0) / (30.0 * MICRO_G) - 1.0).abs() < 1e-14);
        assert!((noise.sigma_omega_rad_s(200.0) / (0.2 * ARCSEC) - 1.0).abs() < 1e-14);
        // A rate error times the sample interval of 5 ms is an angle.
        assert!((noise.sigma_reference_rad(200.0) / (0.7 * ARCSEC * 0.005) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn errors_may_be_given_in_one_line() {
        let found = errors_named("parameters = { Sgxy = 3.0, gyro_bias_x = 0.5 }", 0).unwrap().errors.to_vector();
        assert!((found[0] / ARCSEC - 3.0).abs() < 1e-12 && (found.sum() - 3.0 * ARCSEC - 0.5 * DEG_H).abs() < 1e-15);
        let effects = errors_named("effects.base_tilt_drift_arcsec_h = [2.0, 0.0]", 0).unwrap().effects;
        assert_eq!(effects.base_tilt_drift_arcsec_h, [2.0, 0.0]);
        let both =
            errors_named("parameters.Sgxy = 3, effects.lever_arm_m = [0, 0.1, 0], parameters.alpha = 2", 0).unwrap();
        let [sgxy, alpha] = [0, block::MOUNTING].map(|index| both.errors.to_vector()[index] / ARCSEC);
        assert!((sgxy - 3.0).abs() < 1e-12 && (alpha - 2.0).abs() < 1e-12);
        assert_eq!(both.effects.lever_arm_m, [0.0, 0.1, 0.0]);
        let message = |text| errors_named(text, 0).unwrap_err().to_string();
        assert_eq!(message("parameters = { Sgxx = 1.0 }"), "--errors: unknown parameter `Sgxx`");
        assert_eq!(message("effects.hunting_hz = -1.0"), "--errors: hunting_hz: must be finite and not negative");
        let bare = message("Sgxy = 1.0, effects.hunting_hz = 1.0");
        assert_eq!(bare, "--errors: unknown field `Sgxy`, expected `parameters` or `effects`");
        let words = message("parameters.Sgxy = 1.0, effects.hunting_hz = \"high\"");
        assert_eq!(words, "--errors: effects.hunting_hz: invalid type: string \"high\", expected f64");
        let no_comma = message("parameters.Sgxy = 1.0 effects.hunting_hz = 1.0");
        let syntax = "--errors: not KEY = VALUE, KEY = VALUE with texts in quotes: ";
        assert!(no_comma.starts_with(syntax) && !no_comma.contains('\n'), "{no_comma}");
    }

    #[test]
    fn effects_that_no_unit_can_have_are_refused_by_key_line_and_range() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("errors.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let read = errors_named(path.to_str().unwrap(), 0);
            read.map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
        };
        let zeros = "[0.0, 0.0], [0.0, 0.0]";
        for (text, line, message) in [
            ("accel_quadratic_ug_g2 = [1.0, nan, 0.0]", 2, "accel_quadratic_ug_g2: must be from -5000 to 5000 ug/g^2"),
            ("\naccel_floor_ug = -2.0", 3, "accel_floor_ug: must be from 0 to 1000 ug"),
            ("backlash_arcsec = [0.0, 1e9]", 2, "backlash_arcsec: must be from -60 to 60 arcsec"),
            ("warm_up = { accel_ug = [0.0, 0.0, inf] }", 2, "warm_up.accel_ug: must be from -20000 to 20000 ug"),
            (
                "[effects.hardware.warm_up]\ntime_constant_s = 0.0",
                3,
                "warm_up.time_constant_s: must be from 1 to 1000000 s",
            ),
            ("latitude_error_deg = 181.0", 2, "latitude_error_deg: must be from -180 to 180 deg"),
            (
                &format!("encoder_harmonics_arcsec = [[[0.0, 61.0], {zeros}, [0.0, 0.0]],\n[{zeros}, {zeros}]]"),
                2,
                "encoder_harmonics_arcsec: must be from -60 to 60 arcsec",
            ),
        ] {
            let refused = read(&format!("[effects.hardware]\n{text}\n")).unwrap_err();
            assert_eq!(refused, format!("errors.toml:{line}: hardware.{message}"));
        }
        let refused = read("[effects]\nencoder_bits = 0\n").unwrap_err();
        assert_eq!(refused, "errors.toml:2: encoder_bits: must be from 1 to 32");
        let refused = read("[effects]\nlever_arm_m = [0.0, nan, 0.0]\n").unwrap_err();
        assert_eq!(refused, "errors.toml:2: lever_arm_m: must be finite");
        // What the profiles draw is permitted.
        for (name, hardware) in Hardware::PROFILES {
            let effects = Effects { hardware: Imperfections::draw(&hardware, 1.0, 3), ..Effects::default() };
            let written = toml::to_string(&ErrorsFile { effects, ..ErrorsFile::default() }).unwrap();
            assert!(read(&written).is_ok(), "{name}: {:?}", read(&written));
        }
    }

    #[test]
    fn random_errors_have_their_sizes() {
        // 400 units have 3 accelerometer biases each. The sum of squares over sigma^2 is chi-square with 1200 degrees
        // of freedom, so its sigma is sqrt(2400) = 49. The test allows five sigma.
        let sizes = RandomErrors::default();
        let sum: f64 =
            (0..400).flat_map(|seed| sizes.draw(seed).accel_bias_a).map(|bias| (bias / (30.0 * MICRO_G)).powi(2)).sum();
        assert!((sum - 1200.0).abs() < 245.0, "{sum}");
        let headings: Vec<f64> = (0..400).map(|seed| sizes.draw(seed).heading).collect();
        assert!(headings.iter().all(|heading| (0.0..=TAU).contains(heading)));
        assert!(sizes.draw(3).base_roll.abs() <= 5.0 * DEG);
    }
}
