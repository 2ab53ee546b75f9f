//! Tests of the control on simulated motors: which turn an axis stands on, lost encoders, and settings at their bounds.

use super::axis::AxisLimits;
use super::both_axes::MotionCommand;
use super::fault::{EncoderFault, FaultKind, TurnFault};
use super::plant::Plant;
use super::servo::{Drive, MotorAndLoad};
use super::travel::{LocateError, LocateRefusal, Travel, TurnSource, TurnState};
use crate::base::angle::Angle;
use crate::base::units::{ARCSEC, DEG};

fn around(lowest_deg: f64, highest_deg: f64, turn: TurnSource) -> AxisLimits {
    AxisLimits { travel: Travel::around(lowest_deg * DEG, highest_deg * DEG, turn), ..AxisLimits::default() }
}

/// Travel with cables, of more than a turn, with a stored angle.
fn stored() -> [AxisLimits; 2] {
    [around(-360.0, 0.0, TurnSource::Stored), around(-270.0, 0.0, TurnSource::Stored)]
}

fn unique() -> [AxisLimits; 2] {
    [around(-180.0, 90.0, TurnSource::Unique), around(-270.0, 0.0, TurnSource::Unique)]
}

/// A plant after power-up at these true angles, held.
fn held(limits: [AxisLimits; 2], at_deg: [f64; 2]) -> Plant<f64> {
    let mut plant = Plant::usual(limits, at_deg);
    plant.run(100);
    plant.hold();
    plant
}

fn located(limits: [AxisLimits; 2], at_deg: [f64; 2]) -> Plant<f64> {
    let mut plant = held(limits, at_deg);
    let mark = at_deg.map(|at| Some(at * DEG));
    assert_eq!(plant.gimbal.locate(mark, 60.0 * ARCSEC), Ok(()));
    plant
}

fn turn_fault(plant: &Plant<f64>) -> Option<(u8, FaultKind)> {
    plant.gimbal.status().fault.map(|fault| (fault.axis, fault.kind))
}

#[test]
fn an_axis_parked_near_the_end_of_its_travel_does_not_mistake_its_turn() {
    for arcsec in [-300.0, -1.0, 0.0, 0.02, 1.0, 300.0] {
        let at_deg = [arcsec / 3600.0; 2];
        for mut plant in [located(stored(), at_deg), held(unique(), at_deg)] {
            plant.watch();
            plant.move_to(0.0, 0.0);
            assert!(plant.is_at(0.0, 0.0), "{arcsec}: {:?} {:?}", plant.at_deg(), plant.gimbal.status());
            assert!(plant.range_rad[0] > -0.2 * DEG && plant.range_rad[1] < 0.2 * DEG, "{arcsec}: it moves only there");
        }
    }
}

#[test]
fn an_axis_that_has_parked_itself_finds_its_turn_after_every_power_up() {
    for start in 0..60 {
        let start_deg = [-3.0 - f64::from(start) * 1.37, -5.0 - f64::from(start) * 0.77];
        let mut first = located(stored(), start_deg);
        first.move_to(0.0, 0.0);
        assert!(first.is_at(0.0, 0.0));
        let (mark, parked) = (first.gimbal.angles_rad(), first.at_deg());
        let mut second = held(stored(), parked);
        assert_eq!(second.gimbal.locate(mark, 60.0 * ARCSEC), Ok(()));
        second.move_to(0.0, 0.0);
        assert!(second.is_at(0.0, 0.0), "{start}: {:?}", second.at_deg());
    }
}

#[test]
fn cables_are_not_wound_up_from_power_up_to_power_up() {
    let limits = [around(-720.0, 720.0, TurnSource::Stored); 2];
    let mut plant = located(limits, [0.0; 2]);
    for cycle in 0..5 {
        for (outer, inner) in [(-84.7, 0.0), (-170.2, -191.2), (-288.3, -135.1)] {
            plant.move_to(outer, inner);
            assert!(plant.is_at(outer, inner), "{cycle}: {:?}", plant.at_deg());
        }
        let mark = plant.gimbal.angles_rad();
        plant = held(limits, plant.at_deg());
        assert_eq!(plant.gimbal.status().turns, [TurnState::Unknown; 2]);
        assert_eq!(plant.gimbal.locate(mark, 60.0 * ARCSEC), Ok(()));
    }
}

