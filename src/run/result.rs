//! The result of a run as it is stored: the calibration, its origin, and a short form of its verdict.

use crate::base::imu_identity::ImuIdentity;
use crate::base::method::Method;
use crate::base::site::Site;
use crate::estimator::Estimate;
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::run::policy::Conditions;
use crate::verdict::{Reason, Verdict};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Version of the encoding of [`Reason`] in a stored verdict.
///
/// Count it up with every change that gives stored bytes another meaning: a variant of `Reason`, or of a type inside
/// it, that is removed, moved or inserted; a field that is added or removed or changes its type or unit. A variant that
/// is added at the end needs no new version: older software stops reading at the first variant that it does not know. A
/// test pins the bytes of every variant. Reasons of another version are not read; the verdict itself and the number of
/// its reasons are.
pub const REASONS_SCHEMA: u8 = 1;

/// A calibration with its origin and its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StoredCalibration {
    /// The estimated errors, SI.
    pub errors: InstrumentErrors<f64>,
    /// Their standard deviations in the order of the parameter vector, SI.
    pub sigmas: [f64; PARAMETERS],
    /// The estimation method.
    pub method: Method,
    /// Name of the rotation scheme.
    pub scheme: String<32>,
    /// Where the calibration was made.
    pub site: Site,
    /// Time of the power-up before the calibration, seconds since 1970-01-01 UTC; `None` if there is no clock.
    pub utc_s: Option<u64>,
    /// Mean IMU temperature, deg C; not a number if there is no sensor.
    pub temperature_c: f32,
    /// Chi-square of the residuals.
    pub chi_square: f64,
    /// Degrees of freedom of the chi-square.
    pub degrees_of_freedom: u32,
    /// Version of the software that made the calibration.
    pub software_version: String<16>,
    /// The verdict.
    pub verdict: StoredVerdict,
    /// The IMU that was calibrated; `None` if it is not known.
    pub imu: Option<ImuIdentity>,
}

impl StoredCalibration {
    /// The parameters with their sigmas.
    pub fn estimate(&self) -> Estimate {
        Estimate { errors: self.errors, sigmas: self.sigmas }
    }

    /// Time and temperature of the calibration.
    pub fn conditions(&self) -> Conditions {
        Conditions { utc_s: self.utc_s, temperature_c: self.temperature_c, imu: self.imu }
    }

    /// The stored reasons of the verdict. There are none if they were encoded by another [`REASONS_SCHEMA`].
    pub fn reasons(&self) -> impl Iterator<Item = Reason> + '_ {
        let known = self.verdict.reasons_schema == REASONS_SCHEMA;
        let mut rest: &[u8] = if known { &self.verdict.told } else { &[] };
        core::iter::from_fn(move || {
            let (reason, after) = postcard::take_from_bytes(rest).ok()?;
            rest = after;
            Some(reason)
        })
    }
}

/// The short form of a verdict.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StoredVerdict {
    /// Number of doubts; 0 means accepted.
    pub doubts: u16,
    /// Number of permitted changes from the previous calibration.
    pub changes: u16,
    /// [`REASONS_SCHEMA`] of the software that wrote the reasons.
    reasons_schema: u8,
    /// The first doubts, or the first changes if there are no doubts. They are kept as bytes, so that a record can be
    /// read even if its reasons cannot.
    told: Vec<u8, 128>,
}

impl StoredVerdict {
    /// The short form of a verdict, with as many reasons as fit.
    pub fn new(verdict: &Verdict) -> Self {
        let count = |reasons: &[Reason]| reasons.len() as u16;
        let told = if verdict.accepted() { &verdict.changes } else { &verdict.reasons };
        let mut bytes = Vec::new();
        for reason in told {
            let mut buffer = [0; 64];
            let fits = postcard::to_slice(reason, &mut buffer).is_ok_and(|told| bytes.extend_from_slice(told).is_ok());
            if !fits {
                break;
            }
        }
        let doubts = count(&verdict.reasons).saturating_add(verdict.more);
        Self { doubts, changes: count(&verdict.changes), reasons_schema: REASONS_SCHEMA, told: bytes }
    }

    /// Whether the calibration may be used.
    pub fn accepted(&self) -> bool {
        self.doubts == 0
    }
}
