//! From segments to parameters: one filter, two methods.
//!
//! State: `[encoder errors of the stop before (2), of this stop (2), parameters (28), optional states]`. An encoder error belongs to the
//! accelerometers of its stop and to the two moves that meet there; carried as states they correlate all three as they
//! are, and are renewed at every move. Each segment updates the filter when it ends, so estimate and covariance are
//! live. At the end all segments are processed again about the last estimate until it stands (iterated Kalman filter,
//! Gauss-Newton), so no linearization error remains; then changes during the run are tested for (`constancy`). This final
//! pass is done piece by piece, some segments at a call, so that samples go on being taken in between.
//!
//! Joint method: every stop gives specific force and rate, every move its rotation.
//!
//! Two-stage method (Bai et al., Sensors 2019, 19, 4005, section 3):
//! - Stage 1, (11) at the stops of period one. Bai takes differences to the first stop, z1 = f_a0 - R^T f_a, which
//!   removes the specific force of the base and makes the first stop's error common to all. Here that force is a state (roll,
//!   pitch, and a scale common to the three accelerometers), which is the same estimate with the right covariance.
//! - Heading by gyrocompassing the first stop, or as configured.
//! - Stage 2, (13) in the moves of period two, integrated over each move. The mounting angles and the levelled attitude
//!   of stage 1 are considered: their values stay, their uncertainty counts.
//! - With one period only, both measurements are taken from it in one sweep, and nothing is left as considered: the
//!   same encoder errors act on both stages.

use crate::base::linear::{ComplexField, Real, Vector, Vector3, columns, exp_so3, real, zeros};
use crate::base::method::Method;
use crate::base::sample::CHANNELS;
use crate::base::site::Site;
use crate::base::units::{DEG, DEG_H};
use crate::estimator::constancy::{Seen, Settings, Suspects, Suspicion};
use crate::estimator::filter::{Innovation, Measurement, UdFilter, Update};
use crate::estimator::two_stage::Weights;
use crate::model::error_model::{InstrumentErrors, PARAMETERS, block};
use crate::model::measurement::{ENCODER_ERRORS, MeasurementModel, Prediction};
use crate::model::options::{
    OPTIONAL_STATES, OptionalColumns, OptionalEstimate, Options, force_columns, rotation_columns,
};
use crate::segment::readings::Readings;
use crate::segment::white_noise::Noise;
use crate::segment::{Segment, SegmentKind, Standing};
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// Segments that fit: scheme "bai" run twice has 73.
pub const MAX_SEGMENTS: usize = 76;

/// States of the filter without options.
pub const BASIC_STATES: usize = ENCODER_ERRORS + PARAMETERS;

/// States of the filter with room for all options.
pub const FULL_STATES: usize = BASIC_STATES + OPTIONAL_STATES;

/// Encoder errors of one stop.
const ENCODER_ERRORS_PER_STOP: usize = 2;

/// A parameter is observed if its sigma is at most this part of its prior sigma.
pub const OBSERVED_RATIO: f64 = 0.1;

/// Sweeps over the segments before the estimate must stand.
const MAX_SWEEPS: u8 = 24;

/// Segments processed by one piece of the final pass: 0.4 million instructions with changes under test, 0.7 million with
/// the optional states, of the 2.5 million that a sample interval of 5 ms has on a Cortex-M7 at 500 MHz.
const SEGMENTS_PER_PIECE: usize = 4;

/// The estimate stands when no parameter moves by more than this part of its sigma, and what rounding makes it jitter.
const STANDING: f64 = 0.01;
const JITTER_EPSILONS: f64 = 2.5e6;

/// Standard deviation of what rounding does to a sum and its prediction, in units of the spacing of numbers.
const ROUNDING_EPSILONS: f64 = 0.5;

/// A step that changes at the start of a move or at its end, not half way, is off by half of it.
const PASSING_PART: f64 = 0.25;

/// Where the heading comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum HeadingSource {
    /// The Earth rate felt at the first stop.
    #[default]
    Gyrocompass,
    /// The configuration.
    Configured {
        /// Bearing of the base's y axis, clockwise from north, rad.
        heading_rad: f64,
        /// Its uncertainty, rad.
        sigma_rad: f64,
    },
}