#[test]
fn an_axis_whose_turn_is_unknown_does_not_move() {
    let mut plant = held(stored(), [-10.0, -20.0]);
    assert_eq!(plant.gimbal.angles_rad(), [None; 2]);
    plant.watch();
    plant.move_to(0.0, 0.0);
    assert_eq!(turn_fault(&plant), Some((0, FaultKind::Turn(TurnFault::Unknown))));
    assert!(plant.is_held_at([-10.0, -20.0]));
    // Only the inner axis is left.
    assert_eq!(plant.gimbal.locate([Some(-10.0 * DEG), None], 60.0 * ARCSEC), Ok(()));
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known, TurnState::Unknown]);
    plant.move_to(0.0, 0.0);
    assert_eq!(turn_fault(&plant), Some((1, FaultKind::Turn(TurnFault::Unknown))));
    plant.hold();
    assert!(plant.gimbal.status().fault.is_none() && plant.is_held_at([-10.0, -20.0]));
    assert_eq!(plant.gimbal.locate([None, Some(-20.0 * DEG)], 60.0 * ARCSEC), Ok(()));
    plant.move_to(0.0, 0.0);
    assert!(plant.is_at(0.0, 0.0));
}

#[test]
fn an_angle_that_does_not_fit_is_refused_and_changes_nothing() {
    let mut plant = held(stored(), [-10.0, -20.0]);
    let tolerance_rad = 60.0 * ARCSEC;
    let refused = |axis, refusal| Err(LocateError { axis, refusal });
    let locate = |plant: &mut Plant<f64>, outer: Option<f64>, inner: Option<f64>| {
        plant.gimbal.locate([outer, inner].map(|deg| deg.map(|deg| deg * DEG)), tolerance_rad)
    };
    let off = |result: Result<(), LocateError>| match result {
        Err(LocateError { axis, refusal: LocateRefusal::Disagrees(off) }) => {
            (axis, (f64::from(off) / DEG * 1e3).round() / 1e3)
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(off(locate(&mut plant, Some(-12.0), None)), (0, 2.0));
    assert_eq!(off(locate(&mut plant, None, Some(-19.0))), (1, -1.0));
    assert_eq!(locate(&mut plant, Some(350.0), None), refused(0, LocateRefusal::Outside));
    for wrong in [f64::NAN, f64::INFINITY, -1e300] {
        assert_eq!(locate(&mut plant, None, Some(wrong)), refused(1, LocateRefusal::Outside));
        assert!(plant.gimbal.locate([Some(-10.0 * DEG), None], wrong).is_err() || wrong == f64::INFINITY);
    }
    let mut fresh = Plant::<f64>::usual(stored(), [0.0; 2]);
    assert_eq!(locate(&mut fresh, Some(0.0), None), refused(0, LocateRefusal::Searching));
    // One axis fits, the other does not.
    assert_eq!(locate(&mut plant, Some(-12.0), Some(-20.0)).map_err(|error| error.axis), Err(0));
    assert_eq!(plant.gimbal.status().turns[1], TurnState::Known);
    assert_eq!(locate(&mut plant, Some(-10.0), None), Ok(()));
    plant.begin_move(-100.0, -20.0);
    plant.run(1000);
    assert_eq!(locate(&mut plant, Some(-10.0), None), refused(0, LocateRefusal::Moving));
}

#[test]
fn other_limits_find_the_turn_anew() {
    let motors = [MotorAndLoad::default(); 2];
    let mut plant = held([AxisLimits::default(); 2], [-300.0, 0.0]);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known; 2]);
    // The count of a continuous axis says nothing about cables, although 60 deg is within this travel.
    plant.gimbal.reconfigure(&[around(-360.0, 90.0, TurnSource::Stored); 2], &motors);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Unknown; 2]);
    plant.gimbal.reconfigure(&[around(-340.0, 0.0, TurnSource::Unique); 2], &motors);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known; 2]);
    plant.run(500);
    plant.move_to(-20.0, 0.0);
    assert!(plant.is_at(-20.0, 0.0), "{:?} {:?}", plant.at_deg(), plant.gimbal.status());
    // A turn that was known stays known if the axis stands within the new travel.
    plant
        .gimbal
        .reconfigure(&[around(-720.0, 0.0, TurnSource::Stored), around(-720.0, -400.0, TurnSource::Confirm)], &motors);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known, TurnState::Unknown]);
    plant.gimbal.reconfigure(&[AxisLimits::default(); 2], &motors);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known; 2]);
}

