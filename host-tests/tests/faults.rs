//! A small fault campaign: no wrong result is accepted with any kind of fault, and runs without a fault are rarely
//! rejected.

use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::calibration::{Precision, Setup};
use host_tests::files::unit_file::UnitConfig;
use host_tests::study::fault_campaign::{Campaign, DisturbedRun, Faults, Summary};
use host_tests::study::faults::{Fault, FaultKind, readings};
use host_tests::study::monte_carlo::{ErrorSource, MonteCarlo};
use host_tests::study::statistics::ErrorStatistics;
use host_tests::virtual_unit::presets::{self, RandomErrors};
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{ARCSEC, MICRO_G, PPM};
use rins_selfcal::estimator::constancy::{Change, Suspicion};
use rins_selfcal::model::error_model::{PARAMETERS, block};
use rins_selfcal::scheme::Scheme;

fn run(runs: u64, faults: Faults, precision: Precision) -> Vec<DisturbedRun> {
    Campaign { runs, seed: 2, faults, typical: false, precision }.run(|| ())
}

#[test]
fn no_wrong_answer_is_accepted() {
    let outcomes = run(312, Faults::All, Precision::F64);
    let summary = Summary::new(&outcomes);
    assert_eq!(summary.kinds.len(), FaultKind::ALL.len());
    assert_eq!(summary.total.accepted_wrong, 0, "{summary}");
    // A verdict that rejects every run would pass the test above. Small faults do no harm, so many runs must be
    // accepted.
    assert!(summary.total.accepted > 60, "{summary}");
}

#[test]
fn no_wrong_answer_is_accepted_in_single_precision() {
    let summary = Summary::new(&run(52, Faults::All, Precision::F32));
    assert_eq!(summary.total.accepted_wrong, 0, "{summary}");
}

#[test]
fn clean_runs_are_accepted() {
    // All bounds together reject one clean run in a thousand: more than two of 150 have a probability of 5e-4.
    for (runs, precision) in [(100, Precision::F64), (50, Precision::F32)] {
        let outcomes = run(runs, Faults::None, precision);
        let summary = Summary::new(&outcomes);
        assert!(runs as u32 - summary.total.accepted <= 2, "{summary}");
        assert_eq!(summary.total.accepted_wrong, 0, "{summary}");
    }
}

#[test]
fn near_a_pole_only_the_heading_suffers() {
    let mut unit = UnitConfig::ideal();
    unit.site.latitude_deg = Some(89.9);
    let campaign = MonteCarlo {
        runs: 48,
        methods: vec![Method::Joint.into()],
        precision: Precision::F64,
        scheme: Scheme::named("ideal-60").expect("a scheme of the library"),
        axes: Default::default(),
        refuse_unobserved: true,
        closed_loop: false,
        errors: ErrorSource::Random(RandomErrors::default()),
        unit,
        rate_hz: 100.0,
        seed: 7,
    };
    let [statistics] = &campaign.run(|_| ()).expect("open loop")[..] else { panic!("one method") };
    assert_eq!(statistics.unconverged, 0);
    assert!(statistics.accepted >= 47, "{:?}", statistics.rejections);
    let [twelve @ .., heading] = &statistics.states[..PARAMETERS] else { panic!("as many as there are") };
    let mean = |parameter: &Option<ErrorStatistics>| parameter.as_ref().map_or(f64::NAN, |p| p.mean_normalized_squared);
    // 27 times 48 squares, hardly correlated: one sigma of their mean is 0.04.
    let all = twelve.iter().map(mean).sum::<f64>() / twelve.len() as f64;
    assert!((0.84..1.16).contains(&all), "{all}");
    assert!(heading.as_ref().is_some_and(|heading| heading.bound > 10.0));
}

/// The most significant change in a run with one fault from 124 s on, in a move.
fn suspicion(kind: FaultKind, channel: usize, size: f64, axis_b: [f64; 3]) -> Suspicion {
    let config = UnitConfig::ideal();
    let unit = VirtualUnit { errors: presets::real(3), ..VirtualUnit::default() };
    let run = VirtualRun { unit, scheme: Scheme::bai(10.0, 1), seed: 3 };
    let span = 24_800..70_000;
    let fault = Fault { kind, span, channel, other: 0, size, axis_b, rocking: (0.0, 0.0), rise: 1, seed: 0 };
    let mut chain = Setup::new(&config, 200.0, Method::Joint, Precision::F64).chain();
    for reading in readings(&run, Some(&fault)) {
        // The live estimate does not count.
        let _ = chain.step(&reading);
    }
    chain.conclude().solution.suspicion
}

#[test]
fn changes_are_found_by_kind_place_and_size() {
    let cases = [
        (FaultKind::BiasStep, 1, 60.0 * MICRO_G, Change::Step(block::ACCEL_BIAS as u8 + 1)),
        (FaultKind::Scaled, 3, 100.0 * PPM, Change::Step(block::GYRO_SCALE as u8)),
        (FaultKind::EncoderSlip, 0, 15.0 * ARCSEC, Change::Slip(0)),
        (FaultKind::EncoderScale, 0, 60.0 * PPM, Change::EncoderScale(0)),
    ];
    for (kind, channel, size, change) in cases {
        let found = suspicion(kind, channel, size, [0.0; 3]);
        assert!(found.is_founded(), "{kind:?}: {found:?}");
        assert_eq!(found.change, change, "{found:?}");
        // 124 s is in the eighth move, segment 15. The fault acts on a part of that move only, so the next segment may
        // show it more clearly.
        assert!((13..=17).contains(&found.segment), "{kind:?}: {found:?}");
        let sigma = (found.size / found.sigmas).abs();
        assert!((found.size - size).abs() < 5.0 * sigma + 0.1 * size, "{kind:?}: {found:?}");
    }
}

#[test]
fn a_knock_in_a_move_is_found_by_place_and_size() {
    let found = suspicion(FaultKind::Knock, 0, 20.0 * ARCSEC, [0.0, 1.0, 0.0]);
    assert!(found.is_founded() && (13..=17).contains(&found.segment), "{found:?}");
}
