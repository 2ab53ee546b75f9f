//! `rins inspect` attributes what a log shows to the row where it belongs: a unit with one effect gets that row and no
//! other, and a calibration by the written description is accepted and right, or rejected by the name of the effect.
//!
//! *Right* is what the campaigns call so: each of the twelve and the non-perpendicularity within 4.5 sigma or 1 arcsec.
//! Chance exceeds it in 9 of 100 000 runs.

use host_tests::base::quantity;
use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::calibration::{Outcome, Precision, Setup};
use host_tests::files::unit_file::{Noise, SiteTable, UnitConfig};
use host_tests::inspect::{Inspection, Request};
use host_tests::log::{Layout, LogWriter};
use host_tests::virtual_unit::imperfections::Imperfections;
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::{Effects, VirtualUnit};
use rins_selfcal::base::hardware::Hardware;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, block};
use rins_selfcal::scheme::Scheme;
use std::fs;
use std::path::Path;

const RATE_HZ: f64 = 200.0;

/// A unit with these effects on a scheme.
fn run_of(effects: Effects, noise: Noise, scheme: Scheme, rate_hz: f64) -> VirtualRun {
    let unit = VirtualUnit { errors: presets::real(3), effects, noise, rate_hz, ..VirtualUnit::default() };
    VirtualRun { unit, scheme, seed: 7 }
}

fn on_fast_120(effects: Effects) -> VirtualRun {
    run_of(effects, Noise::navigation(), Scheme::named("fast-120").expect("a scheme of the library"), RATE_HZ)
}

/// What `inspect` finds in the log of a run, and the outcome of a calibration by the unit description that it writes.
fn inspected(name: &str, run: &VirtualRun) -> (Inspection, Outcome) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("inspect_rows");
    fs::create_dir_all(&folder).unwrap();
    let log = folder.join(format!("{name}.parquet"));
    let mut writer = LogWriter::create(&log, false).unwrap();
    run.drive().for_each(|reading| writer.write(&reading).unwrap());
    writer.finish().unwrap();
    let unit = UnitConfig { site: SiteTable::laboratory(), ..UnitConfig::default() };
    let request = Request { log: &log, layout: Some(Layout::standard(&log)), unit };
    let found = request.run(|_, _| ()).unwrap();
    let described = UnitConfig { noise: found.noise, hardware: found.hardware, ..unit };
    let written = toml::from_str(&toml::to_string(&described).unwrap()).unwrap();
    let setup = Setup::new(&written, run.unit.rate_hz, Method::Joint, Precision::F64);
    let outcome = run.calibrate(&[setup]).remove(0);
    (found, outcome)
}

/// The number that the log shows for a row.
fn seen(found: &Inspection, key: &str) -> Option<f64> {
    found.rows.iter().find(|row| row.key == key).expect("a row").seen
}

/// The number that the log shows for a row, minus the true one, in its sigmas.
fn off(found: &Inspection, key: &str, truth: f64) -> f64 {
    let row = found.rows.iter().find(|row| row.key == key).expect("a row");
    (row.seen.expect("seen") - truth) / row.sigma.expect("its sigma")
}

/// The keys of the rows that the log shows.
fn keys(found: &Inspection) -> Vec<&'static str> {
    found.rows.iter().filter(|row| row.seen.is_some()).map(|row| row.key).collect()
}

fn is_right(outcome: &Outcome, run: &VirtualRun) -> bool {
    let errors = quantity::errors(&outcome.estimate().errors, &run.unit.errors);
    let sigmas = quantity::sigmas(&outcome.estimate().sigmas);
    let judged = (0..INSTALLATION_STATES).chain([block::NON_PERPENDICULARITY]);
    judged.into_iter().all(|parameter| errors[parameter].abs() < (4.5 * sigmas[parameter]).max(1.0))
}

fn assert_accepted_and_right(name: &str, outcome: &Outcome, run: &VirtualRun) {
    assert!(outcome.verdict.accepted(), "{name}: {:?}", outcome.reasons());
    assert!(is_right(outcome, run), "{name}: {:?}", quantity::errors(&outcome.estimate().errors, &run.unit.errors));
}

const WHITE: [&str; 2] = ["accel_vrw_ug_sqrt_hz", "gyro_arw_deg_sqrt_h"];

fn near(value: Option<f64>, expected: f64, part: f64) -> bool {
    value.is_some_and(|value| (value / expected - 1.0).abs() < part)
}