#[test]
fn an_axis_outside_of_its_travel_does_not_move() {
    let mut plant =
        held([around(-180.0, 90.0, TurnSource::Unique), around(-180.0, 90.0, TurnSource::Unique)], [0.0, 120.0]);
    assert_eq!(plant.gimbal.status().turns, [TurnState::Known, TurnState::Outside]);
    plant.move_to(0.0, 0.0);
    assert_eq!(turn_fault(&plant), Some((1, FaultKind::Turn(TurnFault::Outside))));
    assert!(plant.is_held_at([0.0, 120.0]));
    plant.hold();
    assert!(plant.gimbal.status().fault.is_none());
    // Turned back by hand.
    plant.gimbal.command(MotionCommand::Release);
    plant.run(500);
    plant.push_to(1, 80.0);
    plant.move_to(0.0, 0.0);
    assert!(plant.is_at(0.0, 0.0), "{:?} {:?}", plant.at_deg(), plant.gimbal.status());
}

#[test]
fn an_axis_that_is_pushed_beyond_its_usable_range_is_stopped_and_comes_back() {
    let mut plant = held(unique(), [89.99, -10.0]);
    // More than the motor has.
    plant.motors[0].disturbance_nm = 0.8;
    while plant.gimbal.status().fault.is_none() {
        plant.run(1);
        assert!(plant.at_deg()[0] < 91.0, "the travel ends at 91 deg");
    }
    plant.motors[0].disturbance_nm = 0.0;
    plant.run(3000);
    println!("pushed to {:.2} deg, {:?}", plant.at_deg()[0], plant.gimbal.status().fault);
    assert!(plant.gimbal.status().at_rest && plant.at_deg()[0] > 90.0);
    plant.move_to(0.0, 0.0);
    assert!(plant.is_at(0.0, 0.0), "{:?} {:?}", plant.at_deg(), plant.gimbal.status());
}

#[test]
fn a_wrong_first_reading_is_not_taken_for_the_angle() {
    let (wrong, damaged) = (Ok(Angle::from_rad(150.0 * DEG)), Err(EncoderFault::Crc));
    // Three equal wrong readings one after the other could not be told from right ones.
    for first in [&[wrong][..], &[wrong, wrong], &[damaged, wrong, wrong, damaged, wrong], &[damaged; 20]] {
        let mut plant = Plant::<f64>::usual(unique(), [10.0, -10.0]);
        for reading in first {
            plant.encoders[0] = Some(*reading);
            plant.run(1);
        }
        plant.encoders[0] = None;
        plant.run(100);
        plant.hold();
        plant.move_to(20.0, -20.0);
        assert!(plant.is_at(20.0, -20.0), "{first:?}: {:?} {:?}", plant.at_deg(), plant.gimbal.status());
    }
}

/// An encoder that is silent for `away_ms` in a move, and the axis brought back to zero. Returns whether it stands there
/// without a fault, and the highest duty since the encoder returned.
fn after_dropout(limits: AxisLimits, away_ms: u32, then_ms: u32, locate: bool) -> (bool, f64) {
    let mut plant = held([limits; 2], [0.0; 2]);
    if locate {
        assert_eq!(plant.gimbal.locate([Some(0.0); 2], 60.0 * ARCSEC), Ok(()));
    }
    plant.begin_move(-90.0, 0.0);
    plant.run(2500);
    plant.encoders[0] = Some(Err(EncoderFault::Silent));
    plant.run(away_ms);
    let fault = plant.gimbal.status().fault.expect("the dropout is reported");
    assert_eq!((fault.axis, fault.kind), (0, FaultKind::Encoder(EncoderFault::Silent)));
    plant.encoders[0] = None;
    plant.run(then_ms);
    plant.watch();
    plant.hold();
    let (at_deg, status) = (plant.at_deg(), plant.gimbal.status());
    assert!(status.fault.is_none(), "{away_ms} ms: {status:?}");
    if status.turns[0] == TurnState::Unknown {
        assert_eq!(plant.gimbal.locate([Some(at_deg[0] * DEG), None], 60.0 * ARCSEC), Ok(()));
    }
    let known_deg = plant.gimbal.angles_rad().map(|angle| angle.expect("known") / DEG);
    assert!((known_deg[0] - plant.at_deg()[0]).abs() < 1e-3, "{away_ms} ms: {known_deg:?}");
    plant.move_to(0.0, 0.0);
    (plant.is_at(0.0, 0.0), plant.highest_duty)
}

