//! The result as JSON: parameters with sigmas, the correction and how to apply it, and the quality of the fit.

use crate::base::quantity;
use crate::calibration::{Enlargement, HostMethod, Outcome, Precision};
use crate::files::hardware::{in_unit, nearest_profile};
use crate::files::unit_file::Noise;
use rins_selfcal::base::hardware::{HARDWARE, Hardware};
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::linear::{Matrix3, Vector3};
use rins_selfcal::base::loss::LossCounts;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{DEG, MGAL};
use rins_selfcal::estimator::{Estimate, LargestInnovation};
use rins_selfcal::model::correction::Calibration;
use rins_selfcal::model::error_model::{InstrumentErrors, PARAMETER_INFO, ParameterInfo};
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::segment::intake::IntakeCounts;
use rins_selfcal::verdict::CHANNEL_NAMES;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

/// Signs, frames and how to apply a result.
pub const CONVENTION: &str = "\
Right-handed frames; rot_ab takes b-components to a-components; SI units in `correction`. \
Apply to every sample: f_s = force_matrix_sa (f_a - accel_bias_a), w_s = rate_matrix_sg (w_g - gyro_bias_g); \
from the rotation frame r to the IMU frame s: v_s = rot_sr v_r. \
Model: f_a = (I + diag ka) rot_sa^-1 f_s + ba, w_g = (I + diag kg) rot_sg^-1 w_s + bg, \
rot_sa = [[1,0,0],[Sayz,1,0],[-Sazy,Sazx,1]], rot_sg = [[1,-Sgxz,Sgxy],[Sgyz,1,-Sgyx],[-Sgzy,Sgzx,1]], \
rot_sr = exp(-[(alpha,beta,gamma) x]), inner axis in r at zero angles = (sin d, 0, cos d) with d = axis_nonperpendicularity. \
Outer axis x, inner axis z, encoder angles right-handed, encoder zeros define r. \
rot_nb = R_z(-heading) R_y(base_pitch) R_x(base_roll), n = east north up, heading of b's y axis clockwise from north. \
1 ug = 9.80665e-6 m/s^2.";

/// Values by name, in order. In files they are a map.
#[derive(Clone, Debug)]
pub struct Named<V>(pub Vec<(&'static str, V)>);

impl<V: Serialize> Serialize for Named<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, value) in &self.0 {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

/// One parameter.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ParameterReport {
    /// Estimate.
    pub value: f64,
    /// Standard deviation of the estimate.
    pub sigma: f64,
    /// Unit of estimate and standard deviation.
    pub unit: &'static str,
}

/// Name and version of a program.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Software {
    name: &'static str,
    version: &'static str,
}

/// Name and version of this program.
pub const SOFTWARE: Software = Software { name: "rins-selfcal", version: env!("CARGO_PKG_VERSION") };

/// Site of the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct SiteReport {
    /// Latitude, deg.
    pub latitude_deg: f64,
    /// Height, m.
    pub height_m: f64,
    /// Gravity, m/s^2.
    pub gravity_m_s2: f64,
    /// Sigma of the latitude, deg. `None` for a stored calibration, which does not have it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latitude_sigma_deg: Option<f64>,
    /// Sigma of gravity at this latitude, mGal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_sigma_mgal: Option<f64>,
}

impl From<&Site> for SiteReport {
    fn from(site: &Site) -> Self {
        Self {
            latitude_deg: site.latitude_rad / DEG,
            height_m: site.height_m,
            gravity_m_s2: site.gravity_m_s2(),
            latitude_sigma_deg: None,
            gravity_sigma_mgal: None,
        }
    }
}

impl SiteReport {
    /// The site of an outcome, with its sigmas.
    pub fn of(outcome: &Outcome) -> Self {
        let sigmas = outcome.site_sigmas();
        Self {
            latitude_sigma_deg: Some(sigmas.latitude_rad / DEG),
            gravity_sigma_mgal: Some(sigmas.gravity_m_s2 / MGAL),
            ..Self::from(&outcome.site())
        }
    }
}

/// Sizes of the imperfections of the hardware, with the keys and in the units of `[hardware]`.
#[derive(Clone, Debug, Serialize)]
struct HardwareReport {
    /// The profile with most of these sizes.
    profile: &'static str,
    #[serde(flatten)]
    sizes: Named<f64>,
}

