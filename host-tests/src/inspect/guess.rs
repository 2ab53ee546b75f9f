//! Guesses a mapping for a log of unknown columns: from their values during the motion, or else from their names.

use super::geometry::{Channel, Counting, Geometry, unit_of};
use super::names::{Role, role, unit};
use super::shape::{Shape, grows_evenly};
use super::sketch::{ColumnSketch, Sketch};
use crate::log::{
    ACCEL_UNITS, Column, EncoderTable, GYRO_UNITS, Mapping, Moment, TEMPERATURE_COLUMN, TIME_UNITS, TemperatureTable,
    TimeTable, TriadTable, Unit,
};
use rins_selfcal::gimbal::fault::AXIS_NAMES;
use std::ops::RangeInclusive;

/// Sample rates of IMUs, Hz.
const RATES_HZ: RangeInclusive<f64> = 9.9..=10_100.0;
/// Fewest rows of a log from which a mapping can be guessed.
const LEAST_ROWS: u64 = 16;
/// Gravity, m/s^2, near enough at every site to recognize a unit.
const GRAVITY_M_S2: f64 = 9.8;
/// The scale factors of a triad's channels agree to this fraction.
const ALIKE: f64 = 0.03;
const AXES: [&str; 3] = ["x", "y", "z"];

/// The role in which a column was recognized.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Taken {
    /// The column.
    pub column: String,
    /// The role in words. Empty if the column is not used.
    pub role: String,
}

/// A mapping and the roles of the columns from which it was made.
#[derive(Clone, Debug)]
pub struct Guess {
    /// The mapping.
    pub mapping: Mapping,
    /// Every column of numbers.
    pub columns: Vec<Taken>,
    /// What the user should check.
    pub remarks: Vec<String>,
}

/// The column of the time, its unit, and the sample interval, s.
#[derive(Clone, Copy)]
struct Clock {
    series: usize,
    unit: Unit,
    interval_s: f64,
}

/// Position in the sketch of every field, and how the field is measured.
struct Roles {
    clock: Option<Clock>,
    encoders: [(usize, Counting); 2],
    channels: [Channel; 6],
    temperature: Option<usize>,
    /// Whether the columns were recognized from the motion.
    shown: bool,
}

impl Guess {
    /// Guesses the mapping of a log that has been sketched.
    ///
    /// # Errors
    /// What cannot be recognized.
    pub fn of(shape: &Shape, sketch: &Sketch) -> Result<Self, String> {
        if sketch.rows < LEAST_ROWS {
            return Err(format!("the log has only {} rows, fewer than {LEAST_ROWS}", sketch.rows));
        }
        let name = |series: &ColumnSketch| if let Column::Name(name) = &series.column { role(name) } else { None };
        let named: Vec<Option<Role>> = sketch.series.iter().map(name).collect();
        let even = |index: &usize| grows_evenly(&sketch.series[*index].head);
        let mut times: Vec<usize> = (0..sketch.series.len()).filter(even).collect();
        // Columns that are named as a time come first, and counters come last.
        times.sort_by_key(|index| (named[*index] != Some(Role::Time), sketch.series[*index].whole));
        let temperature = named.iter().position(|role| *role == Some(Role::Temperature));
        let taken: Vec<usize> = times.iter().copied().chain(temperature).collect();
        let mut roles = match Geometry::of(sketch, &taken) {
            Some(geometry) => shown(geometry, &named, temperature)?,
            None => by_names(sketch, &named, temperature)?,
        };
        roles.clock = roles.clock(sketch, &times);
        Ok(roles.guess(shape, sketch))
    }
}

/// Roles recognized from the motion. A channel that the motion does not excite is found by its name.
fn shown(geometry: Geometry, named: &[Option<Role>], temperature: Option<usize>) -> Result<Roles, String> {
    let mut channels = [Channel { series: 0, factor: 0.0 }; 6];
    for (number, (channel, found)) in channels.iter_mut().zip(&geometry.channels).enumerate() {
        let wanted = if number < 3 { Role::Gyro(number) } else { Role::Accel(number - 3) };
        let by_name =
            || named.iter().position(|role| *role == Some(wanted)).map(|series| Channel { series, factor: 0.0 });
        let missing = || format!("no column was recognized as {}: the axes do not turn enough", in_words(number));
        *channel = found.or_else(by_name).ok_or_else(missing)?;
    }
    Ok(Roles { clock: None, encoders: geometry.encoders, channels, temperature, shown: true })
}

fn in_words(number: usize) -> String {
    format!("{} {}", if number < 3 { "gyro" } else { "accelerometer" }, AXES[number % 3])
}

