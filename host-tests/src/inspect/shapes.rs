//! The noise processes in an Allan curve: the fewest whose sum explains it.
//!
//! Each process has a shape, the Allan variance of unit size, and the variance of the curve is their sum:
//! ```text
//! angle noise, pulses     3 / tau^2             rms of the angle (or velocity)
//! rocking of the base     8 / tau^2 <sin^4(pi f tau)>, mean over 0.1 to 5 Hz in equal ratios; rms of the angle
//! white noise             1 / tau               density
//! floor                   1                     Allan floor
//! walk                    tau / 3               random walk of the bias
//! ramp                    tau^2 / 2             drift of the bias                   (IEEE Std 952, annex C)
//! ```
//! The squared deviation at tau has a chi-square distribution with nu degrees of freedom about the sum m. Sizes of
//! largest likelihood, none negative, follow by iteration (Fevotte, Bertin and Durrieu 2009, Itakura-Saito divergence).
//! A process is in the curve if the likelihood ratio says so: twice its logarithm is the loss of deviance.

use super::allan::AllanPoint;
use rins_selfcal::base::linear::Matrix;
use serde::Serialize;
use std::f64::consts::PI;

/// Averaging times that are used, s: longer than most vibration and than the response of the sensors.
const SHORTEST_S: f64 = 0.07;
/// Deviance that a process must explain. Chance reaches it once in 16 000 curves, where the points are independent.
const TELLING: f64 = 16.0;
/// Iterations of the sizes. The deviance falls in each of them.
const ITERATIONS: usize = 3000;
/// Most processes in a curve.
const MOST: usize = Process::OF_GYRO.len();
/// Waves of the rocking, and their lowest and highest frequency, Hz.
const WAVES: u32 = 48;
const ROCKING_HZ: [f64; 2] = [0.1, 5.0];

/// A noise process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Process {
    /// White noise of the angle or the velocity, as pulses have it.
    Angle,
    /// Rocking of the base, in the angle.
    Rocking,
    /// White noise of the output.
    White,
    /// Allan floor.
    Floor,
    /// Random walk of the bias.
    Walk,
    /// Drift of the bias.
    Ramp,
}

impl Process {
    /// The processes of an accelerometer.
    pub const OF_ACCELEROMETER: [Self; 5] = [Self::White, Self::Floor, Self::Walk, Self::Ramp, Self::Angle];
    /// The processes of a gyro.
    pub const OF_GYRO: [Self; 6] = [Self::White, Self::Floor, Self::Walk, Self::Ramp, Self::Angle, Self::Rocking];

    /// Whether the process grows slowly. Beside white noise it is the larger one at long averaging times only.
    fn is_slow(self) -> bool {
        matches!(self, Self::Floor | Self::Walk | Self::Ramp)
    }

    /// Standard deviation of the size, in units of that for points which are independent and have the degrees of freedom
    /// of white noise. Octaves overlap: together they count as twice as many degrees of freedom as the shortest one, and
    /// have hardly more information than it. Beside that, a floor has 1.2 and a walk 1.5 times fewer degrees of freedom
    /// than white noise, and noise of the angle has more (NIST SP 1065, table 5).
    fn scatter(self) -> Option<f64> {
        let squared: Option<f64> = match self {
            Self::White => Some(2.0),
            Self::Floor => Some(2.0 * 1.2),
            Self::Walk => Some(2.0 * 1.5),
            Self::Angle => Some(1.0),
            Self::Ramp | Self::Rocking => None,
        };
        squared.map(f64::sqrt)
    }

    fn variance(self, tau_s: f64) -> f64 {
        match self {
            Self::Angle => 3.0 / (tau_s * tau_s),
            Self::Rocking => rocking(tau_s),
            Self::White => tau_s.recip(),
            Self::Floor => 1.0,
            Self::Walk => tau_s / 3.0,
            Self::Ramp => 0.5 * tau_s * tau_s,
        }
    }
}

fn rocking(tau_s: f64) -> f64 {
    let [low_hz, high_hz] = ROCKING_HZ;
    let power = |wave: u32| {
        let part = (f64::from(wave) + 0.5) / f64::from(WAVES);
        (PI * low_hz * (high_hz / low_hz).powf(part) * tau_s).sin().powi(4)
    };
    8.0 / (tau_s * tau_s) * (0..WAVES).map(power).sum::<f64>() / f64::from(WAVES)
}

/// A process in a curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The process.
    pub process: Process,
    /// Its size.
    pub size: f64,
    /// Standard deviation of the size. `None` for a ramp, and for rocking, of which a log shows a few waves only.
    pub sigma: Option<f64>,
}

/// The processes in a curve, with their sizes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Processes(pub Vec<Found>);

