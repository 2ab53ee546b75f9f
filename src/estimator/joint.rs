//! The estimator processes segments one by one and keeps a live estimate of all parameters.
//!
//! State: `[encoder errors of the stop before (2), of this stop (2), gyro errors at both ends of the segment (6),
//! flicker of the accelerometers (6), parameters (28), effects of the hardware]`. The encoder error of a stop acts on
//! the accelerometers at this stop and on the two moves that meet at this stop. Because the encoder errors are states,
//! the filter correlates these three measurements as they are correlated in the instrument. The encoder errors are
//! renewed at every move, and the flicker decays from segment to segment. Each segment updates the filter when the
//! segment ends, so estimate and covariance are live. After a stop [`super::passes`] linearizes all segments anew, and
//! it has the final pass over all segments.
//!
//! In the joint method, every stop gives specific force (M6) and angular rate (M7), and every move gives its rotation
//! (M7). [`super::bai`] has the paper's method, which uses the same filter with twelve of the states.

use super::configuration::{
    BEFORE_EFFECTS, BEFORE_FLICKER, BEFORE_PARAMETERS, EstimatorConfig, GYRO_ENDS, HeadingSource, KNOWN_LATITUDE_RAD,
    STATES, encoder_variance, prior_sigmas,
};
use super::constancy::{Seen, Suspects};
use super::filter::{Innovation, Measurement, Update};
use super::solution::{Estimate, Filter, Fit, Forces, SegmentInnovations, Solution, sigmas};
use super::sweep::Pass;
use crate::base::hardware::Hardware;
use crate::base::linear::{Matrix, Real, Vector, Vector3, columns, exp_so3, real, zeros};
use crate::base::method::Method;
use crate::base::sample::CHANNELS;
use crate::base::site::{Site, gravity_by_latitude};
use crate::model::effects::{
    self, EFFECT_STATES, EffectColumns, SiteSigmas, Situation, effect, force_columns, rotation_columns,
};
use crate::model::error_model::{InstrumentErrors, PARAMETERS, block};
use crate::model::measurement::{ENCODER_ERRORS, MeasurementModel, Prediction};
use crate::segment::readings::Readings;
use crate::segment::{Segment, SegmentKind, Standing};
use core::f64::consts::FRAC_PI_2;

/// Largest number of segments. Scheme "bai" with two periods has 73 segments.
pub const MAX_SEGMENTS: usize = 76;

/// Number of encoder errors of one stop: outer and inner.
const ENCODER_ERRORS_PER_STOP: usize = 2;

/// Number of segments that one piece of a sweep processes. A sample interval of 5 ms has 2.5 million instructions on a
/// Cortex-M7 at 500 MHz.
pub(super) const SEGMENTS_PER_PIECE: usize = 1;

/// Standard deviation of the rounding error of a sum and of its prediction, in units of the spacing of numbers.
const ROUNDING_EPSILONS: f64 = 0.5;

/// Turn over which an axis arrives from a side, rad. Hunting turns it less.
pub const LEAST_TURN_RAD: f64 = 1e-2;

/// An encoder step may change at the start or at the end of a move instead of half way. The error is then half of the
/// step, and this is the square of one half.
const PASSING_PART: f64 = 0.25;

