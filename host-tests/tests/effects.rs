//! With the effects that a unit may have, the sigmas stay correct, and a good run is accepted.
//!
//! The tests compare means of `runs` times 28 squared normalized errors. See [`bounds_of_mean`].

use host_tests::base::quantity;
use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::calibration::{Precision, Setup};
use host_tests::files::hardware::HardwareTable;
use host_tests::files::unit_file::UnitConfig;
use host_tests::study::effects_table::{FURTHER, alone, effects, row};
use host_tests::study::monte_carlo::{ErrorSource, MethodStatistics, MonteCarlo};
use host_tests::study::statistics::{binomial_quantile, chi_square_mean_bounds};
use host_tests::virtual_unit::imperfections::Imperfections;
use host_tests::virtual_unit::presets::{self, UnitErrors};
use host_tests::virtual_unit::unit::{Effects, VirtualUnit};
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{ARCSEC, DEG_H, MICRO_G, STANDARD_GRAVITY_M_S2};
use rins_selfcal::model::effects::{EFFECTS, by_noise_effect, effect};
use rins_selfcal::model::error_model::{INSTALLATION_STATES, PARAMETERS, block};
use rins_selfcal::scheme::Scheme;

const RUNS: usize = 24;

/// Units of a source on a scheme of the library.
fn campaign(errors: ErrorSource, unit: UnitConfig, scheme: &str, runs: u64, seed: u64) -> MethodStatistics {
    let campaign = MonteCarlo {
        runs,
        methods: vec![Method::Joint.into()],
        precision: Precision::F64,
        scheme: Scheme::named(scheme).expect("a scheme of the library"),
        axes: Default::default(),
        refuse_unobserved: true,
        closed_loop: false,
        errors,
        unit,
        rate_hz: 200.0,
        seed,
    };
    campaign.run(|_| ()).expect("open loop").remove(0)
}

/// The unit "real" with these effects, on a scheme of the library.
fn statistics(effects: Effects, hardware: Hardware, scheme: &str, seed: u64) -> MethodStatistics {
    let errors = ErrorSource::Fixed(Box::new(UnitErrors { errors: presets::real(3), effects }));
    let unit = UnitConfig { hardware: HardwareTable(hardware), ..UnitConfig::ideal() };
    campaign(errors, unit, scheme, RUNS as u64, seed)
}

fn mean_normalized_squared(statistics: &MethodStatistics) -> f64 {
    let means = statistics.states[..PARAMETERS].iter().flatten().map(|state| state.mean_normalized_squared);
    means.sum::<f64>() / PARAMETERS as f64
}

/// Sigmas of the 28 parameters, SI, and the number of independent squares that their 28 normalized errors count as. The
/// sum of the squares of one run has the variance 2 sum R_ij^2, where R is the correlation matrix of the estimate. So
/// it scatters as 28^2 / sum R_ij^2 independent squares do (Welch and Satterthwaite).
fn sigmas_and_squares(unit: UnitConfig, scheme: &str) -> ([f64; PARAMETERS], f64) {
    let scheme = Scheme::named(scheme).expect("a scheme of the library");
    let setup = Setup::new(&unit, 200.0, Method::Joint, Precision::F64).on_scheme(&scheme);
    let of_setup = VirtualUnit { errors: presets::real(3), ..VirtualUnit::default() };
    let outcome = VirtualRun { unit: of_setup, scheme, seed: 1 }.calibrate(&[setup]).remove(0);
    let covariance = &outcome.covariance;
    let sigma = |index: usize| covariance[(index, index)].sqrt();
    let correlation = |row: usize, column: usize| covariance[(row, column)] / (sigma(row) * sigma(column));
    let squares = (0..PARAMETERS).flat_map(|row| (0..PARAMETERS).map(move |column| (row, column)));
    let squares: f64 = squares.map(|(row, column)| correlation(row, column).powi(2)).sum();
    (std::array::from_fn(sigma), (PARAMETERS * PARAMETERS) as f64 / squares)
}

