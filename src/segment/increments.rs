//! Pulse outputs: sensors that report whole increments of angle or velocity.
//!
//! At rest such an output repeats the same value, differs from it by whole increments, and returns to it. The increment
//! is the greatest common divisor of all differences (Euclid's algorithm, with a tolerance for rounding). The
//! differences of any other output have no common divisor: the remainder becomes smaller and smaller. The steps of an
//! output that begins to move may be equal, but it does not return.

use crate::base::linear::Real;
use crate::base::sample::{CHANNELS, RawSample};

/// Largest deviation of a difference from a whole number of increments, in increments.
const TOLERANCE: f32 = 0.05;
/// A smaller part of an increment is rounding.
const ROUNDING: f32 = 1e-3;
/// A difference between successive samples at rest is at most this many increments of a pulse output.
const LARGEST_DIFFERENCE: f32 = 40.0;
/// Returns to an earlier value in one rest after which an increment is believed. Where a move ends and the next one
/// begins, an output may return once.
const ENOUGH: u8 = 5;

/// What is known of one channel.
#[derive(Clone, Copy, Debug)]
struct Divisor {
    /// Greatest common divisor so far; 0 before the first difference.
    divisor: f32,
    largest: f32,
    /// The value before the last difference.
    left: f32,
    /// Number of returns to the value before the last difference in this rest, up to [`ENOUGH`], where it stays.
    seen: u8,
    /// Whether the differences have no common divisor.
    none: bool,
}

impl Divisor {
    const UNKNOWN: Self = Self { divisor: 0.0, largest: 0.0, left: f32::NAN, seen: 0, none: false };

    fn is_known(&self) -> bool {
        !self.none && self.seen >= ENOUGH
    }

    /// Notes that the output has changed.
    fn see(&mut self, before: f32, now: f32, difference: f32) {
        if self.is_known() {
            // Rounding of the same value. Or a knock, or the start of a move.
            if difference <= TOLERANCE * self.divisor || difference > LARGEST_DIFFERENCE * self.divisor {
                return;
            }
        } else if difference <= ROUNDING * self.divisor {
            return;
        } else if difference * LARGEST_DIFFERENCE < self.divisor {
            // What came before was a knock, or the end of a move.
            *self = Self::UNKNOWN;
        }
        let returned = (now - self.left).abs() <= TOLERANCE * difference;
        self.seen = self.seen.saturating_add(returned.into()).min(ENOUGH);
        self.left = before;
        self.largest = self.largest.max(difference);
        let (mut a, mut b) = (self.divisor.max(difference), self.divisor.min(difference));
        // Two differences are exact, and a remainder is none if it is small beside its divisor. Each remainder is at most
        // half of the divisor before, so the loop ends.
        while b > 0.0 && self.largest <= LARGEST_DIFFERENCE * b {
            let times = (a / b + 0.5) as u32 as f32;
            let remainder = (a - times * b).abs();
            (a, b) = (b, if remainder > TOLERANCE * b { remainder } else { 0.0 });
        }
        if b > 0.0 {
            a = b;
        }
        self.divisor = a;
        self.none = self.largest > LARGEST_DIFFERENCE * a;
    }
}

/// The increments of all channels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Increments {
    channels: [Divisor; CHANNELS],
    /// Whether no channel can be pulses any more in this rest.
    none: bool,
}

impl Increments {
    pub(super) const UNKNOWN: Self = Self { channels: [Divisor::UNKNOWN; CHANNELS], none: false };

    /// Compares two successive samples at rest.
    pub(super) fn step<T: Real>(&mut self, previous: &RawSample<T>, sample: &RawSample<T>) {
        if self.none {
            return;
        }
        let before = previous.force_a.as_slice().iter().chain(previous.omega_g.as_slice());
        let now = sample.force_a.as_slice().iter().chain(sample.omega_g.as_slice());
        for (channel, (before, now)) in self.channels.iter_mut().zip(before.zip(now)) {
            if !channel.none && before != now {
                let single = |value: T| value.widened() as f32;
                channel.see(single(*before), single(*now), single((*now - *before).abs()));
            }
        }
        self.none = self.channels.iter().all(|channel| channel.none);
    }

    /// Ends the rest. A channel that is not known to be pulses is looked at anew in the next rest.
    pub(super) fn end_rest(&mut self) {
        for channel in self.channels.iter_mut().filter(|channel| !channel.is_known()) {
            *channel = Divisor::UNKNOWN;
        }
        self.none = false;
    }

