//! A simulated dual-axis rotational INS, open loop.
//!
//! A sample is the mean of force and rate over one interval. Its time stamp is the **middle** of the interval, and its
//! encoder angles are the angles at the time stamp. The rates of the axes change linearly over an interval to the
//! commanded rates. The first interval starts at time zero, with the axes at rest at (0, 0).

use super::encoder::EncoderErrors;
use super::imperfections::{Arrival, Flicker, Pulses, Rocking};
use super::kinematics::{Drift, Motion, RigidTruth, Sensed};
use super::plant::Reading;
use super::unit::{Effects, VirtualUnit};
use super::vec3::{Vec3, add};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G};
use rins_selfcal::model::error_model::InstrumentErrors;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// The virtual RINS: a [`VirtualUnit`] in motion.
pub struct VirtualRins {
    unit: VirtualUnit,
    truth: RigidTruth,
    white: WhiteNoise,
    walk: BiasWalk,
    pub(super) encoder: EncoderErrors,
    flicker: Option<Flicker>,
    rocking: Option<Rocking>,
    pulses: Pulses,
    lag: Lag,
    arrival: Arrival,
    limits: Limits,
    hunting: Hunting,
    temperature: Temperature,
    pub(super) interval_s: f64,
    pub(super) samples: u64,
    angles_rad: [f64; 2],
    /// Angles at the middle of the last interval.
    read_rad: [f64; 2],
    rates_rad_s: [f64; 2],
    commanded_rad_s: [f64; 2],
    /// Readings of the sensors at the angles at which the axes are at rest.
    at_rest: Option<Sensed<Drift>>,
}

impl VirtualRins {
    /// Puts a unit into operation. Every random number comes from `seed`.
    pub fn new(unit: &VirtualUnit, seed: u64) -> Self {
        Self::with_encoder_rate(unit, seed, unit.rate_hz)
    }

    /// As [`VirtualRins::new`], with encoder errors that advance at this rate.
    pub(super) fn with_encoder_rate(unit: &VirtualUnit, seed: u64, encoder_rate_hz: f64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let encoder_rng = rng.clone();
        // The encoder errors must not depend on the number of samples in a stop.
        rng.jump();
        let noise = &unit.noise;
        let effects = &unit.effects;
        Self {
            unit: unit.clone(),
            truth: RigidTruth::new(unit),
            white: WhiteNoise {
                sigma_force: noise.sigma_force_m_s2(unit.rate_hz),
                sigma_omega: noise.sigma_omega_rad_s(unit.rate_hz),
                rng,
            },
            walk: BiasWalk::new(effects, unit.rate_hz),
            encoder: EncoderErrors::new(
                encoder_rng,
                encoder_rate_hz,
                noise.sigma_encoder_rad(),
                noise.sigma_reference_rad(encoder_rate_hz),
            ),
            flicker: Flicker::new(&effects.hardware, unit.rate_hz.recip(), seed ^ FLICKER_SEED),
            rocking: Rocking::new(&effects.hardware, seed ^ ROCKING_SEED),
            pulses: Pulses::default(),
            lag: Lag::new(effects, unit.rate_hz.recip()),
            arrival: Arrival::default(),
            limits: Limits::new(effects, unit.rate_hz),
            hunting: Hunting { amplitude_rad: effects.hunting_arcsec * ARCSEC, omega_rad_s: TAU * effects.hunting_hz },
            temperature: Temperature::new(effects),
            interval_s: unit.rate_hz.recip(),
            samples: 0,
            angles_rad: [0.0; 2],
            read_rad: [0.0; 2],
            rates_rad_s: [0.0; 2],
            commanded_rad_s: [0.0; 2],
            at_rest: None,
        }
    }

    /// Starts with the axes at rest at these angles of (outer, inner), rad, in place of (0, 0).
    #[must_use]
    pub fn standing_at(self, angles_rad: [f64; 2]) -> Self {
        Self { angles_rad, read_rad: angles_rad, ..self }
    }