/// Roles found by name, for a log in which no axis turns as in a calibration.
fn by_names(sketch: &Sketch, named: &[Option<Role>], temperature: Option<usize>) -> Result<Roles, String> {
    let find = |wanted: Role, what: &str| {
        let found = named.iter().position(|role| *role == Some(wanted));
        found.ok_or_else(|| {
            format!("the motion does not show what the columns are, and no column is named as {what}; give a --mapping")
        })
    };
    let mut channels = [Channel { series: 0, factor: 0.0 }; 6];
    for (number, channel) in channels.iter_mut().enumerate() {
        let wanted = if number < 3 { Role::Gyro(number) } else { Role::Accel(number - 3) };
        channel.series = find(wanted, &in_words(number))?;
    }
    let encoder = |axis: usize, what: &str| {
        let series = find(Role::Encoder(axis), what)?;
        let unit =
            hint(&sketch.series[series]).filter(|unit| ["deg", "arcsec", "turns"].contains(unit)).unwrap_or("rad");
        Ok::<_, String>((series, Counting { unit, counts_per_turn: None, rad: 1.0, zero: 0.0, reversed: false }))
    };
    let encoders = [encoder(0, "outer encoder")?, encoder(1, "inner encoder")?];
    Ok(Roles { clock: None, encoders, channels, temperature, shown: false })
}

fn hint(series: &ColumnSketch) -> Option<&'static str> {
    if let Column::Name(name) = &series.column { unit(name) } else { None }
}

/// Mean of the regular steps in the first rows.
fn mean_step(series: &ColumnSketch) -> f64 {
    let mut steps: Vec<f64> = series.head.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2).copied().unwrap_or(f64::NAN);
    let regular: Vec<f64> = steps.into_iter().filter(|step| (step / median - 1.0).abs() < 0.5).collect();
    regular.iter().sum::<f64>() / regular.len() as f64
}

impl Roles {
    fn guess(&self, shape: &Shape, sketch: &Sketch) -> Guess {
        let mut remarks = Vec::new();
        if !self.shown {
            remarks.push(
                "no axis turns as in a calibration: columns are recognized by name only, units by name and gravity"
                    .into(),
            );
        }
        if self.clock.is_none() {
            remarks.push("no column grows by equal steps, so the log has no time: set rate_hz in [time]".into());
        }
        let (time_unit, interval_s) =
            self.clock.map_or((TIME_UNITS[0], f64::NAN), |clock| (clock.unit, clock.interval_s));
        let gyro = self.triad(sketch, 0, &GYRO_UNITS, interval_s, &mut remarks);
        let accel = self.triad(sketch, 3, &ACCEL_UNITS, interval_s, &mut remarks);
        let encoder = |axis: usize| {
            let (series, counting) = self.encoders[axis];
            EncoderTable {
                column: Some(sketch.series[series].column.clone()),
                unit: Some(counting.unit.into()),
                counts_per_turn: counting.counts_per_turn,
                zero: (counting.zero != 0.0).then_some(counting.zero),
                reversed: counting.reversed.then_some(true),
            }
        };
        let mapping = Mapping {
            time: TimeTable {
                column: self.clock.map(|clock| sketch.series[clock.series].column.clone()),
                unit: Some(time_unit.name.into()),
                // Used until the motion shows when the encoders are read.
                stamp: Some(Moment::Middle),
                ..TimeTable::default()
            },
            gyro,
            accel,
            outer: encoder(0),
            inner: encoder(1),
            temperature: self.temperature(sketch),
            ..shape.mapping.clone()
        };
        Guess { columns: self.columns(sketch, &mapping), mapping, remarks }
    }

    /// The time column and its unit: the first pair that gives the gyros a known unit. A unit in the column's name is
    /// tried first.
    fn clock(&self, sketch: &Sketch, times: &[usize]) -> Option<Clock> {
        let clocks = |index: &usize| {
            let series = &sketch.series[*index];
            let clock = |unit: &Unit| Clock { series: *index, unit: *unit, interval_s: mean_step(series) * unit.si };
            let named = |clock: &Clock| hint(series) == Some(clock.unit.name);
            let possible = TIME_UNITS.iter().map(clock).filter(|clock| RATES_HZ.contains(&clock.interval_s.recip()));
            let mut possible: Vec<Clock> = possible.collect();
            possible.sort_by_key(|clock| !named(clock));
            possible
        };
        let all: Vec<Clock> = times.iter().flat_map(clocks).collect();
        let known = |clock: &&Clock| self.rate_unit(clock.interval_s).is_some();
        all.iter().find(known).or(all.first()).copied()
    }

    fn rate_unit(&self, interval_s: f64) -> Option<Unit> {
        unit_of(&GYRO_UNITS, self.factor(0)?, 1.0 / interval_s, interval_s)
    }

    /// Median size of the known factors in the triad that begins at `first`.
    fn factor(&self, first: usize) -> Option<f64> {
        let triad = self.channels[first..first + 3].iter();
        let mut sizes: Vec<f64> = triad.map(|channel| channel.factor.abs()).filter(|factor| *factor > 0.0).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    }

