//! The separating methods that the paper compares itself with. Each one estimates a part of the twelve installation
//! errors, from the same readings as the core's methods.
//!
//! ```text
//! readings -> run: intervals, turning or at rest
//!              |-> navigation [11]: extended Kalman filter ----> nine non-orthogonality angles, corrected IMU
//!              |-> thin_shell [13]: corrected gyros -----------> three mounting angles
//!              '-> singular_values [14]: corrected forces -----> three mounting angles
//! ```
//! \[11\] and \[13\] together give the reference of the paper's Table 3. The numbers in brackets are those of the paper's
//! list of references (Bai et al., Sensors 2019, 19(18), 4005). The paper states only the principle of each method in
//! its introduction. The details that it leaves open are choices of this project; each file states its own.

mod error;
mod imu_correction;
mod navigation;
mod run;
mod separate;
mod singular_values;
mod thin_shell;

pub use error::SeparatingError;
pub use imu_correction::ImuCorrection;
pub use navigation::{Navigated, PASSES, SensorNoise, navigate};
pub use run::{GimballedRun, Interval, RunBuilder};
pub use separate::{Separated, SeparatingMethod, separate, with_mounting};
pub use singular_values::mounting_by_singular_values;
pub use thin_shell::mounting_by_thin_shell;