#[test]
fn an_axis_is_usable_again_after_every_dropout_of_its_encoder() {
    let travels =
        [Travel::Continuous, Travel::around(-180.0 * DEG, 90.0 * DEG, TurnSource::Unique), stored()[0].travel];
    for travel in travels {
        let limits = AxisLimits { travel, ..AxisLimits::default() };
        let (mut usable, mut highest_duty) = (0, 0.0_f64);
        for step in 0..150 {
            // At 20 ms the axis still turns when the encoder returns and is commanded to hold.
            let (away_ms, then_ms) = (20 + step * 37, if step % 3 == 0 { 5 } else { 3000 + step * 13 });
            let (back, duty) = after_dropout(limits, away_ms, then_ms, travel != Travel::Continuous);
            usable += u32::from(back);
            highest_duty = highest_duty.max(duty);
        }
        println!("{travel:?}: {usable} of 150 dropouts usable again, highest duty {highest_duty:.2}");
        assert_eq!(usable, 150, "{travel:?}");
        // Braking from 20 deg/s with 60 deg/s^2 and the way back need less; a jump of the angle would need all.
        assert!(highest_duty < 0.25, "{travel:?}: {highest_duty}");
    }
}

#[test]
fn after_a_long_loss_the_turn_is_known_only_if_the_reading_tells_it() {
    let cases = [
        (Travel::Continuous, 60_000, TurnState::Known),
        (unique()[0].travel, 60_000, TurnState::Known),
        (stored()[0].travel, 60_000, TurnState::Unknown),
        (stored()[0].travel, 3_100, TurnState::Unknown),
        // Half a turn at 60 deg/s lasts 3 s.
        (stored()[0].travel, 2_900, TurnState::Known),
    ];
    for (travel, away_ms, expected) in cases {
        let limits = AxisLimits { travel, ..AxisLimits::default() };
        let mut plant = held([limits; 2], [-10.0, -10.0]);
        let _ = plant.gimbal.locate([Some(-10.0 * DEG); 2], 60.0 * ARCSEC);
        plant.encoders[0] = Some(Err(EncoderFault::Silent));
        plant.run(away_ms);
        assert_eq!(plant.gimbal.status().turns, [TurnState::Searching, TurnState::Known]);
        plant.encoders[0] = None;
        plant.run(100);
        assert_eq!(plant.gimbal.status().turns[0], expected, "{travel:?} {away_ms}");
    }
}

#[test]
fn a_short_dropout_is_bridged_and_a_longer_one_is_recovered_from() {
    for away_ms in [1, 2, 3, 4, 10, 20, 40, 60, 80, 100, 150, 200] {
        let mut plant = held([AxisLimits::default(); 2], [0.0; 2]);
        plant.begin_move(-90.0, 0.0);
        plant.run(2500);
        plant.encoders[0] = Some(Err(EncoderFault::Silent));
        plant.run(away_ms);
        plant.encoders[0] = None;
        assert_eq!(plant.gimbal.status().fault.is_some(), away_ms > 2, "{away_ms}");
        // Frozen, and at no rate.
        if away_ms > 3 {
            let before = plant.gimbal.status().fault.map(|fault| fault.angle_rad);
            assert_eq!(plant.drives[0], Drive::Brake);
            assert_eq!(before, plant.gimbal.status().fault.map(|fault| fault.angle_rad));
        }
        plant.run(3000);
        plant.gimbal.command(MotionCommand::Release);
        plant.run(1000);
        plant.hold();
        assert!(plant.gimbal.status().fault.is_none());
        plant.move_to(-90.0, 0.0);
        assert!(plant.is_at(-90.0, 0.0), "{away_ms}: {:?}", plant.at_deg());
    }
}

