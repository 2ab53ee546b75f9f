//! With the effects that a unit may have, the sigmas stay correct, and a good run is accepted.
//!
//! The tests compare means of `runs` times 28 squared normalized errors. They are hardly correlated between runs, and
//! little correlated within a run. The bounds are five sigma, sqrt(2 / (7 runs)), of a quarter as many independent
//! squares.

use host_tests::calibration::Precision;
use host_tests::files::unit_file::UnitConfig;
use host_tests::study::monte_carlo::{ErrorSource, MethodStatistics, MonteCarlo};
use host_tests::virtual_unit::encoder::Harmonic;
use host_tests::virtual_unit::presets::{self, UnitErrors};
use host_tests::virtual_unit::unit::Effects;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::PARAMETERS;
use rins_selfcal::model::options::Options;
use rins_selfcal::scheme::Scheme;

const RUNS: usize = 24;

/// The unit "real" with these effects, on a scheme of the library.
fn statistics(effects: Effects, options: Options, scheme: &str) -> MethodStatistics {
    let errors = UnitErrors { errors: presets::real(3), effects };
    let campaign = MonteCarlo {
        runs: RUNS as u64,
        methods: vec![Method::Joint],
        precision: Precision::F64,
        options,
        scheme: Scheme::named(scheme).expect("a scheme of the library"),
        axes: Default::default(),
        refuse_unobserved: true,
        closed_loop: false,
        errors: ErrorSource::Fixed(Box::new(errors)),
        unit: UnitConfig::default(),
        rate_hz: 200.0,
        seed: 5,
    };
    campaign.run(|_| ()).expect("open loop").remove(0)
}

fn mean_normalized_squared(statistics: &MethodStatistics) -> f64 {
    let means = statistics.states[..PARAMETERS].iter().flatten().map(|state| state.mean_normalized_squared);
    means.sum::<f64>() / PARAMETERS as f64
}

fn bound() -> f64 {
    5.0 * (2.0 / (7.0 * RUNS as f64)).sqrt()
}

#[test]
fn servos_that_hunt_before_coarse_encoders_are_no_fault() {
    for (encoder_bits, hunting_hz) in [(24, 1.7), (20, 1.7), (22, 6.0)] {
        let hunting =
            Effects { encoder_bits: Some(encoder_bits), hunting_arcsec: 2.0, hunting_hz, ..Effects::default() };
        let found = statistics(hunting, Options::NONE, "fast-120");
        assert!(found.accepted >= RUNS - 1, "{encoder_bits} bits: {:?}", found.rejections);
        let mean = mean_normalized_squared(&found);
        // Sigmas may be a little too large: single readings that begin one segment end another.
        assert!(mean < 1.0 + bound() && mean > 0.7 - bound(), "{encoder_bits} bits: {mean}");
    }
}

#[test]
fn harmonics_of_the_encoders_are_found_while_both_axes_turn() {
    let harmonic = |amplitude_arcsec, phase_deg| Harmonic { amplitude_arcsec, phase_deg };
    let eccentric = Effects {
        encoder_eccentricity: [harmonic(4.0, 30.0), harmonic(3.0, 200.0)],
        encoder_second_harmonic: [harmonic(2.0, 80.0), harmonic(3.0, -40.0)],
        ..Effects::default()
    };
    let known = Options { encoder_eccentricity: true, encoder_second_harmonic: true, ..Options::NONE };
    let found = statistics(eccentric.clone(), known, "fast-180");
    assert!(found.accepted >= RUNS - 1, "{:?}", found.rejections);
    let mean = mean_normalized_squared(&found);
    assert!((mean - 1.0).abs() < bound(), "{mean}");
    let unknown = statistics(eccentric, Options::NONE, "fast-180");
    assert_eq!(unknown.accepted, 0, "several arcsec that the model has not");
}
