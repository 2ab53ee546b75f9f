//! Simulated annealing over the stops of a scheme: their angles, order, number and durations.
//!
//! Independent chains start from random schemes. The best chains are then cooled further with small steps. A chain
//! depends on its seed only, so the result does not depend on the number of cores. It does not depend on the machine
//! either, because the search uses the core's own mathematics. (Kirkpatrick, Gelatt and Vecchi, Science 220, 1983.) The
//! annealing loop has a dozen lines. The crate argmin has an annealer, but it brings its own random numbers. The steps,
//! the rest of this file, are specific to schemes.

use super::forecast::Forecast;
use super::leg_model::LegModel;
use super::objective::Objective;
use super::request::Travel;
use crate::calibration::virtual_run::{SETTLING_S, Stream, derived_seed};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use rins_selfcal::base::linear::ComplexField;
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::Leg;
use std::collections::HashMap;
use std::rc::Rc;

/// Number of chains that start from random schemes, and their share of all evaluations.
const CHAINS: u64 = 24;
const FIRST_PART: f64 = 0.8;
/// Number of chains that are cooled further.
const FINALISTS: usize = 4;
/// Evaluations between two reports of progress.
const TELL: u64 = 500;
/// Number of leg models in the cache, about 10 MB.
const REMEMBERED: usize = 4000;
/// Smallest extra time of a stop, s. It is not zero, so that scaling can make it larger.
const LEAST_EXTRA_S: f64 = 1e-3;
/// Trials to find a first scheme that fits.
const TRIALS: usize = 10_000;

/// Cooling schedule; each pair is the first and the last value, and the values between are geometric.
#[derive(Clone, Copy)]
struct Cooling {
    /// Increase of the objective's logarithm that is accepted with probability 1/e.
    temperature: [f64; 2],
    /// Size of the steps, relative to the largest.
    step: [f64; 2],
    /// Exponent of the p-norm that approximates the worst sigma.
    exponent: f64,
}

const FIRST: Cooling = Cooling { temperature: [0.05, 1e-4], step: [1.0, 0.02], exponent: 64.0 };
const LAST: Cooling = Cooling { temperature: [2e-4, 1e-6], step: [0.02, 5e-4], exponent: 300.0 };

fn cooled([from, to]: [f64; 2], part: f64) -> f64 {
    from * ComplexField::powf(to / from, part)
}

/// Constraints and objective of a search.
pub struct Problem<'a> {
    /// Predicts the information of a scheme.
    pub forecast: Forecast,
    /// Objective for the information.
    pub objective: &'a Objective,
    /// Duration of the scheme, s.
    pub time_s: f64,
    /// Sample interval, s. Moves and stops take whole intervals.
    pub sample_s: f64,
    /// Travel of the axes.
    pub travel: [Travel; 2],
    /// Step of the stop angles, rad.
    pub step_rad: f64,
    /// Shortest stop, s.
    pub least_stop_s: f64,
    /// Largest number of legs.
    pub most_legs: usize,
}

impl Problem<'_> {
    fn snapped(&self, axis: usize, angle_rad: f64) -> f64 {
        let Travel { lowest_rad, highest_rad } = self.travel[axis];
        // A limit of the travel need not be a multiple of the step.
        let steps = |limit: f64| limit / self.step_rad;
        let lowest = ComplexField::ceil(steps(lowest_rad) - 1e-9);
        let highest = ComplexField::floor(steps(highest_rad) + 1e-9);
        ComplexField::round(steps(angle_rad)).clamp(lowest, highest) * self.step_rad
    }

    fn stand(&self, angles_rad: [f64; 2], stop_s: f64) -> Leg {
        let [outer_rad, inner_rad] = [0, 1].map(|axis| self.snapped(axis, angles_rad[axis]));
        Leg { outer_rad, inner_rad, stop_s }
    }

    fn grid_s(&self, duration_s: f64) -> f64 {
        ComplexField::ceil(duration_s / self.sample_s - 1e-6) * self.sample_s
    }
}

struct Chance(Xoshiro256PlusPlus);

impl Chance {
    /// Uniform random number in [0, 1).
    fn part(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, count: usize) -> usize {
        (self.part() * count as f64) as usize
    }

    /// Nearly normal random number of mean 0 and variance 1: a sum of three uniform numbers, identical on every
    /// machine.
    fn bell(&mut self) -> f64 {
        2.0 * (self.part() + self.part() + self.part() - 1.5)
    }
}

/// A scheme and the value of its objective.
type Valued = (f64, Vec<Leg>);

struct Chain<'a> {
    problem: &'a Problem<'a>,
    chance: Chance,
    remembered: HashMap<[u64; 4], Rc<LegModel>>,
}

