//! The estimator processes segments one by one and keeps a live estimate of all parameters.
//!
//! State: `[encoder errors of the stop before (2), of this stop (2), parameters (28), optional states]`. The encoder
//! error of a stop acts on the accelerometers at this stop and on the two moves that meet at this stop. Because the
//! encoder errors are states, the filter correlates these three measurements as they are correlated in the instrument.
//! The encoder errors are renewed at every move. Each segment updates the filter when the segment ends, so estimate
//! and covariance are live. [`super::passes`] has the final pass over all segments.
//!
//! In the joint method, every stop gives specific force (M6) and angular rate (M7), and every move gives its rotation
//! (M7). [`super::two_stage`] has the differences of the paper's method.

use super::configuration::{BASIC_STATES, EstimatorConfig, HeadingSource, prior_sigmas};
use super::constancy::{Seen, Suspects};
use super::filter::{Innovation, Measurement, UdFilter, Update};
use super::solution::{Estimate, Fit, SegmentInnovations, Solution, sigmas};
use super::sweep::Pass;
use super::two_stage::{STAGE_ONE, StageOneGains, Use, common_accel_scale};
use crate::base::linear::{Real, Vector, Vector3, columns, exp_so3, real, zeros};
use crate::base::method::Method;
use crate::base::sample::CHANNELS;
use crate::model::error_model::{InstrumentErrors, PARAMETERS, block};
use crate::model::measurement::{ENCODER_ERRORS, MeasurementModel, Prediction};
use crate::model::options::{OptionalColumns, force_columns, rotation_columns};
use crate::segment::readings::Readings;
use crate::segment::{Segment, SegmentKind, Standing};

/// Largest number of segments. Scheme "bai" with two periods has 73 segments.
pub const MAX_SEGMENTS: usize = 76;

/// Number of encoder errors of one stop: outer and inner.
const ENCODER_ERRORS_PER_STOP: usize = 2;

/// Number of segments that one piece of the final pass processes. A piece takes 0.4 million instructions with changes
/// under test, and 0.7 million with the optional states. A sample interval of 5 ms has 2.5 million instructions on a
/// Cortex-M7 at 500 MHz.
pub(super) const SEGMENTS_PER_PIECE: usize = 4;

/// Standard deviation of the rounding error of a sum and of its prediction, in units of the spacing of numbers.
const ROUNDING_EPSILONS: f64 = 0.5;

/// An encoder step may change at the start or at the end of a move instead of half way. The error is then half of the
/// step, and this is the square of one half.
const PASSING_PART: f64 = 0.25;

/// Estimates the parameters from segments.
#[derive(Clone, Debug)]
pub struct Estimator<T: Real, const SEGMENTS: usize = MAX_SEGMENTS, const STATES: usize = BASIC_STATES> {
    pub(super) config: EstimatorConfig,
    pub(super) segments: heapless::Vec<Segment<T>, SEGMENTS>,
    pub(super) left_out: u16,
    /// Mean of the prior: zero for all parameters but the attitude, which comes from the coarse alignment.
    pub(super) start: Vector<T, PARAMETERS>,
    /// Linearization point. The state of the filter is the deviation from this point.
    pub(super) nominal: Vector<T, PARAMETERS>,
    pub(super) filter: UdFilter<T, STATES>,
    /// Gains of stage 1 of the two-stage method.
    pub(super) stage_one_gains: StageOneGains<T>,
    pub(super) fit: Fit,
    /// Reference time of biases, attitude and optional rates, us.
    pub(super) reference_us: u64,
    /// Factor on the configured noise variance for each channel, from the last stop.
    pub(super) allowances: [f64; CHANNELS],
    /// Readings of the encoders at the last stop.
    pub(super) readings: [Readings; 2],
    pub(super) pass: Pass<T>,
    /// Solution of the final pass. It is complete when the pass is done.
    pub(super) solution: Option<Solution>,
    /// Changes under test. They are tested in the last part of the final pass only.
    pub(super) suspects: Suspects<STATES>,
    /// Innovations of the segments that the last piece has processed.
    pub(super) innovations: heapless::Vec<SegmentInnovations, SEGMENTS_PER_PIECE>,
}

