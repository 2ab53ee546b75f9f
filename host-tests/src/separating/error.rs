//! Errors of the separating methods.

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