/// What the estimator must know.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EstimatorConfig {
    /// Joint or two-stage.
    pub method: Method,
    /// Where the instrument stands.
    pub site: Site,
    /// Noise of its sensors.
    pub noise: Noise,
    /// Where the heading comes from.
    pub heading: HeadingSource,
    /// Moves of period one, for the two-stage method; unknown, the periods are found from the stops' angles.
    pub period_moves: Option<u16>,
    /// Normalized innovation beyond which a measurement is kept out and counted; `None` keeps all.
    pub gate_sigma: Option<f64>,
    /// Further effects to be estimated or allowed for, by the joint method.
    pub options: Options,
}

impl EstimatorConfig {
    /// Sigmas of the parameters before any segment, SI; 0 for a parameter that the method takes as known.
    pub fn prior_sigmas(&self) -> [f64; PARAMETERS] {
        let common = |state: &usize| self.method == Method::TwoStage && ACCEL_SCALE.contains(state);
        let prior = prior_sigmas::<f64, BASIC_STATES>(self);
        let mut sigmas = [0.0; PARAMETERS];
        for ((state, prior), sigma) in prior.iter().enumerate().skip(ENCODER_ERRORS).zip(&mut sigmas) {
            *sigma = if common(&state) { COMMON_SCALE_SIGMA } else { *prior };
        }
        sigmas
    }

    /// Before there is one.
    const UNKNOWN: Self = Self {
        method: Method::Joint,
        site: Site { latitude_rad: 0.0, height_m: 0.0, measured_gravity_m_s2: None },
        noise: Noise { accel_psd_sqrt: 0.0, gyro_psd_sqrt: 0.0, encoder_sigma_rad: 0.0, margin: 1.0 },
        heading: HeadingSource::Gyrocompass,
        period_moves: None,
        gate_sigma: None,
        options: Options::NONE,
    };
}

/// Prior sigma of a block of parameters: wide, so that it carries no information worth mentioning.
struct Prior {
    states: Range<usize>,
    sigma: f64,
    two_stage: bool,
}

const fn prior(first: usize, count: usize, sigma: f64, two_stage: bool) -> Prior {
    let first = ENCODER_ERRORS + first;
    Prior { states: first..first + count, sigma, two_stage }
}

const PRIORS: [Prior; 10] = [
    prior(block::GYRO_NON_ORTHOGONALITY, 6, 3.0 * DEG, true),
    prior(block::ACCEL_NON_ORTHOGONALITY, 3, 3.0 * DEG, true),
    prior(block::MOUNTING, 3, 3.0 * DEG, true),
    prior(block::ACCEL_BIAS, 3, 0.2, false),
    prior(block::ACCEL_SCALE, 3, 0.02, false),
    prior(block::GYRO_BIAS, 3, 20.0 * DEG_H, false),
    prior(block::GYRO_SCALE, 3, 0.02, false),
    prior(block::NON_PERPENDICULARITY, 1, 0.3 * DEG, false),
    prior(block::ATTITUDE, 2, 20.0 * DEG, true),
    prior(block::ATTITUDE + 2, 1, 2.0, true),
];

/// The innovation farthest from what was expected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LargestInnovation {
    /// In units of its standard deviation.
    pub normalized: f64,
    /// Segment, counted from 0.
    pub segment: u16,
    /// Channel: 0 to 2 accelerometers x y z, 3 to 5 gyros x y z.
    pub channel: u8,
}

/// How far the measurements of a segment are from what all others say, in the last sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentInnovations {
    /// Segment, counted from 0.
    pub segment: u16,
    /// Innovation of each channel in units of its standard deviation, accelerometers x y z, gyros x y z; `None` where
    /// nothing was measured, or refused.
    pub normalized: [Option<f32>; CHANNELS],
}

/// Agreement of the segments with the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Sum of squared normalized innovations.
    pub chi_square: f64,
    /// Measurements taken in.
    pub measurements: u32,
    /// Measurements kept out by the gate.
    pub gated: u32,
    /// Measurements refused for a number that is not finite.
    pub refused: u32,
    /// The worst of all, gated ones included.
    pub largest: LargestInnovation,
}

