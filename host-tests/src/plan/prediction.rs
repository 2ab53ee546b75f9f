//! Prediction for a scheme before it is run: sigmas, rank and condition number.
//!
//! The covariance depends on the geometry only, not on the values of the measurements. So the core processes the
//! readings of a perfect unit without noise, and its configuration has the noise of the real unit.

use super::costs::HardwareCosts;
use super::observability::{along_scheme, of_covariance};
use crate::base::quantity::{STATES, states};
use crate::calibration::Setup;
use crate::calibration::virtual_run::VirtualRun;
use crate::files::unit_file::Noise;
use crate::result::report::{Named, SOFTWARE, SiteReport, Software};
use crate::virtual_unit::unit::{Effects, VirtualUnit};
use rins_selfcal::base::linear::Matrix;
use rins_selfcal::estimator::OBSERVED_RATIO;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors, PARAMETERS, ParameterInfo};
use rins_selfcal::run::telemetry::Progress;
use rins_selfcal::scheme::{Leg, Scheme};
use rins_selfcal::segment::SegmentKind;
use serde::Serialize;
use std::ops::Range;

/// Rank and condition number of Bai's twelve states from the start up to a time of the scheme.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RankAt {
    /// Scheme time, s.
    pub time_s: f64,
    /// Rank, of 12.
    pub rank: usize,
    /// Largest singular value divided by the smallest that does not count as zero.
    pub condition_number: f64,
}

/// A predicted sigma.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PredictedSigma {
    /// Standard deviation.
    pub sigma: f64,
    /// Unit of the sigma.
    pub unit: &'static str,
}

/// Sigmas after a segment, and the information that the segment gained.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentGain {
    /// Segment, counted from 0.
    pub segment: u16,
    /// Stop or move.
    pub kind: SegmentKind,
    /// End of the segment in scheme time, s.
    pub time_s: f64,
    /// Sigmas after the segment, in report units.
    pub sigmas: Named<f64>,
    /// Information gained, bits: binary logarithm of the sigma before over the sigma after.
    pub gained_bits: Named<f64>,
}

impl SegmentGain {
    /// The largest sigma of Bai's twelve states, arcsec.
    pub fn worst_arcsec(&self) -> f64 {
        self.sigmas.0.iter().take(INSTALLATION_STATES).fold(0.0, |worst, (_, sigma)| f64::max(worst, *sigma))
    }
}

/// Prediction for a scheme.
#[derive(Clone, Debug, Serialize)]
pub struct Prediction {
    /// Name of the scheme.
    pub scheme: String,
    /// Name of the method.
    pub method: &'static str,
    /// Duration including first stop, ramps and settling, s.
    pub duration_s: f64,
    /// Number of directions in the space of the estimated states that the data determine.
    pub rank: usize,
    /// Number of parameters and effects that are estimated.
    pub states: usize,
    /// Condition number of the square root of the correlation matrix.
    pub condition_number: f64,
    /// The largest sigma of Bai's twelve states, arcsec.
    pub worst_arcsec: f64,
    /// Lower bound of the largest sigma for any scheme of this duration, arcsec, if it was computed.
    pub least_possible_arcsec: Option<f64>,
    /// What the imperfections of the hardware cost, if it was computed.
    pub hardware: Option<HardwareCosts>,
    /// Time at which the largest sigma of Bai's twelve states has fallen to 1 arcsec, s.
    pub time_to_1_arcsec_s: Option<f64>,
    /// States that are not observed.
    pub unobserved: Vec<&'static str>,
    /// The direction with the largest uncertainty, in words.
    pub weakest_direction: String,
    /// Sigmas by name, at the end of the run.
    pub parameters: Named<PredictedSigma>,
    /// Sigmas of the effects of the hardware that are estimated.
    pub effects: Named<PredictedSigma>,
    /// Rank of Bai's twelve states against scheme time, at each change of rank and at the end of each stop.
    pub installation_rank: Vec<RankAt>,
    /// Gain of every segment.
    pub segments: Vec<SegmentGain>,
    /// Site of the unit.
    pub site: SiteReport,
    /// Noise of the unit.
    pub noise: Noise,
    software: Software,
}

