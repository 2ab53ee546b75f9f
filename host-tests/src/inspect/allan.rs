//! Overlapping Allan deviation of several series over many stops, in one pass. (NIST SP 1065, section 5.2.4)
//!
//! ```text
//! sigma^2(m T) = sum over k of (x[k + 2m] - 2 x[k + m] + x[k])^2 / (2 (m T)^2 K)         x: integral of the series
//! ```
//! K counts the terms of all stops together. No term reaches from one stop into another stop or over a gap. The
//! products of the terms of all pairs of series are summed, so that the deviation of every combination of the series is
//! known after the pass.

use serde::Serialize;
use std::collections::VecDeque;

/// Octaves of the averaging time. The longest averages 65536 samples and needs some megabytes of memory.
const OCTAVES: u32 = 17;
/// Fewest degrees of freedom of a point that is part of the curve.
const LEAST_FREEDOM: f64 = 4.0;

/// A point of the Allan curve, SI.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AllanPoint {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Allan deviation.
    pub deviation: f64,
    /// Standard deviation of the Allan deviation for white noise, as a fraction of the Allan deviation.
    pub scatter: f64,
}

impl AllanPoint {
    /// Degrees of freedom of the squared deviation.
    pub fn freedom(&self) -> f64 {
        0.5 * self.scatter.powi(-2)
    }
}

/// Sums of products of each pair of series.
pub type Products<const SERIES: usize> = [[f64; SERIES]; SERIES];

/// Sums of one averaging time.
#[derive(Clone, Copy)]
struct Octave<const SERIES: usize> {
    products: Products<SERIES>,
    terms: u64,
}

impl<const SERIES: usize> Octave<SERIES> {
    /// Degrees of freedom for white noise of terms over this number of samples, with all stops taken as one series.
    /// (NIST SP 1065, table 5)
    fn freedom(&self, samples: f64) -> f64 {
        let all = self.terms as f64 + 2.0 * samples;
        (1.5 * (all - 1.0) / samples - 2.0 * (all - 2.0) / all) * 4.0 * samples * samples
            / (4.0 * samples * samples + 5.0)
    }
}

/// Collects the samples of stops.
pub struct AllanDeviation<const SERIES: usize> {
    interval_s: f64,
    octaves: Vec<Octave<SERIES>>,
    /// Integrals of the series, the newest last.
    integrals: VecDeque<[f64; SERIES]>,
    /// First sample of the stop. It is subtracted from all samples of the stop, so that the integrals stay small.
    first: [f64; SERIES],
}

impl<const SERIES: usize> AllanDeviation<SERIES> {
    /// Starts with no samples. The samples come at this interval.
    pub fn new(interval_s: f64) -> Self {
        let none = Octave { products: [[0.0; SERIES]; SERIES], terms: 0 };
        Self { interval_s, octaves: vec![none; OCTAVES as usize], integrals: VecDeque::new(), first: [0.0; SERIES] }
    }

    /// Starts new integrals, at the next stop or after a gap.
    pub fn restart(&mut self) {
        self.integrals.clear();
    }

    /// Adds a sample.
    pub fn add(&mut self, values: [f64; SERIES]) {
        let longest = 2_usize << (OCTAVES - 1);
        let Some(last) = self.integrals.back().copied() else {
            self.first = values;
            self.integrals.extend([[0.0; SERIES], [0.0; SERIES]]);
            return;
        };
        self.integrals.push_back(std::array::from_fn(|series| {
            last[series] + (values[series] - self.first[series]) * self.interval_s
        }));
        if self.integrals.len() > longest + 1 {
            self.integrals.pop_front();
        }
        self.add_terms();
    }

    fn add_terms(&mut self) {
        let newest = self.integrals.len() - 1;
        for (exponent, octave) in (0..).zip(&mut self.octaves) {
            let samples = 1 << exponent;
            let Some(oldest) = newest.checked_sub(2 * samples) else { break };
            let [a, b, c] = [oldest, oldest + samples, newest].map(|at| &self.integrals[at]);
            let terms: [f64; SERIES] = std::array::from_fn(|series| c[series] - 2.0 * b[series] + a[series]);
            for (row, term) in octave.products.iter_mut().zip(terms) {
                // Axes that do not hunt have only zeros.
                if term != 0.0 {
                    row.iter_mut().zip(terms).for_each(|(sum, other)| *sum += term * other);
                }
            }
            octave.terms += 1;
        }
    }

    /// The curve of a combination of the series with these weights: the points with enough degrees of freedom.
    pub fn curve(&self, weights: &[f64; SERIES]) -> Vec<AllanPoint> {
        let point = |(tau_s, freedom, octave): (f64, f64, &Octave<SERIES>)| {
            let squares: f64 =
                octave.products.iter().zip(weights).map(|(row, weight)| weight * dot(row, weights)).sum();
            let deviation = (squares.max(0.0) / (2.0 * octave.terms as f64)).sqrt() / tau_s;
            AllanPoint { tau_s, deviation, scatter: (2.0 * freedom).sqrt().recip() }
        };
        self.points().map(point).collect()
    }

    /// Products of the terms of all series over the averaging times in a range, s. They are weighted for a regression
    /// on a series of white noise.
    pub fn products(&self, range_s: [f64; 2]) -> Products<SERIES> {
        let mut sums = [[0.0; SERIES]; SERIES];
        for (tau_s, freedom, octave) in self.points().filter(|(tau_s, ..)| (range_s[0]..range_s[1]).contains(tau_s)) {
            let weight = freedom / (octave.terms as f64 * tau_s);
            for (sum, product) in sums.iter_mut().flatten().zip(octave.products.iter().flatten()) {
                *sum += weight * product;
            }
        }
        sums
    }

    /// Averaging time, s, degrees of freedom and sums of the octaves with enough degrees of freedom.
    fn points(&self) -> impl Iterator<Item = (f64, f64, &Octave<SERIES>)> {
        let numbered = (0_u32..).zip(&self.octaves).filter(|(_, octave)| octave.terms > 0);
        let all = numbered.map(|(exponent, octave)| {
            let samples = f64::from(exponent).exp2();
            (samples * self.interval_s, octave.freedom(samples), octave)
        });
        all.filter(|(_, freedom, _)| *freedom >= LEAST_FREEDOM)
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The test suite of NIST SP 1065, section 12.4: 1000 numbers of a congruential generator, overlapping deviation.
    #[test]
    fn a_thousand_numbers_have_the_published_deviation() {
        let (mut allan, mut number) = (AllanDeviation::new(1.0), 1_234_567_890_u64);
        for _ in 0..1000 {
            allan.add([number as f64 / 2_147_483_647.0]);
            number = 16_807 * number % 2_147_483_647;
        }
        let first = allan.curve(&[1.0])[0];
        assert!((first.deviation - 0.292_231_9).abs() < 1e-7, "{first:?}");
    }
}
