//! What a scheme will give before anything has turned: sigmas, rank and condition.
//!
//! The covariance does not depend on the data beyond the geometry, so a perfect unit without noise is run through the
//! core, which is told the noise of the real one.

use crate::calibration::{Outcome, Setup};
use crate::quantity;
use crate::report::{Named, SOFTWARE, SiteReport, Software};
use crate::unit::Noise;
use crate::virtual_rins::VirtualUnit;
use crate::virtual_run::VirtualRun;
use rins_selfcal::error_model::{InstrumentErrors, PARAMETER_INFO, PARAMETERS};
use rins_selfcal::linear::Matrix;
use rins_selfcal::observability::{along_scheme, of_covariance};
use rins_selfcal::scheme::Scheme;
use serde::Serialize;

const SILENT: Noise = Noise {
    accel_vrw_ug_sqrt_hz: 0.0,
    gyro_arw_deg_sqrt_h: 0.0,
    encoder_repeatability_arcsec: 0.0,
    rate_reference_arcsec_sqrt_s: 0.0,
};

/// Rank and condition number of Bai's twelve states from the start up to a time in the scheme.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RankAt {
    /// Scheme time, s.
    pub time_s: f64,
    /// Rank, of 12.
    pub rank: usize,
    /// Largest singular value over the smallest that counts.
    pub condition_number: f64,
}

/// A predicted sigma.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PredictedSigma {
    /// Standard deviation.
    pub sigma: f64,
    /// Its unit.
    pub unit: &'static str,
}

/// What a scheme will give.
#[derive(Clone, Debug, Serialize)]
pub struct Prediction {
    /// Name of the scheme.
    pub scheme: String,
    /// Joint or two-stage.
    pub method: &'static str,
    /// First stop, ramps and settling included, s.
    pub duration_s: f64,
    /// Directions of the parameter space that the data determine.
    pub rank: usize,
    /// Parameters that the method estimates.
    pub states: usize,
    /// Of the correlation matrix' square root.
    pub condition_number: f64,
    /// Sigmas by name.
    pub parameters: Named<PredictedSigma>,
    /// Bai's twelve states against scheme time, where rank or move changes.
    pub installation_rank: Vec<RankAt>,
    /// Where the unit stands.
    pub site: SiteReport,
    /// Its noise.
    pub noise: Noise,
    software: Software,
}

impl Prediction {
    /// Of a unit without errors, level and facing north.
    pub fn new(setup: &Setup, scheme: &Scheme) -> Self {
        let run = silent_run(setup, scheme);
        let outcome = run.calibrate(std::slice::from_ref(setup)).remove(0);
        let (covariance, prior_sigmas) = estimated_only(&outcome);
        let (rank, condition_number) = of_covariance(&covariance, &prior_sigmas);
        Self {
            scheme: scheme.name.as_str().into(),
            method: crate::calibration::method_name(setup.method),
            duration_s: run.duration_s(),
            rank,
            states: prior_sigmas.iter().filter(|sigma| **sigma > 0.0).count(),
            condition_number,
            parameters: predicted_sigmas(&outcome),
            installation_rank: installation_rank(setup, scheme),
            site: (&setup.site).into(),
            noise: setup.noise,
            software: SOFTWARE,
        }
    }
}

/// Sigmas of all parameters by the core, SI.
pub fn predicted_sigmas_si(setup: &Setup, scheme: &Scheme) -> [f64; PARAMETERS] {
    silent_run(setup, scheme).calibrate(std::slice::from_ref(setup)).remove(0).estimate().sigmas
}

/// Duration of a scheme, first stop, ramps and settling included, s.
pub fn duration_s(setup: &Setup, scheme: &Scheme) -> f64 {
    silent_run(setup, scheme).duration_s()
}

/// A perfect unit without noise, level and facing north.
fn silent_run(setup: &Setup, scheme: &Scheme) -> VirtualRun {
    let unit = VirtualUnit { site: setup.site, noise: SILENT, rate_hz: setup.rate_hz, ..VirtualUnit::default() };
    VirtualRun { unit, scheme: scheme.clone(), seed: 0 }
}

/// Covariance and prior sigmas, zero where the method only carries a parameter along.
fn estimated_only(outcome: &Outcome) -> (Matrix<f64, PARAMETERS, PARAMETERS>, [f64; PARAMETERS]) {
    let kept = |index: usize, value: f64| if outcome.is_estimated(index) { value } else { 0.0 };
    let covariance = &outcome.covariance;
    let entry = |row: usize, column: usize| kept(row, kept(column, covariance[(row, column)]));
    (Matrix::from_fn(entry), std::array::from_fn(|index| kept(index, outcome.prior_sigmas[index])))
}

fn predicted_sigmas(outcome: &Outcome) -> Named<PredictedSigma> {
    let sigmas = quantity::sigmas(&outcome.estimate().sigmas);
    let estimated = (0..PARAMETERS).filter(|index| outcome.is_estimated(*index));
    let predicted = |index: usize| {
        let info = &PARAMETER_INFO[index];
        (info.name, PredictedSigma { sigma: sigmas[index], unit: info.unit })
    };
    Named(estimated.map(predicted).collect())
}

/// Rank and condition number whenever the rank has changed, and at the end of every stop.
fn installation_rank(setup: &Setup, scheme: &Scheme) -> Vec<RankAt> {
    let ends = stop_ends_s(scheme);
    let mut table: Vec<RankAt> = Vec::new();
    along_scheme(scheme, &setup.site, &InstrumentErrors::default(), |time_s, seen| {
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
    let mut from = (0.0, 0.0);
    let mut time_s = scheme.first_stop_s;
    let ends = scheme.legs.iter().map(|leg| {
        let move_s = scheme.move_s(leg.outer_rad - from.0).max(scheme.move_s(leg.inner_rad - from.1));
        from = (leg.outer_rad, leg.inner_rad);
        time_s += move_s + leg.stop_s;
        time_s
    });
    ends.collect()
}