/// Observability and sigmas.
#[derive(Clone, Debug, Serialize)]
pub struct Observed {
    /// Number of directions in the space of the states that the data determine.
    pub rank: usize,
    /// Number of states that are estimated.
    pub states: usize,
    /// Condition number of the square root of the correlation matrix.
    pub condition_number: f64,
    /// The largest sigma of Bai's twelve states, arcsec.
    pub worst_arcsec: f64,
    /// States that are not observed.
    pub unobserved: Vec<&'static str>,
    /// The direction with the largest uncertainty, in words.
    pub weakest_direction: String,
    /// Sigmas by name.
    pub parameters: Named<PredictedSigma>,
}

impl Observed {
    /// Evaluates the covariance of all states, SI units.
    pub fn new(setup: &Setup, covariance: &Matrix<f64, STATES, STATES>) -> Self {
        // The effects of the hardware are known by their priors, and are not what the scheme must observe.
        let mut prior_sigmas = estimated_priors(setup);
        prior_sigmas.iter_mut().skip(PARAMETERS).for_each(|sigma| *sigma = 0.0);
        let covariance = estimated_only(covariance, &prior_sigmas);
        let (rank, condition_number) = of_covariance(&covariance, &prior_sigmas);
        let unobserved = unobserved(&covariance, &prior_sigmas);
        let parameters = predicted(&covariance, &prior_sigmas, 0..PARAMETERS);
        let twelve = parameters.0.iter().take(INSTALLATION_STATES);
        Self {
            rank,
            states: prior_sigmas.iter().filter(|sigma| **sigma > 0.0).count(),
            condition_number,
            worst_arcsec: twelve.fold(0.0, |worst, (_, predicted)| f64::max(worst, predicted.sigma)),
            weakest_direction: weakest_direction(&covariance, &prior_sigmas, !unobserved.is_empty()),
            unobserved,
            parameters,
        }
    }
}

impl Prediction {
    /// Prediction for a unit without errors, level and facing north.
    pub fn new(setup: &Setup, scheme: &Scheme) -> Self {
        let (run, prior_sigmas) = (silent_run(setup, scheme), estimated_priors(setup));
        let foreseen = Foreseen::new(setup, &run);
        let observed = Observed::new(setup, &foreseen.covariance);
        let covariance = estimated_only(&foreseen.covariance, &prior_sigmas);
        let segments = gains(&prior_sigmas, &foreseen.live);
        let below = |gain: &&SegmentGain| gain.worst_arcsec() <= 1.0;
        Self {
            scheme: scheme.name.as_str().into(),
            method: setup.method.name(),
            duration_s: run.duration_s(),
            rank: observed.rank,
            states: observed.states,
            condition_number: observed.condition_number,
            worst_arcsec: segments.last().map_or(f64::INFINITY, SegmentGain::worst_arcsec),
            least_possible_arcsec: None,
            hardware: None,
            time_to_1_arcsec_s: segments.iter().find(below).map(|gain| gain.time_s),
            weakest_direction: observed.weakest_direction,
            unobserved: observed.unobserved,
            parameters: observed.parameters,
            effects: predicted(&covariance, &prior_sigmas, PARAMETERS..STATES),
            installation_rank: installation_rank(setup, scheme),
            segments,
            site: (&setup.known_site()).into(),
            noise: setup.noise,
            software: SOFTWARE,
        }
    }
}

/// A run without noise. The configuration of the core has the noise of the real unit.
struct Foreseen {
    /// Live estimate, which refers to the start of the run, and sigmas of all states (SI units), after every segment.
    live: Vec<(Progress, [f64; STATES])>,
    /// Covariance of all states at the end, SI units.
    covariance: Matrix<f64, STATES, STATES>,
}

