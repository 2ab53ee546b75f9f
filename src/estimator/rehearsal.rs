//! Rehearsal of a scheme before the run. The stops and moves that the segmenter will find follow from the geometry of
//! the scheme. The rehearsal finds the parameters that they will leave unobserved.
//!
//! The covariance depends on the geometry alone. So a rehearsal is one sweep of the filter over the segments of a
//! perfect unit that is level and points north. It is done at power-up, before an axis turns. The windows are those of
//! the segmenter. Only the time that a stop loses because of the segmenter's blocks of 0.1 s is replaced by its mean.

use super::configuration::EstimatorConfig;
use super::joint::Estimator;
use super::solution::OBSERVED_RATIO;
use crate::base::angle::Angle;
use crate::base::hardware::Hardware;
use crate::base::linear::{ComplexField, Real, Vector3, real};
use crate::base::sample::CHANNELS;
use crate::model::effects::SiteSigmas;
use crate::model::error_model::{InstrumentErrors, PARAMETERS, block};
use crate::model::measurement::MeasurementModel;
use crate::scheme::{Leg, SETTLING_S, Scheme, Turning};
use crate::segment::readings::Readings;
use crate::segment::scatter::Scatter;
use crate::segment::{AngleIntegrals, Course, GUARD_S, Held, Segment, SegmentKind, Standing, Turned};

/// Mean time that a stop loses, s. The window of a stop consists of whole blocks. The ends of the ramps that count as
/// at rest are subtracted from the loss.
pub const BLOCK_LOSS_S: f64 = 0.05;
/// Shortest stop, s. It has room for the settling, the guard, and one whole block between them for any start of the
/// blocks.
pub const SHORTEST_STOP_S: f64 = 0.5;
/// Number of steps of the integrals over a move. The error of the midpoint rule is 4e-4 over half a turn.
const STEPS: u32 = 32;

/// Time of a stop of `stop_s` that the accelerometers can use, s. They need `settling_s` after a move. There is no move
/// before the first stop and no move after the last stop.
pub fn usable_s(stop_s: f64, settling_s: f64, is_first: bool, is_last: bool) -> f64 {
    let settling = if is_first { 0.0 } else { settling_s };
    let guard = if is_last { 0.0 } else { GUARD_S };
    SETTLING_S + stop_s - settling - guard - BLOCK_LOSS_S
}

/// The stop of a leg with the usable time `usable_s`. The sensor outputs are zero.
pub fn stop_segment<T: Real>(leg: &Leg, usable_s: f64) -> Segment<T> {
    segment(leg, usable_s, Turned::default(), standing(Vector3::zeros()))
}

fn standing<T: Real>(force_a: Vector3<T>) -> Course<T> {
    let increments = [0.0; CHANNELS];
    Course::Stop(Standing { force_a, scatter: Scatter::default(), readings: [Readings::NONE; 2], increments })
}

/// A move with guard and settling at its ends. The sensor outputs are zero.
pub fn move_segment<T: Real>(from: &Leg, to: &Leg, turning: &Turning) -> Segment<T> {
    let ways = to.ways_from(from);
    let profiles = ways.map(|way| turning.profile(way));
    let move_s = turning.move_s(from, to);
    let guard_s = GUARD_S + 0.5 * BLOCK_LOSS_S;
    let mut turned = Turned { outer: ways[0], inner: ways[1], ..Turned::default() };
    let mut integrals = AngleIntegrals::<f64>::default();
    let mut since_s = 0.0;
    let mut add = |[outer, inner]: [f64; 2], time_s: f64, [outer_way, inner_way]: [f64; 2]| {
        let (so, co) = ComplexField::sin_cos(from.outer_rad + outer);
        let (si, ci) = ComplexField::sin_cos(from.inner_rad + inner);
        for (row, inner) in integrals.attitude_s.iter_mut().zip([1.0, ci, si]) {
            row.iter_mut().zip([1.0, co, so]).for_each(|(sum, outer)| *sum += (inner * outer * time_s) as f32);
        }
        let middle_s = since_s + 0.5 * time_s;
        turned.outer_cos_inner += ci * outer_way;
        turned.outer_sin_inner += si * outer_way;
        integrals.late_cos_inner_s += ci * outer_way * middle_s;
        integrals.late_sin_inner_s += si * outer_way * middle_s;
        integrals.harmonics.add((so as f32, co as f32), (si as f32, ci as f32), outer_way as f32);
        let way_r = [ci * outer_way, -si * outer_way, inner_way];
        integrals.gyro_path.add(way_r.map(|way| way as f32), time_s as f32);
        since_s += time_s;
    };
    add([0.0; 2], guard_s, [0.0; 2]);
    let step_s = move_s / f64::from(STEPS);
    let mut before = [0.0; 2];
    for step in 0..STEPS {
        let middle = profiles.map(|profile| profile.at((f64::from(step) + 0.5) * step_s).angle_rad);
        let after = profiles.map(|profile| profile.at(f64::from(step + 1) * step_s).angle_rad);
        add(middle, step_s, [after[0] - before[0], after[1] - before[1]]);
        before = after;
    }
    add(ways, guard_s, [0.0; 2]);
    let turned = Turned {
        outer: real(turned.outer),
        inner: real(turned.inner),
        outer_cos_inner: real(turned.outer_cos_inner),
        outer_sin_inner: real(turned.outer_sin_inner),
    };
    let integrals = AngleIntegrals {
        attitude_s: integrals.attitude_s,
        late_cos_inner_s: real(integrals.late_cos_inner_s),
        late_sin_inner_s: real(integrals.late_sin_inner_s),
        harmonics: integrals.harmonics,
        gyro_path: integrals.gyro_path,
    };
    segment(to, move_s + 2.0 * guard_s, turned, Course::Move(integrals))
}