impl Processes {
    /// The fewest of these processes that explain a curve. None if the curve is too short.
    pub fn of(curve: &[AllanPoint], known: &[Process]) -> Self {
        let points: Vec<&AllanPoint> = curve.iter().filter(|point| point.tau_s > SHORTEST_S).collect();
        let (mut fit, mut found) = (Fit::of(&points, &[]), Vec::new());
        // Each round adds a process and drops one that the others replace, or ends.
        for _ in known.iter().take(points.len().saturating_sub(1)) {
            let new = known.iter().filter(|process| !found.contains(*process));
            let Some((better, more)) = best(&points, new.map(|process| [&found[..], &[*process]].concat())) else {
                break;
            };
            if fit.deviance - better.deviance <= TELLING {
                break;
            }
            (fit, found) = (better, more);
            let without = |process: &Process| found.iter().copied().filter(|other| other != process).collect();
            if let Some((simpler, fewer)) = best(&points, found.iter().map(without))
                && simpler.deviance - fit.deviance < TELLING
            {
                (fit, found) = (simpler, fewer);
            }
        }
        let sizes = fit.variances.iter().zip(fit.scatter(&points, &found)).zip(found);
        let sizes = sizes.map(|((variance, scatter), process)| {
            let (size, scatter) = (variance.sqrt(), process.scatter().map(|of_process| of_process * scatter));
            Found { process, size, sigma: scatter.map(|scatter| scatter * size) }
        });
        Self(sizes.collect())
    }

    /// A process, if it is in the curve.
    pub fn found(&self, process: Process) -> Option<Found> {
        self.0.iter().find(|found| found.process == process).copied()
    }

    /// Size of a process, if it is in the curve.
    pub fn size(&self, process: Process) -> Option<f64> {
        self.found(process).map(|found| found.size)
    }
}

/// The processes of largest likelihood, among those in which no slow process takes the place of white noise.
fn best(points: &[&AllanPoint], choices: impl Iterator<Item = Vec<Process>>) -> Option<(Fit, Vec<Process>)> {
    let sound = |processes: &Vec<Process>| {
        processes.contains(&Process::White) || !processes.iter().any(|process| process.is_slow())
    };
    let fits = choices.filter(sound).map(|processes| (Fit::of(points, &processes), processes));
    fits.min_by(|(a, _), (b, _)| a.deviance.total_cmp(&b.deviance))
}

/// Sizes of largest likelihood.
struct Fit {
    variances: Vec<f64>,
    deviance: f64,
}

impl Fit {
    fn of(points: &[&AllanPoint], processes: &[Process]) -> Self {
        if processes.is_empty() {
            return Self { variances: Vec::new(), deviance: f64::INFINITY };
        }
        let shapes: Vec<Vec<f64>> = points
            .iter()
            .map(|point| processes.iter().map(|process| process.variance(point.tau_s)).collect())
            .collect();
        let seen: Vec<[f64; 2]> = points.iter().map(|point| [point.deviation.powi(2), point.freedom()]).collect();
        let sum = |variances: &[f64], shape: &[f64]| variances.iter().zip(shape).map(|(a, b)| a * b).sum::<f64>();
        // Every process begins with an equal part of the variance where it is largest against the curve.
        let least = |place: usize| {
            let ratios = seen.iter().zip(&shapes).map(|([variance, _], shape)| variance / shape[place]);
            ratios.fold(f64::INFINITY, f64::min) / processes.len() as f64
        };
        let mut variances: Vec<f64> = (0..processes.len()).map(least).collect();
        for _ in 0..ITERATIONS {
            let expected: Vec<f64> = shapes.iter().map(|shape| sum(&variances, shape)).collect();
            for (place, size) in variances.iter_mut().enumerate() {
                let terms = seen.iter().zip(&expected).zip(&shapes);
                let [above, below] =
                    terms.fold([0.0; 2], |[above, below], (([variance, freedom], expected), shape)| {
                        let weight = freedom * shape[place] / expected;
                        [above + weight * variance / expected, below + weight]
                    });
                *size *= (above / below).sqrt();
            }
        }
        let deviance = seen.iter().zip(&shapes).map(|([variance, freedom], shape)| {
            let ratio = variance / sum(&variances, shape);
            freedom * (ratio - 1.0 - ratio.ln())
        });
        let deviance = deviance.sum::<f64>();
        Self { variances, deviance: if deviance.is_nan() { f64::INFINITY } else { deviance } }
    }