impl From<&Hardware> for HardwareReport {
    fn from(hardware: &Hardware) -> Self {
        let sizes = HARDWARE.iter().map(|size| (size.key, in_unit(size, hardware)));
        Self { profile: nearest_profile(hardware).0, sizes: Named(sizes.collect()) }
    }
}

/// Correction for every sample, in SI units; matrices by rows.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CorrectionReport {
    /// `f_s = force_matrix_sa (f_a - accel_bias_a)`.
    pub force_matrix_sa: [[f64; 3]; 3],
    /// Accelerometer bias, m/s^2.
    pub accel_bias_a: [f64; 3],
    /// `w_s = rate_matrix_sg (w_g - gyro_bias_g)`.
    pub rate_matrix_sg: [[f64; 3]; 3],
    /// Gyro bias, rad/s.
    pub gyro_bias_g: [f64; 3],
    /// Rotation from the rotation frame to the IMU frame.
    pub rot_sr: [[f64; 3]; 3],
    /// Non-perpendicularity d of the inner axis (sin d, 0, cos d), rad.
    pub axis_nonperpendicularity_rad: f64,
}

#[derive(Clone, Debug, Serialize)]
struct CorrelationReport {
    order: Vec<&'static str>,
    matrix: Vec<Vec<f64>>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct FitReport {
    measurements: u32,
    gated: u32,
    refused: u32,
    largest_innovation: InnovationReport,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct InnovationReport {
    normalized: f64,
    segment: u16,
    channel: &'static str,
}

/// Contents of the JSON file of a calibration.
#[derive(Clone, Debug, Serialize)]
pub struct CalibrationReport {
    verdict: &'static str,
    reasons: Vec<String>,
    /// Codes of the reasons, in the order of `reasons`.
    reason_codes: Vec<&'static str>,
    stored: Option<bool>,
    method: &'static str,
    duration_s: f64,
    segments: u16,
    chi_square: f64,
    degrees_of_freedom: u32,
    parameters: Named<ParameterReport>,
    effects: Named<ParameterReport>,
    correction: CorrectionReport,
    convention: &'static str,
    scheme: Option<String>,
    site: SiteReport,
    noise: Noise,
    hardware: HardwareReport,
    rate_hz: f64,
    temperature_c: Option<f32>,
    stops: usize,
    moves: usize,
    left_out: u16,
    samples: IntakeCounts,
    samples_lost: Option<LossCounts>,
    fit: FitReport,
    sweeps: u8,
    converged: bool,
    precision: Precision,
    software: Software,
    correlation: CorrelationReport,
    /// The size of the hardware that was enlarged for this result, if one was.
    #[serde(skip_serializing_if = "Option::is_none")]
    enlarged: Option<Enlargement>,
}

impl From<&Outcome> for CalibrationReport {
    fn from(outcome: &Outcome) -> Self {
        let solution = &outcome.solution;
        Self {
            verdict: outcome.verdict_name(),
            reasons: outcome.reasons(),
            reason_codes: outcome.reason_codes(),
            stored: outcome.stored,
            method: outcome.setup.method.name(),
            duration_s: solution.duration_s,
            segments: solution.segments,
            chi_square: solution.fit.chi_square,
            degrees_of_freedom: solution.degrees_of_freedom,
            parameters: parameters(outcome.estimate(), outcome.setup.method),
            effects: effects(outcome),
            correction: correction(&outcome.estimate().errors),
            convention: CONVENTION,
            scheme: outcome.setup.scheme.clone(),
            site: SiteReport::of(outcome),
            noise: outcome.setup.noise.with_sizes_of(&outcome.setup.hardware),
            hardware: (&outcome.setup.hardware).into(),
            rate_hz: outcome.setup.rate_hz,
            temperature_c: Some(solution.temperature_c).filter(|temperature| temperature.is_finite()),
            stops: outcome.stops,
            moves: outcome.moves,
            left_out: solution.left_out,
            samples: outcome.counts,
            samples_lost: outcome.losses,
            fit: fit(outcome),
            sweeps: solution.sweeps,
            converged: solution.converged,
            precision: outcome.setup.precision,
            software: SOFTWARE,
            correlation: correlation(outcome),
            enlarged: outcome.enlargement.filter(|_| outcome.setup.adapt),
        }
    }
}

/// The parameters that a method estimates.
pub fn parameters(estimate: &Estimate, method: HostMethod) -> Named<ParameterReport> {
    let values = quantity::values(&estimate.errors);
    let sigmas = quantity::sigmas(&estimate.sigmas);
    let report = |index: usize| {
        let info = &PARAMETER_INFO[index];
        (info.name, ParameterReport { value: values[index], sigma: sigmas[index], unit: info.unit })
    };
    Named((0..PARAMETER_INFO.len()).filter(|index| method.estimates(*index)).map(report).collect())
}

fn effects(outcome: &Outcome) -> Named<ParameterReport> {
    let report = |(info, value, sigma): (&'static ParameterInfo, f64, f64)| {
        (info.name, ParameterReport { value, sigma, unit: info.unit })
    };
    Named(outcome.effects().map(report).collect())
}

fn estimated(outcome: &Outcome) -> impl Iterator<Item = usize> + '_ {
    (0..PARAMETER_INFO.len()).filter(|index| outcome.is_estimated(*index))
}

/// Correction for every sample.
pub fn correction(errors: &InstrumentErrors<f64>) -> CorrectionReport {
    let calibration = Calibration::new(errors);
    CorrectionReport {
        force_matrix_sa: rows(calibration.force_matrix_sa()),
        accel_bias_a: errors.accel_bias_a,
        rate_matrix_sg: rows(calibration.rate_matrix_sg()),
        gyro_bias_g: errors.gyro_bias_g,
        rot_sr: rows(calibration.rot_sr()),
        axis_nonperpendicularity_rad: errors.axis_non_perpendicularity,
    }
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| <[f64; 3]>::from(Vector3::from(matrix.row(row).transpose())))
}

