//! Encoder errors of both axes.
//!
//! Repeatability: the error of each axis is drawn anew for every stop. The error is constant while the axes are at
//! rest. During a move the error changes to the next stop's value in proportion to time. A plant does not know how long
//! a move will last, so the expected durations are passed in. While an axis turns, the rate reference noise is also
//! integrated into its angle. The integral is zero at both stops (a Brownian bridge). Errors that follow from the true
//! angle are in [`super::imperfections`].
//!
//! ```text
//! at rest --(an axis leaves its angle)--> turning --(move is over, and rates negligible for REST_S)--> at rest
//! ```

use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rins_selfcal::base::units::ARCSEC;

/// Rate below which an axis counts as at rest, rad/s.
pub const REST_RAD_S: f64 = 1e-4;
/// Turn of an axis from its angle at rest, at rates above [`REST_RAD_S`], that counts as a move, rad. The turn with
/// which a servo corrects an encoder error is smaller.
const MOVED_RAD: f64 = 20.0 * ARCSEC;
/// Time for which both axes must be at rest before the next motion counts as the next move, s.
const REST_S: f64 = 0.1;
/// Duration of a quarter turn at 20 deg/s with ramps of 20 deg/s^2, s.
const DEFAULT_MOVE_S: f64 = 5.5;

enum Phase {
    AtRest {
        /// Turn of each axis since it was at rest, rad.
        left_rad: [f64; 2],
        /// Samples since the axes were at rest.
        elapsed: u32,
    },
    /// All durations are in samples.
    Turning { elapsed: u32, duration: u32, quiet: u32 },
}

impl Phase {
    const AT_REST: Self = Self::AtRest { left_rad: [0.0; 2], elapsed: 0 };
}

/// The random errors of both encoders.
pub struct EncoderErrors {
    rng: Xoshiro256PlusPlus,
    rate_hz: f64,
    sigma_rad: f64,
    sigma_bridge_rad: f64,
    /// Expected durations of future moves, s, in reverse order. The last duration is also used for all later moves.
    durations_s: Vec<f64>,
    phase: Phase,
    from_rad: [f64; 2],
    to_rad: [f64; 2],
    bridge_rad: [f64; 2],
}

impl EncoderErrors {
    /// Errors with `sigma_rad` per stop and axis, and an angle walk of `sigma_bridge_rad` per sample while turning.
    pub fn new(rng: Xoshiro256PlusPlus, rate_hz: f64, sigma_rad: f64, sigma_bridge_rad: f64) -> Self {
        let mut errors = Self {
            rng,
            rate_hz,
            sigma_rad,
            sigma_bridge_rad,
            durations_s: vec![DEFAULT_MOVE_S],
            phase: Phase::AT_REST,
            from_rad: [0.0; 2],
            to_rad: [0.0; 2],
            bridge_rad: [0.0; 2],
        };
        errors.from_rad = errors.drawn();
        errors
    }

    /// Sets the expected durations of future moves, s.
    pub fn expect_moves(&mut self, durations_s: &[f64]) {
        self.durations_s = durations_s.iter().rev().copied().collect();
        if self.durations_s.is_empty() {
            self.durations_s.push(DEFAULT_MOVE_S);
        }
    }

    /// Advances by one sample. At its end the axes turn at `rates_rad_s`.
    pub fn step(&mut self, rates_rad_s: [f64; 2]) {
        let turning = rates_rad_s.map(|rate| rate.abs() > REST_RAD_S);
        let any = turning[0] || turning[1];
        if let Phase::AtRest { left_rad, elapsed } = self.phase {
            let left_rad = [0, 1].map(|axis: usize| left_rad[axis] + rates_rad_s[axis] / self.rate_hz);
            if left_rad.iter().any(|way| way.abs() > MOVED_RAD) {
                self.start_move(elapsed);
            } else {
                self.phase = if any { Phase::AtRest { left_rad, elapsed: elapsed + 1 } } else { Phase::AT_REST };
            }
        }
        if let Phase::Turning { elapsed, duration, quiet } = self.phase {
            self.step_bridge(turning, duration.saturating_sub(elapsed));
            let (elapsed, quiet) = (elapsed.saturating_add(1), if any { 0 } else { quiet + 1 });
            self.phase = Phase::Turning { elapsed, duration, quiet };
            if elapsed >= duration && f64::from(quiet) >= REST_S * self.rate_hz {
                self.from_rad = self.to_rad;
                self.phase = Phase::AT_REST;
            }
        }
    }

    /// Errors of (outer, inner) now, rad.
    pub fn errors_rad(&self) -> [f64; 2] {
        let Phase::Turning { elapsed, duration, .. } = self.phase else { return self.from_rad };
        let part = (f64::from(elapsed) / f64::from(duration)).min(1.0);
        std::array::from_fn(|axis| {
            self.from_rad[axis] + (self.to_rad[axis] - self.from_rad[axis]) * part + self.bridge_rad[axis]
        })
    }

    /// Starts a move that began `elapsed` samples ago.
    fn start_move(&mut self, elapsed: u32) {
        let expected_s = self.durations_s.last().copied().unwrap_or(DEFAULT_MOVE_S);
        if self.durations_s.len() > 1 {
            self.durations_s.pop();
        }
        let duration = (expected_s * self.rate_hz).round().max(1.0) as u32;
        self.phase = Phase::Turning { elapsed, duration, quiet: 0 };
        self.to_rad = self.drawn();
        self.bridge_rad = [0.0; 2];
    }

    /// One step of the Brownian bridges, which end at zero after `remaining` samples.
    fn step_bridge(&mut self, turning: [bool; 2], remaining: u32) {
        if self.sigma_bridge_rad == 0.0 {
            return;
        }
        let kept = if remaining > 1 { 1.0 - f64::from(remaining).recip() } else { 0.0 };
        for (axis, turning) in turning.into_iter().enumerate() {
            let noise = if turning && kept > 0.0 { self.sigma_bridge_rad * kept.sqrt() * self.normal() } else { 0.0 };
            self.bridge_rad[axis] = self.bridge_rad[axis] * kept + noise;
        }
    }

    fn drawn(&mut self) -> [f64; 2] {
        std::array::from_fn(|_| self.sigma_rad * self.normal())
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }
}