#[test]
fn hunting_is_no_noise_of_the_sensors() {
    for (arcsec, hz) in [(0.3, 3.0), (3.0, 3.0), (8.0, 3.0), (8.0, 0.4), (2.0, 7.3)] {
        let name = format!("hunting_{arcsec}_{hz}");
        let lever_arm_m = [0.05, -0.05, 0.03];
        let run = on_fast_120(Effects { hunting_arcsec: arcsec, hunting_hz: hz, lever_arm_m, ..Effects::default() });
        let (found, outcome) = inspected(&name, &run);
        // 75 s at the stops and three channels have 4000 degrees of freedom at 0.08 s: 1.1 %. Five sigma. The hunting of
        // the encoders and the lever arm are removed but for their noise, so that five sigma hold here too.
        assert_eq!(keys(&found), WHITE, "{name}");
        assert!(near(seen(&found, WHITE[0]), 10.0, 0.06) && near(seen(&found, WHITE[1]), 0.001, 0.06), "{name}");
        assert!(
            off(&found, WHITE[0], 10.0).abs() < 5.0 && off(&found, WHITE[1], 0.001).abs() < 5.0,
            "{name}: {:?}",
            found.rows
        );
        // Both axes hunt in quadrature. The octave nearest to half of the slowest period shows half of it.
        let hunting_arcsec = found.stops.hunting_rad / ARCSEC;
        assert!((0.45..1.05).contains(&(hunting_arcsec / arcsec)), "{name}: {hunting_arcsec}");
        assert_accepted_and_right(&name, &outcome, &run);
    }
}

#[test]
fn errors_of_coarse_encoders_are_no_pulses_of_the_gyros() {
    let effects = Effects { hunting_arcsec: 3.0, hunting_hz: 3.0, encoder_bits: Some(20), ..Effects::default() };
    let run = on_fast_120(effects);
    let (found, outcome) = inspected("coarse", &run);
    assert_eq!(seen(&found, "gyro_pulse_arcsec"), None);
    assert_eq!(seen(&found, "base_rocking_arcsec"), None);
    assert_accepted_and_right("coarse", &outcome, &run);
}

#[test]
fn pulses_and_rocking_have_their_own_rows() {
    let gyros = |arcsec: f64| Imperfections { gyro_pulse_arcsec: arcsec, ..Imperfections::default() };
    let accels = Imperfections { accel_pulse_mm_s: 0.1, ..Imperfections::default() };
    let rocking = Imperfections { base_rocking_arcsec: 0.6, ..Imperfections::default() };
    // An increment is exact. The rocking is the sum of 24 waves of given amplitudes, and 75 s show its slowest waves a
    // few times.
    for (name, hardware, key, size, part) in [
        ("pulses_0.1", gyros(0.1), "gyro_pulse_arcsec", 0.1, 0.01),
        ("pulses_0.5", gyros(0.5), "gyro_pulse_arcsec", 0.5, 0.01),
        ("pulses_accel", accels, "accel_pulse_mm_s", 0.1, 0.01),
        ("rocking", rocking, "base_rocking_arcsec", 0.6, 0.15),
    ] {
        let run = on_fast_120(Effects { hardware, ..Effects::default() });
        let (found, outcome) = inspected(name, &run);
        assert!(near(seen(&found, key), size, part), "{name}: {:?}", found.rows);
        let others: Vec<_> = keys(&found).into_iter().filter(|seen| *seen != key && !WHITE.contains(seen)).collect();
        assert!(others.is_empty(), "{name}: {others:?}");
        // The white noise that remains beside a larger noise of the angle is known to some tenths, and never the sum.
        assert!(found.noise.gyro_arw_deg_sqrt_h < 0.0016, "{name}: {:?}", found.rows);
        assert_accepted_and_right(name, &outcome, &run);
    }
}

#[test]
fn floor_and_walk_have_each_their_own_number() {
    let floor = Imperfections { accel_floor_ug: 8.0, ..Imperfections::default() };
    let floor = Effects { hardware: floor, ..Effects::default() };
    let walk = Effects { accel_bias_walk_ug_sqrt_h: 100.0, gyro_bias_walk_deg_h_sqrt_h: 0.3, ..Effects::default() };
    let long = |effects: Effects| run_of(effects, Noise::navigation(), Scheme::bai(100.0, 1), 50.0);
    let (found, _) = inspected("floor", &long(floor));
    // From 5 s on the floor is larger than the white noise. Three channels and 1900 s have 1000 degrees of freedom
    // there: 2 %. The flicker of the virtual unit is a sum of octaves, whose floor differs by some percent.
    assert!(near(seen(&found, "accel_floor_ug"), 8.0, 0.15), "{:?}", found.rows);
    assert_eq!(seen(&found, "accel_walk_ug_sqrt_h"), None);
    // The octaves of the flicker differ from 1/f by some percent beside a sigma of 4 %.
    assert!(off(&found, "accel_floor_ug", 8.0).abs() < 5.0, "{:?}", found.rows);
    let (found, _) = inspected("walk", &long(walk));
    assert!(off(&found, "accel_walk_ug_sqrt_h", 100.0).abs() < 4.0, "{:?}", found.rows);
    assert!(off(&found, "gyro_walk_deg_h_sqrt_h", 0.3).abs() < 4.0, "{:?}", found.rows);
    // The walks are larger than the white noise from 10 s on, where there are 500 degrees of freedom: 3 %. Four sigma.
    assert!(near(seen(&found, "accel_walk_ug_sqrt_h"), 100.0, 0.13), "{:?}", found.rows);
    assert!(near(seen(&found, "gyro_walk_deg_h_sqrt_h"), 0.3, 0.13), "{:?}", found.rows);
    assert_eq!((seen(&found, "accel_floor_ug"), seen(&found, "gyro_floor_deg_h")), (None, None));
}