fn correlation(outcome: &Outcome) -> CorrelationReport {
    let covariance = &outcome.covariance;
    let sigma = |index: usize| covariance[(index, index)].sqrt();
    let entry = |row: usize, column: usize| covariance[(row, column)] / (sigma(row) * sigma(column));
    CorrelationReport {
        order: estimated(outcome).map(|index| PARAMETER_INFO[index].name).collect(),
        matrix: estimated(outcome).map(|row| estimated(outcome).map(|column| entry(row, column)).collect()).collect(),
    }
}

fn fit(outcome: &Outcome) -> FitReport {
    let fit = &outcome.solution.fit;
    let LargestInnovation { normalized, segment, channel } = fit.largest;
    FitReport {
        measurements: fit.measurements,
        gated: fit.gated,
        refused: fit.refused,
        largest_innovation: InnovationReport { normalized, segment, channel: CHANNEL_NAMES[usize::from(channel)] },
    }
}

/// Contents of the JSON file of a calibration from an instrument's store.
#[derive(Clone, Debug, Serialize)]
pub struct StoredReport {
    verdict: &'static str,
    reasons: Vec<String>,
    /// Codes of the reasons, in the order of `reasons`.
    reason_codes: Vec<&'static str>,
    method: &'static str,
    scheme: String,
    chi_square: f64,
    degrees_of_freedom: u32,
    utc_s: Option<u64>,
    temperature_c: Option<f32>,
    software_version: String,
    imu: Option<ImuIdentity>,
    convention: &'static str,
    site: SiteReport,
    correction: CorrectionReport,
    parameters: Named<ParameterReport>,
}

impl From<&StoredCalibration> for StoredReport {
    fn from(stored: &StoredCalibration) -> Self {
        Self {
            verdict: if stored.verdict.accepted() { "accepted" } else { "rejected" },
            reasons: stored.reasons().map(|reason| reason.to_string()).collect(),
            reason_codes: stored.reasons().map(|reason| reason.code()).collect(),
            method: HostMethod::from(stored.method).name(),
            scheme: stored.scheme.as_str().into(),
            chi_square: stored.chi_square,
            degrees_of_freedom: stored.degrees_of_freedom,
            utc_s: stored.utc_s,
            temperature_c: Some(stored.temperature_c).filter(|temperature| temperature.is_finite()),
            software_version: stored.software_version.as_str().into(),
            imu: stored.imu,
            convention: CONVENTION,
            site: (&stored.site).into(),
            correction: correction(&stored.errors),
            parameters: parameters(&stored.estimate(), stored.method.into()),
        }
    }
}
