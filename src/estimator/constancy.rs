//! Tests for changes during the run. The method takes the parameters as constant. Each kind of change is tested
//! separately, because the chi-square is one number for all measurements and is not sensitive to a small change of one
//! kind.
//!
//! A change of size s adds `s c_k` to measurement k. The filter absorbs part of the change. The rest appears in the
//! innovations:
//! ```text
//! innovation k changes by s g_k,   g_k = c_k + h_k y_k,   y_k+1 = y_k - K_k g_k
//! y: the part of the change in the states that the filter has not absorbed, per unit of s
//! score = sum g_k nu_k / S_k,   information = sum g_k^2 / S_k
//! s = score / information,   significance = score / sqrt(information)
//! ```
//! nu is the innovation, S its variance, K the gain and h the row of the measurement matrix. The innovations of a
//! consistent filter are white. So the significance is standard normal if nothing has changed. No test for one kind of
//! change has more power (generalized likelihood ratio; Willsky and Jones 1976).
//!
//! A change begins with a move, or with the run. The tests are for steps and ramps of parameters, slips and scale
//! changes of encoders, and outliers of single measurements. The configured Earth rate of the site and the configured
//! heading may be wrong from the first segment to the last, and each effect of the hardware may be larger than its
//! configured size. They are tested in the same way.

use super::configuration::{BEFORE_PARAMETERS, STATES};
use crate::base::linear::{ComplexField, Real, Vector, real, zeros};
use crate::base::units::ARCSEC;
use crate::model::effects::{EFFECTS, EffectColumns, by_noise_effect, is_of_site, is_possible};
use crate::model::error_model::{INSTALLATION_STATES, PARAMETERS, block};
use crate::model::measurement::ENCODER_ERRORS;
use crate::segment::{Segment, SegmentKind};
use serde::{Deserialize, Serialize};

/// Highest limit of the significance, for a change that does no harm below the limit. The probability of a false alarm
/// is 6e-7 for each test, and 4e-4 for 700 tests.
const HIGHEST_LIMIT: f64 = 5.0;
/// Lowest limit, for a change that could do harm below a higher limit. The probability of a false alarm is 6e-5 for
/// each test. In scheme "bai" with stops of 10 s there are eight such changes.
const LOWEST_LIMIT: f64 = 4.0;
/// A change is found this many sigmas before the change alone uses up the tolerance. The reserve is for noise.
const RESERVE_SIGMAS: f64 = 0.5;
/// Lowest limit for the scale of an encoder. The scale acts on all segments after the onset. So the tests for all
/// onsets are nearly the same test, and the probability of a false alarm is 2e-4 for all of them. This permits a lower
/// limit.
const LOWEST_SCALE_LIMIT: f64 = 3.7;
/// Lowest limit for an effect of the hardware. The probability of a false alarm is 7e-6 for each test, and 5e-4 for all
/// effects.
const LOWEST_EFFECT_LIMIT: f64 = 4.5;
/// A change of the scale of an encoder is found when it uses up this fraction of the tolerance.
const TOLERATED_SCALE_PART: f64 = 0.45;
/// Tolerance of an installation error, in sigmas. The larger of the two tolerances applies.
const TOLERANCE_SIGMAS: f64 = 4.5;
/// Tolerance of an installation error, rad.
const TOLERANCE_RAD: f64 = ARCSEC;

/// Kind of change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Change {
    /// A parameter, by index, has a different value from the onset on. For a step of the attitude, the gyros have
    /// measured the turn.
    Step(u8),
    /// A parameter, by index, ramps from the onset on. The size is per second.
    Ramp(u8),
    /// An encoder has slipped: 0 for outer, 1 for inner.
    Slip(u8),
    /// An encoder has a different scale from the onset on: 0 for outer, 1 for inner.
    EncoderScale(u8),
    /// One channel of one segment is an outlier: an accelerometer (m/s^2) or a gyro (rad) at a stop, or a gyro in a
    /// move.
    Outlier(u8),
    /// The Earth rate differs from that of the site: north, up, or both by the same amount, rad/s.
    EarthRate(EarthRateAxis),
    /// The configured heading is wrong, rad.
    Heading,
    /// An effect of the hardware, by index, is larger than its configured size permits.
    Effect(u8),
    /// The effects of a kind, by number, are together this many times as large as their configured sizes permit.
    Kind(u8),
}

