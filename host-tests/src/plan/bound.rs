//! Lower bound of the sigmas of any scheme of a given duration.
//!
//! Gyros, encoders, non-perpendicularity and all imperfections of the hardware are taken as perfect, those of the
//! accelerometers too: each can only add to the variances. So the bound holds for a unit with any hardware, and it is
//! tight only for ideal hardware. Then 14 parameters are left, which the accelerometers must find. Their information is
//! the sum over the attitudes x of the stops,
//! ```text
//! J = sum over x of t(x) S(x),   S = H^T H / psd,   sum of t(x) <= T_acc
//! ```
//! At best, a scheme distributes the time t freely over all attitudes that it can reach. Two facts limit the time
//! T_acc:
//! - An axis that travels by L needs at least the time L / rate + rate / acceleration, with any number of moves.
//!   Attitudes farther than L from the start on either axis cost at least that time, and the bound is the least over L.
//! - Each stop gives three numbers, so at least five stops and four moves are needed, each with settling and guard.
//!
//! For any J0 and any weights lambda >= 0 of sum 1, with C = J0^-1, L = diag(lambda w^2) and g(x) = tr(C L C S(x)),
//! ```text
//! max (w sigma)^2 >= tr(L J^-1) >= tr(L C)^2 / (T_acc max g(x))
//! ```
//! because tr(L J^-1) is convex in J, and so lies above its tangent at c J0 for every c. (Pukelsheim, Optimal Design of
//! Experiments, 1993, ch. 7.) J0 and lambda only determine how tight the bound is. They come from multiplicative
//! updates. `max g` is taken on a grid of 3 deg. g is a trigonometric polynomial of degree 2 in each angle, so the true
//! maximum is at most 1 / cos^2(3 deg) times the maximum on the grid.

use super::forecast::Forecast;
use super::objective::{Criterion, Objective};
use super::request::{PlanRequest, Travel};
use crate::base::quantity::states;
use crate::calibration::Setup;
use rayon::prelude::*;
use rins_selfcal::base::linear::Matrix;
use rins_selfcal::base::units::DEG;
use rins_selfcal::model::error_model::block;
use rins_selfcal::scheme::{Leg, Scheme};
use rins_selfcal::segment::GUARD_S;

/// Number of parameters: accelerometer non-orthogonality, mounting, bias and scale; roll and pitch of the base.
const STATES: usize = 14;
/// Least number of stops that give 14 numbers, three at each stop.
const LEAST_STOPS: f64 = 5.0;
/// Grid for the optimal attitudes, and grid for the maximum of g.
const COARSE_RAD: f64 = 15.0 * DEG;
const FINE_RAD: f64 = 3.0 * DEG;
const UPDATES: u32 = 300;
/// Updates between two evaluations of the bound, which gets tighter with every update.
const CERTIFY: u32 = 100;
/// Exponent of the update of lambda. It is smaller than that of the attitudes, so that lambda changes more slowly.
const WEIGHT_EXPONENT: f64 = 0.3;

type Rows = Matrix<f64, 3, STATES>;
type Square = Matrix<f64, STATES, STATES>;

/// Lower bound of the worst sigma of Bai's twelve states in the time of a scheme, at its rates and with any travel,
/// arcsec.
pub fn of_scheme(setup: &Setup, scheme: &Scheme, duration_s: f64) -> Option<f64> {
    lower_bound(&PlanRequest {
        setup: setup.clone(),
        time_s: duration_s,
        turning: scheme.turning(),
        settling_s: GUARD_S,
        travel: [Travel::default(); 2],
        angle_step_rad: None,
        objective: Objective::installation(Criterion::Worst),
        evaluations: 0,
        seed: 0,
    })
}

