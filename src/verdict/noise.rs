//! Compares the noise of all stops together with the configured noise.

use super::assessment::{Assessment, Verdict};
use super::fit::chi_square_bounds;
use super::motion::{NoiseLevels, STUCK_RATIO, is_pulses, is_unrest, unnamed};
use super::reason::{Reason, Sensors};
use crate::base::linear::{ComplexField, Real};
use crate::base::sample::CHANNELS;
use crate::estimator::Solution;
use crate::segment::white_noise::{ScatterRatios, chi_square_quantile};

/// Bound of a channel's variance over all stops from one stop to the last, as a normal deviate: 8e-7 for one channel
/// and one first stop, 1e-4 for 19 stops of 6 channels.
const NOISE_Z: f64 = 4.8;

/// Bound of the squared trends of a channel, or of a triad, over all stops, as a normal deviate: 3e-6 for one of them,
/// 3e-5 for 6 channels and 2 triads.
const TRENDS_Z: f64 = 4.5;

/// Stops whose variance is below this fraction of the variance of white noise explain a fit that is too good.
const QUIET_RATIO: f64 = 0.5;

/// One stop may be disturbed. If most stops are, the configured noise is not the noise of the instrument. A configured
/// noise that is too large is no fault by itself, but it explains a fit that is too good.
pub(super) fn noise_levels<T: Real>(assessment: &Assessment<'_, T>) -> NoiseLevels {
    let Solution { fit, degrees_of_freedom, .. } = assessment.solution;
    let [low, _] = chi_square_bounds(*degrees_of_freedom, assessment.hardware);
    let quiet = if fit.chi_square < low { QUIET_RATIO } else { STUCK_RATIO };
    let mut levels = [None; CHANNELS];
    for (channel, level) in (0_u8..).zip(&mut levels) {
        let mut far = Pooled::default();
        let (mut stops, mut stops_far) = (0, 0);
        for stop in assessment.segments {
            let Some(ratios) = assessment.noise.scatter(assessment.hardware, stop, channel) else { continue };
            let freedom = ratios.freedom;
            stops += 1;
            // A dead channel has no noise. It does not count as quiet, because another doubt reports it.
            if is_unrest(ratios.variance, freedom) {
                stops_far += 1;
                far.add(ratios.variance, freedom);
            } else if 0.0 < ratios.of_white && ratios.of_white < quiet && !is_pulses(stop, channel) {
                stops_far += 1;
                far.add(ratios.of_white, freedom);
            }
        }
        *level = (2 * stops_far > stops && stops > 2).then(|| far.ratio());
    }
    levels
}

pub(super) fn judge_noise_levels(verdict: &mut Verdict, levels: &NoiseLevels) {
    let mut doubt = |sensors, variance| {
        verdict.doubt(Reason::NoiseLevel { sensors, ratio: ComplexField::sqrt(variance) });
    };
    let [ax, ay, az, gx, gy, gz] = *levels;
    for (sensors, first, triad) in [(Sensors::Accelerometers, 0, [ax, ay, az]), (Sensors::Gyros, 3, [gx, gy, gz])] {
        if let [Some(x), Some(y), Some(z)] = triad {
            doubt(sensors, (x + y + z) / 3.0);
        } else {
            for (channel, level) in (first..).zip(triad) {
                level.into_iter().for_each(|variance| doubt(Sensors::Channel(channel), variance));
            }
        }
    }
}

/// Judges all stops together. This finds an increase of noise and a drift that are too small to show in a single stop.
pub(super) fn judge_noise<T: Real>(verdict: &mut Verdict, assessment: &Assessment<'_, T>, levels: &NoiseLevels) {
    // The flicker of a triad has one size, which shows in its three channels together before it shows in one.
    let mut triads = [(Pooled::default(), None::<(u8, Pooled)>); 2];
    for channel in unnamed(levels) {
        let mut noise = Pooled::default();
        let mut trends = Pooled::default();
        let mut noisiest: Option<(u16, Pooled)> = None;
        for (segment, stop) in assessment.segments.iter().enumerate().rev() {
            let Some(ratios) = assessment.noise.scatter(assessment.hardware, stop, channel) else { continue };
            let ScatterRatios { variance, trend, freedom, .. } = ratios;
            noise.add(variance, freedom);
            trends.add(trend * trend, 1);
            if noise.exceeds(NOISE_Z) && noisiest.is_none_or(|(_, most)| noise.deviate() > most.deviate()) {
                noisiest = Some((segment as u16, noise));
            }
        }
        if let Some((segment, noise)) = noisiest {
            verdict.doubt(Reason::Noise { segment, channel, ratio: noise.ratio() });
        }
        if trends.exceeds(TRENDS_Z) {
            verdict.doubt(Reason::Trends { channel, ratio: trends.ratio() });
        }
        let [accelerometers, gyros] = &mut triads;
        let (all, worst) = if channel < 3 { accelerometers } else { gyros };
        all.add(trends.ratio(), trends.freedom);
        if worst.is_none_or(|(_, most)| trends.deviate() > most.deviate()) {
            *worst = Some((channel, trends));
        }
    }
    for (all, worst) in triads {
        if let Some((channel, trends)) = worst.filter(|(_, trends)| all.exceeds(TRENDS_Z) && !trends.exceeds(TRENDS_Z))
        {
            verdict.doubt(Reason::Trends { channel, ratio: trends.ratio() });
        }
    }
}

/// A sum of squares over its expectation, with the number of its terms.
#[derive(Clone, Copy, Debug, Default)]
struct Pooled {
    sum: f64,
    freedom: u32,
}

impl Pooled {
    fn add(&mut self, ratio: f64, freedom: u32) {
        self.sum += ratio * f64::from(freedom);
        self.freedom += freedom;
    }

    fn ratio(&self) -> f64 {
        self.sum / f64::from(self.freedom.max(1))
    }

    /// An approximate normal deviate, to compare sums of different length.
    fn deviate(&self) -> f64 {
        (self.ratio() - 1.0) * ComplexField::sqrt(0.5 * f64::from(self.freedom))
    }

    fn exceeds(&self, z: f64) -> bool {
        self.freedom > 0 && self.sum > chi_square_quantile(self.freedom, z)
    }
}
