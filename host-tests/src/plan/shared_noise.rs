//! The information of a scheme for a unit with imperfections of its hardware.
//!
//! Their sizes are the sigmas of small errors that many measurements share, so they are noise of the measurements:
//! ```text
//! z = H x + e,   R = cov e = white + sum sigma^2 c c^T + flicker and walks,   I = diag(1 / prior^2) + H^T R^-1 H
//! ```
//! A column c is an effect (M8)-(M10) or an encoder error of one stop, as the core has it. To take an error of known
//! sigma as noise leaves the parameters the same covariance as to estimate the error with this prior, as the core's
//! filter does. Flicker (M11) has an exponential correlation, and a walk is counted back from the end of the run, to
//! which the biases refer.

use super::information::{Information, STATES};
use super::leg_model::LegModel;
use super::triangle::{factorize, substitute};
use rins_selfcal::base::linear::{Vector, columns};
use rins_selfcal::base::sample::CHANNELS;
use rins_selfcal::base::site::{Site, gravity_by_latitude};
use rins_selfcal::estimator::{EstimatorConfig, LEAST_TURN_RAD};
use rins_selfcal::model::effects::{self, EFFECT_STATES, EffectColumns, Situation};
use rins_selfcal::model::error_model::PARAMETERS;
use rins_selfcal::model::measurement::{ENCODER_ERRORS, Prediction};
use rins_selfcal::segment::Segment;

/// When a segment was, s.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// From the start of the run to the start of the segment.
    pub from_s: f64,
    /// Duration of the segment.
    pub duration_s: f64,
}

impl Window {
    /// End of the segment.
    pub fn end_s(&self) -> f64 {
        self.from_s + self.duration_s
    }

    fn middle_s(&self) -> f64 {
        self.from_s + 0.5 * self.duration_s
    }
}

/// Places of the measurements: the accelerometers x y z with all stops each, then the gyros with all segments each. So
/// the columns of a single sensor are short.
#[derive(Clone, Copy)]
struct Layout {
    segments: usize,
}

impl Layout {
    fn stops(&self) -> usize {
        self.segments.div_ceil(2)
    }

    fn rows(&self) -> usize {
        3 * (self.stops() + self.segments)
    }

    fn force(&self, stop: usize) -> [usize; 3] {
        [0, 1, 2].map(|axis| axis * self.stops() + stop)
    }

    fn rotation(&self, segment: usize) -> [usize; 3] {
        [0, 1, 2].map(|axis| 3 * self.stops() + axis * self.segments + segment)
    }
}

/// All measurements of a scheme with the covariance of their noise.
pub struct SharedNoise<'a> {
    config: &'a EstimatorConfig,
    site: &'a Site,
    layout: Layout,
    /// Derivatives by the parameters, the effects and the encoder errors, each a column of all measurements.
    columns: Vec<f64>,
    /// Lower triangle of the covariance, column by column.
    covariance: Vec<f64>,
}

/// No pulses have been seen at the outputs beyond those that are configured.
const NONE_SEEN: [f32; CHANNELS] = [0.0; CHANNELS];

/// Place of the first column of an encoder error. The first two are of a stop before the first one, and are zero.
const ENCODERS_FROM: usize = PARAMETERS + EFFECT_STATES;
const ENCODERS_PER_STOP: usize = ENCODER_ERRORS / 2;

impl<'a> SharedNoise<'a> {
    /// The measurements of the stops and the moves between them, each in its window.
    pub fn new(config: &'a EstimatorConfig, site: &'a Site, legs: &[&LegModel], windows: &[Window]) -> Self {
        let layout = Layout { segments: windows.len() };
        let rows = layout.rows();
        let count = ENCODERS_FROM + ENCODERS_PER_STOP * (layout.stops() + 1);
        let (columns, covariance) = (vec![0.0; count * rows], vec![0.0; rows * rows]);
        let mut noise = Self { config, site, layout, columns, covariance };
        noise.add_segments(legs, windows);
        noise.add_errors();
        noise.add_flicker_and_walks(windows);
        noise
    }