/// Estimates the parameters from segments.
#[derive(Clone, Debug)]
pub struct Estimator<T: Real, const SEGMENTS: usize = MAX_SEGMENTS> {
    pub(super) config: EstimatorConfig,
    pub(super) segments: heapless::Vec<Segment<T>, SEGMENTS>,
    pub(super) left_out: u16,
    /// Mean of the prior: zero for all parameters but the attitude, which comes from the coarse alignment.
    pub(super) start: Vector<T, PARAMETERS>,
    /// Linearization point. The state of the filter is the deviation from this point.
    pub(super) nominal: Vector<T, PARAMETERS>,
    pub(super) filter: Filter<T>,
    /// The effects in use, in the order of their states.
    pub(super) effects: heapless::Vec<u8, EFFECT_STATES>,
    /// The site about which the measurements are linearized.
    pub(super) site: Site,
    /// Latitude from the configuration or from the coarse alignment, rad, and its sigma: the prior.
    pub(super) start_latitude_rad: f64,
    pub(super) latitude_sigma_rad: f64,
    /// Latitude from the coarse alignment, rad.
    pub(super) coarse_latitude_rad: f64,
    /// Last step of the latitude about which the measurements are linearized, rad.
    pub(super) latitude_step_rad: f64,
    pub(super) fit: Fit,
    /// Innovations of the accelerometers at the stops.
    pub(super) forces: Forces,
    /// Reference time of biases and attitude, us.
    pub(super) reference_us: u64,
    /// Factor on the configured noise variance for each channel, from the last stop.
    pub(super) allowances: [f64; CHANNELS],
    /// Readings of the encoders at the last stop.
    pub(super) readings: [Readings; 2],
    /// Middle of the last segment, us; 0 before the first one.
    pub(super) last_middle_us: u64,
    /// Senses in which the axes last turned.
    pub(super) arrivals: [i8; 2],
    pub(super) pass: Pass<T>,
    /// Solution of the final pass. It is complete when the pass is done.
    pub(super) solution: Option<Solution>,
    /// Changes under test. They are tested in the last part of the final pass only.
    pub(super) suspects: Suspects,
    /// Innovations of the segments that the last piece has processed.
    pub(super) innovations: heapless::Vec<SegmentInnovations, SEGMENTS_PER_PIECE>,
}

impl<T: Real, const SEGMENTS: usize> Default for Estimator<T, SEGMENTS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real, const SEGMENTS: usize> Estimator<T, SEGMENTS> {
    /// An estimator without configuration or data.
    pub const fn new() -> Self {
        Self {
            config: EstimatorConfig::UNKNOWN,
            segments: heapless::Vec::new(),
            left_out: 0,
            start: zeros(),
            nominal: zeros(),
            filter: Filter::CERTAIN,
            effects: heapless::Vec::new(),
            site: EstimatorConfig::UNKNOWN.site,
            start_latitude_rad: 0.0,
            latitude_sigma_rad: 0.0,
            coarse_latitude_rad: 0.0,
            latitude_step_rad: 0.0,
            fit: Fit::NONE,
            forces: Forces::NONE,
            reference_us: 0,
            allowances: [1.0; CHANNELS],
            readings: [Readings::NONE; 2],
            last_middle_us: 0,
            arrivals: [0; 2],
            pass: Pass::Idle,
            solution: None,
            suspects: Suspects::NONE,
            innovations: heapless::Vec::new(),
        }
    }

    /// Discards all data and starts again with this configuration.
    pub fn restart(&mut self, config: &EstimatorConfig) {
        self.configure(config);
        self.site = config.site;
        self.start_latitude_rad = config.site.latitude_rad;
        self.latitude_sigma_rad = config.latitude_sigma_rad();
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

    /// Takes hardware of other sizes. The next final pass solves the same segments with them; until then, the estimate
    /// is that of the sizes before.
    pub fn take_hardware(&mut self, hardware: &Hardware) {
        self.configure(&EstimatorConfig { hardware: *hardware, ..self.config });
        (self.pass, self.solution) = (Pass::Idle, None);
    }

    fn configure(&mut self, config: &EstimatorConfig) {
        self.config = *config;
        self.effects.clear();
        for (effect, sigma) in (0_u8..).zip(config.effect_sigmas()).take(EFFECT_STATES) {
            if sigma > 0.0 {
                // The vector has room for all effects that have a state.
                let _ = self.effects.push(effect);
            }
        }
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
            let increments = standing.increments;
            for earlier in &mut self.segments {
                earlier.know_resolution(resolution_ticks);
                earlier.know_increments(increments);
            }
            if self.segments.len() == 1 {
                self.start = self.coarse_alignment(segment, &standing.force_a);
                self.site.latitude_rad = self.start_latitude_rad;
                self.nominal = self.start;
                self.reference_us = segment.start_us;
            }
        }
        let number = self.segments.len() - 1;
        if self.is_refreshing() {
            // The sweep under way processes this segment too.
            return !segment.is_broken();
        }
        let moves_before = self.moves_before(number);
        let used = self.process(number, segment, moves_before, self.config.period_moves);
        self.absorb();
        used
    }

