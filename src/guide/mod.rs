//! Guide: from a first calibration to a rejected one. No code.
//!
//! # First calibration
//!
//! `cargo run --release` lets a virtual unit power up and calibrate itself in closed loop: scheme `fast-180`, errors of a
//! laboratory unit, noise of navigation grade. It prints every parameter with sigma, truth and error, then the verdict, and
//! writes a page, `rins-report.html`. Look at three things: the verdict, the column error/sigma (two thirds within 1), and
//! on the page the innovations, which scatter without a pattern if the model holds. `--seed 2` is another unit;
//! `--noise tactical --errors random:tactical` another grade; `--firmware` the same on the ARM image in the emulator.
//!
//! # On your board
//!
//! Fill [`RawSample`](crate::base::sample::RawSample) at the data-ready edge, push it to the queue, and in the main loop call
//! [`SelfCalibration::step`](crate::run::self_calibration::SelfCalibration::step). The README lists the calls, `examples/` has
//! them for a host, for cortex-m-rt and for RTIC. What goes wrong first, and how to see it before it does:
//!
//! 1. Log a minute at rest and a few moves by hand, and run `rins inspect` on it. It says which axes, signs and units the
//!    channels have, when the encoders are read, and what the noise is. Signs and axes belong into your driver.
//! 2. Take the noise that it sees into the configuration. Too small a noise rejects good runs; too large a one hides bad.
//! 3. Stamps are the middle of the interval that rates and forces are means over, and the angles are those at that time.
//! 4. Set the travel and the pace of your axes ([`AxisLimits`](crate::gimbal::axis::AxisLimits)). A scheme that they cannot follow
//!    is refused before anything turns, by leg.
//!
//! # On your log
//!
//! ```text
//! rins inspect log.csv --write-mapping map.toml --write-config unit.toml
//! rins replay log.csv --mapping map.toml --config unit.toml --json cal.json --report page.html
//! rins apply log.csv --mapping map.toml --calibration cal.json --out corrected.csv
//! ```
//! Set latitude and height in `unit.toml`: gravity is the scale of the accelerometers, and Earth rate turns with latitude.
//! No scheme is needed; stops and moves are found from the encoders. Look at what `inspect` says is observable before you
//! look at any result.
//!
//! # Choosing a scheme
//!
//! `rins observability --all` compares those of the library. `fast-180` is the default; from 60 s to 300 s the worst sigma
//! falls from 1 to a third of an arcsec. Where the encoders have harmonics, or an axis must not turn while the other one
//! does, take `bai` with short stops (`--stop 10`). For limited travel, other noise or other wishes,
//! `rins plan --time 120 --limits=-180..180,-90..90 --out mine.toml` finds one, and `rins montecarlo --closed-loop
//! --scheme mine.toml` shows that it keeps what is predicted. Longer stops lower the accelerometers' sigmas, more moves the
//! gyros' and the encoders'.
//!
//! # Reading the verdict
//!
//! | ending | means | stored calibration |
//! |---|---|---|
//! | accepted | every test is passed; the sigmas may be believed | replaced |
//! | rejected | the run came to its end, and something does not fit; the reasons say what | as it was |
//! | aborted | the run did not come to its end; the reason says where and why | as it was |
//! | accepted, not stored | as accepted, but the memory failed: look at the store | as it was |
//!
//! Chi-square near its degrees of freedom: noise and model are right. Much smaller: the configured noise is too large.
//! Larger: something is not modelled. A run is not made good by configuring more noise until it passes: find the segment
//! with the largest innovation first. Reasons come in the order of what to believe first; later ones often follow from it.
//!
//! # What each error state means
//!
//! Equations (1) to (5) are in [`error_model`](crate::model::error_model), the optional ones in [`options`](crate::model::options). A
//! state that no stop or move shows keeps its prior sigma; where it is one of the 28, the heading excepted, the run is
//! rejected as `unobserved`.
//!
//! | state | what it is | what shows it | what it does if it is left in |
//! |---|---|---|---|
//! | `Sgxy` `Sgxz` `Sgyx` `Sgyz` `Sgzx` `Sgzy` | (1): a gyro's axis off the IMU frame's; `Sgxy`: gyro x, turned about y | moves: what a gyro feels of a turn about another axis | 1 arcsec: 1.6 arcsec of attitude in a quarter turn |
//! | `Sayz` `Sazx` `Sazy` | (1): accelerometers y and z off the IMU frame's axes, of which accelerometer x is one | stops with gravity along both axes | 1 arcsec: 4.8 ug where gravity lies along the other axis |
//! | `alpha` `beta` `gamma` | (2): the IMU against the rotation axes, about x, y and z | stops: gravity as the encoders turn it; moves: the axis of a turn | 1 arcsec of attitude that turns with the gimbals |
//! | `accel_bias_x` `accel_bias_y` `accel_bias_z` | (4): an accelerometer's output at no force | stops in opposite attitudes | 1 ug: 0.2 arcsec of tilt |
//! | `accel_scale_x` `accel_scale_y` `accel_scale_z` | (4): its scale factor is off | stops with gravity along it, and the site's gravity | 1 ppm: 1 ug along gravity |
//! | `gyro_bias_x` `gyro_bias_y` `gyro_bias_z` | (5): a gyro's output at no rate | long stops, against Earth rate | 0.01 deg/h: about 0.6 nautical miles in an hour, unless turns average it out |
//! | `gyro_scale_x` `gyro_scale_y` `gyro_scale_z` | (5): its scale factor is off | moves, against the encoders | 1 ppm: 0.3 arcsec in a quarter turn |
//! | `axis_nonperpendicularity` | (3): d, by which the inner axis leans towards the outer one | moves and stops at several outer and inner angles | 1 arcsec of attitude that turns with the inner axis |
//! | `base_roll` `base_pitch` `heading` | attitude of the vehicle at the end of the run; not the instrument's | gravity; Earth rate | nothing: the correction does not use them |
//! | `gyro_bias_ramp_x` `gyro_bias_ramp_y` `gyro_bias_ramp_z` `accel_bias_ramp_x` `accel_bias_ramp_y` `accel_bias_ramp_z` | optional: biases that drift, as at warm-up | attitudes that come again later | taken for biases, or `parameter-ramp` |
//! | `outer_eccentricity_cos` `outer_eccentricity_sin` `inner_eccentricity_cos` `inner_eccentricity_sin` | optional: an encoder's error once a turn | moves through many angles | taken for installation errors, or a bad chi-square |
//! | `outer_second_harmonic_cos` `outer_second_harmonic_sin` `inner_second_harmonic_cos` `inner_second_harmonic_sin` | optional: twice a turn | as the eccentricity | as the eccentricity |
//! | `base_roll_drift` `base_pitch_drift` | optional: the base tilts steadily | stops in one attitude, far apart in time | `parameter-ramp`, or a bad chi-square |
//!
//! # States that a run can end in
//!
//! | state | what it means | what to do |
//! |---|---|---|
//! | `Correcting` | every sample is corrected, by this run's calibration or by the stored one | nothing |
//! | `StandBy` | nothing is stored, and the policy lets no run begin | [`start`](crate::run::self_calibration::SelfCalibration::start), or another policy |
//! | `Parked` | aborted or rejected, the axes stand at (0, 0); a stored calibration still corrects | read the reason, then `start` |
//! | `Stranded` | as `Parked`, but the axes could not be brought back | clear the fault of the axis first: see [`reasons`] |
//!
//! # Reasons and their codes
//!
//! [`reasons`] has a page for every code that the program prints in brackets; `rins explain CODE` shows it.

#[cfg(test)]
mod codes;

#[doc = include_str!("reasons.md")]
pub mod reasons {}

#[cfg(test)]
mod tests {
    use crate::model::error_model::PARAMETER_INFO;
    use crate::model::options::OPTIONAL_INFO;

    const GUIDE: &str = include_str!("mod.rs");

    #[test]
    fn every_state_is_explained() {
        for info in PARAMETER_INFO.iter().chain(&OPTIONAL_INFO) {
            let name = std::format!("`{}`", info.name);
            let rows = GUIDE.lines().filter(|line| line.starts_with("//! | `") && line.contains(&name)).count();
            assert_eq!(rows, 1, "{name}");
        }
    }
}
