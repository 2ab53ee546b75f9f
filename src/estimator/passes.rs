//! The final pass. All segments are processed again about the last estimate until the estimate has converged (iterated
//! Kalman filter, Gauss-Newton), so that no linearization error remains. Then the pass tests for changes during the run
//! ([`super::constancy`]). The pass is done in pieces of a few segments for each call, so that samples are processed
//! between two pieces.

use super::bai::find_period;
use super::configuration::{BEFORE_EFFECTS, BEFORE_PARAMETERS, KNOWN_LATITUDE_RAD};
use super::constancy::{SettingEvidence, Suspicion};
use super::joint::{Estimator, SEGMENTS_PER_PIECE};
use super::solution::{EffectEstimates, Estimate, Fit, Forces, SegmentInnovations, Solution, sigmas};
use super::sweep::{HeadingSteps, Pass, Sweep};
use crate::base::linear::{ComplexField, Real, Vector, real};
use crate::base::method::Method;
use crate::base::sample::CHANNELS;
use crate::model::effects::{EFFECT_STATES, effect};
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::segment::SegmentKind;

/// Largest number of sweeps over the segments. An estimate that has not converged after these sweeps is rejected.
const MAX_SWEEPS: u8 = 24;

/// Largest number of sweeps over the segments for a live estimate. The early ones are far from linear.
const MAX_LIVE_SWEEPS: u8 = 8;

/// A live estimate has converged when no step exceeds this fraction of sigma.
const LIVE_CONVERGED_PART: f64 = 0.1;

/// An estimate of the latitude that leaves the configured one by this many of its prior sigmas shows that it is wrong.
/// The probability of chance is 6e-5 at most, since the estimate scatters less than the prior.
const LATITUDE_DOUBT_SIGMAS: f64 = 4.0;

/// Prior sigma of a latitude that is not known, rad.
const UNKNOWN_LATITUDE_RAD: f64 = 1.0;

/// Converged when no step exceeds this fraction of sigma.
const CONVERGED_PART: f64 = 0.01;

/// Rounding noise of an estimate as a fraction of its sigma, in units of the spacing of numbers.
const ROUNDING_NOISE_EPSILONS: f64 = 2.5e6;

impl<T: Real, const SEGMENTS: usize> Estimator<T, SEGMENTS> {
    /// Does one piece of the final pass. The pass processes all segments repeatedly until the estimate has converged,
    /// and then tests for changes. Returns whether the pass is done and [`Estimator::solution`] is available. A
    /// further call begins a new pass.
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

    /// Does one piece of the sweeps over all segments so far. They linearize all segments about the live estimate until
    /// it moves by less than its sigmas, so that estimate, sigmas and chi-square refer to one model. Returns chi-square
    /// and degrees of freedom when the sweeps are done.
    pub fn refresh_piece(&mut self) -> Option<(f64, u32)> {
        let (mut sweep, made, before) = match self.pass {
            Pass::Refreshing { sweep, made, before } => (sweep, made, before),
            _ => (self.begin_sweep(self.config.period_moves), 0, self.nominal),
        };
        if !self.sweep_piece(&mut sweep) {
            self.pass = Pass::Refreshing { sweep, made, before };
            return None;
        }
        let made = made + 1;
        if made < MAX_LIVE_SWEEPS && !self.has_converged(&before, LIVE_CONVERGED_PART) {
            let sweep = self.begin_sweep(self.config.period_moves);
            self.pass = Pass::Refreshing { sweep, made, before: self.nominal };
            return None;
        }
        self.pass = Pass::Idle;
        Some((self.fit.chi_square, self.degrees_of_freedom(&self.estimate())))
    }

    /// Whether a sweep of [`Estimator::refresh_piece`] is in progress. The live estimate is then incomplete.
    pub fn is_refreshing(&self) -> bool {
        matches!(self.pass, Pass::Refreshing { .. })
    }

    /// Innovations of the segments that the last piece of the closing sweep has processed. Empty before the closing
    /// sweep.
    pub fn closing_innovations(&self) -> &[SegmentInnovations] {
        let closing = matches!(self.pass, Pass::Closing { .. }) || self.solution().is_some();
        if closing { &self.innovations } else { &[] }
    }

    /// The solution of the final pass. `None` until the pass is done.
    pub fn solution(&self) -> Option<&Solution> {
        self.solution.as_ref().filter(|_| matches!(self.pass, Pass::Idle))
    }

