//! The core's gimbal control on simulated motors, in normal operation and with failures.

use host_tests::bench::Trouble;
use host_tests::bench::gimbal_plant::GimbalPlant;
use host_tests::bench::servo_bench::{MoveFigures, ServoBench};
use host_tests::virtual_unit::motor::Mechanics;
use rins_selfcal::base::linear::Real;
use rins_selfcal::base::profile::Point;
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::servo::MotorAndLoad;
use rins_selfcal::gimbal::{BridgeFault, EncoderFault, Fault, FaultKind, MotionCommand, Travel, TurnSource};

fn plant_at<T: Real>(angles_deg: [f64; 2]) -> GimbalPlant<T> {
    let assumed = [MotorAndLoad::default(); 2];
    let travel = Travel::around(-360.0 * DEG, 90.0 * DEG, TurnSource::Stored);
    let limits = AxisLimits { travel, ..AxisLimits::default() };
    let angles_rad = angles_deg.map(|angle| angle * DEG);
    let mut plant = GimbalPlant::new(&[limits; 2], &assumed, assumed.map(Mechanics::of), angles_rad);
    run(&mut plant, 5);
    assert_eq!(plant.locate(angles_rad), Ok(()));
    plant
}

fn move_to(outer_deg: f64, inner_deg: f64) -> MotionCommand {
    MotionCommand::MoveTo {
        angles_rad: [outer_deg * DEG, inner_deg * DEG],
        rate_rad_s: 20.0 * DEG,
        acceleration_rad_s2: 20.0 * DEG,
    }
}

fn run<T: Real>(plant: &mut GimbalPlant<T>, periods: u32) {
    (0..periods).for_each(|_| plant.period());
}

fn at_deg<T: Real>(plant: &GimbalPlant<T>, outer_deg: f64, inner_deg: f64, within_arcsec: f64) {
    let [outer, inner] = plant.angles_rad();
    let off = [outer - outer_deg * DEG, inner - inner_deg * DEG].map(|off| off / ARCSEC);
    assert!(off.iter().all(|off| off.abs() < within_arcsec), "{off:?} arcsec");
}

fn goes_there_and_back<T: Real>() {
    let mut plant = plant_at::<T>([30.0, -100.0]);
    run(&mut plant, 100);
    at_deg(&plant, 30.0, -100.0, 1e-6);
    plant.command(move_to(-90.0, -100.0));
    run(&mut plant, 9);
    assert_eq!(plant.status().commands, 0, "it waits");
    // The gimbal accepts the command at rest. The move takes 6 s for 120 deg at 20 deg/s, and one more for the two
    // ramps.
    run(&mut plant, 3);
    assert_eq!(plant.status().commands, 1);
    assert!(!plant.status().arrived && !plant.status().at_rest);
    assert!(plant.status().move_us.abs_diff(7_000_000) < 100, "{:?}", plant.status());
    let mut period = 12;
    while !plant.status().arrived {
        plant.period();
        period += 1;
        assert!(period < 7110, "{:?}", plant.status());
    }
    run(&mut plant, 300);
    at_deg(&plant, -90.0, -100.0, 0.3);
    plant.command(move_to(0.0, 0.0));
    run(&mut plant, 7010);
    assert!(plant.status().arrived && plant.status().fault.is_none());
    at_deg(&plant, 0.0, 0.0, 0.5);
}

#[test]
fn axes_go_where_they_are_told_and_stand_there() {
    goes_there_and_back::<f64>();
    goes_there_and_back::<f32>();
}

#[test]
fn a_command_on_the_way_brakes_first() {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(move_to(-90.0, 45.0));
    run(&mut plant, 2000);
    let before = plant.rates_rad_s();
    assert!(before[0] < -19.0 * DEG && before[1] > 19.0 * DEG);
    plant.command(MotionCommand::Hold);
    // The axes stop from 20 deg/s at 60 deg/s^2 in a third of a second.
    run(&mut plant, 360);
    assert!(plant.status().at_rest && plant.rates_rad_s().iter().all(|rate| rate.abs() < 0.01 * DEG));
    plant.command(move_to(-40.0, 0.0));
    run(&mut plant, 1000);
    plant.command(move_to(10.0, 10.0));
    run(&mut plant, 5000);
    assert!(plant.status().arrived);
    at_deg(&plant, 10.0, 10.0, 1.0);
}