/// Holds both axes, of which the outer turns, and returns the time until it stands, ms.
fn time_to_standstill(plant: &mut Plant<f64>) -> u32 {
    plant.gimbal.command(MotionCommand::Hold);
    let mut ms = 0;
    while plant.motors.iter().any(|motor| motor.rate_rad_s.abs() > 0.02 * DEG) {
        plant.run(1);
        ms += 1;
        assert!(ms < 2000, "{:?}", plant.gimbal.status());
    }
    plant.run(200);
    let status = plant.gimbal.status();
    assert!(status.at_rest && status.arrived && status.fault.is_none(), "{status:?}");
    assert!(plant.drives.iter().all(|drive| matches!(drive, Drive::Duty(_))), "both axes are held");
    ms
}

#[test]
fn hold_stops_the_axes_from_every_mode() {
    let moving = || {
        let mut plant = held([AxisLimits::default(); 2], [0.0; 2]);
        plant.begin_move(-90.0, 45.0);
        plant.run(2500);
        assert!(plant.motors[0].rate_rad_s < -19.9 * DEG);
        plant
    };
    type Change = fn(&mut Plant<f64>);
    let modes: [(&str, Change, u32); 6] = [
        ("moving", |_| {}, 360),
        (
            "braking",
            |plant| {
                plant.gimbal.command(MotionCommand::Hold);
                plant.run(100);
            },
            260,
        ),
        ("holding", |plant| plant.run(10_000), 20),
        (
            "releasing",
            |plant| {
                plant.gimbal.command(MotionCommand::Release);
                plant.run(100);
            },
            260,
        ),
        // The encoder was away, so the axis turns with its winding shorted.
        (
            "free",
            |plant| {
                plant.encoders[0] = Some(Err(EncoderFault::Silent));
                plant.run(20);
                plant.encoders[0] = None;
                plant.run(5);
                assert!(matches!(plant.drives[0], Drive::Brake) && plant.motors[0].rate_rad_s < -15.0 * DEG);
            },
            340,
        ),
        ("a move that waits", |plant| plant.begin_move(10.0, 10.0), 360),
    ];
    for (mode, change, longest_ms) in modes {
        let mut plant = moving();
        change(&mut plant);
        let ms = time_to_standstill(&mut plant);
        println!("Hold from 20 deg/s, {mode}: {ms} ms to standstill");
        assert!(ms <= longest_ms, "{mode}: {ms} ms");
    }
}

#[test]
fn hold_does_not_take_up_a_faulty_axis_by_a_command_from_before_the_fault() {
    let mut plant = held([AxisLimits::default(); 2], [0.0; 2]);
    plant.begin_move(-90.0, 45.0);
    plant.run(2500);
    let seen_us = plant.now_us;
    plant.encoders[0] = Some(Err(EncoderFault::Silent));
    plant.run(5);
    plant.gimbal.command_seen(MotionCommand::Hold, seen_us);
    plant.run(5);
    assert!(plant.drives[0] == Drive::Brake && plant.gimbal.status().fault.is_some());
    // A command after the fault does not take it up either as long as the encoder is away.
    plant.gimbal.command_seen(MotionCommand::Hold, plant.now_us);
    plant.run(5);
    assert!(plant.drives[0] == Drive::Brake && plant.gimbal.status().fault.is_some());
}

#[test]
fn a_duty_that_is_not_finite_is_never_given_to_the_bridge() {
    let spoilt = MotorAndLoad { viscous_nm_s: f64::NAN, ..MotorAndLoad::default() };
    let mut plant = Plant::<f64>::usual([AxisLimits::default(); 2], [0.0; 2]);
    plant.run(10);
    plant.gimbal.reconfigure(&[AxisLimits::default(); 2], &[spoilt, MotorAndLoad::default()]);
    plant.gimbal.command(MotionCommand::Hold);
    plant.run(2);
    assert_eq!(turn_fault(&plant), Some((0, FaultKind::NotFinite)));
    assert!(plant.drives[0] == Drive::Brake && matches!(plant.drives[1], Drive::Duty(_)));
    assert!(!plant.gimbal.status().fault.is_some_and(|fault| fault.allows_parking()));
}