/// Parameters with their uncertainty, widened to `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The parameters.
    pub errors: InstrumentErrors<f64>,
    /// Their standard deviations, SI; 0 for one that the method takes as known.
    pub sigmas: [f64; PARAMETERS],
}

/// The outcome of all sweeps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Parameters and sigmas.
    pub estimate: Estimate,
    /// Agreement with the model.
    pub fit: Fit,
    /// Measurements less parameters that they determine.
    pub degrees_of_freedom: u32,
    /// Sweeps made.
    pub sweeps: u8,
    /// Whether the estimate stands.
    pub converged: bool,
    /// Segments processed.
    pub segments: u16,
    /// Segments that are broken by a gap, or did not fit, and were left out.
    pub left_out: u16,
    /// Time from the first segment's start to the last one's end, s.
    pub duration_s: f64,
    /// Mean temperature, deg C; not a number where it is unknown.
    pub temperature_c: f32,
    /// Optional states. Biases, attitude and optional rates hold at the end of the last segment.
    pub optional: OptionalEstimate,
    /// The most significant change of what should be constant; the joint method only.
    pub suspicion: Suspicion,
    /// What the segments say about what was configured; the joint method only.
    pub settings: Settings,
}

/// Which measurements of a segment are taken in, and which states are only considered.
#[derive(Clone, Copy)]
struct Use {
    force: bool,
    rotation: bool,
    /// The states of stage 1 are considered only.
    considered: bool,
}

/// The states of stage 1 that stage 2 only considers: all but the heading, which the gyros gave.
const STAGE_ONE: Range<usize> = ENCODER_ERRORS + block::ACCEL_NON_ORTHOGONALITY..ENCODER_ERRORS + block::ATTITUDE + 2;

/// One run of the filter over the stored segments, as far as it has come.
#[derive(Clone, Copy, Debug)]
struct Sweep {
    /// The segment that is next.
    next: usize,
    /// Moves before it.
    moves: u16,
    /// Moves of period one, for the two-stage method.
    period_moves: Option<u16>,
}

/// Where the final pass is.
#[derive(Clone, Copy, Debug)]
enum Pass<T: Real> {
    /// Not begun, or done.
    Idle,
    /// Sweeping until the estimate stands: `made` sweeps so far, the estimate before the one under way, and how the
    /// heading goes.
    Iterating { sweep: Sweep, made: u8, before: Vector<T, PARAMETERS>, heading: HeadingSteps<T> },
    /// One sweep that leaves the live estimate better linearized.
    Refreshing { sweep: Sweep },
    /// The last sweep, about the solution: its innovations are told, and the covariance is that of the solution.
    Closing { sweep: Sweep },
    /// Testing for changes that begin with segment `onset`, in several sweeps, about the solution.
    Testing { sweep: Sweep, onset: usize, part: usize },
}

/// Least part of a step of the heading that is taken, and the longest step: beyond, nothing is linear.
const LEAST_PART: f64 = 0.1;
const LONGEST_STEP_RAD: f64 = 1.0;

/// Steps of the heading from sweep to sweep.
///
/// The horizontal Earth rate that the gyros show points the way, but a step is divided by the one there is. Where noise
/// makes it appear more than twice as large, as near the poles, Gauss-Newton steps too far and never stands. So steps that
/// swing are cut: two of them tell by how much (Aitken's extrapolation).
#[derive(Clone, Copy, Debug)]
struct HeadingSteps<T: Real> {
    /// The last one, before it was cut.
    last: T,
    /// Part of it that was taken.
    part: T,
}

impl<T: Real> HeadingSteps<T> {
    /// No step yet.
    const NONE: Self = Self { last: T::ZERO, part: T::ZERO };

    /// The part of the next step that is to be taken.
    fn next(&mut self, step: T) -> T {
        let swings = step * self.last < T::zero();
        let rest = T::one() - step / self.last;
        let extrapolates = self.part > T::zero() && (swings || self.part < T::one()) && rest > self.part;
        let part = if extrapolates { (self.part / rest).max(real(LEAST_PART)) } else { T::one() };
        (self.part, self.last) = (part.min(real::<T>(LONGEST_STEP_RAD) / step.abs()), step);
        self.part
    }
}

