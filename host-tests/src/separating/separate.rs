//! The twelve installation errors by two methods, one after the other.

use super::error::SeparatingError;
use super::navigation::{Navigated, SensorNoise, navigate};
use super::run::GimballedRun;
use super::singular_values::mounting_by_singular_values;
use super::thin_shell::mounting_by_thin_shell;
use crate::base::quantity;
use clap::ValueEnum;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors};

/// The separating methods by name. Reference 11 estimates nine angles in both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SeparatingMethod {
    /// What the paper's Table 3 is compared with: reference 11 for nine angles, 13 for the mounting angles from the moves
    #[value(name = "separating")]
    ThinShell,
    /// Reference 11 for nine angles, 14 for the mounting angles from the forces at the stops
    #[value(name = "svd")]
    SingularValues,
}

impl SeparatingMethod {
    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThinShell => "separating",
            Self::SingularValues => "svd",
        }
    }
}

/// Result of the separating methods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separated {
    /// The twelve installation errors; also scale factors and biases, which \[11\] needs. Non-perpendicularity and
    /// attitude of the base are zero: the methods know neither.
    pub errors: InstrumentErrors<f64>,
    /// Sigmas of the installation errors, rad. The methods for the mounting angles have none.
    pub sigmas: [Option<f64>; INSTALLATION_STATES],
}

impl Separated {
    /// Estimates and sigmas of the installation errors, arcsec.
    pub fn installation_arcsec(&self) -> [(f64, Option<f64>); INSTALLATION_STATES] {
        let values = quantity::values(&self.errors);
        std::array::from_fn(|index| (values[index], self.sigmas[index].map(|sigma| sigma / ARCSEC)))
    }
}

/// Estimates the twelve installation errors of a run.
///
/// # Errors
/// The methods give no result; the error has the reason.
pub fn separate(
    run: &GimballedRun,
    site: &Site,
    noise: &SensorNoise,
    method: SeparatingMethod,
) -> Result<Separated, SeparatingError> {
    with_mounting(run, site, &navigate(run, site, noise)?, method)
}

/// Adds the mounting angles to the nine angles that \[11\] has found on the same run.
///
/// # Errors
/// The method does not find the mounting angles; the error has the reason.
pub fn with_mounting(
    run: &GimballedRun,
    site: &Site,
    navigated: &Navigated,
    method: SeparatingMethod,
) -> Result<Separated, SeparatingError> {
    let mounting = match method {
        SeparatingMethod::ThinShell => mounting_by_thin_shell(run, &navigated.correction, site),
        SeparatingMethod::SingularValues => mounting_by_singular_values(run, &navigated.correction)?,
    };
    let mut sigmas = [None; INSTALLATION_STATES];
    sigmas.iter_mut().zip(navigated.sigmas).for_each(|(sigma, found)| *sigma = Some(found));
    Ok(Separated { errors: InstrumentErrors { mounting, ..navigated.errors() }, sigmas })
}
