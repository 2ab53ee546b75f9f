//! Single faults of base, sensors, encoders and sampling in the readings of a virtual RINS.
//!
//! A disturbance of the base acts on the true motion that the sensors measure, exactly for any angle. All other faults
//! change readings. Sizes are log-uniform from negligible to gross. Channel, axis, onset and end are uniform. A fault
//! lasts from its onset to the end of the run, or for a limited time. If a fault from the first reading on is a
//! different fault, half of the faults begin with the first reading.
//!
//! An encoder offset over the whole run is not a fault, because the encoder zeros define the frames r0 and b. So
//! encoders slip after the measurement of the first stop has begun.

use crate::calibration::virtual_run::VirtualRun;
use crate::virtual_unit::drive::SchemeDrive;
use crate::virtual_unit::kinematics::RigidTruth;
use crate::virtual_unit::plant::Reading;
use crate::virtual_unit::unit::VirtualUnit;
use crate::virtual_unit::vec3::{Vec3, add, scale};
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G};
use std::f64::consts::TAU;
use std::ops::Range;

/// Kinds of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "`name` says what each one is")]
pub enum FaultKind {
    Knock,
    KnockAndBack,
    Rocking,
    BaseDrift,
    BiasStep,
    BiasDrift,
    Stuck,
    Swapped,
    SignFlipped,
    Scaled,
    Delayed,
    Noisy,
    Spikes,
    Saturated,
    Dropped,
    DroppedUnseen,
    BurstDropped,
    BurstDroppedUnseen,
    RepeatedTime,
    Stale,
    EncoderSlip,
    EncoderSlipAndBack,
    EncoderSign,
    EncodersSwapped,
    EncoderScale,
    EncoderStuck,
}

impl FaultKind {
    /// All kinds.
    pub const ALL: [Self; 26] = [
        Self::Knock,
        Self::KnockAndBack,
        Self::Rocking,
        Self::BaseDrift,
        Self::BiasStep,
        Self::BiasDrift,
        Self::Stuck,
        Self::Swapped,
        Self::SignFlipped,
        Self::Scaled,
        Self::Delayed,
        Self::Noisy,
        Self::Spikes,
        Self::Saturated,
        Self::Dropped,
        Self::DroppedUnseen,
        Self::BurstDropped,
        Self::BurstDroppedUnseen,
        Self::RepeatedTime,
        Self::Stale,
        Self::EncoderSlip,
        Self::EncoderSlipAndBack,
        Self::EncoderSign,
        Self::EncodersSwapped,
        Self::EncoderScale,
        Self::EncoderStuck,
    ];

    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Knock => "base knocked",
            Self::KnockAndBack => "base knocked and back",
            Self::Rocking => "base rocking",
            Self::BaseDrift => "base drifting",
            Self::BiasStep => "bias step",
            Self::BiasDrift => "bias drift",
            Self::Stuck => "channel stuck",
            Self::Swapped => "channels swapped",
            Self::SignFlipped => "channel sign flipped",
            Self::Scaled => "channel scaled",
            Self::Delayed => "channel delayed",
            Self::Noisy => "channel noisy",
            Self::Spikes => "channel with spikes",
            Self::Saturated => "gyro saturated",
            Self::Dropped => "samples dropped",
            Self::DroppedUnseen => "samples dropped, times closed up",
            Self::BurstDropped => "burst dropped",
            Self::BurstDroppedUnseen => "burst dropped, times closed up",
            Self::RepeatedTime => "samples repeated, same time",
            Self::Stale => "samples repeated, new time",
            Self::EncoderSlip => "encoder slip",
            Self::EncoderSlipAndBack => "encoder slip and back",
            Self::EncoderSign => "encoder sign flipped",
            Self::EncodersSwapped => "encoders swapped",
            Self::EncoderScale => "encoder scaled",
            Self::EncoderStuck => "encoder stuck",
        }
    }
}

/// A fault with all its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Kind of fault.
    pub kind: FaultKind,
    /// Onset and end, samples.
    pub span: Range<usize>,
    /// Channel: 0 to 5 for accelerometers x y z and gyros x y z; for encoder faults 0 for outer and 1 for inner.
    pub channel: usize,
    /// The other channel of a swap, in the same triad.
    pub other: usize,
    /// Size in SI units, or a factor, a probability or a count, depending on the kind.
    pub size: f64,
    /// Axis of a base motion, unit vector in b.
    pub axis_b: Vec3,
    /// Angular frequency of rocking, rad/s, and its phase, rad.
    pub rocking: (f64, f64),
    /// Duration of the motion of the base, samples.
    pub rise: usize,
    /// Seed of the random numbers during the fault.
    pub seed: u64,
}