impl Foreseen {
    fn new(setup: &Setup, run: &VirtualRun) -> Self {
        let mut chain = setup.clone().on_scheme(&run.scheme).chain();
        let mut live = Vec::new();
        for reading in run.drive() {
            let progress = chain.step(&reading);
            live.extend(progress.map(|progress| (progress, sigmas(&chain.covariance()))));
        }
        let progress = chain.finish();
        live.extend(progress.map(|progress| (progress, sigmas(&chain.covariance()))));
        let _ = chain.conclude();
        Self { live, covariance: chain.covariance() }
    }
}

/// Sigmas of all states for a unit with these errors, in report units: the Cramer-Rao bound.
pub fn bounds(setup: &Setup, unit: &VirtualUnit, scheme: &Scheme) -> [f64; STATES] {
    let unit = VirtualUnit { noise: Noise::NONE, effects: Effects::default(), ..unit.clone() };
    let run = VirtualRun { unit, scheme: scheme.clone(), seed: 0 };
    let sigmas = sigmas(&Foreseen::new(setup, &run).covariance);
    let mut bounds = [0.0; STATES];
    for (bound, (sigma, info)) in bounds.iter_mut().zip(sigmas.iter().zip(states())) {
        *bound = sigma / info.unit_si;
    }
    bounds
}

fn sigmas(covariance: &Matrix<f64, STATES, STATES>) -> [f64; STATES] {
    std::array::from_fn(|state| covariance[(state, state)].sqrt())
}

/// Sigmas of all parameters from the core, SI units.
pub fn predicted_sigmas_si(setup: &Setup, scheme: &Scheme) -> [f64; PARAMETERS] {
    silent_run(setup, scheme).calibrate(std::slice::from_ref(setup)).remove(0).estimate().sigmas
}

/// Duration of a scheme including first stop, ramps and settling, s.
pub fn duration_s(setup: &Setup, scheme: &Scheme) -> f64 {
    silent_run(setup, scheme).duration_s()
}

/// A run of a perfect unit without noise, level and facing north.
pub fn silent_run(setup: &Setup, scheme: &Scheme) -> VirtualRun {
    let unit =
        VirtualUnit { site: setup.known_site(), noise: Noise::NONE, rate_hz: setup.rate_hz, ..VirtualUnit::default() };
    VirtualRun { unit, scheme: scheme.clone(), seed: 0 }
}

/// Prior sigmas, SI units; zero for states that the method does not estimate.
fn estimated_priors(setup: &Setup) -> [f64; STATES] {
    let mut sigmas = setup.prior_sigmas();
    for (state, sigma) in sigmas.iter_mut().enumerate().take(PARAMETERS) {
        *sigma = if setup.method.estimates(state) { *sigma } else { 0.0 };
    }
    sigmas
}

fn estimated_only(
    covariance: &Matrix<f64, STATES, STATES>,
    prior_sigmas: &[f64; STATES],
) -> Matrix<f64, STATES, STATES> {
    let estimated = |state: usize| prior_sigmas[state] > 0.0;
    Matrix::from_fn(|row, column| if estimated(row) && estimated(column) { covariance[(row, column)] } else { 0.0 })
}

/// States whose sigma is above the tenth of their prior sigma that the verdict requires.
fn unobserved(covariance: &Matrix<f64, STATES, STATES>, prior_sigmas: &[f64; STATES]) -> Vec<&'static str> {
    let hidden = states().zip(sigmas(covariance)).zip(prior_sigmas).filter_map(|((info, sigma), prior)| {
        let seen = sigma <= OBSERVED_RATIO * prior;
        (!seen).then_some(info.name)
    });
    hidden.collect()
}

