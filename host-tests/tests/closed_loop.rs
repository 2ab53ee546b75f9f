//! The core calibrates the virtual RINS in closed loop: its own rate commands turn the gimbals.

use host_tests::calibration::raw_sample;
use host_tests::drive::move_durations_s;
use host_tests::plant::Plant;
use host_tests::presets;
use host_tests::unit::Noise;
use host_tests::virtual_rins::{VirtualRins, VirtualUnit};
use rins_selfcal::calibrator::{Calibrator, CalibratorConfig};
use rins_selfcal::error_model::{PARAMETER_INFO, PARAMETERS};
use rins_selfcal::method::Method;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::self_calibration::{SelfCalibration, SelfCalibrationConfig};
use rins_selfcal::sequencer::State;
use rins_selfcal::telemetry::Message;

fn config(unit: &VirtualUnit, scheme: Scheme) -> SelfCalibrationConfig {
    SelfCalibrationConfig::new(CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz), scheme)
}

#[test]
fn power_up_ends_correcting_with_the_truth() {
    let unit = VirtualUnit { errors: presets::real(1), noise: Noise::navigation(), ..VirtualUnit::default() };
    let scheme = Scheme::bai(10.0, 1);
    let mut rins = VirtualRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&scheme, unit.rate_hz));
    let mut calibrator = Calibrator::<f64>::UNCONFIGURED;
    let mut run = SelfCalibration::new(config(&unit, scheme), None, &mut calibrator).expect("a good configuration");
    let mut messages = Vec::new();
    let mut seconds_left = 600.0;
    while run.state() != State::Correcting && seconds_left > 0.0 {
        let reading = rins.next_reading().expect("it never ends");
        let step = run.step(&raw_sample(&reading), &mut |message: &Message| messages.push(message.clone()));
        if step.save {
            run.saved();
        }
        rins.command_rates(step.rates_rad_s);
        seconds_left -= 1.0 / unit.rate_hz;
    }
    assert_eq!(run.state(), State::Correcting);
    let record = run.record().expect("a solution");
    let difference = record.errors.to_vector() - unit.errors.to_vector();
    for (index, (difference, sigma)) in difference.iter().zip(&record.sigmas).enumerate() {
        let turn = std::f64::consts::TAU;
        let error = if index == PARAMETERS - 1 { difference - (difference / turn).round() * turn } else { *difference };
        // One of 28 beyond 4.5 sigma by chance: 2e-4.
        assert!(error.abs() < 4.5 * sigma, "{}: {:.1} sigma", PARAMETER_INFO[index].name, error / sigma);
    }
    let segments = messages.iter().filter(|message| matches!(message, Message::Segment(_))).count();
    assert_eq!(segments, 37);
    assert!(messages.iter().any(|message| matches!(message, Message::Judged(verdict) if verdict.accepted())));
}