/// Bounds of the mean of all squared normalized errors of so many runs. Chance exceeds each of them with a probability
/// of 5e-4.
fn bounds_of_mean(unit: UnitConfig, scheme: &str, runs: u64) -> [f64; 2] {
    let (_, squares) = sigmas_and_squares(unit, scheme);
    chi_square_mean_bounds(runs as usize, squares, 0.999).map(|bound| bound / squares)
}

#[test]
fn servos_that_hunt_before_coarse_encoders_are_no_fault() {
    let [low, high] = bounds_of_mean(UnitConfig::ideal(), "fast-120", RUNS as u64);
    for (encoder_bits, hunting_hz) in [(24, 1.7), (20, 1.7), (22, 6.0)] {
        let hunting =
            Effects { encoder_bits: Some(encoder_bits), hunting_arcsec: 2.0, hunting_hz, ..Effects::default() };
        let found = statistics(hunting, Hardware::IDEAL, "fast-120", 6);
        assert!(found.accepted >= RUNS - 1, "{encoder_bits} bits: {:?}", found.rejections);
        let mean = mean_normalized_squared(&found);
        assert!((low..high).contains(&mean), "{encoder_bits} bits: {mean}, not in {low} to {high}");
    }
}

/// Hardware with harmonics of the encoders of these sizes.
fn eccentric(arcsec: [f64; 4]) -> Hardware {
    Hardware { encoder_harmonics: arcsec.map(|size| (size * ARCSEC) as f32), ..Hardware::IDEAL }
}

#[test]
fn harmonics_of_the_encoders_are_found_while_both_axes_turn() {
    let waves =
        [[[2.0, 3.5], [2.0, -0.3], [0.3, 0.1], [-0.2, 0.3]], [[-1.0, -2.8], [-1.9, 2.3], [0.1, -0.3], [0.3, 0.2]]];
    let imperfections = Imperfections { encoder_harmonics_arcsec: waves, ..Imperfections::default() };
    let effects = Effects { hardware: imperfections, ..Effects::default() };
    let hardware = eccentric([2.5, 2.0, 0.3, 0.3]);
    let found = statistics(effects.clone(), hardware, "fast-180", 5);
    assert!(found.accepted >= RUNS - 1, "{:?}", found.rejections);
    let mean = mean_normalized_squared(&found);
    // The harmonics are the same in all runs, so that their part of the errors does not scatter. Their squares are 0.77
    // of those of their sizes on average, so that this part is no larger than expected. At least the part of the noise
    // is left: its variance is no less than that of an estimate that knows the harmonics (Gauss and Markov).
    let with = |hardware| UnitConfig { hardware: HardwareTable(hardware), ..UnitConfig::ideal() };
    let [low, high] = bounds_of_mean(with(hardware), "fast-180", RUNS as u64);
    let [(known, _), (estimated, _)] = [Hardware::IDEAL, hardware].map(|of| sigmas_and_squares(with(of), "fast-180"));
    let of_noise = known.iter().zip(&estimated).map(|(known, estimated)| (known / estimated).powi(2)).sum::<f64>();
    let of_noise = of_noise / PARAMETERS as f64;
    assert!((of_noise * low..high).contains(&mean), "{mean}, not in {} to {high}", of_noise * low);
    let unknown = statistics(effects, Hardware::IDEAL, "fast-180", 5);
    assert_eq!(unknown.accepted, 0, "several arcsec that the model has not");
}

/// The number of accepted runs that 99 of 100 campaigns exceed if 2 % of all runs are rejected.
fn least_accepted(runs: u64) -> u64 {
    runs - binomial_quantile(runs, 0.02, 0.99)
}

