//! The true parameters of an instrument by name and in report units, and their file TRUTH.json.

use super::json_file::{self, JsonFileError, write_json};
use crate::base::quantity::parameter;
use rins_selfcal::base::linear::Vector;
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETER_INFO, PARAMETERS};
use serde::de::{Error as _, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::path::Path;

/// Some or all of the 28 parameters in report units. In files they are a map from name to value. An unknown or repeated
/// name is an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ParameterTable(pub [Option<f64>; PARAMETERS]);

impl ParameterTable {
    /// Converts SI to report units.
    pub fn from_errors(errors: &InstrumentErrors<f64>) -> Self {
        let x = errors.to_vector();
        Self(std::array::from_fn(|index| Some(x[index] / PARAMETER_INFO[index].unit_si)))
    }

    /// Converts report units to SI. Parameters that are left out are zero.
    pub fn to_errors(&self) -> InstrumentErrors<f64> {
        let x: [f64; PARAMETERS] =
            std::array::from_fn(|index| self.0[index].unwrap_or(0.0) * PARAMETER_INFO[index].unit_si);
        InstrumentErrors::from_vector(&Vector::from(x))
    }

    /// Value in report units by name.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.0[parameter(name)?]
    }

    /// Name of the first value that is not finite.
    pub(crate) fn not_finite(&self) -> Option<&'static str> {
        let values = PARAMETER_INFO.iter().zip(&self.0);
        values.filter(|(_, value)| value.is_some_and(|value| !value.is_finite())).map(|(info, _)| info.name).next()
    }
}

impl Serialize for ParameterTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (info, value) in PARAMETER_INFO.iter().zip(&self.0) {
            if let Some(value) = value {
                map.serialize_entry(info.name, value)?;
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for ParameterTable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(TableVisitor)
    }
}

struct TableVisitor;

impl<'de> Visitor<'de> for TableVisitor {
    type Value = ParameterTable;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a table of parameter names and values")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ParameterTable, A::Error> {
        let mut values = [None; PARAMETERS];
        while let Some(name) = map.next_key::<String>()? {
            let index = parameter(&name).ok_or_else(|| A::Error::custom(format!("unknown parameter `{name}`")))?;
            if values[index].replace(map.next_value::<f64>()?).is_some() {
                return Err(A::Error::custom(format!("parameter `{name}` given twice")));
            }
        }
        Ok(ParameterTable(values))
    }
}

/// Contents of TRUTH.json.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// The units in words.
    #[serde(default)]
    pub units: String,
    /// The known true parameters, report units.
    pub parameters: ParameterTable,
    /// Sigmas that an exact estimator reaches on the log, report units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reachable_sigma: Option<ParameterTable>,
}

impl Truth {
    /// The truth about an instrument with these errors.
    pub fn new(errors: &InstrumentErrors<f64>) -> Self {
        let units = "12 installation errors and non-perpendicularity arcsec; accel_bias ug; scales ppm; \
                     gyro_bias deg/h; roll, pitch, heading deg";
        Self { units: units.into(), parameters: ParameterTable::from_errors(errors), reachable_sigma: None }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// One line that names the file and, for its contents, line and key.
    pub fn read(path: &Path) -> Result<Self, JsonFileError> {
        json_file::read(path)
    }

    /// Writes a file.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        write_json(path, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_round_trips_through_si_and_json() {
        let table = ParameterTable(std::array::from_fn(|index| Some(index as f64 - 9.5)));
        let back = ParameterTable::from_errors(&table.to_errors());
        assert!(table.0.iter().flatten().zip(back.0.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12));
        let json = serde_json::to_string(&table).unwrap();
        assert_eq!(serde_json::from_str::<ParameterTable>(&json).unwrap(), table);
        assert_eq!(table.value("heading"), Some(17.5));
    }

    #[test]
    fn unknown_and_repeated_names_are_refused() {
        let message = |json| serde_json::from_str::<ParameterTable>(json).unwrap_err().to_string();
        assert!(message("{\"Sgxx\": 1.0}").contains("unknown parameter `Sgxx`"));
        assert!(message("{\"alpha\": 1.0, \"alpha\": 2.0}").contains("`alpha` given twice"));
    }
}