    /// Standard deviations of the sizes as fractions of them, by the information that chi-square numbers have: nu / 2
    /// about the logarithm of their mean.
    fn scatter(&self, points: &[&AllanPoint], processes: &[Process]) -> Vec<f64> {
        let mut information = Matrix::<f64, MOST, MOST>::identity();
        information.view_mut((0, 0), (processes.len(), processes.len())).fill(0.0);
        for point in points {
            let parts = processes.iter().zip(&self.variances).map(|(of, size)| of.variance(point.tau_s) * size);
            let parts: Vec<f64> = parts.collect();
            let sum: f64 = parts.iter().sum();
            for (row, a) in parts.iter().enumerate() {
                for (column, b) in parts.iter().enumerate() {
                    information[(row, column)] += 0.5 * point.freedom() * a * b / (sum * sum);
                }
            }
        }
        let covariance = information.try_inverse();
        // Half of the deviation of the variance, which is the square of the size.
        let of = |place: usize| covariance.map_or(f64::INFINITY, |covariance| 0.5 * covariance[(place, place)].sqrt());
        (0..processes.len()).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::allan::AllanDeviation;
    use super::*;
    use crate::virtual_unit::imperfections::{Flicker, Imperfections};
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;
    use rins_selfcal::base::units::MICRO_G;

    const INTERVAL_S: f64 = 0.01;

    /// The processes in 20 stops of some seconds of white noise of density 1 at 100 Hz, and of what `add` makes of it.
    fn found(stop_s: f64, add: impl FnMut(u32, f64) -> f64) -> Processes {
        drawn(3, stop_s, add)
    }

    fn drawn(seed: u64, stop_s: f64, mut add: impl FnMut(u32, f64) -> f64) -> Processes {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut allan = AllanDeviation::new(INTERVAL_S);
        for stop in 0..20 {
            allan.restart();
            for sample in 0..(stop_s / INTERVAL_S) as u32 {
                let noise: f64 = StandardNormal.sample(&mut rng);
                let time_s = f64::from(sample) * INTERVAL_S;
                allan.add([9.8 * f64::from(stop) + noise / INTERVAL_S.sqrt() + add(sample, time_s)]);
            }
        }
        Processes::of(&allan.curve(&[1.0]), &Process::OF_GYRO)
    }

    #[test]
    fn white_noise_of_many_stops_is_found_alone_and_nothing_reaches_over_their_ends() {
        let found = found(10.0, |_, _| 0.0);
        assert_eq!(found.0.len(), 1, "{found:?}");
        // 200 s of noise give 3700 degrees of freedom at 0.08 s: 1.2 % of the deviation. Four sigma.
        assert!((found.size(Process::White).unwrap() - 1.0).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn sigmas_of_the_sizes_are_honest() {
        let flicker = |seed: u64| {
            let floor = Imperfections { accel_floor_ug: 0.3 / MICRO_G, ..Imperfections::default() };
            let mut flicker = Flicker::new(&floor, INTERVAL_S, seed).unwrap();
            drawn(seed, 100.0, move |_, _| flicker.step()[0][0])
        };
        let walk = |seed: u64| {
            let (mut rng, mut bias) = (Xoshiro256PlusPlus::seed_from_u64(!seed), 0.0);
            drawn(seed, 100.0, move |_, _| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                bias += 0.3 * INTERVAL_S.sqrt() * normal;
                bias
            })
        };
        let angle = |seed: u64| {
            let (mut rng, mut angle) = (Xoshiro256PlusPlus::seed_from_u64(!seed), 0.0);
            drawn(seed, 100.0, move |_, _| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                let before = std::mem::replace(&mut angle, normal);
                (angle - before) / INTERVAL_S
            })
        };
        type Source<'a> = &'a dyn Fn(u64) -> Processes;
        type Sizes<'a> = &'a [(Process, f64)];
        let white = |seed: u64| drawn(seed, 10.0, |_, _| 0.0);
        let cases: [(Source, u64, Sizes); 4] = [
            (&white, 200, &[(Process::White, 1.0)]),
            (&walk, 60, &[(Process::White, 1.0), (Process::Walk, 0.3)]),
            (&angle, 60, &[(Process::White, 1.0), (Process::Angle, 1.0)]),
            (&flicker, 60, &[(Process::White, 1.0), (Process::Floor, 0.3)]),
        ];
        for (source, runs, sizes) in cases {
            let all: Vec<Processes> = (0..runs).map(source).collect();
            for (process, size) in sizes {
                let off = |all: &Processes| all.found(*process).map(|it| (it.size - size) / it.sigma.unwrap());
                let squares: f64 = all.iter().map(|all| off(all).expect("in the curve").powi(2)).sum();
                let mean = squares / runs as f64;
                // Four sigma above one. The sigmas are at most twice too large.
                let high = 1.0 + 4.0 * (2.0 / runs as f64).sqrt();
                assert!((0.25..high).contains(&mean), "{process:?}: {mean}, not below {high}");
            }
        }
    }

    #[test]
    fn every_process_has_its_own_number() {
        // White noise of density 1, and a second process that is as large at some seconds.
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let mut bias = 0.0;
        let walk = found(100.0, |_, _| {
            bias += 0.3 * INTERVAL_S.sqrt() * normal();
            bias
        });
        let mut angle = 0.0;
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
        let pulses = found(100.0, |_, _| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            let before = std::mem::replace(&mut angle, normal);
            (angle - before) / INTERVAL_S
        });
        let ramp = found(100.0, |_, time_s| 0.05 * time_s);
        for (found, process, size) in
            [(walk, Process::Walk, 0.3), (pulses, Process::Angle, 1.0), (ramp, Process::Ramp, 0.05)]
        {
            assert_eq!(found.0.len(), 2, "{found:?}");
            // 2000 s have 100 degrees of freedom and more where the process is the larger one: 7 %. Four sigma.
            assert!((found.size(process).unwrap() / size - 1.0).abs() < 0.28, "{process:?}: {found:?}");
            assert!((found.size(Process::White).unwrap() - 1.0).abs() < 0.28, "{found:?}");
        }
    }
}