/// Biases that walk and a base that tilts slowly: each parameter's error agrees with its sigma.
#[test]
fn walks_and_drifts_are_in_the_sigmas() {
    let hardware = Hardware {
        accel_walk: (20.0 * MICRO_G / 60.0) as f32,
        gyro_walk: (0.01 * DEG_H / 60.0) as f32,
        base_drift: (20.0 * ARCSEC / 3600.0) as f32,
        ..Hardware::IDEAL
    };
    let mut unit = UnitConfig { hardware: HardwareTable(hardware), ..UnitConfig::ideal() };
    let exactly = Some(0.0);
    (unit.site.latitude_sigma_deg, unit.site.height_sigma_m, unit.site.gravity_sigma_mgal) =
        (exactly, exactly, exactly);
    let found = campaign(ErrorSource::With(Box::new(hardware)), unit, "fast-180", 60, 4);
    assert!(found.accepted as u64 >= least_accepted(60), "{:?}", found.rejections);
    let [low, high] = found.normalized_bounds;
    for (index, state) in found.states.iter().enumerate() {
        let mean = state.map_or(1.0, |state| state.mean_normalized_squared);
        assert!((low..=high).contains(&mean), "state {index}: {mean}, not in {low} to {high}");
    }
}

/// Sizes of all effects at once, on the two schemes of most users: nothing wrong is accepted, and good runs are.
#[test]
fn typical_units_are_accepted_and_right() {
    for (scheme, runs) in [("fast-180", 60), ("fast-60", 60)] {
        let found = campaign(ErrorSource::Typical(1.0), UnitConfig::default().somewhere(), scheme, runs, 11);
        assert!(found.accepted as u64 >= least_accepted(runs), "{scheme}: {:?}", found.rejections);
        // None is wrong but by chance, whose probability is 60 times 9e-5.
        assert_eq!(found.accepted_wrong, 0, "{scheme}: {:?}", found.wrong);
        let mean = mean_normalized_squared(&found);
        let [low, high] = bounds_of_mean(UnitConfig::default().somewhere(), scheme, runs);
        assert!((low..high).contains(&mean), "{scheme}: {mean}, not in {low} to {high}");
    }
}

/// Nobody says where the units are, from the Dead Sea to the high Andes: the sigmas of the accelerometer scales say so,
/// and the twelve are as good as elsewhere.
#[test]
fn units_at_unknown_places_are_accepted_and_honest() {
    let found = campaign(ErrorSource::Typical(1.0), UnitConfig::default(), "fast-60", 40, 3);
    assert!(found.accepted as u64 >= least_accepted(40), "{:?}", found.rejections);
    assert_eq!(found.accepted_wrong, 0, "{:?}", found.wrong);
    let [_, high] = found.normalized_bounds;
    for (index, state) in found.states.iter().enumerate() {
        // Near a pole the heading is not normal.
        if let Some(state) = state.filter(|_| index != block::HEADING) {
            assert!(state.mean_normalized_squared < high, "state {index}: {}", state.mean_normalized_squared);
        }
    }
    let scale = found.states[block::ACCEL_SCALE].expect("estimated");
    // 2000 m are 617 ppm of gravity.
    assert!((scale.bound / 617.0 - 1.0).abs() < 0.1, "{scale:?}");
}

#[test]
fn with_adapt_a_size_that_the_verdict_names_is_enlarged_and_the_result_is_right() {
    let imperfections = Imperfections { backlash_arcsec: [4.0, 0.0], ..Imperfections::default() };
    let effects = Effects { hardware: imperfections, ..Effects::default() };
    let unit = VirtualUnit { errors: presets::real(3), effects, ..VirtualUnit::default() };
    let run = VirtualRun { unit, scheme: Scheme::named("fast-180").expect("a scheme of the library"), seed: 7 };
    let plain = Setup::new(&UnitConfig::default().somewhere(), 200.0, Method::Joint, Precision::F64);
    let [named, adapted] =
        run.calibrate(&[plain.clone(), Setup { adapt: true, ..plain }]).try_into().expect("two setups");
    assert_eq!(named.reason_codes().first(), Some(&"hardware-effect"), "{:?}", named.reasons());
    // One effect is to blame, so the verdict says which, and how much, and not only that all of its size are large.
    assert!(named.reasons()[0].contains("outer_backlash is "), "{:?}", named.reasons());
    assert!(adapted.verdict.accepted(), "{:?}", adapted.reasons());
    for enlargement in [named.enlargement, adapted.enlargement] {
        let found = enlargement.expect("named");
        assert_eq!((found.key, found.unit), ("backlash_arcsec", "arcsec"));
        // The sigma of the backlash is 0.4 arcsec.
        assert!((found.configured - 0.6).abs() < 1e-6 && (found.found - 4.0).abs() < 1.6, "{found:?}");
    }
    let errors = quantity::errors(&adapted.estimate().errors, &run.unit.errors);
    let sigmas = quantity::sigmas(&adapted.estimate().sigmas);
    for (parameter, (error, sigma)) in errors.iter().zip(&sigmas).enumerate().take(INSTALLATION_STATES) {
        assert!(error.abs() < 4.5 * sigma, "{parameter}: {error} +- {sigma}");
    }
}