    /// The live estimate.
    pub fn estimate(&self) -> Estimate {
        Estimate {
            errors: InstrumentErrors::from_vector(&self.nominal.map(Real::widened)),
            sigmas: sigmas(&self.filter, BEFORE_PARAMETERS),
        }
    }

    /// Row `parameter` of the covariance of the parameters, (28), SI.
    pub fn covariance_row(&self, parameter: usize) -> Vector<T, PARAMETERS> {
        self.filter
            .covariance_row(BEFORE_PARAMETERS + parameter)
            .fixed_rows::<PARAMETERS>(BEFORE_PARAMETERS)
            .into_owned()
    }

    /// The filter. Its states are [`STATES`].
    pub fn filter(&self) -> &Filter<T> {
        &self.filter
    }

    /// The effects that have a state in the filter, in the order of their states behind the parameters.
    pub fn effects(&self) -> &[u8] {
        &self.effects
    }

    /// The state of an effect; `None` if the effect is absent.
    pub(super) fn state_of(&self, effect: usize) -> Option<usize> {
        self.effects.iter().position(|used| usize::from(*used) == effect).map(|place| BEFORE_EFFECTS + place)
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
        (self.last_middle_us, self.arrivals) = (0, [0; 2]);
    }

    /// Encoder readings at the stop after segment `number`. If this stop has not ended yet, the readings at the last
    /// stop.
    fn readings_after(&self, number: usize) -> [Readings; 2] {
        let next = self.segments.get(number + 1).and_then(Segment::standing);
        next.map_or(self.readings, |standing| standing.readings)
    }

    /// Sets the filters to the prior.
    pub(super) fn restart_filters(&mut self, gate_sigma: Option<f64>) {
        let site_sigmas = SiteSigmas { latitude_rad: self.latitude_sigma_rad, ..self.config.site_sigmas };
        let prior = prior_sigmas(&EstimatorConfig { site_sigmas, ..self.config });
        self.filter.restart(&prior, BEFORE_EFFECTS + self.effects.len(), gate_sigma.map(real));
    }

    /// Moves the linearization point to the estimate.
    pub(super) fn absorb(&mut self) {
        let mut deviation = self.filter.state_mut().fixed_rows_mut::<PARAMETERS>(BEFORE_PARAMETERS);
        self.nominal += &deviation;
        deviation.fill(T::zero());
        let latitude = self.state_of(effect::LATITUDE);
        if let Some(deviation) = latitude.and_then(|state| self.filter.state_mut().get_mut(state)) {
            // A poor early estimate must not leave the Earth.
            let latitude_rad = self.site.latitude_rad + deviation.widened();
            let latitude_rad = latitude_rad.clamp(-FRAC_PI_2, FRAC_PI_2);
            self.latitude_step_rad = latitude_rad - core::mem::replace(&mut self.site.latitude_rad, latitude_rad);
            *deviation = T::zero();
        }
        if self.config.method == Method::Bai {
            self.level();
        }
    }

    /// Processes segment `number`, counted from 0, which comes after `moves_before` moves. `period_moves` is the number
    /// of moves in period one, for the paper's method. Returns whether the segment is used.
    pub(super) fn process(
        &mut self,
        number: usize,
        segment: &Segment<T>,
        moves_before: u16,
        period_moves: Option<u16>,
    ) -> bool {
        match self.config.method {
            Method::Joint => self.process_jointly(number, segment),
            Method::Bai => self.process_by_bai(number, segment, moves_before, period_moves),
        }
    }