/// Lower bound of the objective; `None` for D-optimality, or if no parameter of the accelerometers has a weight.
pub fn lower_bound(request: &PlanRequest) -> Option<f64> {
    let weights = squared_weights(request)?;
    let farthest = request.travel.iter().map(farthest_rad).fold(0.0, f64::max);
    let steps = (farthest / COARSE_RAD).ceil() as u32;
    let bounds = (1..=steps).into_par_iter().filter_map(|step| {
        let time_s = at_rest_s(request, f64::from(step - 1) * COARSE_RAD);
        let design = Design::new(request, f64::from(step) * COARSE_RAD);
        (time_s > 0.0).then(|| (design.least_variance_s(&weights, request.objective.criterion()) / time_s).sqrt())
    });
    bounds.min_by(f64::total_cmp)
}

/// Distance from the start beyond which an axis reaches no new attitudes, rad.
fn farthest_rad(travel: &Travel) -> f64 {
    let half_turn = 180.0 * DEG;
    let (back, forth) = (-travel.lowest_rad, travel.highest_rad);
    if back.min(forth) >= half_turn { half_turn } else { back.max(forth).min(2.0 * half_turn) }
}

/// Index of a parameter among the 14, if the accelerometers observe the parameter.
fn place(parameter: usize) -> Option<usize> {
    let first = parameter.checked_sub(block::ACCEL_NON_ORTHOGONALITY).filter(|place| *place < STATES - 2);
    let attitude = || parameter.checked_sub(block::ATTITUDE).filter(|place| *place < 2).map(|place| STATES - 2 + place);
    first.filter(|_| parameter < block::GYRO_BIAS).or_else(attitude)
}

/// Squared weights in 1 / SI^2; for A-optimality divided by the number of weights.
fn squared_weights(request: &PlanRequest) -> Option<[f64; STATES]> {
    let objective = &request.objective;
    let mut squared = [0.0; STATES];
    for weight in objective.weights() {
        if let (Some(place), Some(info)) = (place(weight.parameter), states().nth(weight.parameter)) {
            squared[place] = (weight.factor / info.unit_si).powi(2);
        }
    }
    if objective.criterion() == Criterion::A {
        squared.iter_mut().for_each(|weight| *weight /= objective.weights().len() as f64);
    }
    (objective.criterion() != Criterion::D && squared.iter().any(|weight| *weight > 0.0)).then_some(squared)
}

/// Time at rest, T_acc, in a scheme that reaches at least this far, s.
fn at_rest_s(request: &PlanRequest, reach_rad: f64) -> f64 {
    let there = Leg { outer_rad: reach_rad, inner_rad: 0.0, stop_s: 0.0 };
    let moves_s = request.turning.move_s(&Leg { outer_rad: 0.0, ..there }, &there);
    request.time_s - moves_s - (LEAST_STOPS - 1.0) * (request.settling_s.max(GUARD_S) + GUARD_S)
}

/// Measurement matrices of the attitudes within reach.
struct Design {
    coarse: Vec<Rows>,
    fine: Vec<Rows>,
}

impl Design {
    fn new(request: &PlanRequest, reach_rad: f64) -> Self {
        let forecast = Forecast::new(&request.setup, request.turning, request.settling_s);
        let psd_sqrt = request.setup.noise.psd().accel_psd_sqrt;
        let at = |step_rad: f64| {
            let [outer, inner] = request.travel.map(|travel| angles(&travel, reach_rad, step_rad));
            let stands = outer.iter().flat_map(|outer| inner.iter().map(|inner| (*outer, *inner)));
            let rows = stands.map(|(outer_rad, inner_rad)| {
                let by = forecast.force_rows(&Leg { outer_rad, inner_rad, stop_s: 0.0 });
                let mut rows = Rows::zeros();
                for (parameter, column) in by.column_iter().enumerate() {
                    if let Some(place) = place(parameter) {
                        rows.set_column(place, &(column / psd_sqrt));
                    }
                }
                rows
            });
            rows.collect()
        };
        Self { coarse: at(COARSE_RAD), fine: at(FINE_RAD) }
    }

