//! Recognizes encoders, gyros and accelerometers, and their units, by the values of the columns while the axes turn.
//!
//! A perfect unit on a level base measures at the gimbal angles (outer, inner) = (o, i), in the rotation frame r,
//! ```text
//! rotation  (cos i do, -sin i do, di)        up  (sin i sin o, cos i sin o, cos o)
//! ```
//! Installation errors of a degree and tilts of some degrees hardly change the correlation of a channel with its
//! component. So all pairs of columns are tried as encoders, in all units. Each component takes the column with which
//! it correlates best. The pair wins whose worst component has the highest correlation. Factor and sign of each channel
//! follow by regression.

use super::sketch::{ColumnSketch, Sketch};
use crate::log::Unit;
use rins_selfcal::base::units::{ARCSEC, DEG};
use std::f64::consts::TAU;

/// Number of components of rotation and up.
pub const COMPONENTS: usize = 6;
/// Least correlation that every channel must reach for the columns to be recognized.
const RECOGNIZED: f64 = 0.95;
/// Correlations that differ by less than this are equal. The errors of a real unit make such differences.
const EQUAL: f64 = 0.01;
/// Travel of an axis, rad. Less travel is no calibration. More travel than some turns shows that the unit is wrong.
const TRAVEL_RAD: [f64; 2] = [0.3, 200.0];
/// An axis is at rest between two points if it turns by less than this, rad.
const REST_RAD: f64 = 3e-4;
/// Least fraction of the time for which an axis of a calibration is at rest.
const REST_PART: f64 = 0.1;
/// A component is excited if it varies by at least this fraction of the most excited component.
const EXCITED: f64 = 0.02;
/// A first angle larger than this, rad, suggests that the encoder's zero is not at angle zero.
const ELSEWHERE_RAD: f64 = 10.0 * DEG;

/// How an encoder counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counting {
    /// Name of the unit.
    pub unit: &'static str,
    /// Counts in a turn, for the unit counts.
    pub counts_per_turn: Option<f64>,
    /// One unit, rad.
    pub rad: f64,
    /// Reading at angle zero.
    pub zero: f64,
    /// Whether the encoder counts left-handed.
    pub reversed: bool,
}

/// A channel of a triad: `column = factor * component`. The rotation is in rad per row, and up is a unit vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// Position of its column in the sketch.
    pub series: usize,
    /// Factor from the component to the column.
    pub factor: f64,
}

/// The recognized columns.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Outer and inner encoder: position in the sketch, and how the encoder counts.
    pub encoders: [(usize, Counting); 2],
    /// Channels along x, y, z: gyros and then accelerometers. `None` for a channel that the motion does not excite.
    pub channels: [Option<Channel>; COMPONENTS],
    /// Least correlation of a channel with its component.
    pub correlation: f64,
}

impl Geometry {
    /// The best geometry of the columns, if it is good enough. `taken` are columns that have another role.
    pub fn of(sketch: &Sketch, taken: &[usize]) -> Option<Self> {
        let free: Vec<usize> = (0..sketch.series.len()).filter(|index| !taken.contains(index)).collect();
        let centred: Vec<Centred> = sketch.series.iter().map(|series| Centred::new(&series.means[1..])).collect();
        let mut best: Option<(Self, u32)> = None;
        for encoders in pairs(sketch, &free) {
            let others: Vec<usize> =
                free.iter().copied().filter(|index| encoders.iter().all(|(encoder, _)| encoder != index)).collect();
            let Some(found) = read(sketch, encoders, &others, &centred) else { continue };
            let cost = found.cost();
            let better = best.as_ref().is_none_or(|(best, least)| {
                let gain = found.score() - best.score();
                gain > EQUAL || (gain > -EQUAL && cost < *least)
            });
            if better {
                best = Some((found, cost));
            }
        }
        best.map(|(found, _)| found).filter(|found| found.correlation >= RECOGNIZED)
    }

    /// Score of a geometry. One more recognized channel outweighs every correlation.
    fn score(&self) -> f64 {
        let recognized = self.channels.iter().flatten().count();
        self.correlation + recognized as f64
    }