/// The derivatives by which the verdict tests effects without a state are those of the virtual unit.
#[test]
fn effects_without_a_state_act_as_on_the_virtual_unit() {
    let in_g = [0.3, -0.8, 0.5];
    let force_a = in_g.map(|force| force * STANDARD_GRAVITY_M_S2);
    for tested in 0..EFFECTS {
        let mut unit = Imperfections::default();
        if let Some(place) = tested.checked_sub(effect::G_SENSITIVITY.start) {
            unit.gyro_g_sensitivity_deg_h_g[place / 3][place % 3] = 1.0;
        } else if let Some(place) = tested.checked_sub(effect::ACCEL_CROSS_QUADRATIC.start) {
            unit.accel_cross_quadratic_ug_g2[place / 3][place % 3] = 1.0;
        }
        let [force, omega] = unit.distortion(force_a, [0.0; 3], 0.0);
        let expected = force.iter().map(|force| force / MICRO_G).chain(omega.iter().map(|omega| omega / DEG_H));
        for (channel, expected) in (0..).zip(expected) {
            let found = by_noise_effect(tested, channel, &in_g);
            assert!((found - expected).abs() < 1e-12, "effect {tested}, channel {channel}: {found} for {expected}");
        }
    }
}

/// A small part of the table that `effects-table` prints.
#[test]
fn effects_alone_are_accepted_at_their_typical_size_and_never_wrong() {
    let scheme = Scheme::named("fast-120").expect("a scheme of the library");
    let of = |key: &str| effects().find(|effect| effect.key == key).expect("a size of the hardware");
    for (key, times, named) in [
        ("accel_quadratic_ug_g2", 1.0, false),
        ("encoder_harmonic_1_arcsec", 1.0, false),
        ("encoder_harmonic_1_arcsec", 10.0, true),
        ("backlash_arcsec", 10.0, true),
    ] {
        let found = row(alone(of(key), times), &scheme, 16, 2).expect("open loop");
        assert_eq!(found.wrong, 0, "{key} x {times}: {found:?}");
        if named {
            // Ten times a normal number is below three in a quarter of all units.
            assert!(found.accepted <= binomial_quantile(16, 0.25, 0.99), "{key} x {times}: {found:?}");
            assert_eq!(found.reason.as_ref().map(|(code, _)| code.as_str()), Some("hardware-effect"), "{found:?}");
        } else {
            assert!(found.accepted >= least_accepted(16), "{key} x {times}: {found:?}");
        }
    }
    // The delay of the design's table is harmless, and a bandwidth of 2 Hz is no measurement of Earth rate after a
    // move.
    let further = |name: &str| FURTHER.iter().find(|further| further.name == name).expect("in the table");
    let late = row(further("sensor_delay_ms").alone(5.0), &scheme, 16, 2).expect("open loop");
    assert_eq!((late.accepted, late.wrong), (16, 0), "{late:?}");
    let slow = row(further("sensor_bandwidth_hz").alone(2.0), &scheme, 16, 2).expect("open loop");
    assert_eq!(slow.accepted, 0, "{slow:?}");
}