    /// Sets the expected durations of future moves, s. Over these times the encoder errors change from stop to stop.
    /// The last duration (5.5 s if the list is empty) is also used for all later moves.
    pub fn expect_moves(&mut self, durations_s: &[f64]) {
        self.encoder.expect_moves(durations_s);
    }

    /// True angles of (outer, inner) now, rad.
    pub fn true_angles_rad(&self) -> [f64; 2] {
        self.angles_rad
    }

    /// True angles of (outer, inner) at the stamp of the last reading, rad.
    pub fn true_angles_at_stamp_rad(&self) -> [f64; 2] {
        self.read_rad
    }

    /// True rates of (outer, inner) now, rad/s.
    pub fn true_rates_rad_s(&self) -> [f64; 2] {
        self.rates_rad_s
    }

    /// The 28 errors as they are now.
    pub fn errors_now(&self) -> InstrumentErrors<f64> {
        self.errors_after(self.samples as f64 * self.interval_s)
    }

    /// The 28 errors to which a live estimate refers: with the random walks up to now, but with warm-up and tilt of the
    /// base as at the start of the run.
    pub fn errors_of_live_estimate(&self) -> InstrumentErrors<f64> {
        self.errors_after(0.0)
    }

    fn errors_after(&self, time_s: f64) -> InstrumentErrors<f64> {
        let errors = self.unit.errors_at(time_s);
        InstrumentErrors {
            accel_bias_a: add(errors.accel_bias_a, self.walk.accel_a),
            gyro_bias_g: add(errors.gyro_bias_g, self.walk.gyro_g),
            ..errors
        }
    }

    /// Sample interval, s.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// The next reading. A virtual instrument never runs out of readings.
    pub fn advance(&mut self) -> Reading {
        let to_rad_s = self.limits.limited(self.rates_rad_s, self.commanded_rad_s);
        let [start_s, middle_s, end_s] = [0.0, 0.5, 1.0].map(|part| (self.samples as f64 + part) * self.interval_s);
        let motion = Motion {
            angles_rad: self.angles_rad,
            from_rad_s: self.hunting.added(self.rates_rad_s, start_s),
            to_rad_s: self.hunting.added(to_rad_s, end_s),
            duration_s: self.interval_s,
        };
        let felt = self.feel(&motion, middle_s);
        self.read_rad = motion.angles_at(0.5);
        self.angles_rad = motion.angles_at(1.0);
        self.rates_rad_s = to_rad_s;
        self.encoder.step(self.rates_rad_s);
        let measured = self.measured(felt);
        let [outer_rad, inner_rad] = self.seen_rad(self.read_rad);
        Reading { outer_rad, inner_rad, ..measured }
    }

    /// Mean readings of the sensors over a motion, without noise. The middle of the motion is at `middle_s`.
    pub(super) fn feel(&mut self, motion: &Motion, middle_s: f64) -> Sensed<Vec3> {
        let felt = if motion.from_rad_s != [0.0; 2] || motion.to_rad_s != [0.0; 2] {
            self.at_rest = None;
            let ([from, to], part) = ([motion.angles_at(0.0), motion.angles_at(1.0)], [0, 1]);
            self.arrival.follow(part.map(|axis: usize| to[axis] - from[axis]));
            self.truth.mean_over(motion, middle_s)
        } else {
            let at_rest = self.at_rest.get_or_insert_with(|| self.truth.at_rest(motion.angles_rad));
            Sensed { force_a: at_rest.force_a.at(middle_s), omega_g: at_rest.omega_g.at(middle_s) }
        };
        let felt = self.truth.distorted(felt, middle_s);
        let Some(rocking) = &self.rocking else { return felt };
        let [turned, rate] = rocking.at(middle_s, motion.duration_s);
        let moved = self.truth.by_base_motion(turned, rate, motion.angles_at(0.5), middle_s);
        Sensed { force_a: add(felt.force_a, moved.force_a), omega_g: add(felt.omega_g, moved.omega_g) }
    }