    /// Number of differences from a standard log. Among equal scores the lowest cost wins.
    fn cost(&self) -> u32 {
        let encoders = self.encoders.iter().map(|(_, counting)| {
            u32::from(counting.reversed)
                + u32::from(counting.zero != 0.0)
                + u32::from(counting.counts_per_turn.is_some())
        });
        let negative = self.channels.iter().flatten().filter(|channel| channel.factor < 0.0).count() as u32;
        let falls = |triad: &[Option<Channel>]| {
            triad.windows(2).filter(|pair| matches!(pair, [Some(a), Some(b)] if b.series < a.series)).count() as u32
        };
        encoders.sum::<u32>() + negative + falls(&self.channels[..3]) + falls(&self.channels[3..])
    }
}

type Encoders = [(usize, Counting); 2];

/// All pairs of columns that may be encoders, in all units, with their zeros at reading zero or at the first reading.
fn pairs(sketch: &Sketch, free: &[usize]) -> Vec<Encoders> {
    let candidates: Vec<(usize, Counting)> = free
        .iter()
        .flat_map(|index| countings(&sketch.series[*index]).into_iter().map(|counting| (*index, counting)))
        .collect();
    let with = |outer: (usize, Counting)| candidates.iter().map(move |inner| [outer, *inner]);
    candidates.iter().flat_map(|outer| with(*outer)).filter(|[outer, inner]| outer.0 != inner.0).collect()
}

/// The units in which a column may be the angle of an axis that stops and moves.
fn countings(series: &ColumnSketch) -> Vec<Counting> {
    let plain = |(unit, rad)| Counting { unit, counts_per_turn: None, rad, zero: 0.0, reversed: false };
    let units = [("rad", 1.0), ("deg", DEG), ("arcsec", ARCSEC), ("turns", TAU)].map(plain);
    let binary = (10..=32).map(|bits| f64::from(bits).exp2());
    let decimal = (3..=7).map(|digits| 36.0 * 10_f64.powi(digits));
    let counts = binary
        .chain(decimal)
        .map(|counts| Counting { counts_per_turn: Some(counts), ..plain(("counts", TAU / counts)) });
    let all = units.into_iter().chain(counts.filter(|_| series.whole));
    all.filter(|counting| stops_and_moves(series, counting)).flat_map(|counting| with_zeros(series, counting)).collect()
}

fn stops_and_moves(series: &ColumnSketch, counting: &Counting) -> bool {
    let steps = turns(series, counting.rad);
    let at_rest = steps.iter().filter(|step| step.abs() < REST_RAD).count();
    let travel = series.span() * counting.rad;
    (TRAVEL_RAD[0]..TRAVEL_RAD[1]).contains(&travel) && at_rest as f64 > REST_PART * steps.len() as f64
}