    fn begin_pass(&mut self) {
        let period_moves = self.config.period_moves.or_else(|| find_period(&self.segments));
        self.reference_us = self.segments.last().map_or(0, |last| last.start_us + last.duration_us);
        // The pass does not start from the live estimate, because updates about poor early estimates may have spoiled
        // it.
        self.nominal = self.start;
        self.start_latitude_rad = self.config.site.latitude_rad;
        self.latitude_sigma_rad = self.config.latitude_sigma_rad();
        if self.latitude_sigma_rad > KNOWN_LATITUDE_RAD {
            self.start_latitude_rad = self.coarse_latitude_rad;
        }
        self.site.latitude_rad = self.start_latitude_rad;
        self.solution = None;
        self.suspects.clear();
        let sweep = self.begin_sweep(period_moves);
        self.pass = Pass::Iterating { sweep, made: 0, before: self.nominal, heading: HeadingSteps::NONE };
    }

    /// Ends a sweep, the one with number `made`. Begins the next sweep, unless the estimate has converged.
    // Not inlined, so that the sweeps do not need its stack.
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
        let converged = self.has_converged(before, CONVERGED_PART);
        if made < MAX_SWEEPS && !converged {
            let sweep = self.begin_sweep(period_moves);
            self.pass = Pass::Iterating { sweep, made, before: self.nominal, heading };
            return;
        }
        if self.doubts_latitude() {
            // The pass begins again without the configured latitude, so that the gyros say what it is.
            self.latitude_sigma_rad = UNKNOWN_LATITUDE_RAD;
            self.start_latitude_rad = self.coarse_latitude_rad;
            self.site.latitude_rad = self.start_latitude_rad;
            self.nominal = self.start;
            let sweep = self.begin_sweep(period_moves);
            self.pass = Pass::Iterating { sweep, made: 0, before: self.nominal, heading: HeadingSteps::NONE };
            return;
        }
        self.solution = Some(self.solved(made, converged));
        match self.config.method {
            Method::Bai => self.close(period_moves),
            Method::Joint => self.test_next(0, 0),
        }
    }

    /// Whether the estimate has left the configured latitude by more than its sigma permits.
    fn doubts_latitude(&self) -> bool {
        let known = self.latitude_sigma_rad > 0.0 && self.latitude_sigma_rad <= KNOWN_LATITUDE_RAD;
        let off_rad = self.site.latitude_rad - self.config.site.latitude_rad;
        known && off_rad.abs() > LATITUDE_DOUBT_SIGMAS * self.latitude_sigma_rad
    }

    fn close(&mut self, period_moves: Option<u16>) {
        self.innovations.clear();
        self.pass = Pass::Closing { sweep: self.begin_sweep(period_moves) };
    }

    /// Ends a sweep with changes under test. The estimate is set back to the solution.
    #[inline(never)]
    fn tested(&mut self, onset: usize, part: usize) {
        let found = self.suspects.most_significant(&sigmas(&self.filter, BEFORE_PARAMETERS));
        if let Some(solution) = &mut self.solution {
            solution.suspicion = solution.suspicion.more_significant(found);
            solution.settings = self.suspects.settings().unwrap_or(solution.settings);
        }
        self.test_next(onset, part + 1);
    }

    /// Begins the sweep that tests this part of the changes with the onset at segment `onset`. If there is no such
    /// part, begins the sweep for the next onset. Changes begin with the first stop and with every move. After the
    /// last onset the closing sweep begins.
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
        self.test_kinds();
        self.close(None);
    }

    fn test_kinds(&mut self) {
        let Some(Solution { suspicion: alone, .. }) = self.solution else { return };
        let found = self.most_explaining(alone);
        if let Some(solution) = &mut self.solution {
            solution.suspicion = found;
        }
    }

    fn begin_sweep(&mut self, period_moves: Option<u16>) -> Sweep {
        // The gate is off while changes are under test, because it would hide a large change.
        let gate_sigma = self.config.gate_sigma.filter(|_| self.suspects.is_empty());
        self.restart_filters(gate_sigma);
        (self.fit, self.forces) = (Fit::NONE, Forces::NONE);
        self.forget_last_stop();
        let deviation = self.start - self.nominal;
        self.filter.state_mut().fixed_rows_mut::<PARAMETERS>(BEFORE_PARAMETERS).copy_from(&deviation);
        let latitude = real(self.start_latitude_rad - self.site.latitude_rad);
        let state = self.state_of(effect::LATITUDE);
        if let Some(deviation) = state.and_then(|state| self.filter.state_mut().get_mut(state)) {
            *deviation = latitude;
        }
        Sweep { next: 0, moves: 0, period_moves }
    }

    /// Processes the next segments of a sweep. Returns whether the sweep has ended.
    fn sweep_piece(&mut self, sweep: &mut Sweep) -> bool {
        self.innovations.clear();
        for _ in 0..SEGMENTS_PER_PIECE {
            let Some(segment) = self.segments.get(sweep.next).copied() else { break };
            let none = SegmentInnovations { segment: sweep.next as u16, normalized: [None; CHANNELS] };
            // The vector cannot overflow: it holds the segments of one piece.
            let _ = self.innovations.push(none);
            let _ = self.process(sweep.next, &segment, sweep.moves, sweep.period_moves);
            sweep.moves += u16::from(segment.kind() == SegmentKind::Move);
            sweep.next += 1;
        }
        let ended = sweep.next >= self.segments.len();
        // The tests for changes are about the solution, which stays as it is.
        if ended && self.suspects.is_empty() {
            self.absorb();
        }
        ended
    }

    /// Whether the step of every parameter and of the latitude since the sweep before is within this fraction of its
    /// sigma, plus rounding noise.
    fn has_converged(&self, before: &Vector<T, PARAMETERS>, part: f64) -> bool {
        let step = self.nominal - before;
        let variances = self.filter.variances();
        let part = part + ROUNDING_NOISE_EPSILONS * T::EPSILON;
        let limit = real::<T>(part * part);
        // A parameter that the method takes as known has no variance.
        let moved = |(step, variance): (&T, &T)| *variance > T::zero() && *step * *step > limit * *variance;
        let latitude_step = real(self.latitude_step_rad);
        let latitude = self.state_of(effect::LATITUDE).and_then(|state| variances.get(state));
        !step.iter().zip(variances.iter().skip(BEFORE_PARAMETERS)).any(moved)
            && !latitude.is_some_and(|variance| moved((&latitude_step, variance)))
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
            effects: self.effect_estimates(),
            suspicion: Suspicion::default(),
            settings: SettingEvidence::default(),
            temperature_c: self.segments.iter().map(|segment| segment.temperature_c).sum::<f32>() / count,
        }
    }

    pub(super) fn degrees_of_freedom(&self, estimate: &Estimate) -> u32 {
        self.fit.measurements.saturating_sub(self.determined(estimate))
    }

    /// Number of parameters that are determined by the measurements and not by the prior. Effects of the hardware do
    /// not count: their priors are the sizes that they have, so that they add to the innovations what they take away.
    fn determined(&self, estimate: &Estimate) -> u32 {
        let gained = |(sigma, prior): (&f64, &f64)| {
            if *prior > 0.0 { 1.0 - sigma * sigma / (prior * prior) } else { 0.0 }
        };
        let total: f64 = estimate.sigmas.iter().zip(&self.config.prior_sigmas()).map(gained).sum();
        let latitude = if self.latitude_sigma_rad > KNOWN_LATITUDE_RAD { 1.0 } else { 0.0 };
        ComplexField::round(total + latitude) as u32
    }

    fn effect_estimates(&self) -> EffectEstimates {
        let mut estimates = EffectEstimates::NONE;
        let sigmas: [f64; EFFECT_STATES] = sigmas(&self.filter, BEFORE_EFFECTS);
        let states = self.filter.state().iter().skip(BEFORE_EFFECTS).zip(sigmas);
        for (effect, (value, sigma)) in self.effects.iter().map(|effect| usize::from(*effect)).zip(states) {
            // The latitude is moved into the linearization point.
            let linearized =
                if effect == effect::LATITUDE { self.site.latitude_rad - self.config.site.latitude_rad } else { 0.0 };
            let places = estimates.values.get_mut(effect).zip(estimates.sigmas.get_mut(effect));
            if let Some((of_value, of_sigma)) = places {
                (*of_value, *of_sigma) = ((value.widened() + linearized) as f32, sigma as f32);
            }
        }
        estimates
    }
}