    fn process_jointly(&mut self, number: usize, segment: &Segment<T>) -> bool {
        if segment.kind() == SegmentKind::Move {
            let encoder = encoder_variance(&self.config);
            let variance = |readings: Readings| real(encoder + readings.mean_variance());
            let variances = self.readings_after(number).map(variance);
            self.filter.renew_leading::<ENCODER_ERRORS_PER_STOP>(&variances);
        }
        self.suspects.begin(number as u16, segment);
        let arrived = self.arrivals;
        for (arrival, turned) in self.arrivals.iter_mut().zip([segment.turned.outer, segment.turned.inner]) {
            let turned = turned.widened();
            if turned.abs() > LEAST_TURN_RAD {
                *arrival = if turned > 0.0 { 1 } else { -1 };
            }
        }
        self.renew_gyro_ends(number);
        self.pass_time(segment);
        let now = self.situation(segment, arrived);
        if let Some(standing) = segment.standing() {
            self.allowances = self.config.noise.allowances(&self.config.hardware, segment);
            self.readings = standing.readings;
        }
        if segment.is_broken() {
            return false;
        }
        let model = MeasurementModel::new(&InstrumentErrors::from_vector(&self.nominal), &self.site);
        if let Some(standing) = segment.standing() {
            self.process_force(number, (segment, standing), &model, &now);
        }
        self.process_rotation(number, segment, &model, &now);
        true
    }

    // This function and the next one are not inlined, so that they use the same stack one after the other.
    #[inline(never)]
    fn process_force(
        &mut self,
        number: usize,
        (segment, standing): (&Segment<T>, &Standing<T>),
        model: &MeasurementModel<T>,
        now: &Situation<T>,
    ) {
        let psd_sqrt: T = real(self.config.noise.accel_psd_sqrt);
        let [x, y, z, ..] = self.allowances.map(real::<T>);
        let white = Vector3::new(x, y, z) * (psd_sqrt * psd_sqrt / segment.duration_s());
        let prediction = model.force_at_stop(segment);
        let in_g = prediction.in_g.map(Real::widened).into();
        let duration_s = segment.duration_s().widened();
        let [x, y, z, ..] = self.pulses(segment, standing);
        let gravity = self.site.gravity_m_s2();
        let noise = effects::force_noise(&self.config.hardware, &in_g, duration_s, &[x, y, z], gravity);
        let variance = white + Vector3::from(noise.map(real::<T>));
        let columns = force_columns(&prediction, now);
        let flicker = effects::by_flicker(duration_s);
        self.take_in(&standing.force_a, (&prediction, &columns, flicker), variance, (number, 0));
    }