/// Evaluates this many schemes. Returns the best one, with its stops on the sample grid; `None` if no scheme fits.
pub fn search(problem: &Problem, evaluations: u64, seed: u64, progress: &(impl Fn(u64, f64) + Sync)) -> Option<Valued> {
    let of_first = (evaluations as f64 * FIRST_PART) as u64 / CHAINS;
    let chain = |number: u64| Chain::new(problem, derived_seed(seed, number, Stream::Noise));
    let first = (0..CHAINS).into_par_iter().map(|number| {
        let mut chain = chain(number);
        let start = chain.start()?;
        Some(chain.anneal(start, &FIRST, of_first, progress))
    });
    let mut found: Vec<Valued> = first.collect::<Vec<_>>().into_iter().flatten().collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.truncate(FINALISTS);
    let of_last = (evaluations - CHAINS * of_first) / FINALISTS as u64;
    let last = found.into_par_iter().enumerate().map(|(number, (_, stands))| {
        let mut chain = chain(CHAINS + number as u64);
        let (_, stands) = chain.anneal(stands, &LAST, of_last, progress);
        chain.on_grid(stands)
    });
    last.collect::<Vec<_>>().into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0))
}

impl<'a> Chain<'a> {
    fn new(problem: &'a Problem<'a>, seed: u64) -> Self {
        let chance = Chance(Xoshiro256PlusPlus::seed_from_u64(seed));
        Self { problem, chance, remembered: HashMap::new() }
    }

    /// Random stops in the order of the outer angle.
    fn start(&mut self) -> Option<Vec<Leg>> {
        for trial in 0..TRIALS {
            // One stop per 15 s and five more; fewer if they do not fit.
            let legs = (4 + (self.problem.time_s / 15.0) as usize).min(self.problem.most_legs);
            let legs = legs - (legs - 1) * trial / TRIALS;
            let stop_s = self.problem.least_stop_s + 1.0;
            let mut stands: Vec<Leg> = (0..legs).map(|_| self.anywhere(stop_s)).collect();
            stands.sort_by(|a, b| a.outer_rad.abs().total_cmp(&b.outer_rad.abs()));
            stands.insert(0, self.problem.stand([0.0; 2], stop_s));
            if self.fitted(&mut stands).is_some() {
                return Some(stands);
            }
        }
        None
    }

    fn anywhere(&mut self, stop_s: f64) -> Leg {
        let angles = [0, 1].map(|axis| {
            let Travel { lowest_rad, highest_rad } = self.problem.travel[axis];
            lowest_rad + (highest_rad - lowest_rad) * self.chance.part()
        });
        self.problem.stand(angles, stop_s)
    }

    fn anneal(
        &mut self,
        start: Vec<Leg>,
        cooling: &Cooling,
        evaluations: u64,
        progress: &(impl Fn(u64, f64) + Sync),
    ) -> Valued {
        let mut current = (f64::INFINITY, start);
        let mut best = current.clone();
        for number in 0..evaluations {
            let part = number as f64 / evaluations as f64;
            let temperature = cooled(cooling.temperature, part);
            let mut stands =
                if number == 0 { best.1.clone() } else { self.neighbour(&current.1, cooled(cooling.step, part)) };
            if let Some(value) = self.value(&mut stands, cooling.exponent)
                && self.accepts(ComplexField::ln(value / current.0), temperature)
            {
                current = (value, stands);
                if current.0 < best.0 {
                    best = current.clone();
                }
            }
            if (number + 1) % TELL == 0 {
                progress(TELL, self.told_value(&best.1));
            }
        }
        progress(evaluations % TELL, self.told_value(&best.1));
        best
    }

    /// Final value of a scheme, with the worst sigma itself in place of the p-norm.
    fn told_value(&mut self, stands: &[Leg]) -> f64 {
        self.value(&mut stands.to_vec(), f64::INFINITY).unwrap_or(f64::INFINITY)
    }

    fn accepts(&mut self, worse_by: f64, temperature: f64) -> bool {
        worse_by < 0.0 || self.chance.part() < ComplexField::exp(-worse_by / temperature)
    }

