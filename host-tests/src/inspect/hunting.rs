//! Hunting of the servos, which the encoders see, is no noise of the sensors.
//!
//! At rest the axes turn by small angles phi in the rotation frame r. A gyro feels their rate, and an accelerometer the
//! tilt of gravity and, with a lever arm, the angular acceleration:
//! ```text
//! gyro            phi'     (phi'' for a delay between gyros and encoders)
//! accelerometer   f x phi, phi''
//! ```
//! The installation errors, the lever arm and the delay are unknown but constant. So one regression over all stops
//! finds how each channel follows the encoders, and its residual is the noise. A regression adds no noise of the
//! encoders: if the encoders see nothing but their own noise, the coefficients are near zero.

use super::allan::{AllanDeviation, Products};
use super::passage::{between, in_r};
use rins_selfcal::base::sample::{CHANNELS, RawSample};
use rins_selfcal::segment::Segment;

/// Number of series: the channels, and what the encoders predict.
pub const SERIES: usize = CHANNELS + 9;
/// Averaging times over which a channel is compared with the encoders, s: the periods of servos that hunt. Over shorter
/// times the errors of single readings are larger than the hunting.
const PERIODS_S: [f64; 2] = [0.07, 1.01];
/// A series that the series before it explain up to this fraction adds nothing.
const EXPLAINED: f64 = 1e-6;

/// Positions of the series behind the channels: phi', phi'' and f x phi.
const RATE: usize = CHANNELS;
const ACCELERATION: usize = CHANNELS + 3;
const TILT: usize = CHANNELS + 6;

/// The series of one stop.
pub struct Series {
    force: [f64; 3],
    last: Option<RawSample<f64>>,
    /// Turn from the reading before the last one to the last one, rad.
    step: Option<[f64; 3]>,
    rate: Option<[f64; 3]>,
    turned: [f64; 3],
}

impl Series {
    /// Starts at a stop.
    pub fn at(stop: &Segment<f64>) -> Self {
        let force = stop.standing().map_or([0.0; 3], |standing| standing.force_a.into());
        Self { force, last: None, step: None, rate: None, turned: [0.0; 3] }
    }

    /// All series at the sample before this one. The encoders are read in the middle of its interval, so that the next
    /// reading completes its rate. `None` until three readings show an acceleration.
    pub fn step(&mut self, sample: &RawSample<f64>, interval_s: f64) -> Option<[f64; SERIES]> {
        let last = self.last.replace(*sample)?;
        let to_next = in_r(&last, between(&last, sample));
        let to_last = self.step.replace(to_next)?;
        let rate = std::array::from_fn(|axis| 0.5 * (to_last[axis] + to_next[axis]) / interval_s);
        self.turned = std::array::from_fn(|axis| self.turned[axis] + to_last[axis]);
        let before = self.rate.replace(rate)?;
        let ([fx, fy, fz], [x, y, z]) = (self.force, self.turned);
        let tilt = [fy * z - fz * y, fz * x - fx * z, fx * y - fy * x];
        let acceleration = std::array::from_fn(|axis| (rate[axis] - before[axis]) / interval_s);
        let groups: [[f64; 3]; 5] = [last.force_a.into(), last.omega_g.into(), rate, acceleration, tilt];
        Some(std::array::from_fn(|series| groups[series / 3][series % 3]))
    }
}

/// For each channel the combination of the series in which hunting does not show.
pub fn removed(allan: &AllanDeviation<SERIES>) -> [[f64; SERIES]; CHANNELS] {
    let products = allan.products(PERIODS_S);
    std::array::from_fn(|channel| {
        let by_tilt = [TILT + channel % 3, ACCELERATION, ACCELERATION + 1, ACCELERATION + 2];
        let by_rate: [usize; 6] = std::array::from_fn(|place| RATE + place);
        residual(&products, channel, if channel < 3 { &by_tilt } else { &by_rate })
    })
}

/// Weights of the residual of a channel after its regression on other series.
fn residual(products: &Products<SERIES>, channel: usize, predictors: &[usize]) -> [f64; SERIES] {
    let mut sweep: Vec<Vec<f64>> = predictors
        .iter()
        .map(|row| predictors.iter().chain([&channel]).map(|column| products[*row][*column]).collect())
        .collect();
    let mut weights = [0.0; SERIES];
    weights[channel] = 1.0;
    let mut used = Vec::new();
    for (pivot, predictor) in predictors.iter().enumerate() {
        let row = sweep[pivot].clone();
        if row[pivot] <= EXPLAINED * products[*predictor][*predictor] {
            continue;
        }
        used.push(pivot);
        for (_, other) in sweep.iter_mut().enumerate().filter(|(number, _)| *number != pivot) {
            let factor = other[pivot] / row[pivot];
            other.iter_mut().zip(&row).for_each(|(entry, by)| *entry -= factor * by);
        }
    }
    for pivot in used {
        weights[predictors[pivot]] = -sweep[pivot][predictors.len()] / sweep[pivot][pivot];
    }
    weights
}

/// Root mean square of the angles by which the axes hunt, rad. The second differences of a wave over half of its period
/// have 16 times its mean square. The octaves come near to half of the period, and show no more.
pub fn size_rad(allan: &AllanDeviation<SERIES>) -> f64 {
    let square = |axis: usize| {
        let mut weights = [0.0; SERIES];
        weights[RATE + axis] = 1.0;
        let curve = allan.curve(&weights);
        let near = curve.iter().filter(|point| (PERIODS_S[0]..PERIODS_S[1]).contains(&point.tau_s));
        near.map(|point| (point.deviation * point.tau_s).powi(2) / 8.0).fold(0.0, f64::max)
    };
    (0..3).map(square).sum::<f64>().sqrt()
}