impl<T: Real, const SEGMENTS: usize, const STATES: usize> Default for Estimator<T, SEGMENTS, STATES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real, const SEGMENTS: usize, const STATES: usize> Estimator<T, SEGMENTS, STATES> {
    /// An estimator without configuration or data.
    pub const fn new() -> Self {
        Self {
            config: EstimatorConfig::UNKNOWN,
            segments: heapless::Vec::new(),
            left_out: 0,
            start: zeros(),
            nominal: zeros(),
            filter: UdFilter::CERTAIN,
            stage_one_gains: StageOneGains::NONE,
            fit: Fit::NONE,
            reference_us: 0,
            allowances: [1.0; CHANNELS],
            readings: [Readings::NONE; 2],
            pass: Pass::Idle,
            solution: None,
            suspects: Suspects::NONE,
            innovations: heapless::Vec::new(),
        }
    }

    /// Discards all data and starts again with this configuration.
    pub fn restart(&mut self, config: &EstimatorConfig) {
        self.config = *config;
        self.segments.clear();
        self.left_out = 0;
        self.start.fill(T::zero());
        self.nominal.fill(T::zero());
        self.restart_filters(config.gate_sigma);
        self.fit = Fit::NONE;
        self.forget_last_stop();
        (self.pass, self.solution) = (Pass::Idle, None);
        self.suspects.clear();
    }

    /// Processes a finished segment and updates the live estimate. Returns whether the segment is used. A move before
    /// the first stop is not used, nor is a segment that is broken by a gap, nor a segment for which there is no
    /// memory.
    pub fn add(&mut self, segment: &Segment<T>) -> bool {
        if self.segments.is_empty() && segment.kind() == SegmentKind::Move {
            return false;
        }
        if self.segments.push(*segment).is_err() {
            self.left_out = self.left_out.saturating_add(1);
            return false;
        }
        if let Some(standing) = segment.standing() {
            // The resolution of an encoder becomes better known with every stop, so it is set for the earlier stops
            // too.
            let resolution_ticks = standing.readings.map(|readings| readings.resolution_ticks);
            self.segments.iter_mut().for_each(|earlier| earlier.know_resolution(resolution_ticks));
            if self.segments.len() == 1 {
                self.start = self.coarse_alignment(segment, &standing.force_a);
                self.nominal = self.start;
                self.reference_us = segment.start_us;
            }
        }
        let number = self.segments.len() - 1;
        let moves_before = self.moves_before(number);
        let used = self.process(number, segment, self.use_of(segment.kind(), moves_before, self.config.period_moves));
        self.absorb();
        used
    }

    /// The live estimate.
    pub fn estimate(&self) -> Estimate {
        Estimate {
            errors: InstrumentErrors::from_vector(&self.nominal.map(Real::widened)),
            sigmas: sigmas(&self.filter, ENCODER_ERRORS),
        }
    }

    /// Row `parameter` of the covariance of the parameters, (28), SI.
    pub fn covariance_row(&self, parameter: usize) -> Vector<T, PARAMETERS> {
        self.filter.covariance_row(ENCODER_ERRORS + parameter).fixed_rows::<PARAMETERS>(ENCODER_ERRORS).into_owned()
    }

    /// The filter. Its states are encoder errors, parameters and optional states.
    pub fn filter(&self) -> &UdFilter<T, STATES> {
        &self.filter
    }

    /// The configuration of the last restart.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// The segments so far, including those that are broken by a gap.
    pub fn segments(&self) -> &[Segment<T>] {
        &self.segments
    }

    pub(super) fn forget_last_stop(&mut self) {
        (self.allowances, self.readings) = ([1.0; CHANNELS], [Readings::NONE; 2]);
    }

    /// Encoder readings at the stop after segment `number`. If this stop has not ended yet, the readings at the last
    /// stop.
    fn readings_after(&self, number: usize) -> [Readings; 2] {
        let next = self.segments.get(number + 1).and_then(Segment::standing);
        next.map_or(self.readings, |standing| standing.readings)
    }