    /// The information about the parameters, with these prior sigmas.
    pub fn information(mut self, prior_sigmas: &Vector<f64, STATES>) -> Information {
        let mut information = Information::prior(*prior_sigmas);
        let rows = self.layout.rows();
        if factorize(&mut self.covariance, rows).is_none() {
            // Every channel has white noise, so only an overflow leads here.
            return information;
        }
        for column in self.columns.chunks_exact_mut(rows).take(PARAMETERS) {
            let first = column.iter().position(|entry| *entry != 0.0).unwrap_or(rows);
            substitute(&self.covariance, column, first);
        }
        for row in 0..rows {
            let mut h = Vector::<f64, STATES>::zeros();
            let by_parameters = self.columns.iter().skip(row).step_by(rows);
            h.iter_mut().skip(ENCODER_ERRORS).zip(by_parameters).for_each(|(h, entry)| *h = *entry);
            information.add(&h, 1.0);
        }
        information
    }

    /// Adds the derivatives and the independent noise of all segments.
    fn add_segments(&mut self, legs: &[&LegModel], windows: &[Window]) {
        let reference_s = windows.last().map_or(0.0, Window::end_s);
        let mut arrivals = [[0.0; 2]; 2];
        for (segment, Window { from_s, duration_s }) in windows.iter().copied().enumerate() {
            let (stop, is_move) = (segment.div_ceil(2), segment % 2 == 1);
            let leg = legs[stop];
            arrivals[0] = arrivals[1];
            if is_move {
                let ways = [leg.moved.turned.outer, leg.moved.turned.inner];
                let turned = arrivals[1].iter_mut().zip(ways).filter(|(_, way)| way.abs() > LEAST_TURN_RAD);
                turned.for_each(|(sense, way)| *sense = way.signum());
            }
            let measured = self.site.measured_gravity_m_s2.is_some();
            let latitude_rad = self.site.latitude_rad;
            let gravity_by_latitude = if measured { 0.0 } else { gravity_by_latitude(latitude_rad) };
            let now = Situation { from_s, duration_s, reference_s, arrivals, latitude_rad, gravity_by_latitude };
            if is_move {
                self.put_rotation(segment, &leg.turn, &leg.moved, &now);
            } else {
                self.put_rotation(segment, &leg.rest_of(duration_s), &leg.at_rest, &now);
                self.put_force(stop, leg, &now);
            }
        }
    }

    fn put_rotation(
        &mut self,
        number: usize,
        prediction: &Prediction<f64>,
        segment: &Segment<f64>,
        now: &Situation<f64>,
    ) {
        let psd_sqrt = self.config.noise.gyro_psd_sqrt;
        let shaken = effects::rotation_noise(&self.config.hardware, now.duration_s);
        let variance = psd_sqrt * psd_sqrt * now.duration_s + shaken;
        let by_effects = effects::rotation_columns(prediction, segment, now);
        self.put(self.layout.rotation(number), number.div_ceil(2), prediction, &by_effects, [variance; 3]);
    }

    fn put_force(&mut self, stop: usize, leg: &LegModel, now: &Situation<f64>) {
        let psd_sqrt = self.config.noise.accel_psd_sqrt;
        let [x, y, z, ..] = effects::pulses(&self.config.hardware, &NONE_SEEN);
        let (in_g, gravity) = (leg.force.in_g.into(), self.site.gravity_m_s2());
        let noise = effects::force_noise(&self.config.hardware, &in_g, now.duration_s, &[x, y, z], gravity);
        let variances = noise.map(|noise| psd_sqrt * psd_sqrt / now.duration_s + noise);
        let by_effects = effects::force_columns(&leg.force, now);
        self.put(self.layout.force(stop), stop, &leg.force, &by_effects, variances);
    }