/// The longest principal axis of the covariance, in units of the sigmas, or of the prior sigmas if some states are not
/// observed. It is described by its two largest entries and whether their signs are equal ("with") or not ("against").
fn weakest_direction(covariance: &Matrix<f64, STATES, STATES>, prior_sigmas: &[f64; STATES], by_prior: bool) -> String {
    let unit = |index: usize| if by_prior { prior_sigmas[index] } else { covariance[(index, index)].sqrt() };
    let inverse = |index: usize| if unit(index) > 0.0 { unit(index).recip() } else { 0.0 };
    let scaled = Matrix::<f64, STATES, STATES>::from_fn(|row, column| {
        covariance[(row, column)] * inverse(row) * inverse(column)
    });
    let axes = scaled.symmetric_eigen();
    let axis = axes.eigenvectors.column(axes.eigenvalues.imax());
    let mut order: Vec<(usize, &str)> = states().map(|info| info.name).enumerate().collect();
    order.sort_by(|(a, _), (b, _)| axis[*b].abs().total_cmp(&axis[*a].abs()));
    let ((first, name), (second, other)) = (order[0], order[1]);
    // The second entry is named only from a tenth of the squared length on.
    if axis[second] * axis[second] < 0.1 {
        name.into()
    } else if axis[first] * axis[second] < 0.0 {
        format!("{name} against {other}")
    } else {
        format!("{name} with {other}")
    }
}

/// Gain of each segment for the states that are estimated.
fn gains(prior_sigmas: &[f64; STATES], live: &[(Progress, [f64; STATES])]) -> Vec<SegmentGain> {
    let named = |value: &dyn Fn(usize, &ParameterInfo) -> f64| {
        let estimated = states().enumerate().filter(|(state, _)| prior_sigmas[*state] > 0.0);
        Named(estimated.map(|(state, info)| (info.name, value(state, info))).collect())
    };
    let mut before = *prior_sigmas;
    let gain = |(progress, after): &(Progress, [f64; STATES])| {
        let gain = SegmentGain {
            segment: progress.segments - 1,
            kind: progress.kind,
            time_s: progress.end_us as f64 * 1e-6,
            sigmas: named(&|state, info| after[state] / info.unit_si),
            gained_bits: named(&|state, _| (before[state] / after[state]).log2()),
        };
        before = *after;
        gain
    };
    live.iter().map(gain).collect()
}

fn predicted(
    covariance: &Matrix<f64, STATES, STATES>,
    prior_sigmas: &[f64; STATES],
    range: Range<usize>,
) -> Named<PredictedSigma> {
    let sigmas = sigmas(covariance);
    let states = states().enumerate().take(range.end).skip(range.start);
    let estimated = states.filter(|(state, _)| prior_sigmas[*state] > 0.0);
    let predicted = |(state, info): (usize, &'static ParameterInfo)| {
        (info.name, PredictedSigma { sigma: sigmas[state] / info.unit_si, unit: info.unit })
    };
    Named(estimated.map(predicted).collect())
}

/// Rank and condition number at each change of the rank and at the end of every stop.
fn installation_rank(setup: &Setup, scheme: &Scheme) -> Vec<RankAt> {
    let ends = stop_ends_s(scheme);
    let mut table: Vec<RankAt> = Vec::new();
    along_scheme(scheme, &setup.known_site(), &InstrumentErrors::default(), |time_s, seen| {
        let changed = table.last().is_none_or(|last| last.rank != seen.rank);
        let stop_over = ends.iter().any(|end_s| (end_s - time_s).abs() < 1e-6);
        if changed || stop_over {
            table.push(RankAt { time_s, rank: seen.rank, condition_number: seen.condition_number() });
        }
    });
    table
}

/// Times at which the stops of one period end, s.
fn stop_ends_s(scheme: &Scheme) -> Vec<f64> {
    let mut from = Leg::default();
    let mut time_s = scheme.first_stop_s;
    let ends = scheme.legs.iter().map(|leg| {
        time_s += scheme.move_s(&from, leg) + leg.stop_s;
        from = *leg;
        time_s
    });
    ends.collect()
}