    /// Whether the output of a channel is known to be pulses.
    pub(super) fn are_known(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel)).is_some_and(Divisor::is_known)
    }

    /// The increments, m/s^2 and rad/s; 0 for a channel whose output is not known to be pulses.
    pub(super) fn known(&self) -> [f32; CHANNELS] {
        self.channels.map(|channel| if channel.is_known() { channel.divisor } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::Vector3;

    /// What is known after these outputs of gyro x.
    fn known(outputs: impl IntoIterator<Item = f64>) -> f32 {
        let mut increments = Increments::UNKNOWN;
        let mut previous = RawSample::<f64>::default();
        for output in outputs {
            let sample = RawSample { omega_g: Vector3::new(output, 0.0, 0.0), ..previous };
            increments.step(&previous, &sample);
            previous = sample;
        }
        increments.known()[3]
    }

    #[test]
    fn pulses_are_recognized_and_noise_is_not() {
        let mut seed = 5_u64;
        let mut random = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        let step = 4.8e-5;
        let pulses: std::vec::Vec<f64> = (0..400).map(|_| (4.0 * random()).floor() * step + 1e-9 * random()).collect();
        assert!((f64::from(known(pulses)) / step - 1.0).abs() < 1e-3);
        // Pulses two and three increments apart only.
        let sparse: std::vec::Vec<f64> = (0..60).map(|n| [0.0, 2.0, 0.0, 5.0, 2.0, 5.0][n % 6] * step).collect();
        assert!((f64::from(known(sparse)) / step - 1.0).abs() < 1e-3);
        let noise: std::vec::Vec<f64> = (0..400).map(|_| random() * step).collect();
        assert_eq!(known(noise), 0.0);
        assert_eq!(known([1.0; 400]), 0.0, "a channel that does not change shows nothing");
        assert_eq!(known((0..400).map(|n| f64::from(n / 10) * step)), 0.0, "steps without return are a motion");
        let arrival = [3.0, 1.0, 0.0].map(|steps| steps * step);
        let at_rest: std::vec::Vec<f64> = (0..4000).map(|_| 0.01 * random() * step).collect();
        assert_eq!(known(arrival.into_iter().chain(at_rest)), 0.0, "noise after the end of a move");
        let arrival = [36.0, 0.0, 1.0, 0.0].map(|steps| steps * step);
        let at_rest: std::vec::Vec<f64> = (0..60).map(|n| [0.0, 1.0, 0.0, 2.0][n % 4] * step).collect();
        assert!((f64::from(known(arrival.into_iter().chain(at_rest))) / step - 1.0).abs() < 1e-3, "pulses after it");
    }

    #[test]
    fn pulses_stay_known_through_a_knock_and_are_found_after_one() {
        let step = 4.8e-5;
        let pulses = (0..60).map(|n| [0.0, 2.0, 0.0, 5.0, 2.0, 5.0][n % 6] * step);
        let knock = [0.0, 9137.3 * step, 11.6 * step];
        assert!((f64::from(known(pulses.clone().chain(knock))) / step - 1.0).abs() < 1e-3);
        let mut increments = Increments::UNKNOWN;
        let mut rest = |outputs: &[f64]| {
            for pair in outputs.windows(2) {
                let [before, now] = [pair[0], pair[1]]
                    .map(|output| RawSample { omega_g: Vector3::new(output, 0.0, 0.0), ..RawSample::default() });
                increments.step(&before, &now);
            }
            increments.end_rest();
            increments.known()[3]
        };
        assert_eq!(rest(&knock), 0.0);
        // Noise behind a knock that is many times as large.
        let mut noise = [0.0; 60];
        for (n, output) in noise.iter_mut().enumerate().skip(1) {
            *output = 9137.3 * step + (n as f64 * 0.7).sin() * step;
        }
        assert_eq!(rest(&noise), 0.0);
        assert!((f64::from(rest(&pulses.collect::<std::vec::Vec<_>>())) / step - 1.0).abs() < 1e-3);
        // A move begins with a step of 36 increments.
        assert!(
            (f64::from(rest(&[0.0, 1.0, 0.0, 1.0, 37.0, 90.0].map(|steps| steps * step))) / step - 1.0).abs() < 1e-3
        );
    }
}