/// Takes segments in and gives parameters out.
#[derive(Clone, Debug)]
pub struct Estimator<T: Real, const SEGMENTS: usize = MAX_SEGMENTS, const STATES: usize = BASIC_STATES> {
    config: EstimatorConfig,
    segments: heapless::Vec<Segment<T>, SEGMENTS>,
    left_out: u16,
    /// Mean of the prior: zero, and the attitude of the coarse alignment.
    start: Vector<T, PARAMETERS>,
    /// The point that the filter's state deviates from.
    nominal: Vector<T, PARAMETERS>,
    filter: UdFilter<T, STATES>,
    /// Of the two-stage method.
    weights: Weights<T>,
    fit: Fit,
    /// Time that biases, attitude and optional rates refer to, us.
    reference_us: u64,
    /// How many times the configured variance there was, channel by channel.
    allowances: [f64; CHANNELS],
    /// Of the encoders, at the stop before.
    readings: [Readings; 2],
    pass: Pass<T>,
    /// Of the final pass, complete when that is done.
    solution: Option<Solution>,
    /// Changes under test; none but in the last part of the final pass.
    suspects: Suspects<STATES>,
    /// Innovations of the segments of the last piece.
    innovations: heapless::Vec<SegmentInnovations, SEGMENTS_PER_PIECE>,
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
            weights: Weights::NONE,
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

    /// Forgets all data and begins anew with a configuration.
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