    /// Sets the filters to the prior.
    pub(super) fn restart_filters(&mut self, gate_sigma: Option<f64>) {
        let prior = prior_sigmas(&self.config);
        self.filter.restart(&prior, gate_sigma.map(real));
        if self.config.method == Method::TwoStage {
            let scale = common_accel_scale();
            self.filter.inflate(&scale, T::one());
            self.stage_one_gains.restart(&(prior + scale));
        }
    }

    /// Moves the linearization point to the estimate.
    pub(super) fn absorb(&mut self) {
        let mut deviation = self.filter.state_mut().fixed_rows_mut::<PARAMETERS>(ENCODER_ERRORS);
        self.nominal += &deviation;
        deviation.fill(T::zero());
    }

    /// The measurements that are used of a segment of this kind after `moves_before` moves.
    pub(super) fn use_of(&self, kind: SegmentKind, moves_before: u16, period_moves: Option<u16>) -> Use {
        let is_stop = kind == SegmentKind::Stop;
        let gyrocompass = is_stop && moves_before == 0 && self.config.heading == HeadingSource::Gyrocompass;
        match self.config.method {
            Method::Joint => Use { force: is_stop, rotation: true, considered: false },
            Method::TwoStage => Use::in_two_stages(is_stop, moves_before, period_moves, gyrocompass),
        }
    }

    /// Processes segment `number`, counted from 0. Returns whether the segment is used.
    pub(super) fn process(&mut self, number: usize, segment: &Segment<T>, usage: Use) -> bool {
        if segment.kind() == SegmentKind::Move {
            let sigma = self.config.noise.encoder_sigma_rad;
            let variance = |readings: Readings| real(sigma * sigma + readings.mean_variance());
            let variances = self.readings_after(number).map(variance);
            self.filter.renew_leading::<ENCODER_ERRORS_PER_STOP>(&variances);
        }
        self.suspects.begin(number as u16, segment);
        if self.config.method == Method::Joint {
            self.walk(segment);
        }
        let since_s = self.since_reference_s(segment);
        if let Some(standing) = segment.standing() {
            self.allowances = self.config.noise.allowances(segment);
            self.readings = standing.readings;
        }
        if segment.is_broken() {
            return false;
        }
        let model = MeasurementModel::new(&InstrumentErrors::from_vector(&self.nominal), &self.config.site);
        if let Some(standing) = segment.standing().filter(|_| usage.force) {
            self.process_force(number, (segment, standing), &model, since_s, usage);
        }
        if usage.rotation {
            self.process_rotation(number, segment, &model, since_s, usage);
        }
        usage.force || usage.rotation
    }

    // This function and the next one are not inlined, so that they use the same stack one after the other.
    #[inline(never)]
    fn process_force(
        &mut self,
        number: usize,
        (segment, standing): (&Segment<T>, &Standing<T>),
        model: &MeasurementModel<T>,
        since_s: T,
        usage: Use,
    ) {
        let psd_sqrt: T = real(self.config.noise.accel_psd_sqrt);
        let [x, y, z, ..] = self.allowances.map(real::<T>);
        let variance = Vector3::new(x, y, z) * (psd_sqrt * psd_sqrt / segment.duration_s());
        let prediction = model.force_at_stop(segment);
        let optional = force_columns(&prediction, since_s);
        self.take_in(&standing.force_a, (&prediction, &optional), variance, usage, (number, 0));
    }

    #[inline(never)]
    fn process_rotation(
        &mut self,
        number: usize,
        segment: &Segment<T>,
        model: &MeasurementModel<T>,
        since_s: T,
        usage: Use,
    ) {
        let psd_sqrt: T = real(self.config.noise.gyro_psd_sqrt);
        let [.., x, y, z] = self.allowances.map(real::<T>);
        let white = Vector3::new(x, y, z) * (psd_sqrt * psd_sqrt * segment.duration_s());
        let mut prediction = model.rotation(segment);
        let variance = white + self.ends_variance(number, segment, model, &prediction);
        if segment.kind() == SegmentKind::Stop {
            // The encoder error is the same at both ends of a stop, so it does not act on the rotation.
            prediction.by_encoder_errors.fill(T::zero());
            prediction.by_harmonics.fill(T::zero());
        }
        let optional = rotation_columns(&prediction, since_s);
        self.take_in(&segment.rotation_g, (&prediction, &optional), variance, usage, (number, 3));
    }

