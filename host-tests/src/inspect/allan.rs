//! Overlapping Allan deviation of several channels over many stops, in one pass. (NIST SP 1065, section 5.2.4)
//!
//! ```text
//! sigma^2(m T) = sum over k of (x[k + 2m] - 2 x[k + m] + x[k])^2 / (2 (m T)^2 K)         x: integral of the channel
//! ```
//! K counts the terms of all stops together. No term reaches from one stop into another stop or over a gap.

use serde::Serialize;
use std::collections::VecDeque;

/// Octaves of the averaging time. The longest averages 65536 samples and needs some megabytes of memory.
const OCTAVES: u32 = 17;
/// Averaging times from which white noise is taken, s: longer than most vibration, shorter than most bias drift.
const WHITE_S: [f64; 2] = [0.1, 1.01];
/// Fewest degrees of freedom of a point that is part of the curve.
const LEAST_FREEDOM: f64 = 4.0;
/// Flicker noise of size B has a deviation of B sqrt(2 ln 2 / pi) at its flattest. (IEEE Std 952)
const FLICKER: f64 = 0.664;

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

/// Sums of one averaging time.
#[derive(Clone, Copy)]
struct Octave<const CHANNELS: usize> {
    squares: [f64; CHANNELS],
    terms: u64,
}

/// Collects the samples of stops.
pub struct AllanDeviation<const CHANNELS: usize> {
    interval_s: f64,
    octaves: Vec<Octave<CHANNELS>>,
    /// Integrals of the channels, the newest last.
    integrals: VecDeque<[f64; CHANNELS]>,
    /// First sample of the stop. It is subtracted from all samples of the stop, so that the integrals stay small.
    first: [f64; CHANNELS],
}

impl<const CHANNELS: usize> AllanDeviation<CHANNELS> {
    /// Starts with no samples. The samples come at this interval.
    pub fn new(interval_s: f64) -> Self {
        let none = Octave { squares: [0.0; CHANNELS], terms: 0 };
        Self { interval_s, octaves: vec![none; OCTAVES as usize], integrals: VecDeque::new(), first: [0.0; CHANNELS] }
    }

    /// Starts new integrals, at the next stop or after a gap.
    pub fn restart(&mut self) {
        self.integrals.clear();
    }

    /// Adds a sample.
    pub fn add(&mut self, values: [f64; CHANNELS]) {
        let longest = 2_usize << (OCTAVES - 1);
        let Some(last) = self.integrals.back().copied() else {
            self.first = values;
            self.integrals.extend([[0.0; CHANNELS], [0.0; CHANNELS]]);
            return;
        };
        self.integrals.push_back(std::array::from_fn(|channel| {
            last[channel] + (values[channel] - self.first[channel]) * self.interval_s
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
            for (channel, squares) in octave.squares.iter_mut().enumerate() {
                *squares += (c[channel] - 2.0 * b[channel] + a[channel]).powi(2);
            }
            octave.terms += 1;
        }
    }

    /// The curve of a channel: the points with enough degrees of freedom.
    pub fn curve(&self, channel: usize) -> Vec<AllanPoint> {
        let point = |(exponent, octave): (u32, &Octave<CHANNELS>)| {
            let samples = f64::from(exponent).exp2();
            let tau_s = samples * self.interval_s;
            // Degrees of freedom for white noise, with all stops taken as one series. (NIST SP 1065, table 5)
            let all = octave.terms as f64 + 2.0 * samples;
            let freedom = (1.5 * (all - 1.0) / samples - 2.0 * (all - 2.0) / all) * 4.0 * samples * samples
                / (4.0 * samples * samples + 5.0);
            let deviation = (octave.squares[channel] / (2.0 * octave.terms as f64)).sqrt() / tau_s;
            let counts = octave.terms > 0 && freedom >= LEAST_FREEDOM;
            counts.then(|| AllanPoint { tau_s, deviation, scatter: (2.0 * freedom).sqrt().recip() })
        };
        (0..).zip(&self.octaves).filter_map(point).collect()
    }
}

/// White noise of a curve, and the noise in excess of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NoiseFigures {
    /// Density of the white noise: its deviation at 1 s.
    pub white: f64,
    /// Bias instability: the size of the flicker noise with the deviation of the curve's lowest point.
    pub instability: f64,
    /// Deviation at the longest averaging time divided by the deviation of white noise alone.
    pub excess: f64,
    /// Longest averaging time, s.
    pub longest_s: f64,
}

/// The figures of a curve. `None` if the curve is too short.
pub fn figures(curve: &[AllanPoint]) -> Option<NoiseFigures> {
    let white = |point: &&AllanPoint| (WHITE_S[0]..WHITE_S[1]).contains(&point.tau_s);
    let weight = |point: &AllanPoint| point.scatter.powi(-2);
    let near: Vec<&AllanPoint> = curve.iter().filter(white).collect();
    let weights: f64 = near.iter().map(|point| weight(point)).sum();
    let sum: f64 = near.iter().map(|point| weight(point) * point.deviation.powi(2) * point.tau_s).sum();
    let (last, white) = (curve.last()?, (sum / weights).sqrt());
    let lowest = curve.iter().map(|point| point.deviation).fold(f64::INFINITY, f64::min);
    let excess = last.deviation * last.tau_s.sqrt() / white;
    white.is_finite().then_some(NoiseFigures { white, instability: lowest / FLICKER, excess, longest_s: last.tau_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    /// The test suite of NIST SP 1065, section 12.4: 1000 numbers of a congruential generator, overlapping deviation.
    #[test]
    fn a_thousand_numbers_have_the_published_deviation() {
        let (mut allan, mut number) = (AllanDeviation::new(1.0), 1_234_567_890_u64);
        for _ in 0..1000 {
            allan.add([number as f64 / 2_147_483_647.0]);
            number = 16_807 * number % 2_147_483_647;
        }
        let first = allan.curve(0)[0];
        assert!((first.deviation - 0.292_231_9).abs() < 1e-7, "{first:?}");
    }

    #[test]
    fn white_noise_of_many_stops_is_found_and_nothing_reaches_over_their_ends() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let mut allan = AllanDeviation::new(0.005);
        for stop in 0..20 {
            allan.restart();
            for _ in 0..2000 {
                let noise: f64 = StandardNormal.sample(&mut rng);
                allan.add([9.8 * f64::from(stop) + 0.02 * noise]);
            }
        }
        let found = figures(&allan.curve(0)).unwrap();
        // 0.02 sqrt(5 ms) = 0.001414. 200 s of noise give 3000 degrees of freedom at 0.1 s: 1.3 %. The test allows four
        // sigma.
        assert!((found.white / 0.001_414_2 - 1.0).abs() < 0.05, "{found:?}");
        assert!((0.4..1.9).contains(&found.excess), "{found:?}");
    }

    #[test]
    fn a_wandering_channel_shows_excess() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
        let (mut allan, mut bias) = (AllanDeviation::new(0.01), 0.0);
        for _ in 0..20_000 {
            let [noise, step]: [f64; 2] = [StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng)];
            bias += 0.01 * step;
            allan.add([bias + noise]);
        }
        // White noise of 0.1 and a random walk of 0.1 sqrt(tau / 3) are equal at 1.7 s.
        let found = figures(&allan.curve(0)).unwrap();
        assert!(found.excess > 5.0 && (found.white / 0.1 - 1.0).abs() < 0.3, "{found:?}");
    }
}