impl Change {
    /// Whether this is an error of the configuration, not a change during the run.
    fn is_setting(self) -> bool {
        matches!(self, Self::EarthRate(_) | Self::Heading)
    }
}

/// Component of the Earth rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EarthRateAxis {
    /// Horizontal component.
    North,
    /// Vertical component.
    Up,
    /// Both components by the same amount. This test gives their common information.
    Both,
}

/// Evidence of the segments about the configured site and heading. For the Earth rate, it is score (s/rad) and
/// information (s^2/rad^2) of the measured Earth rate minus that of the site, north and up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SettingEvidence {
    /// Score of the Earth rate, north and up, s/rad.
    pub earth_rate_score: [f64; 2],
    /// Information on the Earth rate: north, north with up, up, s^2/rad^2.
    pub earth_rate_information: [f64; 3],
    /// Measured heading minus the configured heading, rad.
    pub heading_rad: f64,
    /// `heading_rad` in units of its standard deviation.
    pub heading_sigmas: f64,
}

impl SettingEvidence {
    /// Product of two differences of Earth rates, weighted by the information.
    pub fn product(&self, [a_north, a_up]: [f64; 2], [b_north, b_up]: [f64; 2]) -> f64 {
        let [north, across, up] = self.earth_rate_information;
        a_north * (north * b_north + across * b_up) + a_up * (across * b_north + up * b_up)
    }

    /// Decrease of the chi-square if the Earth rate differs from that of the site by `error_rad_s`, rad/s.
    pub fn explained_by(&self, error_rad_s: [f64; 2]) -> f64 {
        let [north, up] = self.earth_rate_score;
        2.0 * (error_rad_s[0] * north + error_rad_s[1] * up) - self.product(error_rad_s, error_rad_s)
    }

    /// Measured Earth rate minus that of the site, north and up, rad/s. `None` if the Earth rate was not tested.
    pub fn earth_rate_error_rad_s(&self) -> Option<[f64; 2]> {
        let ([north, up], [i_nn, i_nu, i_uu]) = (self.earth_rate_score, self.earth_rate_information);
        let determinant = i_nn * i_uu - i_nu * i_nu;
        let error = [(i_uu * north - i_nu * up) / determinant, (i_nn * up - i_nu * north) / determinant];
        (determinant > 0.0).then_some(error)
    }
}

/// The most significant change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Suspicion {
    /// Kind of change.
    pub change: Change,
    /// Segment with which the change begins, counted from 0.
    pub segment: u16,
    /// Estimated size of the change, SI.
    pub size: f64,
    /// The size in units of its standard deviation.
    pub sigmas: f64,
    /// Largest magnitude of `sigmas` that is attributed to chance.
    pub limit: f64,
}

impl Suspicion {
    /// Whether the significance is too large to be chance.
    pub fn is_founded(&self) -> bool {
        // A significance that is not a number must not pass the test.
        self.sigmas.is_nan() || self.sigmas.abs() > self.limit
    }

    /// The suspicion with the larger ratio of `sigmas` to its limit.
    pub fn more_significant(self, other: Self) -> Self {
        if self.sigmas.is_nan() {
            return self;
        }
        if other.sigmas.is_nan() || other.sigmas.abs() * self.limit > self.sigmas.abs() * other.limit {
            other
        } else {
            self
        }
    }
}

impl Default for Suspicion {
    /// No suspicion.
    fn default() -> Self {
        Self { change: Change::Step(0), segment: 0, size: 0.0, sigmas: 0.0, limit: HIGHEST_LIMIT }
    }
}

/// One scalar measurement as the filter saw it.
pub struct Seen<'a, T: Real> {
    /// Row of the measurement matrix.
    pub h: &'a Vector<T, STATES>,
    /// Gain.
    pub gain: &'a Vector<T, STATES>,
    /// Innovation.
    pub innovation: T,
    /// Variance of the innovation.
    pub variance: T,
    /// Segment, counted from 0.
    pub segment: u16,
    /// Channel: accelerometers x y z, gyros x y z.
    pub channel: u8,
    /// Derivative of the channel by the rates of roll, pitch and heading, s.
    pub by_attitude_rate: [T; 3],
    /// Derivative of the channel by the Earth rate, north and up, s.
    pub by_earth_rate: [T; 2],
    /// Derivatives of the triad by the effects, and the row of the channel in them.
    pub by_effects: &'a EffectColumns<T>,
    /// Row of the channel in its triad.
    pub row: usize,
    /// Specific force along the sensors' axes, in g; for gyros, its integral over the segment, s.
    pub in_g: [f64; 3],
}

