//! Plays a scheme into a virtual RINS, open loop, with trapezoidal moves whose corners all lie on the sample grid.
//!
//! The profile of an axis is stretched to a whole number of sample intervals and is symmetric in time. Between samples
//! the rates are linear. The profile is scaled so that these rates turn the axis by exactly the leg's angle. Apart from
//! this scaling (2e-6 on a quarter turn at 20 deg/s) an axis never turns faster than the scheme says. Both axes start
//! together, and the axis with the longer profile ends the move.

use super::plant::Reading;
use super::virtual_rins::VirtualRins;
use rins_selfcal::scheme::Scheme;

/// A virtual RINS that follows a scheme. It gives readings until the last stop is over.
pub struct SchemeDrive {
    rins: VirtualRins,
    legs: Vec<GridLeg>,
    next_leg: usize,
    sample_in_leg: u32,
}

/// A move and the stop after it, in samples. The first stop is a leg without a move.
struct GridLeg {
    profiles: [Profile; 2],
    move_samples: u32,
    stop_samples: u32,
}

/// Rates of one axis at the ends of the sample intervals of a move.
#[derive(Clone, Copy, Default)]
struct Profile {
    samples: u32,
    /// Fraction of the time in each of the two ramps.
    ramp_part: f64,
    /// Rate between the ramps, signed.
    peak_rad_s: f64,
}

impl Profile {
    fn new(scheme: &Scheme, angle_rad: f64, interval_s: f64) -> Self {
        if angle_rad == 0.0 {
            return Self::default();
        }
        let move_s = scheme.turning().profile(angle_rad).duration_s();
        // Rounding must not add a sample to a profile that ends on the grid.
        let samples = (move_s / interval_s - 1e-6).ceil().max(2.0) as u32;
        let ramp_s = (scheme.rate_rad_s / scheme.acceleration_rad_s2).min(0.5 * move_s);
        let unit = Self { samples, ramp_part: ramp_s / move_s, peak_rad_s: 1.0 };
        let turned: f64 = (1..samples).map(|sample| unit.rate_at(sample) * interval_s).sum();
        Self { peak_rad_s: angle_rad / turned, ..unit }
    }

    fn rate_at(&self, sample: u32) -> f64 {
        if sample >= self.samples {
            return 0.0;
        }
        let nearer_end = sample.min(self.samples - sample);
        let part = f64::from(nearer_end) / f64::from(self.samples);
        self.peak_rad_s * (part / self.ramp_part).min(1.0)
    }
}

impl SchemeDrive {
    /// Puts `rins`, which is at rest at (0, 0), at the start of a scheme. Every stop is `settling_s` longer than in the
    /// scheme. The durations of the moves are passed to the encoder errors.
    pub fn new(mut rins: VirtualRins, scheme: &Scheme, settling_s: f64) -> Self {
        let legs = grid_legs(scheme, settling_s, rins.interval_s());
        let interval_s = rins.interval_s();
        let durations: Vec<f64> = legs[1..].iter().map(|leg| f64::from(leg.move_samples) * interval_s).collect();
        rins.expect_moves(&durations);
        Self { rins, legs, next_leg: 0, sample_in_leg: 0 }
    }

    /// Number of readings from the start to the end of the last stop.
    pub fn total_samples(&self) -> u64 {
        self.legs.iter().map(|leg| u64::from(leg.samples())).sum()
    }

    /// The instrument.
    pub fn rins(&self) -> &VirtualRins {
        &self.rins
    }

    /// Rates at the end of the next interval; `None` when the scheme is over.
    fn next_rates(&mut self) -> Option<[f64; 2]> {
        let mut leg = self.legs.get(self.next_leg)?;
        while self.sample_in_leg == leg.samples() {
            self.next_leg += 1;
            self.sample_in_leg = 0;
            leg = self.legs.get(self.next_leg)?;
        }
        self.sample_in_leg += 1;
        Some(leg.profiles.map(|profile| profile.rate_at(self.sample_in_leg)))
    }
}

impl Iterator for SchemeDrive {
    type Item = Reading;

    fn next(&mut self) -> Option<Reading> {
        let rates = self.next_rates()?;
        self.rins.command_rates(rates);
        Some(self.rins.advance())
    }
}

impl GridLeg {
    fn samples(&self) -> u32 {
        self.move_samples + self.stop_samples
    }
}

/// Durations of a scheme's moves on a sample grid, s, for [`VirtualRins::expect_moves`].
pub fn move_durations_s(scheme: &Scheme, rate_hz: f64) -> Vec<f64> {
    grid_legs(scheme, 0.0, rate_hz.recip())[1..].iter().map(|leg| f64::from(leg.move_samples) / rate_hz).collect()
}

fn grid_legs(scheme: &Scheme, settling_s: f64, interval_s: f64) -> Vec<GridLeg> {
    let stop_samples = |stop_s: f64| ((stop_s + settling_s) / interval_s).round() as u32;
    let first =
        GridLeg { profiles: Default::default(), move_samples: 0, stop_samples: stop_samples(scheme.first_stop_s) };
    let mut legs = vec![first];
    let mut from = [0.0; 2];
    for leg in (0..).map_while(|index| scheme.leg(index)) {
        let to = [leg.outer_rad, leg.inner_rad];
        let profiles = [0, 1].map(|axis| Profile::new(scheme, to[axis] - from[axis], interval_s));
        let move_samples = profiles[0].samples.max(profiles[1].samples);
        legs.push(GridLeg { profiles, move_samples, stop_samples: stop_samples(leg.stop_s) });
        from = to;
    }
    legs
}
