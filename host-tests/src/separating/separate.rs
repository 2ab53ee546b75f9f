//! The twelve installation errors by two methods, one after the other.

use super::navigation::{SensorNoise, navigate};
use super::run::GimballedRun;
use super::singular_values::mounting_by_singular_values;
use super::thin_shell::mounting_by_thin_shell;
use rins_selfcal::base::site::Site;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors};

/// Reasons why the separating methods give no result.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SeparatingError {
    /// There is no move between two stops.
    #[error("{stops} stops; the separating methods need at least two, and moves between them")]
    Stops {
        /// Number of stops.
        stops: usize,
    },
    /// Samples are missing, so the navigation loses the attitude.
    #[error("no sample for {duration_s:.3} s after {time_s:.3} s; the separating methods need every sample")]
    Gap {
        /// Time of the last sample before the gap, s.
        time_s: f64,
        /// Duration of the gap, s.
        duration_s: f64,
    },
    /// The Earth rate shows no heading near a pole.
    #[error("within 5 deg of a pole there is no heading; the separating methods need one")]
    Heading,
    /// The motion does not show all angles.
    #[error("the motion does not show all twelve installation errors")]
    Unobserved,
    /// The passes of the Kalman filter do not converge.
    #[error("the Kalman filter has not converged: the last pass still changes an angle by {sigmas:.2} sigma")]
    NotConverged {
        /// Largest step of the last pass, in sigmas.
        sigmas: f64,
    },
}

/// The method that estimates the mounting angles, after [11] has estimated the nine other angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountingMethod {
    /// [13], from the gyros while the axes turn. With [11] it is the reference of the paper's Table 3.
    ThinShell,
    /// [14], from the accelerometers at the stops.
    SingularValues,
}

/// Result of the separating methods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separated {
    /// The twelve installation errors; also scale factors and biases, which [11] needs. Non-perpendicularity and
    /// attitude of the base are zero: the methods know neither.
    pub errors: InstrumentErrors<f64>,
    /// Sigmas of the installation errors, rad. The methods for the mounting angles have none.
    pub sigmas: [Option<f64>; INSTALLATION_STATES],
}

/// Estimates the twelve installation errors of a run.
///
/// # Errors
/// The methods give no result; the error has the reason.
pub fn separate(
    run: &GimballedRun,
    site: &Site,
    noise: &SensorNoise,
    method: MountingMethod,
) -> Result<Separated, SeparatingError> {
    let navigated = navigate(run, site, noise)?;
    let mounting = match method {
        MountingMethod::ThinShell => mounting_by_thin_shell(run, &navigated.correction, site),
        MountingMethod::SingularValues => mounting_by_singular_values(run, &navigated.correction)?,
    };
    let mut sigmas = [None; INSTALLATION_STATES];
    sigmas.iter_mut().zip(navigated.sigmas).for_each(|(sigma, found)| *sigma = Some(found));
    Ok(Separated { errors: InstrumentErrors { mounting, ..navigated.errors() }, sigmas })
}