    /// Takes in a finished segment and updates the live estimate. Returns whether the segment is used; one before the
    /// first stop, or broken by a gap, is not.
    pub fn add(&mut self, segment: &Segment<T>) -> bool {
        if self.segments.is_empty() && segment.kind() == SegmentKind::Move {
            return false;
        }
        if self.segments.push(*segment).is_err() {
            self.left_out = self.left_out.saturating_add(1);
            return false;
        }
        if let Some(standing) = segment.standing() {
            // The later, the more have the encoders shown of it.
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

    /// The filter: encoder errors, parameters, optional states.
    pub fn filter(&self) -> &UdFilter<T, STATES> {
        &self.filter
    }

    /// The configuration.
    pub fn config(&self) -> &EstimatorConfig {
        &self.config
    }

    /// Segments taken in so far.
    pub fn segments(&self) -> &[Segment<T>] {
        &self.segments
    }

    /// One piece of the final pass: processes all segments again and again until the estimate stands, and tests for
    /// changes. Returns whether there is a [`Estimator::solution`] now; a further call begins anew.
    pub fn solve_piece(&mut self) -> bool {
        match self.pass {
            Pass::Idle | Pass::Refreshing { .. } => {
                self.begin_pass();
                false
            }
            Pass::Iterating { mut sweep, made, before, heading } => {
                let swept = self.sweep_piece(&mut sweep);
                self.pass = Pass::Iterating { sweep, made, before, heading };
                if swept {
                    self.iterate(sweep, made + 1, &before, heading);
                }
                false
            }
            Pass::Closing { mut sweep } => {
                let swept = self.sweep_piece(&mut sweep);
                self.pass = if swept { Pass::Idle } else { Pass::Closing { sweep } };
                swept
            }
            Pass::Testing { mut sweep, onset, part } => {
                let swept = self.sweep_piece(&mut sweep);
                self.pass = Pass::Testing { sweep, onset, part };
                if swept {
                    self.tested(onset, part);
                }
                false
            }
        }
    }

    /// One piece of a sweep over all segments so far: it leaves the live estimate linearized about where it was, and the
    /// chi-square that of one model. Returns chi-square and degrees of freedom when done.
    pub fn refresh_piece(&mut self) -> Option<(f64, u32)> {
        let mut sweep = match self.pass {
            Pass::Refreshing { sweep } => sweep,
            _ => self.begin_sweep(self.config.period_moves),
        };
        let swept = self.sweep_piece(&mut sweep);
        self.pass = if swept { Pass::Idle } else { Pass::Refreshing { sweep } };
        swept.then(|| (self.fit.chi_square, self.degrees_of_freedom(&self.estimate())))
    }

    /// Whether such a sweep is under way, and the live estimate not whole.
    pub fn is_refreshing(&self) -> bool {
        matches!(self.pass, Pass::Refreshing { .. })
    }

    /// Innovations of the segments that the last piece of the final pass has processed for the last time; none while the
    /// estimate is still sought.
    pub fn closing_innovations(&self) -> &[SegmentInnovations] {
        let closing = matches!(self.pass, Pass::Closing { .. }) || self.solution().is_some();
        if closing { &self.innovations } else { &[] }
    }

    /// The outcome of the final pass, once it is done.
    pub fn solution(&self) -> Option<&Solution> {
        self.solution.as_ref().filter(|_| matches!(self.pass, Pass::Idle))
    }

    fn forget_last_stop(&mut self) {
        (self.allowances, self.readings) = ([1.0; CHANNELS], [Readings::NONE; 2]);
    }

    /// Encoder readings at the stop after segment `number`, or where there is none yet, at the one before.
    fn readings_after(&self, number: usize) -> [Readings; 2] {
        let next = self.segments.get(number + 1).and_then(Segment::standing);
        next.map_or(self.readings, |standing| standing.readings)
    }

    fn begin_pass(&mut self) {
        let period_moves = self.config.period_moves.or_else(|| self.find_period());
        self.reference_us = self.segments.last().map_or(0, |last| last.start_us + last.duration_us);
        // Not from the live estimate: updates about poor early points can lead it astray.
        self.nominal = self.start;
        self.solution = None;
        self.suspects.clear();
        let sweep = self.begin_sweep(period_moves);
        self.pass = Pass::Iterating { sweep, made: 0, before: self.nominal, heading: HeadingSteps::NONE };
    }

    /// A sweep has ended, and `made` are made: another one, unless the estimate stands. Not inlined: what it
    /// needs on the stack, the sweeps do not.
    #[inline(never)]
    fn iterate(
        &mut self,
        Sweep { period_moves, .. }: Sweep,
        made: u8,
        before: &Vector<T, PARAMETERS>,
        mut heading: HeadingSteps<T>,
    ) {
        let mut errors = InstrumentErrors::from_vector(&self.nominal);
        let heading_before = InstrumentErrors::from_vector(before).heading;
        let turned = errors.heading - heading_before;
        errors.heading = heading_before + turned * heading.next(turned);
        self.nominal = errors.to_vector();
        let converged = self.stands(before);
        if made < MAX_SWEEPS && !converged {
            let sweep = self.begin_sweep(period_moves);
            self.pass = Pass::Iterating { sweep, made, before: self.nominal, heading };
            return;
        }
        self.solution = Some(self.solved(made, converged));
        match self.config.method {
            Method::TwoStage => self.close(period_moves),
            Method::Joint => self.test_next(0, 0),
        }
    }

    fn close(&mut self, period_moves: Option<u16>) {
        self.innovations.clear();
        self.pass = Pass::Closing { sweep: self.begin_sweep(period_moves) };
    }

    /// A sweep with changes under test has ended. It leaves the estimate as it was solved.
    #[inline(never)]
    fn tested(&mut self, onset: usize, part: usize) {
        let found = self.suspects.most_significant(&sigmas(&self.filter, ENCODER_ERRORS));
        if let Some(solution) = &mut self.solution {
            self.nominal = solution.estimate.errors.to_vector().map(real);
            solution.suspicion = solution.suspicion.more_significant(found);
            solution.settings = self.suspects.settings().unwrap_or(solution.settings);
        }
        self.test_next(onset, part + 1);
    }

    /// Begins the sweep that tests this part of the changes that begin with segment `onset`, or the next one that there
    /// is: changes begin with the first stop and with every move. After the last one the pass is closed.
    fn test_next(&mut self, onset: usize, part: usize) {
        let mut part = part;
        for onset in onset..self.segments.len() {
            let is_stop = self.segments.get(onset).is_some_and(|segment| segment.kind() == SegmentKind::Stop);
            if (!is_stop || onset == 0) && self.suspects.restart(onset as u16, is_stop, part) {
                let sweep = self.begin_sweep(None);
                self.pass = Pass::Testing { sweep, onset, part };
                return;
            }
            part = 0;
        }
        self.suspects.clear();
        self.close(None);
    }

    fn begin_sweep(&mut self, period_moves: Option<u16>) -> Sweep {
        // A change under test may be large, and shall be seen.
        let gate_sigma = self.config.gate_sigma.filter(|_| self.suspects.is_empty());
        self.restart_filters(gate_sigma);
        self.fit = Fit::NONE;
        self.forget_last_stop();
        let deviation = self.start - self.nominal;
        self.filter.state_mut().fixed_rows_mut::<PARAMETERS>(ENCODER_ERRORS).copy_from(&deviation);
        Sweep { next: 0, moves: 0, period_moves }
    }

    /// Processes the next segments of a sweep. Returns whether it has ended.
    fn sweep_piece(&mut self, sweep: &mut Sweep) -> bool {
        self.innovations.clear();
        for _ in 0..SEGMENTS_PER_PIECE {
            let Some(segment) = self.segments.get(sweep.next).copied() else { break };
            let usage = self.use_of(segment.kind(), sweep.moves, sweep.period_moves);
            let none = SegmentInnovations { segment: sweep.next as u16, normalized: [None; CHANNELS] };
            // It holds those of a piece.
            let _ = self.innovations.push(none);
            let _ = self.process(sweep.next, &segment, usage);
            sweep.moves += u16::from(segment.kind() == SegmentKind::Move);
            sweep.next += 1;
        }
        let ended = sweep.next >= self.segments.len();
        if ended {
            self.absorb();
        }
        ended
    }

    /// Sets the filters to what is known before any segment.
    fn restart_filters(&mut self, gate_sigma: Option<f64>) {
        let prior = prior_sigmas(&self.config);
        self.filter.restart(&prior, gate_sigma.map(real));
        if self.config.method == Method::TwoStage {
            let scale = common_accel_scale();
            self.filter.inflate(&scale, T::one());
            self.weights.restart(&(prior + scale));
        }
    }

    /// Moves the linearization point to the estimate.
    fn absorb(&mut self) {
        let mut deviation = self.filter.state_mut().fixed_rows_mut::<PARAMETERS>(ENCODER_ERRORS);
        self.nominal += &deviation;
        deviation.fill(T::zero());
    }

    fn stands(&self, before: &Vector<T, PARAMETERS>) -> bool {
        let step = self.nominal - before;
        let variances = self.filter.variances();
        let standing = STANDING + JITTER_EPSILONS * T::EPSILON;
        let limit = real::<T>(standing * standing);
        let moved = |(step, variance): (&T, &T)| *step * *step > limit * *variance;
        !step.iter().zip(variances.iter().skip(ENCODER_ERRORS)).any(moved)
    }

    fn use_of(&self, kind: SegmentKind, moves_before: u16, period_moves: Option<u16>) -> Use {
        let stop = kind == SegmentKind::Stop;
        let gyrocompass = stop && moves_before == 0 && self.config.heading == HeadingSource::Gyrocompass;
        match (self.config.method, period_moves) {
            (Method::Joint, _) => Use { force: stop, rotation: true, considered: false },
            (Method::TwoStage, None) => Use { force: stop, rotation: !stop || gyrocompass, considered: false },
            (Method::TwoStage, Some(period)) if moves_before < period || (stop && moves_before == period) => {
                Use { force: stop, rotation: gyrocompass, considered: false }
            }
            (Method::TwoStage, Some(_)) => Use { force: false, rotation: !stop, considered: true },
        }
    }

    fn process(&mut self, number: usize, segment: &Segment<T>, usage: Use) -> bool {
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

    // Not inlined, as the next two: what one of them needs on the stack is free again for the other.
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
            // The same encoder error at both ends.
            prediction.by_encoder_errors.fill(T::zero());
            prediction.by_harmonics.fill(T::zero());
        }
        let optional = rotation_columns(&prediction, since_s);
        self.take_in(&segment.rotation_g, (&prediction, &optional), variance, usage, (number, 3));
    }

    /// What the encoder readings at the ends of a segment add to the variance of its rotation, channel by channel: single
    /// ones along the axes as these stand there; and across, while the outer axis turns, an inner axis whose step changes at
    /// any time.
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

    /// From the time that biases and attitude refer to, to the middle of a segment.
    fn since_reference_s(&self, segment: &Segment<T>) -> T {
        let middle_us = segment.start_us + segment.duration_us / 2;
        real(middle_us.wrapping_sub(self.reference_us).cast_signed() as f64 * 1e-6)
    }

    /// Lets the biases walk over a segment.
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

    /// Three scalar updates: white sensor noise is independent from channel to channel. To its variance comes that of
    /// rounding the sums, which counts in `f32` only.
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
        let chosen = weighted.then(|| self.weights.gain(h, r + floor * floor));
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

    /// Attitude from the first stop as if the sensors were perfect: levelling, then gyrocompassing.
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

    /// Number of moves after which the stops' angles begin again, if they do so once.
    fn find_period(&self) -> Option<u16> {
        const SAME_RAD: f64 = DEG;
        let stops = || self.segments.iter().filter(|segment| segment.kind() == SegmentKind::Stop);
        let moves = stops().count().checked_sub(1)?;
        let half = moves / 2;
        let near = |a: &Segment<T>, b: &Segment<T>| {
            let apart = |ticks: i32| crate::base::angle::ticks_to_rad::<f64>(ticks.into()).abs();
            apart(a.outer.since(b.outer)) < SAME_RAD && apart(a.inner.since(b.inner)) < SAME_RAD
        };
        let repeats = moves > 0 && moves % 2 == 0 && stops().zip(stops().skip(half)).all(|(a, b)| near(a, b));
        repeats.then_some(half as u16)
    }

    fn solved(&self, sweeps: u8, converged: bool) -> Solution {
        let estimate = self.estimate();
        let broken = self.segments.iter().filter(|segment| segment.is_broken()).count();
        let ends = self.segments.first().zip(self.segments.last());
        let count = self.segments.len().max(1) as f32;
        Solution {
            estimate,
            fit: Fit { gated: self.filter.gated(), refused: self.filter.refused(), ..self.fit },
            degrees_of_freedom: self.degrees_of_freedom(&estimate),
            sweeps,
            converged,
            segments: self.segments.len() as u16,
            left_out: self.left_out.saturating_add(broken as u16),
            duration_s: ends.map_or(0.0, |(first, last)| {
                (last.start_us + last.duration_us).saturating_sub(first.start_us) as f64 * 1e-6
            }),
            optional: self.optional(),
            suspicion: Suspicion::default(),
            settings: Settings::default(),
            temperature_c: self.segments.iter().map(|segment| segment.temperature_c).sum::<f32>() / count,
        }
    }

    fn optional(&self) -> OptionalEstimate {
        let mut values = [0.0; OPTIONAL_STATES];
        for (value, state) in values.iter_mut().zip(self.filter.state().iter().skip(BASIC_STATES)) {
            *value = state.widened();
        }
        OptionalEstimate { values, sigmas: sigmas(&self.filter, BASIC_STATES) }
    }

    fn degrees_of_freedom(&self, estimate: &Estimate) -> u32 {
        self.fit.measurements.saturating_sub(self.determined(estimate))
    }

    /// How many parameters the measurements, not the prior, determine.
    fn determined(&self, estimate: &Estimate) -> u32 {
        let gained = |(sigma, prior): (&f64, &f64)| {
            if *prior > 0.0 { 1.0 - sigma * sigma / (prior * prior) } else { 0.0 }
        };
        let total: f64 = estimate.sigmas.iter().zip(&self.config.prior_sigmas()).map(gained).sum();
        let optional = self.optional().sigmas;
        let optional: f64 = optional.iter().zip(&self.config.options.prior_sigmas()).map(gained).sum();
        // Of the accelerometers' scale errors, the two-stage method knows only one, common to the three.
        let common = if self.config.method == Method::TwoStage { 2.0 } else { 0.0 };
        ComplexField::round(total + optional - common) as u32
    }
}

impl Fit {
    const NONE: Self = Self {
        chi_square: 0.0,
        measurements: 0,
        gated: 0,
        refused: 0,
        largest: LargestInnovation { normalized: 0.0, segment: 0, channel: 0 },
    };