    #[inline(never)]
    fn process_rotation(
        &mut self,
        number: usize,
        segment: &Segment<T>,
        model: &MeasurementModel<T>,
        now: &Situation<T>,
    ) {
        let psd_sqrt: T = real(self.config.noise.gyro_psd_sqrt);
        let [.., x, y, z] = self.allowances.map(real::<T>);
        let white = Vector3::new(x, y, z) * (psd_sqrt * psd_sqrt * segment.duration_s());
        let mut prediction = model.rotation(segment);
        let mut variance = white + self.ends_variance(number, segment, model, &prediction);
        let is_move = segment.kind() == SegmentKind::Move;
        if !is_move {
            // The encoder error is the same at both ends of a stop, so it does not act on the rotation.
            prediction.by_encoder_errors.fill(T::zero());
            prediction.by_geometry.fill(T::zero());
        }
        let noise = effects::rotation_noise(&self.config.hardware, segment.duration_s().widened());
        variance += Vector3::repeat(real(noise));
        let columns = rotation_columns(&prediction, segment, now);
        let ends = if number.is_multiple_of(2) { [1.0, -1.0] } else { [-1.0, 1.0] };
        self.take_in(&segment.rotation_g, (&prediction, &columns, ends), variance, (number, 3));
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

    /// Increments of the pulse outputs per channel at a stop, m/s and rad.
    fn pulses(&self, stop: &Segment<T>, standing: &Standing<T>) -> [f64; CHANNELS] {
        let interval_s = stop.duration_s().widened() as f32 / stop.samples.max(1) as f32;
        effects::pulses(&self.config.hardware, &standing.increments.map(|increment| increment * interval_s))
    }

    /// When a segment was. The axes arrived at the stop before it in these senses.
    fn situation(&self, segment: &Segment<T>, arrived: [i8; 2]) -> Situation<T> {
        let begun_us = self.segments.first().map_or(segment.start_us, |first| first.start_us);
        let since_s = |time_us: u64| real(time_us.wrapping_sub(begun_us).cast_signed() as f64 * 1e-6);
        let measured = self.site.measured_gravity_m_s2.is_some();
        Situation {
            from_s: since_s(segment.start_us),
            duration_s: segment.duration_s(),
            reference_s: since_s(self.reference_us),
            arrivals: [arrived, self.arrivals].map(|both| both.map(|sense| real(f64::from(sense)))),
            latitude_rad: self.site.latitude_rad,
            gravity_by_latitude: if measured { 0.0 } else { gravity_by_latitude(self.site.latitude_rad) },
        }
    }

    /// The end of the last segment is the start of segment `number`, whose end has a new error. The two ends change
    /// places from segment to segment.
    fn renew_gyro_ends(&mut self, number: usize) {
        let stops = || self.segments.iter().take(number + 1).rev();
        let last = stops().find_map(|stop| Some((stop, stop.standing()?)));
        let [.., x, y, z] = last.map_or([0.0; CHANNELS], |(stop, standing)| self.pulses(stop, standing));
        let variances = effects::gyro_end_variances(&self.config.hardware, &[x, y, z]);
        let new = number % 2 * (GYRO_ENDS / 2);
        let ends = if number == 0 { 0..GYRO_ENDS } else { new..new + GYRO_ENDS / 2 };
        for (end, variance) in ends.zip(variances.into_iter().cycle()) {
            if variance > 0.0 {
                self.filter.renew_state(ENCODER_ERRORS + end, real(variance));
                self.suspects.scale_state(ENCODER_ERRORS + end, 0.0);
            }
        }
    }

    /// Lets the flicker decay from the middle of the last segment to the middle of this one, and adds the random walk
    /// of the biases over this segment.
    // Not inlined, so that its stack is free again when the segment is processed.
    #[inline(never)]
    fn pass_time(&mut self, segment: &Segment<T>) {
        let hardware = self.config.hardware;
        let middle_us = segment.start_us + segment.duration_us / 2;
        let before_us = core::mem::replace(&mut self.last_middle_us, middle_us);
        if hardware.accel_floor > 0.0 && before_us > 0 {
            let decays = effects::flicker_decay(middle_us.saturating_sub(before_us) as f64 * 1e-6);
            let each = decays.into_iter().flat_map(|decay| [decay; 3]);
            let sigmas = effects::flicker_sigmas(&hardware);
            for ((state, decay), sigma) in (BEFORE_FLICKER..).zip(each).zip(sigmas) {
                self.filter.scale_state(state, real(decay));
                self.filter.inflate_state(state, real(sigma * sigma * (1.0 - decay * decay)));
                self.suspects.scale_state(state, decay as f32);
            }
        }
        let walks = effects::walk_variances(&hardware);
        for (first, walk) in
            [block::ACCEL_BIAS, block::GYRO_BIAS].into_iter().zip(walks).filter(|(_, walk)| *walk > 0.0)
        {
            let variance = real::<T>(walk) * segment.duration_s();
            for bias in BEFORE_PARAMETERS + first..BEFORE_PARAMETERS + first + 3 {
                self.filter.inflate_state(bias, variance);
            }
        }
    }

    /// Updates the filter with the three channels one by one, because white sensor noise is independent from channel to
    /// channel. The variance of rounding the sums is added to the noise variance. Rounding matters in `f32` only.
    fn take_in(
        &mut self,
        measured: &Vector3<T>,
        // The last two are the derivatives of each sensor by its own noise: its flicker, or its errors at the two ends.
        derivatives: (&Prediction<T>, &EffectColumns<T>, [f64; 2]),
        variance: Vector3<T>,
        (segment, first_channel): (usize, u8),
    ) {
        let residual = measured - derivatives.0.value;
        let rounding = rounding_variance(measured.norm());
        for ((z, channel), (row, variance)) in residual.iter().zip(first_channel..).zip((0..3).zip(variance.iter())) {
            self.take_in_channel((*z, *variance + rounding), derivatives, row, (segment, channel));
        }
    }

    #[inline(never)]
    fn take_in_channel(
        &mut self,
        (z, r): (T, T),
        (prediction, effects, by_noise): (&Prediction<T>, &EffectColumns<T>, [f64; 2]),
        row: usize,
        (segment, channel): (usize, u8),
    ) {
        let mut measurement = Measurement { z, h: Vector::<T, STATES>::zeros(), r };
        let h = &mut measurement.h;
        let of_row = |column: &[T; 3]| column.get(row).copied().unwrap_or(T::zero());
        let encoders = columns(&prediction.by_encoder_errors).iter().map(of_row);
        let of_sensor =
            by_noise.into_iter().flat_map(|by| [0, 1, 2].map(|axis| if axis == row { real(by) } else { T::zero() }));
        let (ends, flicker) = if channel < 3 { (T::zero(), T::one()) } else { (T::one(), T::zero()) };
        let of_ends = of_sensor.clone().map(|by| by * ends);
        let of_flicker = of_sensor.map(|by| by * flicker);
        let parameters = columns(&prediction.by_parameters).iter().map(of_row);
        let in_use =
            self.effects.iter().map(|effect| columns(effects).get(usize::from(*effect)).map_or(T::zero(), of_row));
        let all = encoders.chain(of_ends).chain(of_flicker).chain(parameters).chain(in_use);
        h.iter_mut().zip(all).for_each(|(h, value)| *h = value);
        let (update, gain) = self.filter.update(&measurement);
        self.note(&update, r, segment, channel);
        if let Update::Applied(Innovation { value: innovation, variance }) = update {
            self.suspects.see(&Seen {
                h: &measurement.h,
                gain: &gain,
                innovation,
                variance,
                segment: segment as u16,
                channel,
                by_attitude_rate: row_of(&prediction.by_attitude_rate, row),
                by_earth_rate: row_of(&prediction.by_earth_rate, row),
                by_effects: effects,
                row,
                in_g: prediction.in_g.map(Real::widened).into(),
            });
        }
    }

    /// Notes the outcome of a measurement with the noise variance `r` on this channel of this segment.
    pub(super) fn note(&mut self, update: &Update<T>, r: T, segment: usize, channel: u8) {
        self.fit.note(update, segment, channel);
        if channel < 3 {
            self.forces.note(update, r);
        }
        let normalized = match update {
            Update::Applied(innovation) | Update::Gated(innovation) => innovation.normalized().widened() as f32,
            Update::Refused => return,
        };
        let last = self.innovations.last_mut();
        if let Some(place) = last.and_then(|last| last.normalized.get_mut(usize::from(channel))) {
            *place = Some(normalized);
        }
    }

    /// Attitude from the first stop, computed as for perfect sensors: levelling, then gyrocompassing. If the latitude
    /// is not known, it follows from the direction of the Earth rate.
    fn coarse_alignment(&mut self, stop: &Segment<T>, force_a: &Vector3<T>) -> Vector<T, PARAMETERS> {
        let rot_rr0 = InstrumentErrors::<T>::default().rot_rr0(stop.outer, stop.inner);
        let force_b = rot_rr0.transpose() * force_a;
        let rotation_b = rot_rr0.transpose() * stop.rotation_g;
        let (attitude, levelled) = level_attitude(&force_b, &rotation_b, &self.config.heading);
        let latitude_rad = levelled.z.atan2(levelled.x.hypot(levelled.y)).widened();
        self.coarse_latitude_rad = if latitude_rad.is_finite() { latitude_rad } else { 0.0 };
        if self.latitude_sigma_rad > KNOWN_LATITUDE_RAD {
            self.start_latitude_rad = self.coarse_latitude_rad;
        }
        let mut start = Vector::<T, PARAMETERS>::zeros();
        start.fixed_rows_mut::<3>(block::ATTITUDE).copy_from(&attitude);
        start
    }

    fn moves_before(&self, number: usize) -> u16 {
        let is_move = |segment: &&Segment<T>| segment.kind() == SegmentKind::Move;
        self.segments.iter().take(number).filter(is_move).count() as u16
    }
}

/// Variance of the rounding error of a measured vector and its prediction, in each channel. `size` is the magnitude of
/// the vector.
pub(super) fn rounding_variance<T: Real>(size: T) -> T {
    let rounding = size * real(ROUNDING_EPSILONS * T::EPSILON);
    rounding * rounding
}

/// Roll, pitch and heading of the base from the specific force and the rotation in b: levelling, then gyrocompassing.
/// The second value is the rotation in the level frame.
pub(super) fn level_attitude<T: Real>(
    force_b: &Vector3<T>,
    rotation_b: &Vector3<T>,
    source: &HeadingSource,
) -> (Vector3<T>, Vector3<T>) {
    let roll = force_b.y.atan2(force_b.z);
    let pitch = (-force_b.x).atan2(force_b.y.hypot(force_b.z));
    let zero = T::zero();
    let levelled = exp_so3(&Vector3::new(zero, pitch, zero)) * exp_so3(&Vector3::new(roll, zero, zero)) * rotation_b;
    let heading = match source {
        HeadingSource::Gyrocompass => (-levelled.x).atan2(levelled.y),
        HeadingSource::Configured { heading_rad, .. } => real(*heading_rad),
    };
    (Vector3::new(roll, pitch, heading), levelled)
}

/// A row of a matrix.
fn row_of<T: Real, const C: usize>(matrix: &Matrix<T, 3, C>, row: usize) -> [T; C] {
    let columns = columns(matrix);
    core::array::from_fn(|column| columns.get(column).and_then(|column| column.get(row)).copied().unwrap_or(T::zero()))
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

    #[test]
    fn a_day_between_two_stops_only_renews_the_flicker() {
        let Assignment::SelfCalibrate(config) = Assignment::default() else { unreachable!() };
        let mut estimator = Estimator::<f64>::new();
        estimator.restart(&config.calibrator.estimator);
        let first = Segment::quiet_stop(60_000_000);
        let second = Segment { start_us: 86_400_000_000, ..first };
        assert!(estimator.add(&first) && estimator.add(&second));
        let deviations = estimator.filter.variances().map(f64::sqrt);
        assert!(deviations.iter().all(|sigma| sigma.is_finite()), "{deviations}");
        let flicker = effects::flicker_sigmas(&config.calibrator.estimator.hardware);
        for (sigma, prior) in deviations.iter().skip(BEFORE_FLICKER).zip(flicker) {
            // The second stop alone tells little of them.
            assert!(*sigma > 0.5 * prior && *sigma <= prior * (1.0 + 1e-9), "{sigma} of {prior}");
        }
    }
}