/// A change under test. Its vector is `f32` even if the filter computes in `f64`, because a significance needs only two
/// digits.
#[derive(Clone, Debug)]
struct Suspect {
    change: Change,
    segment: u16,
    not_absorbed: Vector<f32, STATES>,
    score: f64,
    information: f64,
}

/// Largest number of changes under test in one sweep. There are 37 changes for each onset. To save memory, they are
/// tested in three sweeps. The first onset has the four configured settings before them, in the very first sweep, and the
/// effects of the hardware behind them.
const SUSPECTS: usize = 13;

/// Changes that begin with one segment, under test in one sweep of the filter.
#[derive(Clone, Debug)]
pub struct Suspects {
    onset: u16,
    duration_s: f32,
    /// Angles by which the axes have turned since the onset, rad.
    turned: [f32; 2],
    suspects: heapless::Vec<Suspect, SUSPECTS>,
}

impl Suspects {
    /// No change under test.
    pub const NONE: Self = Self { onset: 0, duration_s: 0.0, turned: [0.0; 2], suspects: heapless::Vec::new() };

    /// Whether no change is under test.
    pub fn is_empty(&self) -> bool {
        self.suspects.is_empty()
    }

    /// Removes all changes from the test.
    pub fn clear(&mut self) {
        self.suspects.clear();
    }

    /// Puts changes that begin with segment `onset` under test: those of sweep number `part`, counted from 0. Returns
    /// whether there are any. `onset_is_stop` says that the onset is the first stop, not a move.
    pub fn restart(&mut self, onset: u16, onset_is_stop: bool, part: usize) -> bool {
        let attitude = block::ATTITUDE..PARAMETERS;
        let steps = (block::ACCEL_BIAS..block::NON_PERPENDICULARITY).chain(attitude.clone());
        let biases = (block::ACCEL_BIAS..block::ACCEL_SCALE).chain(block::GYRO_BIAS..block::GYRO_SCALE);
        let (stop, turn) = if onset_is_stop { (onset, onset + 1) } else { (onset + 1, onset) };
        let changes = steps
            .map(|parameter| (Change::Step(parameter as u8), onset))
            .chain(biases.chain(attitude).map(|parameter| (Change::Ramp(parameter as u8), onset)))
            .chain((0..2).flat_map(|axis| [(Change::Slip(axis), onset), (Change::EncoderScale(axis), onset)]))
            .chain((0..6).map(|channel| (Change::Outlier(channel), stop)))
            .chain((3..6).map(|channel| (Change::Outlier(channel), turn)));
        let settings = [EarthRateAxis::North, EarthRateAxis::Up, EarthRateAxis::Both].map(Change::EarthRate);
        let settings = settings.into_iter().chain([Change::Heading]).filter(|_| onset_is_stop);
        let effects = (0..EFFECTS as u8)
            .filter(|effect| onset_is_stop && !is_of_site((*effect).into()))
            .map(|effect| (Change::Effect(effect), onset));
        let changes = settings.map(|setting| (setting, onset)).chain(changes).chain(effects);
        let suspect =
            |(change, segment)| Suspect { change, segment, not_absorbed: zeros(), score: 0.0, information: 0.0 };
        (self.onset, self.duration_s, self.turned) = (onset, 0.0, [0.0; 2]);
        self.suspects.clear();
        for suspect in changes.map(suspect).skip(part * SUSPECTS).take(SUSPECTS) {
            // The vector cannot overflow: at most `SUSPECTS` changes are taken.
            let _ = self.suspects.push(suspect);
        }
        !self.suspects.is_empty()
    }