    /// Puts the derivatives and the independent noise of three channels to their places.
    fn put(
        &mut self,
        rows: [usize; 3],
        stop: usize,
        prediction: &Prediction<f64>,
        by_effects: &EffectColumns<f64>,
        variances: [f64; 3],
    ) {
        let size = self.layout.rows();
        let states = columns(&prediction.by_parameters).iter().chain(columns(by_effects)).zip(0..);
        let first_encoder = ENCODERS_FROM + ENCODERS_PER_STOP * stop;
        let encoders = columns(&prediction.by_encoder_errors).iter().zip(first_encoder..);
        for (column, place) in states.chain(encoders) {
            for (row, entry) in rows.iter().zip(column) {
                self.columns[place * size + row] = *entry;
            }
        }
        for (row, variance) in rows.into_iter().zip(variances) {
            self.add(row, row, variance);
        }
    }

    /// Adds a covariance of two measurements.
    fn add(&mut self, one: usize, other: usize, covariance: f64) {
        self.covariance[one.min(other) * self.layout.rows() + one.max(other)] += covariance;
    }

    /// Adds the effects and the encoder errors, `sigma^2 c c^T`.
    fn add_errors(&mut self) {
        let rows = self.layout.rows();
        let encoder = self.config.noise.encoder_sigma_rad;
        let encoder = encoder * encoder + effects::encoder_noise(&self.config.hardware);
        let sigmas = self.config.effect_sigmas();
        let of_effects = sigmas.iter().take(EFFECT_STATES).map(|sigma| sigma * sigma);
        let variances = of_effects.chain(std::iter::repeat(encoder));
        for (column, variance) in self.columns.chunks_exact(rows).skip(PARAMETERS).zip(variances) {
            let end = column.iter().rposition(|entry| *entry != 0.0).map_or(0, |last| last + 1);
            for (place, entry) in column[..end].iter().enumerate().filter(|(_, entry)| **entry * variance != 0.0) {
                let below = self.covariance[place * rows + place..].iter_mut().zip(&column[place..end]);
                below.for_each(|(covariance, other)| *covariance += variance * entry * other);
            }
        }
    }

    /// Adds the flicker and the random walks of the biases, and the errors of the gyros' angles at the ends of the
    /// segments.
    fn add_flicker_and_walks(&mut self, windows: &[Window]) {
        let hardware = &self.config.hardware;
        let [flicker, ..] = effects::flicker_sigmas(hardware).map(|sigma| sigma * sigma);
        let [accel_walk, gyro_walk] = effects::walk_variances(hardware);
        let [.., x, y, z] = effects::pulses(hardware, &NONE_SEEN);
        let ends = effects::gyro_end_variances(hardware, &[x, y, z]);
        // The sum of the durations of all segments after each segment: the time over which a bias walks from there on.
        let mut left_s = vec![0.0; windows.len()];
        for segment in (1..windows.len()).rev() {
            left_s[segment - 1] = left_s[segment] + windows[segment].duration_s;
        }
        let by_flicker: Vec<_> = windows.iter().map(|window| effects::by_flicker(window.duration_s)).collect();
        for (later, window) in windows.iter().enumerate() {
            for (earlier, before) in windows.iter().enumerate().take(later + 1) {
                let walked = gyro_walk * left_s[later] * window.duration_s * before.duration_s;
                let [one, other] = [later, earlier].map(|segment| self.layout.rotation(segment));
                one.into_iter().zip(other).for_each(|(one, other)| self.add(one, other, walked));
                if later % 2 == 0 && earlier % 2 == 0 {
                    let decays = effects::flicker_decay(window.middle_s() - before.middle_s());
                    let parts = by_flicker[later].iter().zip(by_flicker[earlier]).zip(decays);
                    let part: f64 = parts.map(|((one, other), decay)| one * other * decay).sum();
                    let walked = accel_walk * left_s[later];
                    let [one, other] = [later, earlier].map(|segment| self.layout.force(segment / 2));
                    one.into_iter().zip(other).for_each(|(one, other)| self.add(one, other, flicker * part + walked));
                }
            }
            // The error at the end of a segment is that at the start of the next one.
            for (row, end) in self.layout.rotation(later).into_iter().zip(ends) {
                self.add(row, row, 2.0 * end);
                if later > 0 {
                    self.add(row, row - 1, -end);
                }
            }
        }
    }
}