    /// Variance that the encoder readings at the ends of a segment add to its rotation, for each channel. Single
    /// readings act along the axes, in the direction that the axes have at that end. The inner reading also acts
    /// across while the outer axis turns, because the encoder step may change at any time during the move.
    fn ends_variance(
        &self,
        number: usize,
        segment: &Segment<T>,
        model: &MeasurementModel<T>,
        prediction: &Prediction<T>,
    ) -> Vector3<T> {
        let squares = |v: Vector3<T>| v.map(|by| by * by);
        let ends = [(segment.inner_from(), self.readings), (segment.inner, self.readings_after(number))];
        let mut variance = Vector3::zeros();
        for (inner, readings) in ends {
            for (axis, readings) in model.axes_at(inner).into_iter().zip(readings) {
                variance += squares(axis) * real::<T>(readings.variance());
            }
        }
        let steps = ends.iter().map(|(_, [_, inner])| inner.mean_variance()).sum::<f64>();
        let [_, before, _, after] = *columns(&prediction.by_encoder_errors);
        variance + squares(Vector3::from(before) + Vector3::from(after)) * real::<T>(PASSING_PART * steps)
    }

    /// Time from the reference time of biases and attitude to the middle of a segment, s.
    fn since_reference_s(&self, segment: &Segment<T>) -> T {
        let middle_us = segment.start_us + segment.duration_us / 2;
        real(middle_us.wrapping_sub(self.reference_us).cast_signed() as f64 * 1e-6)
    }

    /// Adds the random walk of the biases over a segment to the covariance.
    fn walk(&mut self, segment: &Segment<T>) {
        let options = &self.config.options;
        let walks = [(block::ACCEL_BIAS, options.accel_bias_walk), (block::GYRO_BIAS, options.gyro_bias_walk)];
        for (first, walk) in walks.into_iter().filter(|(_, walk)| *walk > 0.0) {
            let variance = real::<T>(walk * walk) * segment.duration_s();
            let first = ENCODER_ERRORS + first;
            for bias in first..first + 3 {
                let direction = Vector::from_fn(|state, _| if state == bias { T::one() } else { T::zero() });
                self.filter.inflate(&direction, variance);
            }
        }
    }

    /// Updates the filter with the three channels one by one, because white sensor noise is independent from channel to
    /// channel. The variance of rounding the sums is added to the noise variance. Rounding matters in `f32` only.
    fn take_in(
        &mut self,
        measured: &Vector3<T>,
        (prediction, optional): (&Prediction<T>, &OptionalColumns<T>),
        variance: Vector3<T>,
        usage: Use,
        (segment, first_channel): (usize, u8),
    ) {
        let residual = measured - prediction.value;
        let rounding = measured.norm() * real(ROUNDING_EPSILONS * T::EPSILON);
        let floor = measured.norm() * real(self.config.noise.encoder_sigma_rad);
        for ((z, channel), (row, variance)) in residual.iter().zip(first_channel..).zip((0..3).zip(variance.iter())) {
            let r = *variance + rounding * rounding;
            self.take_in_channel((*z, r, floor), (prediction, optional), row, usage, (segment, channel));
        }
    }

    #[inline(never)]
    fn take_in_channel(
        &mut self,
        (z, r, floor): (T, T, T),
        (prediction, optional): (&Prediction<T>, &OptionalColumns<T>),
        row: usize,
        usage: Use,
        (segment, channel): (usize, u8),
    ) {
        let weighted = self.config.method == Method::TwoStage && channel < 3;
        let zero = |gain: &mut T| *gain = T::zero();
        let mut measurement = Measurement { z, h: Vector::<T, STATES>::zeros(), r };
        let h = &mut measurement.h;
        let of_row = |column: &[T; 3]| column.get(row).copied().unwrap_or(T::zero());
        let encoders = columns(&prediction.by_encoder_errors).iter().map(of_row);
        let others = columns(&prediction.by_parameters).iter().chain(columns(optional)).map(of_row);
        let (by_encoders, by_others) = h.as_mut_slice().split_at_mut(ENCODER_ERRORS);
        by_encoders.iter_mut().zip(encoders).for_each(|(h, column)| *h = column);
        by_others.iter_mut().zip(others).for_each(|(h, column)| *h = column);
        let chosen = weighted.then(|| self.stage_one_gains.gain(h, r + floor * floor));
        let choose = |gain: &mut Vector<T, STATES>| match &chosen {
            Some(chosen) => gain.copy_from(chosen),
            None if usage.considered => gain.iter_mut().take(STAGE_ONE.end).skip(STAGE_ONE.start).for_each(zero),
            None => {}
        };
        let (update, gain) = self.filter.update(&measurement, choose);
        self.fit.note(&update, segment, channel);
        self.note_innovation(&update, channel);
        if let Update::Applied(Innovation { value: innovation, variance }) = update {
            self.suspects.see(&Seen {
                h: &measurement.h,
                gain: &gain,
                innovation,
                variance,
                segment: segment as u16,
                channel,
                by_attitude_rate: prediction.by_attitude_rate.row(row).transpose().into(),
                by_earth_rate: prediction.by_earth_rate.row(row).transpose().into(),
            });
        }
    }