    /// Begins segment `number`. At a move, the filter has already renewed its leading states, the encoder errors.
    pub fn begin<T: Real>(&mut self, number: u16, segment: &Segment<T>) {
        if number < self.onset {
            return;
        }
        let first = number == self.onset;
        let is_move = segment.kind() == SegmentKind::Move;
        let duration_s = segment.duration_s().widened() as f32;
        // Time from the middle of the segment before, or from the onset, to the middle of this segment.
        let passed_s = (self.duration_s + duration_s) * 0.5;
        self.duration_s = duration_s;
        for (turned, increment) in self.turned.iter_mut().zip([segment.turned.outer, segment.turned.inner]) {
            *turned += increment.widened() as f32;
        }
        let turned = |axis: u8| self.turned.get(usize::from(axis)).copied();
        for suspect in &mut self.suspects {
            let parameter = |parameter: u8| BEFORE_PARAMETERS + usize::from(parameter);
            let encoder = |axis: u8| ENCODER_ERRORS / 2 + usize::from(axis);
            if is_move {
                suspect.renew();
            }
            let changed = match suspect.change {
                Change::Step(of) if first => Some((parameter(of), 1.0)),
                Change::Heading if first => Some((BEFORE_PARAMETERS + block::HEADING, 1.0)),
                Change::Ramp(of) => Some((parameter(of), passed_s)),
                Change::Slip(axis) if is_move => Some((encoder(axis), 1.0)),
                Change::EncoderScale(axis) if is_move => turned(axis).map(|turned| (encoder(axis), turned)),
                _ => None,
            };
            if let Some((state, by)) = changed
                && let Some(state) = suspect.not_absorbed.iter_mut().nth(state)
            {
                *state += by;
            }
        }
    }

    /// Multiplies a state by a factor in the same way as the filter.
    pub fn scale_state(&mut self, state: usize, factor: f32) {
        for suspect in &mut self.suspects {
            if let Some(y) = suspect.not_absorbed.get_mut(state) {
                *y *= factor;
            }
        }
    }

    /// Processes a measurement that the filter has used.
    pub fn see<T: Real>(&mut self, seen: &Seen<'_, T>) {
        if seen.segment < self.onset {
            return;
        }
        // In the precision of the filter: a processor without a double-precision FPU takes long for so many products.
        let single = |value: f32| real::<T>(value.into());
        for suspect in &mut self.suspects {
            let absorbed = seen.h.as_slice().iter().zip(suspect.not_absorbed.as_slice());
            let through_states = absorbed.fold(T::zero(), |sum, (h, y)| sum + *h * single(*y));
            let g = real::<T>(suspect.direct(seen, self.onset, self.duration_s)) + through_states;
            if g == T::zero() {
                continue;
            }
            let weighted = g.widened() / seen.variance.widened();
            suspect.score += weighted * seen.innovation.widened();
            suspect.information += weighted * g.widened();
            for (y, gain) in suspect.not_absorbed.as_mut_slice().iter_mut().zip(seen.gain.as_slice()) {
                *y -= (g * *gain).widened() as f32;
            }
        }
    }

    /// The change with the largest ratio of significance to limit, for parameters with these sigmas, SI.
    pub fn most_significant(&self, sigmas: &[f64; PARAMETERS]) -> Suspicion {
        let changes = self.suspects.iter().filter(|suspect| !suspect.change.is_setting());
        let suspicions = changes.map(|suspect| suspect.suspicion(sigmas));
        suspicions.fold(Suspicion::default(), Suspicion::more_significant)
    }

    /// Evidence about the configured site and heading. `None` if they were not under test.
    pub fn settings(&self) -> Option<SettingEvidence> {
        let found = |change| self.suspects.iter().find(|suspect| suspect.change == change);
        let of = |axis| found(Change::EarthRate(axis)).map(|suspect| (suspect.score, suspect.information));
        let heading = found(Change::Heading)?.suspicion(&[0.0; PARAMETERS]);
        let ((north, i_nn), (up, i_uu)) = (of(EarthRateAxis::North)?, of(EarthRateAxis::Up)?);
        let (_, both) = of(EarthRateAxis::Both)?;
        Some(SettingEvidence {
            earth_rate_score: [north, up],
            earth_rate_information: [i_nn, 0.5 * (both - i_nn - i_uu), i_uu],
            heading_rad: heading.size,
            heading_sigmas: heading.sigmas,
        })
    }
}

impl Suspect {
    /// Renews the encoder errors in the same way as the filter.
    fn renew(&mut self) {
        let mut moved = self.not_absorbed.iter().copied().skip(ENCODER_ERRORS / 2).take(ENCODER_ERRORS / 2);
        let moved: [f32; ENCODER_ERRORS / 2] = core::array::from_fn(|_| moved.next().unwrap_or(0.0));
        let renewed = moved.into_iter().chain([0.0; ENCODER_ERRORS / 2]);
        for (y, renewed) in self.not_absorbed.iter_mut().zip(renewed) {
            *y = renewed;
        }
    }