    /// A neighbour of this scheme. `step` is the size of the changes, 1 for the largest.
    fn neighbour(&mut self, stands: &[Leg], step: f64) -> Vec<Leg> {
        let mut stands = stands.to_vec();
        let last = stands.len() - 1;
        let (one, other) = (1 + self.chance.below(last), 1 + self.chance.below(last));
        let (low, high) = (one.min(other), one.max(other));
        match self.chance.below(20) {
            0..6 => {
                let way = if self.chance.part() < 0.5 { 60.0 * DEG } else { 5.0 * DEG };
                self.shift(&mut stands[one..=one], way * step);
            }
            6 => self.shift(&mut stands[low..=high], 60.0 * DEG * step),
            7..9 => self.replace(&mut stands[one]),
            9..13 => {
                let stand = self.chance.below(stands.len());
                let extra_s = stands[stand].stop_s - self.problem.least_stop_s;
                let factor = ComplexField::exp(0.5 * step * self.chance.bell());
                stands[stand].stop_s = self.problem.least_stop_s + extra_s * factor;
            }
            13..15 => {
                let moved_s = 0.3 * self.chance.part() * stands[one].stop_s;
                let to = self.chance.below(stands.len());
                stands[one].stop_s -= moved_s;
                stands[to].stop_s += moved_s;
            }
            15 => {
                if last < self.problem.most_legs {
                    let mut stand = stands[one - 1];
                    self.replace(&mut stand);
                    stand.stop_s = self.problem.time_s / stands.len() as f64 * self.chance.part();
                    stands.insert(one, stand);
                }
            }
            16..18 => {
                if last > 1 {
                    stands.remove(one);
                }
            }
            18 => stands.swap(one, other),
            _ => stands[low..=high].reverse(),
        }
        stands
    }

    /// Moves one or both axes to random angles.
    fn replace(&mut self, stand: &mut Leg) {
        let new = self.anywhere(stand.stop_s);
        let axes = self.chance.below(3);
        if axes != 0 {
            stand.outer_rad = new.outer_rad;
        }
        if axes != 1 {
            stand.inner_rad = new.inner_rad;
        }
    }

    /// Shifts one or both axes of all these stops by about `way_rad`.
    fn shift(&mut self, stands: &mut [Leg], way_rad: f64) {
        let axes = self.chance.below(3);
        let ways = [0, 1].map(|axis| if axes == axis { 0.0 } else { way_rad * self.chance.bell() });
        for stand in stands {
            *stand = self.problem.stand([stand.outer_rad + ways[0], stand.inner_rad + ways[1]], stand.stop_s);
        }
    }

    /// Scales the stops to fill the time. Returns the legs; `None` if that is impossible, or if a leg moves neither
    /// axis.
    fn fitted(&mut self, stands: &mut [Leg]) -> Option<Vec<Rc<LegModel>>> {
        let stays = |pair: &[Leg]| (pair[0].outer_rad, pair[0].inner_rad) == (pair[1].outer_rad, pair[1].inner_rad);
        if stands.windows(2).any(stays) {
            return None;
        }
        let legs: Vec<_> = (0..stands.len()).map(|to| self.leg(&stands[to.saturating_sub(1)], &stands[to])).collect();
        let moves_s: f64 = legs.iter().skip(1).map(|leg| self.problem.grid_s(leg.move_s)).sum();
        let least_s = self.problem.least_stop_s;
        let free_s = self.problem.time_s - moves_s - stands.len() as f64 * (SETTLING_S + least_s);
        if free_s <= 0.0 {
            return None;
        }
        let extra_s = |stand: &Leg| (stand.stop_s - least_s).max(LEAST_EXTRA_S);
        let factor = free_s / stands.iter().map(extra_s).sum::<f64>();
        stands.iter_mut().for_each(|stand| stand.stop_s = least_s + extra_s(stand) * factor);
        Some(legs)
    }

    fn leg(&mut self, from: &Leg, to: &Leg) -> Rc<LegModel> {
        if self.remembered.len() > REMEMBERED {
            self.remembered.clear();
        }
        let key = [from.outer_rad, from.inner_rad, to.outer_rad, to.inner_rad].map(f64::to_bits);
        let forecast = &self.problem.forecast;
        Rc::clone(self.remembered.entry(key).or_insert_with(|| Rc::new(forecast.leg(from, to))))
    }

    fn value(&mut self, stands: &mut [Leg], exponent: f64) -> Option<f64> {
        let legs = self.fitted(stands)?;
        let information = self.problem.forecast.information(stands, &legs);
        self.problem.objective.value(&information, exponent)
    }

    /// Stops rounded down to the sample grid, and their objective.
    fn on_grid(&mut self, mut stands: Vec<Leg>) -> Option<Valued> {
        let legs = self.fitted(&mut stands)?;
        let sample_s = self.problem.sample_s;
        let on_grid = |stop_s: f64| ComplexField::floor(stop_s / sample_s + 1e-6) * sample_s;
        stands.iter_mut().for_each(|stand| stand.stop_s = on_grid(stand.stop_s));
        let information = self.problem.forecast.information(&stands, &legs);
        Some((self.problem.objective.value(&information, f64::INFINITY)?, stands))
    }
}
