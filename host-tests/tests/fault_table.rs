//! No failure ends with a moving axis, a lost calibration, a hang, or an accepted wrong result.

use host_tests::study::fault_table::{Failing, Phase, fate, good_calibration};
use rins_selfcal::run::state::State;

/// Longest time from the fault to rest, ms. The control stops an axis from 20 deg/s in a third of a second, and the
/// shorted winding in less than a second. Before that, the fault must be noticed: missing samples after 0.1 s; a weak
/// motor, or a bridge that keeps its duty, when the axis leaves its profile, in a quarter turn perhaps as late as in
/// the ramp down.
const STOPPED_MS: u64 = 4000;

#[test]
fn no_fault_ends_with_a_moving_axis_a_lost_calibration_or_a_hang() {
    let before = good_calibration();
    for (failing, name) in Failing::ALL {
        for axis in [0, 1] {
            // For the axis at rest, all phases of the move of the other axis are alike.
            let phases = Phase::ALL.into_iter().filter(|phase| axis == 0 || *phase == Phase::ConstantRate);
            for phase in phases {
                let fate = fate(failing, phase, axis, &before);
                let what = format!("{name}, axis {axis}, {}: {fate:?}", phase.name());
                assert!(fate.at_rest && fate.stored && fate.ended, "{what}");
                let end = [State::Correcting, State::Parked, State::Stranded, State::Stopping, State::Stopped];
                assert!(end.contains(&fate.state), "{what}");
                if failing == Failing::StopCommand {
                    // Braking from 20 deg/s at 60 deg/s^2 takes a third of a second. After that the servo covers the
                    // last arcseconds in small steps, which count as motion above 0.01 deg/s. An accepted result stays
                    // in use.
                    assert!(fate.stopped_ms.is_some_and(|ms| ms < 2000), "{what}");
                    assert!(matches!(fate.state, State::Stopped | State::Correcting), "{what}");
                }
                // Where no fault is noticed, the run continues, and its result must be right.
                match fate.accepted {
                    // Chance exceeds 5 sigma in one of 160 runs with 27 parameters each with a probability of 2e-3.
                    Some(worst) => assert!(worst < 5.0, "{what}"),
                    None => assert!(!fate.told.is_empty(), "{what}"),
                }
                let noticed_at_once = fate.state != State::Correcting && phase != Phase::Parking;
                if noticed_at_once
                    && matches!(phase, Phase::RampUp | Phase::ConstantRate | Phase::RampDown)
                    && axis == 0
                {
                    assert!(fate.stopped_ms.is_some_and(|ms| ms < STOPPED_MS), "{what}");
                }
            }
        }
    }
}
