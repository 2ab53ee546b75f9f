//! Results read back from the file that `--json` writes.

use crate::calibration::{Outcome, method_name};
use crate::json_file::{self, JsonFileError};
use crate::quantity;
use crate::report::SiteReport;
use crate::truth::ParameterTable;
use rins_selfcal::error_model::{Calibration, PARAMETER_INFO, PARAMETERS};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a result cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SavedError {
    /// It cannot be read, or is no result.
    #[error(transparent)]
    File(#[from] JsonFileError),
    /// A parameter is no parameter, or has no number.
    #[error("{}: parameters: {message}", path.display())]
    Parameter {
        /// The file.
        path: PathBuf,
        /// Which, and what of it.
        message: String,
    },
}

/// Estimate and sigma, report units.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct SavedParameter {
    /// Estimate.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    unit: Option<UnitName>,
}

/// Only compared with the one that is meant.
#[derive(Clone, Copy, Debug)]
struct UnitName(&'static str);

impl<'de> Deserialize<'de> for UnitName {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let known = PARAMETER_INFO.iter().find(|info| info.unit == name);
        known.map(|info| Self(info.unit)).ok_or_else(|| serde::de::Error::custom(format!("unknown unit `{name}`")))
    }
}

#[derive(Deserialize)]
struct Contents {
    verdict: String,
    method: Option<String>,
    scheme: Option<String>,
    temperature_c: Option<f64>,
    site: Option<SiteReport>,
    parameters: BTreeMap<String, SavedParameter>,
}

/// A result.
#[derive(Clone, Debug)]
pub struct Saved {
    /// The file it is from.
    pub path: PathBuf,
    /// "accepted" or "rejected".
    pub verdict: String,
    /// "joint" or "two-stage".
    pub method: Option<String>,
    /// Where it is known.
    pub scheme: Option<String>,
    /// Of the IMU.
    pub temperature_c: Option<f64>,
    /// Where the unit stood.
    pub site: Option<SiteReport>,
    /// Those that the method estimates.
    pub parameters: [Option<SavedParameter>; PARAMETERS],
}

impl Saved {
    /// Reads a file.
    ///
    /// # Errors
    /// One line that names the file and what of it is wrong.
    pub fn read(path: &Path) -> Result<Self, SavedError> {
        let contents: Contents = json_file::read(path)?;
        let wrong = |message: String| SavedError::Parameter { path: path.into(), message };
        Ok(Self {
            path: path.into(),
            parameters: by_index(&contents.parameters).map_err(wrong)?,
            verdict: contents.verdict,
            method: contents.method,
            scheme: contents.scheme,
            temperature_c: contents.temperature_c,
            site: contents.site,
        })
    }

    /// A result of this process, as if it had been written and read back.
    pub fn of(outcome: &Outcome) -> Self {
        let estimate = outcome.estimate();
        let (values, sigmas) = (quantity::values(&estimate.errors), quantity::sigmas(&estimate.sigmas));
        let parameter = |index: usize| SavedParameter { value: values[index], sigma: sigmas[index], unit: None };
        let temperature_c = f64::from(outcome.solution.temperature_c);
        Self {
            path: "this result".into(),
            verdict: outcome.verdict_name().into(),
            method: Some(method_name(outcome.setup.method).into()),
            scheme: outcome.setup.scheme.clone(),
            temperature_c: Some(temperature_c).filter(|temperature| temperature.is_finite()),
            site: Some(SiteReport::from(&outcome.setup.site)),
            parameters: std::array::from_fn(|index| outcome.is_estimated(index).then(|| parameter(index))),
        }
    }

    /// Whether it was accepted.
    pub fn is_accepted(&self) -> bool {
        self.verdict == "accepted"
    }

    /// What to apply; what was not estimated is zero.
    pub fn calibration(&self) -> Calibration<f64> {
        let table = ParameterTable(self.parameters.map(|parameter| parameter.map(|parameter| parameter.value)));
        Calibration::new(&table.to_errors())
    }
}

fn by_index(named: &BTreeMap<String, SavedParameter>) -> Result<[Option<SavedParameter>; PARAMETERS], String> {
    let mut parameters = [None; PARAMETERS];
    for (name, parameter) in named {
        let index = PARAMETER_INFO.iter().position(|info| info.name == name);
        let index = index.ok_or_else(|| format!("unknown parameter {name}"))?;
        if let Some(UnitName(unit)) = parameter.unit.filter(|unit| unit.0 != PARAMETER_INFO[index].unit) {
            return Err(format!("{name} is in {unit}, not {}", PARAMETER_INFO[index].unit));
        }
        let is_estimate = parameter.value.is_finite() && parameter.sigma.is_finite() && parameter.sigma > 0.0;
        if !is_estimate {
            return Err(format!("{name}: value {} and sigma {} are no estimate", parameter.value, parameter.sigma));
        }
        parameters[index] = Some(*parameter);
    }
    if named.is_empty() { Err("none".into()) } else { Ok(parameters) }
}