    fn suspicion(&self, sigmas: &[f64; PARAMETERS]) -> Suspicion {
        let sigma = ComplexField::sqrt(self.information.max(f64::MIN_POSITIVE)).recip();
        // Installation errors do not change. So their entries in `not_absorbed` are the errors that the change causes.
        let wrong = self.not_absorbed.iter().skip(BEFORE_PARAMETERS).take(INSTALLATION_STATES).zip(sigmas);
        let harm = wrong.fold(0.0_f64, |harm, (wrong, parameter_sigma)| {
            let tolerance = (TOLERANCE_SIGMAS * parameter_sigma).max(TOLERANCE_RAD);
            harm.max(f64::from(*wrong).abs() * sigma / tolerance)
        });
        let without_harm = harm.max(f64::MIN_POSITIVE).recip();
        let limit = match self.change {
            Change::EncoderScale(_) => (TOLERATED_SCALE_PART * without_harm).max(LOWEST_SCALE_LIMIT),
            Change::Effect(_) => (without_harm - RESERVE_SIGMAS).max(LOWEST_EFFECT_LIMIT),
            _ => (without_harm - RESERVE_SIGMAS).max(LOWEST_LIMIT),
        };
        let size = self.score * sigma * sigma;
        let limit = match self.change {
            // Such a value has another cause, which other tests name.
            Change::Effect(effect) if !is_possible(effect.into(), size) => f64::INFINITY,
            _ => limit.min(HIGHEST_LIMIT),
        };
        Suspicion { change: self.change, segment: self.segment, size, sigmas: self.score * sigma, limit }
    }

    /// Direct effect of the change on a measurement, `c_k`. The effect through the states is not included.
    fn direct<T: Real>(&self, seen: &Seen<'_, T>, onset: u16, duration_s: f32) -> f64 {
        let by_rate = |parameter: u8| {
            let axis = usize::from(parameter).checked_sub(block::ATTITUDE);
            axis.and_then(|axis| seen.by_attitude_rate.get(axis)).map_or(0.0, |by| by.widened())
        };
        match self.change {
            Change::Outlier(channel) if channel == seen.channel && self.segment == seen.segment => 1.0,
            Change::Step(parameter) if seen.segment == onset => by_rate(parameter) / f64::from(duration_s),
            Change::Ramp(parameter) => by_rate(parameter),
            Change::Effect(effect) => match seen.by_effects.get((seen.row, usize::from(effect))) {
                Some(by) => by.widened(),
                None => by_noise_effect(effect.into(), seen.channel, &seen.in_g),
            },
            Change::EarthRate(axis) => {
                let [north, up] = seen.by_earth_rate.map(Real::widened);
                match axis {
                    EarthRateAxis::North => north,
                    EarthRateAxis::Up => up,
                    EarthRateAxis::Both => north + up,
                }
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limit of a change. For each sigma of the change, an installation error of sigma `sigma_rad` is wrong by
    /// `wrong_rad`.
    fn limit(change: Change, wrong_rad: f64, sigma_rad: f64) -> f64 {
        let mut not_absorbed: Vector<f32, STATES> = zeros();
        not_absorbed[BEFORE_PARAMETERS] = wrong_rad as f32;
        let suspect = Suspect { change, segment: 0, not_absorbed, score: 0.0, information: 1.0 };
        let limit = suspect.suspicion(&[sigma_rad; PARAMETERS]).limit;
        (100.0 * limit).round() / 100.0
    }

    #[test]
    fn a_change_that_does_more_harm_has_a_lower_limit() {
        let of = |change| move |part: f64| limit(change, part * TOLERANCE_RAD, 0.1 * ARCSEC);
        assert_eq!([0.0, 0.08, 0.1, 0.12, 1.0].map(of(Change::EncoderScale(0))), [5.0, 5.0, 4.5, 3.75, 3.7]);
        assert_eq!([0.0, 0.1, 0.2, 0.25, 1.0].map(of(Change::Slip(0))), [5.0, 5.0, 4.5, 4.0, 4.0]);
        assert_eq!(limit(Change::Slip(0), TOLERANCE_RAD, 10.0 * ARCSEC), 5.0, "harmless if the error is uncertain");
    }
}
