//! Accepted settings at and between their bounds, put through the closed loop with `f64` and with `f32`.
//!
//! A setting that is accepted never makes an axis exceed its rate limit or its physical travel, and never gives a duty
//! that is not a number. The tolerances of the rate limit are overshoot of a linear loop at the end of the shortest
//! permitted ramp, and the kick of a dry friction that breaks away. They are a part of the rate limit because the bounds
//! of ramp and friction are relative to it.

use super::axis::{AXIS_AND_MOTOR_BOUNDS, AXIS_BOUNDS, AxisLimits};
use super::both_axes::MotionCommand;
use super::plant::Plant;
use super::servo::{MOTOR_BOUNDS, MotorAndLoad};
use super::travel::{Travel, TurnSource};
use crate::base::bounds::{Bounded, first_outside};
use crate::base::linear::Real;
use crate::base::units::DEG;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Permitted excess over the rate limit if inertia and friction are as configured.
const EXCESS: f64 = 0.1;
/// Permitted excess if they are not.
const EXCESS_OF_ANOTHER_LOAD: f64 = 0.25;

/// A number from `lowest` to `highest`, as likely in every decade; in two of five cases one of the ends.
fn between(lowest: f64, highest: f64) -> impl Strategy<Value = f64> {
    let (low, high) = (lowest.ln(), highest.ln());
    let inside = (0.0..=1.0_f64).prop_map(move |part: f64| (low + part * (high - low)).exp());
    prop_oneof![3 => inside, 1 => Just(lowest), 1 => Just(highest)]
}

/// A number within its bounds. A lowest bound of zero becomes a millionth of the highest one.
fn permitted<C>(table: &[Bounded<C>], name: &str) -> impl Strategy<Value = f64> {
    let bound = table.iter().map(|row| row.bound).find(|bound| bound.name == name).expect("the table has it");
    between(bound.lowest.max(1e-6 * bound.highest) * bound.unit.si, bound.highest * bound.unit.si)
}

fn limits() -> impl Strategy<Value = AxisLimits> {
    let of_axis = |name| permitted(&AXIS_BOUNDS, name);
    let motion = (of_axis("highest rate"), of_axis("highest acceleration"), of_axis("jerk"));
    let errors = (of_axis("tolerance of arrival"), of_axis("following error"), of_axis("runaway limit"));
    (motion, errors).prop_map(|((rate_rad_s, acceleration_rad_s2, jerk_rad_s3), errors)| AxisLimits {
        rate_rad_s,
        acceleration_rad_s2,
        jerk_rad_s3,
        // From end to end in 1.2 s at the highest rate.
        travel: Travel::around(-0.6 * rate_rad_s, 0.6 * rate_rad_s, TurnSource::Unique),
        arrived_rad: errors.0,
        following_error_rad: errors.1,
        runaway_rad_s: errors.2,
    })
}

/// A motor for these limits, from the numbers that decide how it behaves: inertia; torque, dry and viscous friction
/// relative to the torque that the highest acceleration takes; supply relative to the voltage at the highest rate.
fn motor(limits: AxisLimits) -> impl Strategy<Value = MotorAndLoad> {
    let of_motor = |name| permitted(&MOTOR_BOUNDS, name);
    let load = (of_motor("moment of inertia"), between(1e-3, 10.0), between(1e-3, 1.0));
    let electric = (between(1.5, 1e5), of_motor("torque constant"), between(1.001, 1e3));
    let winding_and_encoder = (of_motor("electrical time constant"), 16_u8..=32);
    (load, electric, winding_and_encoder).prop_map(move |((inertia, dry, viscous), (more, constant, supply), rest)| {
        let torque_nm = inertia * limits.acceleration_rad_s2;
        let highest_current_a = 1.001 * more * torque_nm * (1.0 + dry + viscous) / constant;
        let supply_v = (constant * limits.rate_rad_s * supply).max(1.0);
        let resistance_ohm = (supply_v - constant * limits.rate_rad_s) / highest_current_a;
        MotorAndLoad {
            inertia_kg_m2: inertia,
            coulomb_nm: torque_nm * dry,
            viscous_nm_s: torque_nm * viscous / limits.rate_rad_s,
            torque_constant_nm_a: constant,
            resistance_ohm,
            inductance_h: rest.0 * resistance_ohm,
            supply_v,
            highest_current_a,
            encoder_bits: rest.1,
        }
    })
}

fn is_accepted((limits, motor): &(AxisLimits, MotorAndLoad)) -> bool {
    first_outside(&AXIS_BOUNDS, limits).is_none()
        && first_outside(&MOTOR_BOUNDS, motor).is_none()
        && first_outside(&AXIS_AND_MOTOR_BOUNDS, &(*limits, *motor)).is_none()
}

fn accepted() -> impl Strategy<Value = (AxisLimits, MotorAndLoad)> {
    let both = limits().prop_flat_map(|limits| (Just(limits), motor(limits)));
    both.prop_filter("accepted", is_accepted)
}