#[test]
fn a_released_gimbal_gives_way_and_is_taken_up_where_it_is() {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(move_to(20.0, 20.0));
    run(&mut plant, 1000);
    plant.command(MotionCommand::Release);
    run(&mut plant, 1000);
    let stood = plant.angles_rad();
    plant.with_motor(0, |motor| motor.mechanics.disturbance_nm = 0.1);
    run(&mut plant, 2000);
    assert!(plant.angles_rad()[0] > stood[0] + 5.0 * DEG && plant.status().fault.is_none());
    plant.with_motor(0, |motor| motor.mechanics.disturbance_nm = 0.0);
    plant.command(MotionCommand::Hold);
    run(&mut plant, 1000);
    assert!(plant.status().at_rest);
    let held = plant.angles_rad();
    run(&mut plant, 1000);
    assert!((plant.angles_rad()[0] - held[0]).abs() < ARCSEC);
}

#[test]
fn a_target_out_of_reach_moves_nothing() {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(MotionCommand::Hold);
    plant.command(move_to(0.0, 91.0));
    run(&mut plant, 500);
    let limit_rad = (90.0 * DEG) as f32;
    assert_eq!(plant.status().fault, Some(Fault { axis: 1, angle_rad: 0.0, kind: FaultKind::Travel { limit_rad } }));
    at_deg(&plant, 0.0, 0.0, 0.1);
    // The end of the travel belongs to the travel, with a margin for rounding.
    plant.command(move_to(0.0, 90.0 + 1e-9));
    run(&mut plant, 6000);
    assert!(plant.status().arrived && plant.status().fault.is_none());
}

/// The fault of an axis.
#[derive(Clone, Copy, Debug)]
enum Failing {
    Chip(Trouble),
    Jammed,
}

/// Lets an axis fail while both axes turn at constant rate. Returns the time until both have stopped, ms, the angle
/// that they have turned by meanwhile, deg, and the fault.
fn stopped_after(axis: usize, trouble: Failing) -> (u32, f64, Fault) {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(move_to(-90.0, -90.0));
    run(&mut plant, 2500);
    assert!(plant.rates_rad_s().iter().all(|rate| *rate < -19.9 * DEG));
    let before = plant.angles_rad();
    match trouble {
        Failing::Chip(trouble) => plant.set_trouble(axis, Some(trouble)),
        Failing::Jammed => plant.with_motor(axis, |motor| motor.jammed = true),
    }
    let (mut stopped_ms, mut ms, mut farthest) = (0, 0, 0.0_f64);
    while ms < 6000 {
        plant.period();
        ms += 1;
        if plant.rates_rad_s().iter().any(|rate| rate.abs() > 0.01 * DEG) {
            stopped_ms = ms;
        }
        let went = [0, 1].map(|axis: usize| (plant.angles_rad()[axis] - before[axis]).abs() / DEG);
        farthest = farthest.max(went[0]).max(went[1]);
    }
    let status = plant.status();
    assert!(status.at_rest, "{trouble:?}");
    (stopped_ms, farthest, status.fault.unwrap_or_else(|| panic!("{trouble:?} is not noticed")))
}

