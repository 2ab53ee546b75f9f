//! Results that are read from a file of `--json`.

use super::report::SiteReport;
use crate::base::quantity;
use crate::calibration::Outcome;
use crate::files::json_file::{self, JsonFileError};
use crate::files::truth::ParameterTable;
use rins_selfcal::model::correction::Calibration;
use rins_selfcal::model::error_model::{PARAMETER_INFO, PARAMETERS};
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::path::{Path, PathBuf};

/// Estimate and sigma, report units.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct SavedParameter {
    /// Estimate.
    pub value: f64,
    /// Standard deviation of the estimate.
    pub sigma: f64,
    unit: Option<UnitName>,
}

/// Unit as a file names it. It must be the unit of the parameter.
#[derive(Clone, Copy, Debug)]
struct UnitName(&'static str);

impl<'de> Deserialize<'de> for UnitName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let known = PARAMETER_INFO.iter().find(|info| info.unit == name);
        known.map(|info| Self(info.unit)).ok_or_else(|| D::Error::custom(format!("unknown unit `{name}`")))
    }
}

#[derive(Deserialize)]
struct Contents {
    verdict: String,
    method: Option<String>,
    scheme: Option<String>,
    temperature_c: Option<f64>,
    site: Option<SiteReport>,
    parameters: SavedParameters,
}

/// Parameters by index. In files they are a map by name.
struct SavedParameters([Option<SavedParameter>; PARAMETERS]);

impl<'de> Deserialize<'de> for SavedParameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ParametersVisitor)
    }
}

struct ParametersVisitor;

impl<'de> Visitor<'de> for ParametersVisitor {
    type Value = SavedParameters;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a table of parameter names and estimates")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SavedParameters, A::Error> {
        let wrong = |message: String| A::Error::custom(format!("parameters: {message}"));
        let mut parameters = [None; PARAMETERS];
        while let Some(name) = map.next_key::<String>()? {
            let index = quantity::parameter(&name).ok_or_else(|| wrong(format!("unknown parameter `{name}`")))?;
            let parameter: SavedParameter = map.next_value()?;
            if let Some(UnitName(unit)) = parameter.unit.filter(|unit| unit.0 != PARAMETER_INFO[index].unit) {
                return Err(wrong(format!("{name} is in {unit}, not {}", PARAMETER_INFO[index].unit)));
            }
            let SavedParameter { value, sigma, .. } = parameter;
            if !(value.is_finite() && sigma.is_finite() && sigma > 0.0) {
                return Err(wrong(format!("{name}: value {value} and sigma {sigma} are not a valid estimate")));
            }
            parameters[index] = Some(parameter);
        }
        if parameters.iter().all(Option::is_none) {
            Err(wrong("the table is empty".into()))
        } else {
            Ok(SavedParameters(parameters))
        }
    }
}

/// A result from a file.
#[derive(Clone, Debug)]
pub struct Saved {
    /// Path of the file.
    pub path: PathBuf,
    /// "accepted" or "rejected".
    pub verdict: String,
    /// "joint" or "bai".
    pub method: Option<String>,
    /// Name of the scheme, if it is known.
    pub scheme: Option<String>,
    /// Temperature of the IMU, deg C.
    pub temperature_c: Option<f64>,
    /// Site of the calibration.
    pub site: Option<SiteReport>,
    /// The parameters that the method estimates.
    pub parameters: [Option<SavedParameter>; PARAMETERS],
}

impl Saved {
    /// Reads a file.
    ///
    /// # Errors
    /// One line that names the file and its fault.
    pub fn read(path: &Path) -> Result<Self, JsonFileError> {
        let contents: Contents = json_file::read(path)?;
        Ok(Self {
            path: path.into(),
            parameters: contents.parameters.0,
            verdict: contents.verdict,
            method: contents.method,
            scheme: contents.scheme,
            temperature_c: contents.temperature_c,
            site: contents.site,
        })
    }

    /// The result of a calibration of this process, equal to one that was written and read back.
    pub fn of(outcome: &Outcome) -> Self {
        let estimate = outcome.estimate();
        let (values, sigmas) = (quantity::values(&estimate.errors), quantity::sigmas(&estimate.sigmas));
        let parameter = |index: usize| SavedParameter { value: values[index], sigma: sigmas[index], unit: None };
        let temperature_c = f64::from(outcome.solution.temperature_c);
        Self {
            path: "this result".into(),
            verdict: outcome.verdict_name().into(),
            method: Some(outcome.setup.method.name().into()),
            scheme: outcome.setup.scheme.clone(),
            temperature_c: Some(temperature_c).filter(|temperature| temperature.is_finite()),
            site: Some(SiteReport::of(outcome)),
            parameters: std::array::from_fn(|index| outcome.is_estimated(index).then(|| parameter(index))),
        }
    }

    /// Whether the result was accepted.
    pub fn is_accepted(&self) -> bool {
        self.verdict == "accepted"
    }

    /// The correction. Parameters that were not estimated are zero.
    pub fn calibration(&self) -> Calibration<f64> {
        let table = ParameterTable(self.parameters.map(|parameter| parameter.map(|parameter| parameter.value)));
        Calibration::new(&table.to_errors())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fault_of_a_parameter_is_reported_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cal.json");
        let message = |parameters: &str| {
            std::fs::write(&path, format!("{{\"verdict\": \"accepted\",\n\"parameters\": {{\n{parameters}}}\n}}\n"))
                .unwrap();
            let read = Saved::read(&path).map_or_else(|error| error.to_string(), |_| "fine".into());
            read.replace(&format!("{}/", folder.path().display()), "")
        };
        assert_eq!(message("\"Sgxy\": {\"value\": 1.0, \"sigma\": 0.1, \"unit\": \"arcsec\"}"), "fine");
        let wrong = message("\"Sgxx\": {\"value\": 1.0, \"sigma\": 0.1}");
        assert_eq!(wrong, "cal.json:3: parameters: unknown parameter `Sgxx`");
        let wrong = message("\"Sgxy\": {\"value\": 1.0, \"sigma\": 0.1, \"unit\": \"ppm\"}");
        assert_eq!(wrong, "cal.json:3: parameters: Sgxy is in ppm, not arcsec");
        let wrong = message("\"Sgxy\": {\"value\": 1.0, \"sigma\": 0.0}");
        assert_eq!(wrong, "cal.json:3: parameters: Sgxy: value 1 and sigma 0 are not a valid estimate");
        assert_eq!(message(""), "cal.json:3: parameters: the table is empty");
    }
}