/// Random numbers for a fault.
struct Dice(Xoshiro256PlusPlus);

impl Dice {
    fn unit(&mut self) -> f64 {
        StandardUniform.sample(&mut self.0)
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    fn index(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    fn signed_log(&mut self, low: f64, high: f64) -> f64 {
        let size = self.log(low, high);
        if self.chance(0.5) { size } else { -size }
    }

    /// A coordinate axis, or a random direction.
    fn direction(&mut self) -> Vec3 {
        if self.chance(0.7) {
            let axis = self.index(3);
            return std::array::from_fn(|component| f64::from(u8::from(component == axis)));
        }
        let v: Vec3 = std::array::from_fn(|_| self.normal());
        scale(v, v.iter().map(|x| x * x).sum::<f64>().sqrt().recip())
    }
}

impl Fault {
    /// Draws the numbers of a fault for a run of `samples` samples.
    pub fn draw(kind: FaultKind, seed: u64, samples: usize) -> Self {
        let mut dice = Dice(Xoshiro256PlusPlus::seed_from_u64(seed));
        let channel = match kind {
            FaultKind::Saturated => 3 + dice.index(3),
            FaultKind::EncoderSlip
            | FaultKind::EncoderSlipAndBack
            | FaultKind::EncoderSign
            | FaultKind::EncodersSwapped
            | FaultKind::EncoderScale
            | FaultKind::EncoderStuck => dice.index(2),
            _ => dice.index(6),
        };
        let other = channel / 3 * 3 + (channel % 3 + 1 + dice.index(2)) % 3;
        Self {
            kind,
            span: span(&mut dice, kind, samples),
            channel,
            other,
            size: size(&mut dice, kind, channel, samples),
            axis_b: dice.direction(),
            rocking: (TAU * dice.log(0.01, 2.0), TAU * dice.unit()),
            rise: dice.log(1.0, 1000.0) as usize,
            seed: seed ^ 0x5eed,
        }
    }

    /// Rotation of the base about the axis of the fault at the end of a sample, rad.
    fn base_angle_rad(&self, sample: usize, interval_s: f64) -> f64 {
        let risen = |from: usize| (sample.saturating_sub(from) as f64 / self.rise as f64).min(1.0);
        let (omega, phase) = self.rocking;
        match self.kind {
            FaultKind::Knock => self.size * risen(self.span.start),
            FaultKind::KnockAndBack => self.size * (risen(self.span.start) - risen(self.span.end)),
            FaultKind::Rocking if sample >= self.span.start => {
                let at = |sample: usize| (omega * sample as f64 * interval_s + phase).sin();
                self.size * (at(sample) - at(self.span.start))
            }
            FaultKind::BaseDrift => self.size * sample.saturating_sub(self.span.start) as f64 * interval_s,
            _ => 0.0,
        }
    }

    fn moves_base(&self) -> bool {
        matches!(self.kind, FaultKind::Knock | FaultKind::KnockAndBack | FaultKind::Rocking | FaultKind::BaseDrift)
    }
}

/// First sample at which an encoder may slip.
const FIRST_SLIP: usize = 200;

fn span(dice: &mut Dice, kind: FaultKind, samples: usize) -> Range<usize> {
    let onset = dice.index(samples);
    let duration = dice.log(10.0, samples as f64) as usize;
    match kind {
        FaultKind::EncoderSlip => onset.max(FIRST_SLIP)..samples,
        FaultKind::KnockAndBack | FaultKind::EncoderSlipAndBack => onset..(onset + duration).min(samples),
        FaultKind::Stuck | FaultKind::EncoderStuck if dice.chance(0.5) => onset..(onset + duration).min(samples),
        FaultKind::Knock | FaultKind::BiasStep | FaultKind::BurstDropped | FaultKind::BurstDroppedUnseen => {
            onset..samples
        }
        _ if dice.chance(0.5) => 0..samples,
        _ => onset..samples,
    }
}

/// Size of a fault, from negligible to gross.
fn size(dice: &mut Dice, kind: FaultKind, channel: usize, samples: usize) -> f64 {
    let accel = channel < 3;
    let run_s = samples as f64 / 200.0;
    match kind {
        FaultKind::Knock | FaultKind::KnockAndBack | FaultKind::EncoderSlip | FaultKind::EncoderSlipAndBack => {
            dice.signed_log(0.05 * ARCSEC, 10.0 * DEG)
        }
        FaultKind::Rocking => dice.log(0.02 * ARCSEC, 1.0 * DEG),
        FaultKind::BaseDrift => dice.signed_log(0.05 * ARCSEC, 0.5 * DEG) / run_s,
        FaultKind::BiasStep if accel => dice.signed_log(0.1 * MICRO_G, 1e5 * MICRO_G),
        FaultKind::BiasStep => dice.signed_log(3e-4 * DEG_H, 1000.0 * DEG_H),
        FaultKind::BiasDrift if accel => dice.signed_log(0.1 * MICRO_G, 1e4 * MICRO_G) / run_s,
        FaultKind::BiasDrift => dice.signed_log(1e-3 * DEG_H, 100.0 * DEG_H) / run_s,
        FaultKind::Scaled | FaultKind::EncoderScale => dice.signed_log(1e-7, 0.5),
        FaultKind::Delayed => (1 + dice.index(200)) as f64,
        // Factor for the standard deviation.
        FaultKind::Noisy => 1.0 + dice.log(0.03, 100.0),
        FaultKind::Spikes if accel => dice.log(1.0, 1e5) * 140.0 * MICRO_G,
        FaultKind::Spikes => dice.log(1.0, 1e5) * 0.85 * ARCSEC,
        FaultKind::Saturated => dice.log(1.0, 21.0) * DEG,
        // Probability for each sample.
        FaultKind::Dropped | FaultKind::DroppedUnseen | FaultKind::RepeatedTime | FaultKind::Stale => {
            dice.log(1e-5, 0.5)
        }
        // Number of samples.
        FaultKind::BurstDropped | FaultKind::BurstDroppedUnseen => dice.log(1.0, 2000.0).round(),
        _ => 0.0,
    }
}

/// The readings of a run, with or without a fault.
pub fn readings(run: &VirtualRun, fault: Option<&Fault>) -> Vec<Reading> {
    let mut drive = run.drive();
    let Some(fault) = fault else { return drive.collect() };
    let mut readings = if fault.moves_base() { on_moving_base(&run.unit, &mut drive, fault) } else { drive.collect() };
    change(&mut readings, fault, &run.unit);
    readings
}

fn on_moving_base(unit: &VirtualUnit, drive: &mut SchemeDrive, fault: &Fault) -> Vec<Reading> {
    let truth = RigidTruth::new(unit);
    let interval_s = unit.rate_hz.recip();
    let mut before_rad = drive.rins().true_angles_rad();
    let mut readings = Vec::new();
    while let Some(mut reading) = drive.next() {
        let after_rad = drive.rins().true_angles_rad();
        let sample = readings.len() + 1;
        let (from, to) = (fault.base_angle_rad(sample - 1, interval_s), fault.base_angle_rad(sample, interval_s));
        let sensed = truth.by_base_motion(
            scale(fault.axis_b, 0.5 * (from + to)),
            scale(fault.axis_b, (to - from) / interval_s),
            [0, 1].map(|axis| 0.5 * (before_rad[axis] + after_rad[axis])),
            (sample as f64 - 0.5) * interval_s,
        );
        reading.force_a = add(reading.force_a, sensed.force_a);
        reading.omega_g = add(reading.omega_g, sensed.omega_g);
        readings.push(reading);
        before_rad = after_rad;
    }
    readings
}

fn channel(reading: &mut Reading, channel: usize) -> &mut f64 {
    if channel < 3 { &mut reading.force_a[channel] } else { &mut reading.omega_g[channel - 3] }
}

fn encoder(reading: &mut Reading, axis: usize) -> &mut f64 {
    if axis == 0 { &mut reading.outer_rad } else { &mut reading.inner_rad }
}

/// Applies a fault that changes readings.
fn change(readings: &mut Vec<Reading>, fault: &Fault, unit: &VirtualUnit) {
    let mut dice = Dice(Xoshiro256PlusPlus::seed_from_u64(fault.seed));
    let span = fault.span.start.min(readings.len())..fault.span.end.min(readings.len());
    match fault.kind {
        FaultKind::Delayed => delay(readings, span, fault),
        FaultKind::Dropped | FaultKind::DroppedUnseen => {
            thin(readings, span, |_| dice.chance(fault.size), fault.kind == FaultKind::DroppedUnseen);
        }
        FaultKind::BurstDropped | FaultKind::BurstDroppedUnseen => {
            let burst = span.start..span.start + fault.size as usize;
            thin(readings, span, |index| burst.contains(&index), fault.kind == FaultKind::BurstDroppedUnseen);
        }
        FaultKind::RepeatedTime => {
            let mut repeated = Vec::with_capacity(readings.len());
            for (index, reading) in readings.iter().enumerate() {
                repeated.push(*reading);
                if span.contains(&index) && dice.chance(fault.size) {
                    repeated.push(*reading);
                }
            }
            *readings = repeated;
        }
        FaultKind::Stale => {
            for index in span.start.max(1)..span.end {
                if dice.chance(fault.size) {
                    readings[index] = Reading { time_us: readings[index].time_us, ..readings[index - 1] };
                }
            }
        }
        kind if (FaultKind::EncoderSlip..=FaultKind::EncoderStuck).contains(&kind) => {
            change_encoder(&mut readings[span], fault);
        }
        _ => change_channel(&mut readings[span], fault, unit, &mut dice),
    }
}

fn delay(readings: &mut [Reading], span: Range<usize>, fault: &Fault) {
    for index in span.rev() {
        let earlier = index.saturating_sub(fault.size as usize);
        *channel(&mut readings[index], fault.channel) = *channel(&mut readings[earlier].clone(), fault.channel);
    }
}

/// Removes readings. If `unseen`, the times of the remaining readings are closed up, as if no reading had been lost.
fn thin(readings: &mut Vec<Reading>, span: Range<usize>, mut lost: impl FnMut(usize) -> bool, unseen: bool) {
    let times: Vec<u64> = readings.iter().map(|reading| reading.time_us).collect();
    let mut index = 0;
    readings.retain(|_| {
        let keep = !(span.contains(&index) && lost(index));
        index += 1;
        keep
    });
    if unseen {
        for (reading, time_us) in readings.iter_mut().zip(times) {
            reading.time_us = time_us;
        }
    }
}

fn change_channel(readings: &mut [Reading], fault: &Fault, unit: &VirtualUnit, dice: &mut Dice) {
    let Some(mut first) = readings.first().copied() else { return };
    let held = *channel(&mut first, fault.channel);
    let sigma = if fault.channel < 3 {
        unit.noise.sigma_force_m_s2(unit.rate_hz)
    } else {
        unit.noise.sigma_omega_rad_s(unit.rate_hz)
    };
    // The probability of a spike is from one in the run to one in a hundred samples.
    let spike = dice.log(1.0 / readings.len() as f64, 1e-2);
    for (number, reading) in readings.iter_mut().enumerate() {
        let other = *channel(reading, fault.other);
        let value = channel(reading, fault.channel);
        let was = *value;
        *value = match fault.kind {
            FaultKind::BiasStep => was + fault.size,
            FaultKind::BiasDrift => was + fault.size * number as f64 / unit.rate_hz,
            FaultKind::Stuck => held,
            FaultKind::Swapped => other,
            FaultKind::SignFlipped => -was,
            FaultKind::Scaled => was * (1.0 + fault.size),
            FaultKind::Noisy => was + sigma * (fault.size * fault.size - 1.0).sqrt() * dice.normal(),
            FaultKind::Spikes if dice.chance(spike) => was + fault.size * dice.normal(),
            FaultKind::Saturated => was.clamp(-fault.size, fault.size),
            _ => was,
        };
        if fault.kind == FaultKind::Swapped {
            *channel(reading, fault.other) = was;
        }
    }
}

fn change_encoder(readings: &mut [Reading], fault: &Fault) {
    let Some(mut first) = readings.first().copied() else { return };
    let held = *encoder(&mut first, fault.channel);
    // The sign flips about zero or about the present angle of the axis.
    let mirror = if fault.seed.is_multiple_of(2) { 0.0 } else { held };
    for reading in readings.iter_mut() {
        if fault.kind == FaultKind::EncodersSwapped {
            std::mem::swap(&mut reading.outer_rad, &mut reading.inner_rad);
            continue;
        }
        let angle = encoder(reading, fault.channel);
        *angle = match fault.kind {
            FaultKind::EncoderSlip | FaultKind::EncoderSlipAndBack => *angle + fault.size,
            FaultKind::EncoderSign => 2.0 * mirror - *angle,
            FaultKind::EncoderScale => held + (*angle - held) * (1.0 + fault.size),
            FaultKind::EncoderStuck => held,
            _ => *angle,
        };
    }
}
