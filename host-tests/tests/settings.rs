//! A wrong setting is reported with the right number, and no other fault is taken for a wrong setting.

use host_tests::calibration::virtual_run::VirtualRun;
use host_tests::calibration::{Precision, Setup};
use host_tests::files::unit_file::UnitConfig;
use host_tests::study::faults::{Fault, FaultKind, readings};
use host_tests::virtual_unit::presets;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::{Reason, Verdict, WrongSetting};

/// What is said of a unit at 30.93041 N, 20 m, with one fault or none, by someone who was told this.
fn verdict(told: impl FnOnce(&mut UnitConfig), fault: Option<&Fault>, precision: Precision) -> Verdict {
    let unit = VirtualUnit { errors: presets::real(5), ..VirtualUnit::default() };
    let run = VirtualRun { unit, scheme: Scheme::named("fast-180").expect("a scheme of the library"), seed: 5 };
    let mut config = UnitConfig::ideal();
    told(&mut config);
    let mut chain = Setup::new(&config, 200.0, Method::Joint, precision).on_scheme(&run.scheme).chain();
    for reading in readings(&run, fault) {
        // The live estimate does not count.
        let _ = chain.step(&reading);
    }
    chain.conclude().verdict
}

fn settings(verdict: &Verdict) -> Vec<WrongSetting> {
    let setting = |reason: &Reason| if let Reason::Setting(setting) = reason { Some(*setting) } else { None };
    verdict.reasons.iter().filter_map(setting).collect()
}

#[test]
fn a_wrong_latitude_is_named() {
    for (latitude_deg, precision) in [
        (31.4, Precision::F64),
        (31.4, Precision::F32),
        (30.0, Precision::F64),
        (60.0, Precision::F64),
        (0.0, Precision::F64),
        (-30.93041, Precision::F64),
    ] {
        let verdict = verdict(|config| config.site.latitude_deg = Some(latitude_deg), None, precision);
        let [WrongSetting::Latitude { felt_rad, sigma_rad, configured_rad }] = settings(&verdict)[..] else {
            panic!("{latitude_deg}: {:?}", verdict.reasons)
        };
        // The Earth rate is linear in its components, but what else is wrong by then is not: a thirtieth of the error.
        let bound = 4.5 * sigma_rad + (latitude_deg - 30.93041).abs() * DEG / 30.0;
        assert!((felt_rad / DEG - 30.93041).abs() * DEG < bound, "{latitude_deg}: {}", felt_rad / DEG);
        assert_eq!(configured_rad, latitude_deg * DEG);
        assert!(matches!(verdict.reasons[0], Reason::Setting(_)), "the first to look at");
        // What is no cause is not named beside it.
        assert!(!verdict.reasons.iter().any(|reason| matches!(reason, Reason::Changing(_))), "{:?}", verdict.reasons);
    }
}

#[test]
fn a_wrong_heading_is_named() {
    let truth_deg = presets::real(5).heading / DEG;
    for (off_deg, sigma_deg) in [(5.0, 0.5), (-1.0, 0.05), (1.0, 0.002)] {
        let told = |config: &mut UnitConfig| {
            config.initial.heading_deg = Some(truth_deg - off_deg);
            config.initial.heading_sigma_deg = sigma_deg;
        };
        let verdict = verdict(told, None, Precision::F64);
        let [WrongSetting::Heading { off_rad, sigmas }] = settings(&verdict)[..] else {
            panic!("{off_deg}: {:?}", verdict.reasons)
        };
        let sigma_rad = (off_rad / sigmas).abs();
        assert!((off_rad - off_deg * DEG).abs() < 4.5 * sigma_rad + 0.02 * (off_deg * DEG).abs(), "{}", off_rad / DEG);
    }
    let told = |config: &mut UnitConfig| config.initial.heading_deg = Some(truth_deg - 1.5);
    assert!(verdict(told, None, Precision::F64).accepted(), "1.5 sigma");
}

#[test]
fn a_wrong_gravity_is_named_once() {
    let told = |config: &mut UnitConfig| config.site.gravity_m_s2 = Some(9.73);
    let verdict = verdict(told, None, Precision::F64);
    let [WrongSetting::Gravity { of_configured, .. }] = settings(&verdict)[..] else { panic!("{:?}", verdict.reasons) };
    // The scale errors of the unit, 100 ppm with mixed signs, are their share.
    let gravity = rins_selfcal::base::site::Site::default().gravity_m_s2();
    assert!((of_configured * 9.73 / gravity - 1.0).abs() < 100e-6, "{of_configured}");
    assert_eq!(verdict.reasons.len(), 1, "{:?}", verdict.reasons);
}

#[test]
fn a_base_that_turns_is_no_wrong_latitude() {
    // 30 deg/h and a tenth of it about every axis: more than the Earth, and a latitude off by a fifth of a degree.
    for rate_deg_h in [30.0, 3.0, 0.05] {
        for axis_b in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let size = rate_deg_h * DEG / 3600.0;
            let fault = Fault {
                kind: FaultKind::BaseDrift,
                span: 0..usize::MAX,
                channel: 0,
                other: 1,
                size,
                axis_b,
                rocking: (0.0, 0.0),
                rise: 1,
                seed: 0,
            };
            let verdict = verdict(|_| (), Some(&fault), Precision::F64);
            assert!(settings(&verdict).is_empty(), "{rate_deg_h} {axis_b:?}: {:?}", verdict.reasons);
            assert!(rate_deg_h * 180.0 < 20.0 || !verdict.accepted(), "{} arcsec", size * 180.0 / ARCSEC);
        }
    }
}