#[test]
fn residuals_with_a_name_are_no_noise_of_the_encoders() {
    let scheme = Scheme::named("ideal-180").expect("a scheme of the library");
    let waves = [[[3.0, 4.0], [2.0, 0.0], [0.0; 2], [0.0; 2]], [[-3.0, 3.0], [0.0, 2.0], [0.0; 2], [0.0; 2]]];
    let hardware = Imperfections { encoder_harmonics_arcsec: waves, ..Imperfections::default() };
    let run = run_of(Effects { hardware, ..Effects::default() }, Noise::navigation(), scheme, RATE_HZ);
    let (found, outcome) = inspected("harmonics", &run);
    let residuals = found.residuals.as_ref().expect("moves");
    assert_eq!(seen(&found, "encoder_repeatability_arcsec"), None);
    assert!(residuals.named[0].starts_with("[hardware-effect] "), "{:?}", residuals.named);
    assert!(found.remarks.iter().any(|remark| remark.contains("replay --adapt")), "{:?}", found.remarks);
    assert_eq!(outcome.reason_codes().first(), Some(&"hardware-effect"), "{:?}", outcome.reasons());
}

/// Errors of the encoders that differ from stop to stop have no name, but so few of them may look like an effect. At
/// stops at multiples of 45 deg, which this scheme has not, the first four harmonics would explain them all.
#[test]
fn residuals_without_a_name_are_noise_of_the_encoders() {
    let noise = Noise { encoder_repeatability_arcsec: 5.0, ..Noise::navigation() };
    let scheme = Scheme::named("ideal-180").expect("a scheme of the library");
    let mut enlarged = 0;
    for seed in 1..=6 {
        // A unit with the hardware that is described: one that is better has a smaller chi-square, which `inspect` takes
        // for better encoders.
        let effects = Effects { hardware: Imperfections::draw(&Hardware::NAVIGATION, 1.0, seed), ..Effects::default() };
        let run = VirtualRun { seed, ..run_of(effects, noise, scheme.clone(), RATE_HZ) };
        let (found, outcome) = inspected(&format!("encoders_{seed}"), &run);
        let named = &found.residuals.as_ref().expect("moves").named;
        assert!(!named.iter().any(|reason| reason.contains("accel_floor_ug")), "no flicker: {named:?}");
        let Some(arcsec) = seen(&found, "encoder_repeatability_arcsec") else {
            assert!(!outcome.verdict.accepted(), "{seed}: the residuals are too large for what is configured");
            continue;
        };
        enlarged += 1;
        let encoders = found.residuals.as_ref().and_then(|residuals| residuals.encoders).expect("an encoder error");
        let [low, high] = encoders.range_arcsec;
        // The range is one sigma on either side in the logarithm of the error; four are allowed.
        let sigma = if arcsec < 5.0 { (high / arcsec).ln() } else { (arcsec / low).ln() };
        assert!(((5.0 / arcsec).ln() / sigma).abs() < 4.0, "{seed}: {encoders:?}");
        assert_accepted_and_right("encoders", &outcome, &run);
    }
    // Two of three logs show it: fewer than two of six have a probability of 2 %.
    assert!(enlarged >= 2, "{enlarged}");
}

/// Every effect of a unit at once, at its typical size.
#[test]
fn a_typical_unit_is_accepted_and_right_by_its_own_rows() {
    let hardware = Imperfections::draw(&rins_selfcal::base::hardware::Hardware::NAVIGATION, 1.0, 5);
    let run = on_fast_120(Effects { hardware, ..Effects::default() });
    let (found, outcome) = inspected("typical", &run);
    assert_eq!(seen(&found, "encoder_repeatability_arcsec"), None, "{:?}", found.rows);
    assert_accepted_and_right("typical", &outcome, &run);
}