#[test]
fn whatever_fails_both_axes_stop() {
    type Expected = fn(FaultKind) -> bool;
    let cases: [(Failing, Expected); 11] = [
        (Failing::Chip(Trouble::EncoderSilent), |kind| kind == FaultKind::Encoder(EncoderFault::Silent)),
        (Failing::Chip(Trouble::EncoderCrc(1)), |kind| kind == FaultKind::Encoder(EncoderFault::Crc)),
        (Failing::Chip(Trouble::EncoderAlarm), |kind| kind == FaultKind::Encoder(EncoderFault::Alarm)),
        (Failing::Chip(Trouble::EncoderSlip(3.0)), |kind| matches!(kind, FaultKind::Encoder(EncoderFault::Jump(_)))),
        (Failing::Chip(Trouble::EncoderReversed), |kind| matches!(kind, FaultKind::Encoder(EncoderFault::Jump(_)))),
        (Failing::Chip(Trouble::EncoderFrozen), |kind| matches!(kind, FaultKind::Stall { .. })),
        (Failing::Jammed, |kind| matches!(kind, FaultKind::Stall { .. })),
        (Failing::Chip(Trouble::MotorReversed), |kind| {
            matches!(kind, FaultKind::Stall { .. } | FaultKind::Runaway { .. })
        }),
        (Failing::Chip(Trouble::Overcurrent), |kind| kind == FaultKind::Bridge(BridgeFault::Overcurrent)),
        (Failing::Chip(Trouble::BridgeDead), |kind| {
            matches!(kind, FaultKind::Following { .. } | FaultKind::Stall { .. })
        }),
        (Failing::Chip(Trouble::Weak(0.1)), |kind| {
            matches!(kind, FaultKind::Following { .. } | FaultKind::Stall { .. })
        }),
    ];
    for (trouble, expected) in cases {
        for axis in [0, 1] {
            let (stopped_ms, farthest_deg, fault) = stopped_after(axis, trouble);
            println!("{trouble:?} {axis}: {stopped_ms} ms, {farthest_deg:.1} deg, {fault}");
            assert!(expected(fault.kind), "{trouble:?}: {fault}");
            assert_eq!(usize::from(fault.axis), axis);
            // The control stops an axis in a third of a second; friction and the shorted winding alone take less than a
            // second.
            assert!(stopped_ms < 1000 && farthest_deg < 20.0, "{trouble:?}: {stopped_ms} ms, {farthest_deg} deg");
        }
    }
}

#[test]
fn an_axis_that_is_pushed_while_it_stands_is_a_runaway() {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(MotionCommand::Hold);
    run(&mut plant, 100);
    // A torque above the largest of the motor, for a tenth of a second.
    plant.with_motor(1, |motor| motor.mechanics.disturbance_nm = -1.5);
    run(&mut plant, 100);
    plant.with_motor(1, |motor| motor.mechanics.disturbance_nm = 0.0);
    let fault = plant.status().fault.expect("it is noticed");
    let wrong_way = |kind| matches!(kind, FaultKind::Runaway { rate_rad_s, .. } if f64::from(rate_rad_s) < -5.0 * DEG);
    assert!(fault.axis == 1 && wrong_way(fault.kind), "{fault}");
    run(&mut plant, 3000);
    assert!(plant.status().at_rest && plant.rates_rad_s() == [0.0; 2]);
}

#[test]
fn a_few_damaged_frames_are_nothing() {
    let mut plant = plant_at::<f64>([0.0, 0.0]);
    plant.command(move_to(-90.0, 0.0));
    plant.set_trouble(0, Some(Trouble::EncoderCrc(7)));
    run(&mut plant, 6000);
    assert!(plant.status().arrived && plant.status().fault.is_none(), "{:?}", plant.status());
    at_deg(&plant, -90.0, 0.0, 1.0);
}

#[test]
fn an_axis_pushed_out_of_its_travel_is_stopped() {
    let mut plant = plant_at::<f64>([89.99, 0.0]);
    plant.command(MotionCommand::Hold);
    run(&mut plant, 100);
    // A torque above the largest of the motor.
    plant.with_motor(0, |motor| motor.mechanics.disturbance_nm = 0.8);
    let mut period = 0;
    while plant.status().fault.is_none() {
        plant.period();
        period += 1;
        assert!(period < 1000);
    }
    plant.with_motor(0, |motor| motor.mechanics.disturbance_nm = 0.0);
    run(&mut plant, 3000);
    assert!(plant.status().at_rest);
    assert!(plant.angles_rad()[0] < 100.0 * DEG);
    plant.command(move_to(0.0, 0.0));
    run(&mut plant, 7000);
    assert!(plant.status().arrived, "{:?}", plant.status());
}