    /// Least weighted variance after one second at rest, s: the tightest bound of all updates.
    fn least_variance_s(&self, weights: &[f64; STATES], criterion: Criterion) -> f64 {
        let mut shares = vec![1.0 / self.coarse.len() as f64; self.coarse.len()];
        let counted = weights.iter().filter(|weight| **weight > 0.0).count() as f64;
        let even = if criterion == Criterion::Worst { counted.recip() } else { 1.0 };
        let mut lambda = weights.map(|weight| if weight > 0.0 { even } else { 0.0 });
        let mut best = 0.0;
        for update in 1..=UPDATES {
            let mut information = Square::zeros();
            for (rows, share) in self.coarse.iter().zip(&shares) {
                information += rows.tr_mul(rows) * *share;
            }
            let Some(covariance) = information.try_inverse().filter(|covariance| covariance.trace().is_finite()) else {
                // These attitudes do not observe all parameters, so the variance is infinite.
                return f64::INFINITY;
            };
            let of = |place: usize| lambda[place] * weights[place];
            let total: f64 = (0..STATES).map(|place| of(place) * covariance[(place, place)]).sum();
            let scaled = Square::from_fn(|row, column| covariance[(row, column)] * of(column).sqrt());
            let gain = |rows: &Rows| (rows * scaled).norm_squared();
            if update % CERTIFY == 0 {
                let most = self.fine.iter().map(gain).fold(0.0, f64::max) / FINE_RAD.cos().powi(2);
                best = f64::max(best, total * total / most);
            }
            shares.iter_mut().zip(&self.coarse).for_each(|(share, rows)| *share *= (gain(rows) / total).sqrt());
            let sum: f64 = shares.iter().sum();
            shares.iter_mut().for_each(|share| *share /= sum);
            if criterion == Criterion::Worst {
                for (place, lambda) in lambda.iter_mut().enumerate() {
                    *lambda *= (weights[place] * covariance[(place, place)] / total).powf(WEIGHT_EXPONENT);
                }
                let sum: f64 = lambda.iter().sum();
                lambda.iter_mut().for_each(|lambda| *lambda /= sum);
            }
        }
        best
    }
}

/// Angles of one axis within reach, at most one turn, rad.
fn angles(travel: &Travel, reach_rad: f64, step_rad: f64) -> Vec<f64> {
    let (lowest, highest) = (travel.lowest_rad.max(-reach_rad), travel.highest_rad.min(reach_rad));
    let steps = ((highest - lowest).min(360.0 * DEG) / step_rad).ceil() as u32;
    (0..=steps).map(|step| (lowest + f64::from(step) * step_rad).min(highest)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Precision;
    use crate::files::unit_file::UnitConfig;
    use crate::plan::prediction::{duration_s, predicted_sigmas_si};
    use rins_selfcal::base::method::Method;
    use rins_selfcal::base::units::ARCSEC;
    use rins_selfcal::model::error_model::INSTALLATION_STATES;
    use rins_selfcal::scheme::library::LIBRARY;

    #[test]
    fn no_scheme_of_the_library_is_below_the_bound() {
        for unit in [UnitConfig::ideal(), UnitConfig::default().somewhere()] {
            let setup = Setup::new(&unit, 200.0, Method::Joint, Precision::F64);
            for entry in &LIBRARY {
                let scheme = entry.scheme();
                let sigmas = predicted_sigmas_si(&setup, &scheme);
                let worst = sigmas.iter().take(INSTALLATION_STATES).fold(0.0, |worst, sigma| f64::max(worst, *sigma));
                let bound = of_scheme(&setup, &scheme, duration_s(&setup, &scheme)).expect("there is one");
                assert!(bound > 0.05 && bound < worst / ARCSEC, "{}: {bound}", entry.name);
            }
        }
    }

    #[test]
    fn the_bound_falls_with_the_root_of_time() {
        // The longer the scheme, the smaller is the share of moves and settling.
        let setup = Setup::new(&UnitConfig::ideal(), 200.0, Method::Joint, Precision::F64);
        let scheme = LIBRARY[0].scheme();
        let bound = |time_s| of_scheme(&setup, &scheme, time_s).expect("there is one");
        let ratio = bound(10_000.0) / bound(40_000.0);
        assert!((ratio / 2.0 - 1.0).abs() < 0.002, "{ratio}");
        assert!(bound(60.0) / bound(240.0) > 2.1);
    }
}