    fn triad(
        &self,
        sketch: &Sketch,
        first: usize,
        units: &[Unit],
        interval_s: f64,
        remarks: &mut Vec<String>,
    ) -> TriadTable {
        let channels = &self.channels[first..first + 3];
        let mut order = [0, 1, 2];
        order.sort_by_key(|axis| channels[*axis].series);
        let axes = [0, 1, 2].map(|axis: usize| {
            let position = order.iter().position(|other| *other == axis).unwrap_or(axis);
            format!("{}{}", if channels[axis].factor < 0.0 { "-" } else { "" }, AXES[position])
        });
        let (unit, scale) = self.unit(sketch, first, units, interval_s, remarks);
        TriadTable {
            columns: Some(order.map(|axis| sketch.series[channels[axis].series].column.clone())),
            unit: Some(unit.name.into()),
            scale,
            axes: (axes != AXES).then_some(axes.map(Into::into)),
        }
    }

    /// Unit of a triad, and the scale of its counts if the unit is not known.
    fn unit(
        &self,
        sketch: &Sketch,
        first: usize,
        units: &[Unit],
        interval_s: f64,
        remarks: &mut Vec<String>,
    ) -> (Unit, Option<f64>) {
        let (name, si) = if first == 0 { ("gyros", 1.0 / interval_s) } else { ("accelerometers", GRAVITY_M_S2) };
        let hinted = || {
            let hint = hint(&sketch.series[self.channels[first].series])?;
            units.iter().copied().find(|unit| unit.name == hint)
        };
        let gravity = || (first == 3).then(|| self.resting_force(sketch));
        let Some(factor) = self.factor(first).or_else(gravity) else { return (hinted().unwrap_or(units[0]), None) };
        let odd = |channel: &&Channel| channel.factor != 0.0 && (channel.factor.abs() / factor).ln().abs() > ALIKE;
        if let Some(odd) = self.channels[first..first + 3].iter().find(odd) {
            let column = &sketch.series[odd.series].column;
            remarks.push(format!(
                "{name}: column {column} is {:.3} times as large as the others",
                odd.factor.abs() / factor
            ));
        }
        match unit_of(units, factor, si, interval_s) {
            Some(unit) => {
                if let Some(hinted) = hinted().filter(|hinted| hinted.si != unit.si) {
                    remarks.push(format!(
                        "{name}: the column names say {}, but the values fit {}",
                        hinted.name, unit.name
                    ));
                }
                (unit, None)
            }
            None => {
                let scale = si / (factor * units[0].si);
                remarks.push(format!(
                    "{name}: the unit is not known; the scale {scale:.6e} {} was computed from the values",
                    units[0].name
                ));
                (units[0], Some(scale))
            }
        }
    }

    /// Median magnitude of the specific force.
    fn resting_force(&self, sketch: &Sketch) -> f64 {
        let axis = |number: usize| &sketch.series[self.channels[3 + number].series].means;
        let length = |point: usize| (0..3).map(|number| axis(number)[point].powi(2)).sum::<f64>().sqrt();
        let mut lengths: Vec<f64> = (0..axis(0).len()).map(length).collect();
        lengths.sort_by(f64::total_cmp);
        lengths.get(lengths.len() / 2).copied().unwrap_or(f64::NAN)
    }

    fn temperature(&self, sketch: &Sketch) -> TemperatureTable {
        let Some(series) = self.temperature.map(|index| &sketch.series[index]) else {
            return TemperatureTable::default();
        };
        let column = Some(series.column.clone()).filter(|column| column.to_string() != TEMPERATURE_COLUMN);
        // No IMU works below -73 deg C, so numbers above 200 are kelvins.
        let unit = (series.range[0] > 200.0).then(|| "K".to_string());
        TemperatureTable { column, unit }
    }

    fn columns(&self, sketch: &Sketch, mapping: &Mapping) -> Vec<Taken> {
        let unit = |unit: &Option<String>| unit.clone().unwrap_or_default();
        let role = |index: usize| {
            if let Some(number) = self.channels.iter().position(|channel| channel.series == index) {
                let sign = if self.channels[number].factor < 0.0 { "-" } else { "" };
                let units = [&mapping.gyro.unit, &mapping.accel.unit];
                return format!(
                    "{} {sign}{}, {}",
                    if number < 3 { "gyro" } else { "accelerometer" },
                    AXES[number % 3],
                    unit(units[number / 3])
                );
            }
            if let Some(axis) = self.encoders.iter().position(|(series, _)| *series == index) {
                let counting = &self.encoders[axis].1;
                let turn = counting.counts_per_turn.map_or_else(String::new, |counts| format!(", {counts} per turn"));
                let reversed = if counting.reversed { ", reversed" } else { "" };
                let zero = if counting.zero == 0.0 { String::new() } else { format!(", zero at {}", counting.zero) };
                return format!("{} encoder, {}{turn}{reversed}{zero}", AXIS_NAMES[axis], counting.unit);
            }
            match index {
                index if self.clock.is_some_and(|clock| clock.series == index) => {
                    format!("time, {}", unit(&mapping.time.unit))
                }
                index if self.temperature == Some(index) => {
                    format!("temperature, {}", mapping.temperature.unit.as_deref().unwrap_or("C"))
                }
                _ => String::new(),
            }
        };
        let taken =
            |(index, series): (usize, &ColumnSketch)| Taken { column: series.column.to_string(), role: role(index) };
        sketch.series.iter().enumerate().map(taken).collect()
    }
}