/// Worst figures over moves of all lengths in both directions, with a motor that differs from the one that the
/// controller assumes.
fn moves<T: Real>(assumed: &MotorAndLoad, mechanics: Mechanics) -> MoveFigures {
    let mut bench = ServoBench::<T>::new(assumed, mechanics);
    let mut worst = MoveFigures::default();
    for way_deg in [90.0, -180.0, 5.0, 1.0, -0.1] {
        let (end_s, trace) = bench.move_by(way_deg, 1.5);
        worst = worst.worse(&MoveFigures::new(way_deg, end_s, &trace));
    }
    worst
}

#[test]
fn a_move_arrives_without_overshoot_and_holds() {
    for encoder_bits in [26, 32] {
        let data = MotorAndLoad { encoder_bits, ..MotorAndLoad::default() };
        for figures in [moves::<f64>(&data, Mechanics::of(data)), moves::<f32>(&data, Mechanics::of(data))] {
            println!("{encoder_bits} bit: {figures:?}");
            assert!(figures.following_arcsec < 10.0 && figures.overshoot_arcsec < 2.0, "{figures:?}");
            assert!(figures.settling_s < 0.05 && figures.hold_rms_arcsec < 0.2, "{figures:?}");
        }
    }
}

#[test]
fn a_load_that_is_not_as_assumed_is_moved_all_the_same() {
    let assumed = MotorAndLoad::default();
    for (inertia, friction) in [(1.3, 1.0), (0.7, 1.0), (1.0, 2.0), (1.0, 0.5), (1.3, 2.0), (0.7, 0.5), (1.0, 0.0)] {
        let data = MotorAndLoad {
            inertia_kg_m2: inertia * assumed.inertia_kg_m2,
            coulomb_nm: friction * assumed.coulomb_nm,
            viscous_nm_s: friction * assumed.viscous_nm_s,
            ..assumed
        };
        let figures = moves::<f64>(&assumed, Mechanics::of(data));
        println!("inertia x {inertia}, friction x {friction}: {figures:?}");
        assert!(
            figures.following_arcsec < 60.0 && figures.overshoot_arcsec < 30.0,
            "{inertia} {friction}: {figures:?}"
        );
        assert!(figures.settling_s < 0.4 && figures.hold_rms_arcsec < 0.4, "{inertia} {friction}: {figures:?}");
    }
}

#[test]
fn a_step_beyond_the_torque_does_not_wind_up() {
    let data = MotorAndLoad::default();
    let mut bench = ServoBench::<f64>::new(&data, Mechanics::of(data));
    let step = bench.follow(2.0, |_| Point { angle_rad: 5.0 * DEG, ..Point::default() });
    assert!(step.iter().filter(|at| at.duty.abs() > 0.45).count() > 50, "the torque is at its limit");
    let beyond_deg = step.iter().map(|at| at.error_rad).fold(0.0, f64::max) / DEG;
    // The overshoot of the linear loop itself is 25 % at most.
    assert!(beyond_deg < 0.25 * 5.0, "{beyond_deg}");
    assert!(step.iter().skip(1500).all(|at| at.error_rad.abs() < 2.0 * ARCSEC));
}

#[test]
fn a_ramp_is_followed_without_lag() {
    let data = MotorAndLoad::default();
    let mut bench = ServoBench::<f64>::new(&data, Mechanics::of(data));
    let rate = 20.0 * DEG;
    let ramp =
        bench.follow(3.0, |time_s| Point { angle_rad: rate * time_s, rate_rad_s: rate, acceleration_rad_s2: 0.0 });
    assert!(ramp.iter().skip(1000).all(|at| at.error_rad.abs() < 1.0 * ARCSEC), "{:?}", ramp.last());
}