    fn note_innovation(&mut self, update: &Update<T>, channel: u8) {
        let normalized = match update {
            Update::Applied(innovation) | Update::Gated(innovation) => innovation.normalized().widened() as f32,
            Update::Refused => return,
        };
        let last = self.innovations.last_mut();
        if let Some(place) = last.and_then(|last| last.normalized.get_mut(usize::from(channel))) {
            *place = Some(normalized);
        }
    }

    /// Attitude from the first stop, computed as for perfect sensors: levelling, then gyrocompassing.
    fn coarse_alignment(&self, stop: &Segment<T>, force_a: &Vector3<T>) -> Vector<T, PARAMETERS> {
        let rot_rr0 = InstrumentErrors::<T>::default().rot_rr0(stop.outer, stop.inner);
        let force_b = rot_rr0.transpose() * force_a;
        let rotation_b = rot_rr0.transpose() * stop.rotation_g;
        let roll = force_b.y.atan2(force_b.z);
        let pitch = (-force_b.x).atan2(force_b.y.hypot(force_b.z));
        let zero = T::zero();
        let levelled =
            exp_so3(&Vector3::new(zero, pitch, zero)) * exp_so3(&Vector3::new(roll, zero, zero)) * rotation_b;
        let heading = match self.config.heading {
            HeadingSource::Gyrocompass => (-levelled.x).atan2(levelled.y),
            HeadingSource::Configured { heading_rad, .. } => real(heading_rad),
        };
        let attitude = InstrumentErrors { base_roll: roll, base_pitch: pitch, heading, ..InstrumentErrors::default() };
        attitude.to_vector()
    }

    fn moves_before(&self, number: usize) -> u16 {
        let is_move = |segment: &&Segment<T>| segment.kind() == SegmentKind::Move;
        self.segments.iter().take(number).filter(is_move).count() as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::angle::Angle;
    use crate::base::units::DEG;
    use crate::run::assignment::Assignment;
    use crate::segment::{AngleIntegrals, Course, Turned};

    #[test]
    fn readings_at_the_ends_of_a_move_act_along_the_axes_at_that_end() {
        let Assignment::SelfCalibrate(config) = Assignment::default() else { unreachable!() };
        let config = config.calibrator.estimator;
        let mut estimator = Estimator::<f64>::new();
        estimator.restart(&config);
        let noisy = Readings { jumps_ticks2: 6e6, count: 1000, resolution_ticks: 0 };
        estimator.readings = [noisy, Readings::NONE];
        // The inner axis turns from 45 to 135 deg. The outer axis is normal to gyro x on average, but not at either
        // end.
        let turn = Segment {
            inner: Angle::from_rad(135.0 * DEG),
            turned: Turned { inner: 90.0 * DEG, ..Turned::default() },
            course: Course::Move(AngleIntegrals::default()),
            ..Segment::quiet_stop(6_000_000)
        };
        let model = MeasurementModel::new(&InstrumentErrors::default(), &config.site);
        let variance = estimator.ends_variance(1, &turn, &model, &model.rotation(&turn)) / noisy.variance();
        assert!((variance - Vector3::new(1.0, 1.0, 0.0)).norm() < 1e-6, "{variance}");
    }
}