fn with_zeros(series: &ColumnSketch, counting: Counting) -> Vec<Counting> {
    let first = series.head.first().copied().unwrap_or(0.0);
    let within_turn = (first * counting.rad + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
    let mut all = vec![counting];
    if within_turn.abs() > ELSEWHERE_RAD {
        all.push(Counting { zero: round_reading(first, counting.rad), ..counting });
    }
    all
}

/// Rounds a reading to a whole degree if it is within 0.1 deg of it.
fn round_reading(reading: f64, rad: f64) -> f64 {
    let degrees = reading * rad / DEG;
    if (degrees - degrees.round()).abs() < 0.1 { degrees.round() * DEG / rad } else { reading }
}

/// Turns from point to point, the shorter way, rad.
fn turns(series: &ColumnSketch, rad: f64) -> Vec<f64> {
    let shorter = |turn: f64| turn - TAU * (turn / TAU).round();
    series.lasts.windows(2).map(|pair| shorter((pair[1] - pair[0]) * rad)).collect()
}

/// The components of the rotation per row and of up that a pair of encoders predicts.
fn components(sketch: &Sketch, encoders: &Encoders) -> [Vec<f64>; COMPONENTS] {
    let [outer_turns, inner_turns] = encoders.map(|(index, counting)| turns(&sketch.series[index], counting.rad));
    let middles = |axis: usize, turns: &[f64]| -> Vec<f64> {
        let (index, counting) = encoders[axis];
        let ends = sketch.series[index].lasts[1..].iter().map(|last| (last - counting.zero) * counting.rad);
        ends.zip(turns).map(|(end, turn)| end - 0.5 * turn).collect()
    };
    let (outer, inner) = (middles(0, &outer_turns), middles(1, &inner_turns));
    let rows = f64::from(sketch.rows_to_a_point);
    let mut components = [const { Vec::new() }; COMPONENTS];
    for point in 0..outer.len() {
        let ((so, co), (si, ci)) = (outer[point].sin_cos(), inner[point].sin_cos());
        let (outer_turn, inner_turn) = (outer_turns[point] / rows, inner_turns[point] / rows);
        let values = [ci * outer_turn, -si * outer_turn, inner_turn, si * so, ci * so, co];
        components.iter_mut().zip(values).for_each(|(component, value)| component.push(value));
    }
    components
}

/// A series less its mean, and the sum of the squares.
struct Centred {
    values: Vec<f64>,
    squares: f64,
}

impl Centred {
    fn new(values: &[f64]) -> Self {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let values: Vec<f64> = values.iter().map(|value| value - mean).collect();
        let squares = values.iter().map(|value| value * value).sum();
        Self { values, squares }
    }

    /// Correlation with another series, and the factor from the other series to this one.
    fn on(&self, other: &Self) -> (f64, f64) {
        let product: f64 = self.values.iter().zip(&other.values).map(|(a, b)| a * b).sum();
        (product / (self.squares * other.squares).sqrt(), product / other.squares)
    }
}

/// Finds the channel of each excited component. `None` if two components share a column.
fn read(sketch: &Sketch, encoders: Encoders, others: &[usize], centred: &[Centred]) -> Option<Geometry> {
    let components = components(sketch, &encoders).map(|values| Centred::new(&values));
    let most = |triad: &[Centred]| triad.iter().map(|component| component.squares).fold(0.0, f64::max);
    let most = [most(&components[..3]), most(&components[3..])];
    let mut channels = [None; COMPONENTS];
    let mut correlation = 1.0_f64;
    for (number, component) in components.iter().enumerate() {
        if component.squares <= EXCITED * EXCITED * most[number / 3] {
            continue;
        }
        let fit = |index: &usize| (*index, centred[*index].on(component));
        let strength = |(_, (correlation, _)): &(usize, (f64, f64))| correlation.abs();
        let fits = others.iter().map(fit).filter(|fit| strength(fit).is_finite());
        let (series, (found, factor)) = fits.max_by(|a, b| strength(a).total_cmp(&strength(b)))?;
        if channels.iter().flatten().any(|other: &Channel| other.series == series) {
            return None;
        }
        channels[number] = Some(Channel { series, factor });
        correlation = correlation.min(found.abs());
    }
    let found = channels.iter().flatten().count() >= 4;
    found.then(|| Geometry { encoders, channels, correlation }.turned_right())
}

impl Geometry {
    /// Reverses encoders so that the fewest channels are negative. A reversed outer axis changes the signs of both x
    /// and y of rotation and up. A reversed inner axis changes the signs of y and z of rotation and of x of up.
    fn turned_right(self) -> Self {
        let reversals = [[false, false], [true, false], [false, true], [true, true]];
        let all = reversals.map(|[outer, inner]| {
            let mut turned = self.clone();
            turned.encoders[0].1.reversed = outer;
            turned.encoders[1].1.reversed = inner;
            let signs = [outer, outer != inner, inner, outer != inner, outer, false];
            for (channel, _) in turned.channels.iter_mut().zip(signs).filter(|(_, negative)| *negative) {
                channel.iter_mut().for_each(|channel| channel.factor = -channel.factor);
            }
            turned
        });
        let cost = |turned: &Self| turned.cost();
        all.into_iter().min_by_key(cost).unwrap_or(self)
    }
}

/// The unit in which a column with this factor reads `si` when its component is one, within 3 %.
pub fn unit_of(units: &[Unit], factor: f64, si: f64, interval_s: f64) -> Option<Unit> {
    let expected = |unit: &Unit| if unit.is_increment { si * interval_s / unit.si } else { si / unit.si };
    units.iter().copied().find(|unit| (factor.abs() / expected(unit)).ln().abs() < 0.03)
}