    /// Completes the reading of an interval with noise. The angles are set by the caller.
    pub(super) fn measured(&mut self, felt: Sensed<Vec3>) -> Reading {
        let middle_s = (self.samples as f64 + 0.5) * self.interval_s;
        self.samples += 1;
        let felt = self.lag.followed(felt);
        self.walk.step(&mut self.white.rng);
        let [force, omega] = self.flicker.as_mut().map_or([[0.0; 3]; 2], Flicker::step);
        let omega_g = self.white.added(add(add(felt.omega_g, self.walk.gyro_g), omega), self.white.sigma_omega);
        let force_a = self.white.added(add(add(felt.force_a, self.walk.accel_a), force), self.white.sigma_force);
        let hardware = &self.unit.effects.hardware;
        let pulse = [hardware.accel_pulse_mm_s * 1e-3, hardware.gyro_pulse_arcsec * ARCSEC];
        let [force_a, omega_g] = self.pulses.quantized([force_a, omega_g], pulse, self.interval_s);
        Reading {
            time_us: (middle_s * 1e6).round() as u64,
            omega_g,
            force_a,
            outer_rad: 0.0,
            inner_rad: 0.0,
            temperature_c: self.temperature.at(middle_s),
        }
    }

    /// Readings of the encoders at these angles, rad.
    pub(super) fn seen_rad(&self, angles_rad: [f64; 2]) -> [f64; 2] {
        let random = self.encoder.errors_rad();
        std::array::from_fn(|axis| {
            let angle = angles_rad[axis];
            let hardware = &self.unit.effects.hardware;
            let backlash = hardware.backlash_arcsec[axis] * ARCSEC * self.arrival.sense(axis);
            let reading = angle + hardware.encoder_rad(axis, angle) + backlash + random[axis];
            self.unit.effects.encoder_bits.map_or(reading, |bits| {
                let step_rad = TAU / f64::from(bits).exp2();
                (reading / step_rad).round() * step_rad
            })
        })
    }

    /// Sets the rates of (outer, inner) at the end of the next interval, rad/s.
    pub fn command_rates(&mut self, rates_rad_s: [f64; 2]) {
        self.commanded_rad_s = rates_rad_s;
    }
}

/// Seeds of the flicker and of the rocking, so that they do not change the white noise.
const FLICKER_SEED: u64 = 0x666c_6963_6b65_7200;
const ROCKING_SEED: u64 = 0x726f_636b_696e_6700;

/// Delay and bandwidth of the inertial sensors.
struct Lag {
    /// Delay in intervals.
    delay: f64,
    /// What was felt in the last intervals, the newest first.
    felt: VecDeque<Sensed<Vec3>>,
    /// Part of a step that the output follows in one interval.
    part: f64,
    output: Option<Sensed<Vec3>>,
}

impl Lag {
    fn new(effects: &Effects, interval_s: f64) -> Self {
        let part =
            effects.sensor_bandwidth_hz.map_or(1.0, |bandwidth_hz| 1.0 - (-TAU * bandwidth_hz * interval_s).exp());
        Self { delay: effects.sensor_delay_ms * 1e-3 / interval_s, felt: VecDeque::new(), part, output: None }
    }

    /// The output of the sensors. It is as if they had been at rest before the first interval.
    fn followed(&mut self, felt: Sensed<Vec3>) -> Sensed<Vec3> {
        if self.delay == 0.0 && self.part == 1.0 {
            return felt;
        }
        let [whole, between] = [self.delay.floor(), self.delay.fract()];
        self.felt.push_front(felt);
        self.felt.truncate(whole as usize + 2);
        let at = |place: usize| self.felt[place.min(self.felt.len() - 1)];
        let delayed = towards(at(whole as usize), at(whole as usize + 1), between);
        *self.output.insert(towards(self.output.unwrap_or(delayed), delayed, self.part))
    }
}