/// Both axes go from end to end of their usable range at their limits, the first time with a stop after `stop_ms`. Then
/// they are released. The loads differ from the configured ones by the fraction `off`: the outer one is heavier with more
/// friction, the inner one is lighter with less.
fn drive<T: Real>(limits: &AxisLimits, motor: &MotorAndLoad, stop_ms: u32, off: f64) -> Plant<T> {
    let mut plant = Plant::<T>::new([*limits; 2], [*motor; 2], [0.0; 2]);
    for (motor, off) in plant.motors.iter_mut().zip([off, -off]) {
        motor.data.inertia_kg_m2 *= 1.0 + off;
        motor.data.coulomb_nm *= 1.0 + 3.0 * off;
    }
    plant.run(10);
    plant.hold();
    let (lowest, highest) = limits.travel.usable_rad().into_inner();
    for (angles_rad, ms) in [([lowest, highest], stop_ms), ([highest, lowest], 2500), ([lowest, highest], 2500)] {
        plant.gimbal.command(MotionCommand::MoveTo {
            angles_rad,
            rate_rad_s: limits.rate_rad_s,
            acceleration_rad_s2: limits.acceleration_rad_s2,
        });
        plant.run(ms);
        plant.gimbal.command(MotionCommand::Hold);
        plant.run(300);
    }
    plant.gimbal.command(MotionCommand::Release);
    plant.run(300);
    plant
}

fn stays_within<T: Real>(limits: &AxisLimits, motor: &MotorAndLoad, stop_ms: u32, off: f64) {
    let plant = drive::<T>(limits, motor, stop_ms, off);
    let excess = plant.highest_rate_rad_s / limits.rate_rad_s - 1.0;
    let permitted = if off == 0.0 { EXCESS } else { EXCESS_OF_ANOTHER_LOAD };
    assert!(excess <= permitted, "{excess:.3} above the rate limit: {limits:?} {motor:?}");
    let (lowest, highest) = limits.travel.physical_rad().into_inner();
    let range = plant.range_rad;
    assert!(range[0] >= lowest && range[1] <= highest, "{range:?} rad: {limits:?} {motor:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Default::default() })]

    #[test]
    fn an_accepted_setting_keeps_rate_and_travel((limits, motor) in accepted(), stop_ms in 1_u32..1500, another: bool) {
        let off = if another { 0.3 } else { 0.0 };
        stays_within::<f64>(&limits, &motor, stop_ms, off);
        stays_within::<f32>(&limits, &motor, stop_ms, off);
    }
}

#[test]
fn defaults_are_accepted() {
    assert!(is_accepted(&(AxisLimits::default(), MotorAndLoad::default())));
}

/// An obstacle stops the axis, the loosest limits let the control push against it, and then it gives way.
#[test]
fn an_axis_that_comes_free_does_not_exceed_its_rate_limit() {
    let rate_rad_s = 5.0 * DEG;
    let limits = AxisLimits {
        rate_rad_s,
        acceleration_rad_s2: 20.0 * DEG,
        following_error_rad: 10.0 * DEG,
        runaway_rad_s: 20.0 * DEG,
        ..AxisLimits::default()
    };
    let motor = MotorAndLoad::default();
    assert!(is_accepted(&(limits, motor)));
    for commanded_deg_s in [1.5, 5.0] {
        let mut plant = Plant::<f64>::usual([limits; 2], [0.0; 2]);
        plant.run(10);
        plant.hold();
        plant.gimbal.command(MotionCommand::MoveTo {
            angles_rad: [90.0 * DEG, 0.0],
            rate_rad_s: commanded_deg_s * DEG,
            acceleration_rad_s2: 20.0 * DEG,
        });
        plant.run(1000);
        // Friction that the motor cannot overcome.
        plant.motors[0].data.coulomb_nm = 5.0;
        plant.run(3000);
        plant.motors[0].data.coulomb_nm = motor.coulomb_nm;
        plant.run(1000);
        // The runaway limit, and what the motor gives in the 3 ms until the filtered rate shows it.
        let tolerance_rad_s = 0.2 * rate_rad_s + 3e-3 * motor.highest_acceleration_rad_s2();
        let excess_rad_s = plant.highest_rate_rad_s - rate_rad_s;
        assert!(excess_rad_s <= tolerance_rad_s, "{commanded_deg_s}: {} deg/s above", excess_rad_s / DEG);
    }
}

/// The numbers with which the loop gave duties that were not numbers, and rates of hundreds of degrees per second.
#[test]
fn numbers_that_overflow_are_refused() {
    let limits = AxisLimits::default();
    for wrong in [
        AxisLimits { jerk_rad_s3: 1e-320, ..limits },
        AxisLimits { jerk_rad_s3: 1e-40, ..limits },
        AxisLimits { jerk_rad_s3: f64::INFINITY, ..limits },
        AxisLimits { runaway_rad_s: 1e300, ..limits },
        AxisLimits { following_error_rad: 1e300, ..limits },
        AxisLimits { acceleration_rad_s2: f64::NAN, ..limits },
        AxisLimits { travel: Travel::around(-1e300, 0.0, TurnSource::Stored), ..limits },
        AxisLimits { travel: Travel::around(-180.0 * DEG, 178.0 * DEG, TurnSource::Unique), ..limits },
    ] {
        assert!(first_outside(&AXIS_BOUNDS, &wrong).is_some(), "{wrong:?}");
    }
    let unique = AxisLimits { travel: Travel::around(-180.0 * DEG, 176.0 * DEG, TurnSource::Unique), ..limits };
    assert_eq!(first_outside(&AXIS_BOUNDS, &unique), None);
}