fn segment<T: Real>(leg: &Leg, duration_s: f64, turned: Turned<T>, course: Course<T>) -> Segment<T> {
    Segment {
        start_us: 0,
        duration_us: ComplexField::round(duration_s * 1e6) as u64,
        samples: 0,
        longest_interval_us: 0,
        held: Held::NONE,
        temperature_c: 0.0,
        rotation_g: Vector3::zeros(),
        outer: Angle::from_rad(leg.outer_rad),
        inner: Angle::from_rad(leg.inner_rad),
        turned,
        course,
    }
}

/// The first parameter, by index, that a run of the scheme would leave unobserved. `None` if all parameters are
/// observed. The criterion is that of the verdict, and the heading is excepted. The configuration of the estimator is
/// used, without the imperfections of the hardware: they take accuracy, but leave nothing unobserved, and the rehearsal is
/// one long computation. The data of the estimator are discarded, and its configuration must be set again.
pub fn unobserved<T: Real, const SEGMENTS: usize>(
    estimator: &mut Estimator<T, SEGMENTS>,
    scheme: &Scheme,
) -> Option<u8> {
    let config = EstimatorConfig { hardware: Hardware::IDEAL, site_sigmas: SiteSigmas::EXACT, ..*estimator.config() };
    estimator.restart(&config);
    let model = MeasurementModel::<T>::new(&InstrumentErrors::default(), &config.site);
    let turning = scheme.turning();
    let mut start_us = 0;
    let mut take = |mut segment: Segment<T>| {
        segment.start_us = start_us;
        start_us += segment.duration_us;
        if segment.kind() == SegmentKind::Stop {
            segment.course = standing(model.force_at_stop(&segment).value);
        }
        segment.rotation_g = model.rotation(&segment).value;
        let _ = estimator.add(&segment);
    };
    let mut before: Option<Leg> = None;
    let count = scheme.moves() + 1;
    for (number, leg) in scheme.stops().enumerate() {
        if let Some(before) = before.replace(leg) {
            take(move_segment(&before, &leg, &turning));
        }
        let usable_s = usable_s(leg.stop_s, GUARD_S, number == 0, number + 1 == count);
        if usable_s > 0.0 {
            take(stop_segment(&leg, usable_s));
        }
    }
    let sigmas = estimator.estimate().sigmas;
    let wide = |(parameter, (sigma, prior)): (usize, (&f64, &f64))| {
        // A sigma that is NaN counts as not observed.
        let observed = *sigma <= OBSERVED_RATIO * prior || *prior == 0.0 || parameter == block::HEADING;
        (!observed).then_some(parameter as u8)
    };
    sigmas.iter().zip(&config.prior_sigmas()).enumerate().take(PARAMETERS).find_map(wide)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::method::Method;
    use crate::run::assignment::Assignment;
    use std::boxed::Box;

    fn config() -> EstimatorConfig {
        let Assignment::SelfCalibrate(config) = Assignment::default() else { unreachable!() };
        config.calibrator.estimator
    }

    fn unobserved_by<T: Real>(config: &EstimatorConfig, scheme: &Scheme) -> Option<u8> {
        let mut estimator = Box::new(Estimator::<T>::new());
        estimator.restart(config);
        unobserved(&mut *estimator, scheme)
    }

    #[test]
    fn schemes_that_leave_states_unobserved_are_found_in_either_precision() {
        let whole = Scheme::bai(10.0, 1);
        // Without a move of the inner axis, errors of the sensors along the outer axis cannot be separated.
        let mut outer_only = whole.clone();
        outer_only.legs.truncate(5);
        for found in [unobserved_by::<f64>, unobserved_by::<f32>] {
            assert_eq!(found(&config(), &whole), None);
            assert!(found(&config(), &outer_only).is_some());
        }
        let bai = EstimatorConfig { method: Method::Bai, period_moves: Some(18), ..config() };
        assert_eq!(unobserved_by::<f64>(&bai, &Scheme::bai(200.0, 2)), None);
    }

    #[test]
    fn stops_that_are_too_short_leave_parameters_unobserved() {
        assert!(unobserved_by::<f64>(&config(), &Scheme::bai(0.2, 1)).is_some());
    }
}