/// The reading on the way from one to another after this part of the way.
fn towards(from: Sensed<Vec3>, to: Sensed<Vec3>, part: f64) -> Sensed<Vec3> {
    let between = |from: Vec3, to: Vec3| std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * part);
    Sensed { force_a: between(from.force_a, to.force_a), omega_g: between(from.omega_g, to.omega_g) }
}

/// White noise per sample.
struct WhiteNoise {
    rng: Xoshiro256PlusPlus,
    sigma_force: f64,
    sigma_omega: f64,
}

impl WhiteNoise {
    fn added(&mut self, mean: Vec3, sigma: f64) -> Vec3 {
        mean.map(|value| value + sigma * normal(&mut self.rng))
    }
}

fn normal(rng: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(rng)
}

/// Random walk of the biases, starting from the values in the unit's errors.
struct BiasWalk {
    accel_a: Vec3,
    gyro_g: Vec3,
    sigma_accel: f64,
    sigma_gyro: f64,
}

impl BiasWalk {
    fn new(effects: &Effects, rate_hz: f64) -> Self {
        let per_step = (3600.0 * rate_hz).sqrt().recip();
        Self {
            accel_a: [0.0; 3],
            gyro_g: [0.0; 3],
            sigma_accel: effects.accel_bias_walk_ug_sqrt_h * MICRO_G * per_step,
            sigma_gyro: effects.gyro_bias_walk_deg_h_sqrt_h * DEG_H * per_step,
        }
    }

    fn step(&mut self, rng: &mut Xoshiro256PlusPlus) {
        if self.sigma_accel > 0.0 {
            self.accel_a = self.accel_a.map(|bias| bias + self.sigma_accel * normal(rng));
        }
        if self.sigma_gyro > 0.0 {
            self.gyro_g = self.gyro_g.map(|bias| bias + self.sigma_gyro * normal(rng));
        }
    }
}

/// A limit cycle of the servos. The inner axis leads by a quarter of a cycle.
struct Hunting {
    amplitude_rad: f64,
    omega_rad_s: f64,
}

impl Hunting {
    /// Adds the rates of the hunting to rates of (outer, inner), rad/s.
    fn added(&self, rates_rad_s: [f64; 2], time_s: f64) -> [f64; 2] {
        let (sin, cos) = (self.omega_rad_s * time_s).sin_cos();
        let fastest_rad_s = self.amplitude_rad * self.omega_rad_s;
        let [outer, inner] = rates_rad_s;
        [outer + fastest_rad_s * cos, inner - fastest_rad_s * sin]
    }
}

/// Limits of the drives.
struct Limits {
    rate_rad_s: f64,
    change_rad_s: f64,
}

impl Limits {
    fn new(effects: &Effects, rate_hz: f64) -> Self {
        Self {
            rate_rad_s: effects.max_rate_deg_s.map_or(f64::INFINITY, |rate| rate * DEG),
            change_rad_s: effects.max_acceleration_deg_s2.map_or(f64::INFINITY, |limit| limit * DEG / rate_hz),
        }
    }

    fn limited(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let wanted = to[axis].clamp(-self.rate_rad_s, self.rate_rad_s);
            wanted.clamp(from[axis] - self.change_rad_s, from[axis] + self.change_rad_s)
        })
    }
}

/// The temperature sensor.
struct Temperature {
    start_c: f64,
    per_s: f64,
}

impl Temperature {
    fn new(effects: &Effects) -> Self {
        Self { start_c: effects.temperature_c.unwrap_or(f64::NAN), per_s: effects.temperature_ramp_c_h / 3600.0 }
    }

    fn at(&self, time_s: f64) -> f32 {
        (self.start_c + self.per_s * time_s) as f32
    }
}