    fn note<T: Real>(&mut self, update: &Update<T>, segment: usize, channel: u8) {
        let innovation = match update {
            Update::Applied(innovation) => innovation,
            Update::Gated(innovation) => innovation,
            Update::Refused => return,
        };
        let normalized = innovation.normalized().widened();
        if matches!(update, Update::Applied(_)) {
            self.chi_square += normalized * normalized;
            self.measurements += 1;
        }
        if normalized.abs() > self.largest.normalized.abs() {
            self.largest = LargestInnovation { normalized, segment: segment as u16, channel };
        }
    }
}

/// Standard deviations of `COUNT` states from `first` on, SI; 0 for those that the filter does not have.
fn sigmas<T: Real, const STATES: usize, const COUNT: usize>(
    filter: &UdFilter<T, STATES>,
    first: usize,
) -> [f64; COUNT] {
    let mut sigmas = [0.0; COUNT];
    for (sigma, variance) in sigmas.iter_mut().zip(filter.variances().iter().skip(first)) {
        *sigma = variance.sqrt().widened();
    }
    sigmas
}

/// Sigmas of the states before any segment, (STATES): wide where the method estimates, zero where it takes a parameter as
/// known. The common scale error of the two-stage method comes on top.
fn prior_sigmas<T: Real, const STATES: usize>(config: &EstimatorConfig) -> Vector<T, STATES> {
    let mut sigmas = Vector::<T, STATES>::zeros();
    sigmas.fixed_rows_mut::<ENCODER_ERRORS>(0).fill(real(config.noise.encoder_sigma_rad));
    for prior in PRIORS.iter().filter(|prior| prior.two_stage || config.method == Method::Joint) {
        for sigma in sigmas.iter_mut().take(prior.states.end).skip(prior.states.start) {
            *sigma = real(prior.sigma);
        }
    }
    if config.method == Method::Joint {
        for (sigma, prior) in sigmas.iter_mut().skip(BASIC_STATES).zip(config.options.prior_sigmas()) {
            *sigma = real(prior);
        }
    }
    let heading = sigmas.iter_mut().nth(BASIC_STATES - 1);
    if let (HeadingSource::Configured { sigma_rad, .. }, Some(heading)) = (config.heading, heading) {
        *heading = real(sigma_rad);
    }
    sigmas
}

/// One scale error common to the three accelerometers, with its prior sigma: it stands for the magnitude of the specific
/// force, which (11) does not use.
fn common_accel_scale<T: Real, const STATES: usize>() -> Vector<T, STATES> {
    Vector::from_fn(|state, _| if ACCEL_SCALE.contains(&state) { real(COMMON_SCALE_SIGMA) } else { T::zero() })
}

const ACCEL_SCALE: Range<usize> = ENCODER_ERRORS + block::ACCEL_SCALE..ENCODER_ERRORS + block::ACCEL_SCALE + 3;
const COMMON_SCALE_SIGMA: f64 = 0.02;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::assignment::Assignment;
    use crate::segment::{AngleIntegrals, Course, Turned};

    #[test]
    fn readings_at_the_ends_of_a_move_count_along_the_axes_as_they_stand_there() {
        let Assignment::SelfCalibrate(config) = Assignment::default() else { unreachable!() };
        let config = config.calibrator.estimator;
        let mut estimator = Estimator::<f64>::new();
        estimator.restart(&config);
        let noisy = Readings { jumps_ticks2: 6e6, count: 1000, resolution_ticks: 0 };
        estimator.readings = [noisy, Readings::NONE];
        // The inner axis turns from 45 to 135 deg: the outer one is square to gyro x on average, but not at either end.
        let turn = Segment {
            inner: crate::base::angle::Angle::from_rad(135.0 * DEG),
            turned: Turned { inner: 90.0 * DEG, ..Turned::default() },
            course: Course::Move(AngleIntegrals::default()),
            ..Segment::quiet_stop(6_000_000)
        };
        let model = MeasurementModel::new(&InstrumentErrors::default(), &config.site);
        let variance = estimator.ends_variance(1, &turn, &model, &model.rotation(&turn)) / noisy.variance();
        assert!((variance - Vector3::new(1.0, 1.0, 0.0)).norm() < 1e-6, "{variance}");
    }
}
