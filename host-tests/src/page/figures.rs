//! The figures of the page as SVG in the page's text colour.

use super::canvas::{Curve, Drawn, Figure, Scale, figure, shade, shade_signed};
use crate::base::quantity;
use crate::calibration::Outcome;
use crate::files::truth::ParameterTable;
use crate::plan::observability::{INTERVAL_S, along_scheme};
use crate::result::signals::{Point, Signals};
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::DEG;
use rins_selfcal::gimbal::fault::AXIS_NAMES;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors, PARAMETER_INFO};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::CHANNEL_NAMES;

const WIDE: (u32, u32) = (960, 320);
const SMALL: (u32, u32) = (330, 210);
const PANEL: (u32, u32) = (960, 220);
const PANELS: [(usize, &str); 3] = [(0, "(a) x axis"), (1, "(b) y axis"), (2, "(c) z axis")];
const AXES: [&str; 3] = ["x", "y", "z"];
/// Information of a segment that has the darkest cell, bits.
const DARKEST_BITS: f64 = 3.0;
/// Half height of the figure of an estimate, in final sigmas.
const SHOWN_SIGMAS: f64 = 12.0;

/// Outer and inner angle against time. (Bai et al., Figure 5)
pub fn angles(signals: &Signals) -> Drawn {
    let line = |axis: usize, name: &str| {
        Curve::new(name, signals.points().iter().map(|point| (point.time_s, point.angles_rad[axis] / DEG)))
    };
    Figure::new("gimbal angles, deg, against time, s", WIDE).lines(&[line(0, AXIS_NAMES[0]), line(1, AXIS_NAMES[1])])
}

/// A signal against time in a panel of its own.
fn panel(signals: &Signals, title: &str, unit: &str, value: impl Fn(&Point) -> f64) -> Drawn {
    let points = signals.points().iter().map(|point| (point.time_s, value(point)));
    Figure::new(title, PANEL).axes("time, s", unit).lines(&[Curve::new(title, points)])
}

/// The inner and the outer angle against time, each in a panel. (Bai et al., Figure 5)
pub fn angle_panels(signals: &Signals) -> [Drawn; 2] {
    [(1, "(a) inner axis"), (0, "(b) outer axis")]
        .map(|(axis, title)| panel(signals, title, "angle, deg", |point| point.angles_rad[axis] / DEG))
}

/// The outputs of the gyros against time, each in a panel. (Bai et al., Figures 7 and 14)
pub fn gyro_panels(signals: &Signals) -> [Drawn; 3] {
    PANELS.map(|(axis, title)| panel(signals, title, "rate, deg/s", |point| point.omega_g[axis] / DEG))
}

/// The outputs of the accelerometers against time, each in a panel. (Bai et al., Figures 8 and 15)
pub fn accelerometer_panels(signals: &Signals) -> [Drawn; 3] {
    PANELS.map(|(axis, title)| panel(signals, title, "force, m/s²", |point| point.force_a[axis]))
}

/// Gyro outputs against time. (Bai et al., Figure 7)
pub fn gyros(signals: &Signals) -> Drawn {
    let line = |axis: usize| {
        Curve::new(AXES[axis], signals.points().iter().map(|point| (point.time_s, point.omega_g[axis] / DEG)))
    };
    Figure::new("gyro outputs, deg/s, against time, s", WIDE).lines(&[line(0), line(1), line(2)])
}

/// Accelerometer outputs against time. (Bai et al., Figure 8)
pub fn accelerometers(signals: &Signals) -> Drawn {
    let line =
        |axis: usize| Curve::new(AXES[axis], signals.points().iter().map(|point| (point.time_s, point.force_a[axis])));
    Figure::new("accelerometer outputs, m/s², against time, s", WIDE).lines(&[line(0), line(1), line(2)])
}

/// One estimated parameter against time with a band of three sigmas, and the true value if it is known. (Bai et al.,
/// Figures 9 to 11 and 16 to 18)
pub fn estimate(outcome: &Outcome, index: usize, truth: Option<&ParameterTable>) -> Drawn {
    let info = &PARAMETER_INFO[index];
    let (last, last_sigma) = values_of(outcome, index).last().map_or((0.0, 1.0), |(_, value, sigma)| (*value, *sigma));
    let near = |value: f64| last + quantity::error(index, value, last);
    let truth = truth.and_then(|truth| truth.0[index]).map(|truth| near(quantity::value(index, truth)));
    let half = truth.map_or(0.0, |truth| 1.3 * (truth - last).abs()).max(SHOWN_SIGMAS * last_sigma);
    let points = values_of(outcome, index).into_iter().map(|(time_s, value, sigma)| {
        let value = near(value);
        (time_s, [value - 3.0 * sigma, value, value + 3.0 * sigma])
    });
    let points: Vec<_> = points.collect();
    Figure::new(info.name, SMALL).axes("time, s", info.unit).band(&points, truth, last - half..last + half)
}

/// Time (s), value and sigma (report units) of a parameter after every segment.
fn values_of(outcome: &Outcome, index: usize) -> Vec<(f64, f64, f64)> {
    let of = |progress: &rins_selfcal::run::telemetry::Progress| {
        let estimate = &progress.estimate;
        let (value, sigma) = (quantity::values(&estimate.errors)[index], quantity::sigmas(&estimate.sigmas)[index]);
        (progress.end_us as f64 * 1e-6, value, sigma)
    };
    let mut values: Vec<_> = outcome.live.iter().map(of).collect();
    // The last point is the final estimate.
    if let Some(end) = values.last().map(|last| last.0) {
        let estimate = outcome.estimate();
        values.push((end, quantity::values(&estimate.errors)[index], quantity::sigmas(&estimate.sigmas)[index]));
    }
    values
}

/// Singular values of the stripped observability matrix of Bai's twelve against scheme time, and their rank. (Bai et
/// al., Figure 6)
pub fn singular_values(scheme: &Scheme, site: &Site, base: &InstrumentErrors<f64>) -> [Drawn; 2] {
    let mut trace = Vec::new();
    along_scheme(scheme, site, base, |time_s, seen| trace.push((time_s, *seen)));
    let line = |number: usize| {
        let value = move |(time_s, seen): &(f64, _)| (*time_s, singular_value(seen, number));
        Curve::new(&format!("{}", number + 1), trace.iter().map(value))
    };
    let lines: Vec<_> = (0..INSTALLATION_STATES).map(line).collect();
    // Two points at the later time draw the rank as a vertical step.
    let steps = trace.windows(2).flat_map(|pair| [(pair[1].0, pair[0].1.rank), (pair[1].0, pair[1].1.rank)]);
    let rank = Curve::new("rank", steps.map(|(time_s, rank)| (time_s, rank as f64)));
    [
        Figure::new("singular values of the stripped observability matrix", WIDE)
            .axes("scheme time, s", "singular value")
            .scaled(Scale::Logarithmic)
            .lines(&lines),
        Figure::new("rank of the matrix, at most 12", (WIDE.0, 200))
            .axes("scheme time, s", "rank")
            .scaled(Scale::From(0.0))
            .lines(&[rank]),
    ]
}

/// Rank of the stripped observability matrix against the number of activated intervals so far, each of them with the
/// duration of the paper, 5 ms.
pub fn relative_rank(ranks: &[usize]) -> Drawn {
    let time_s = |place: usize| place as f64 * INTERVAL_S;
    let steps = ranks.iter().enumerate().flat_map(|(place, rank)| [(time_s(place), *rank), (time_s(place + 1), *rank)]);
    let rank = Curve::new("rank", steps.map(|(time_s, rank)| (time_s, rank as f64)));
    Figure::new("rank of the matrix in relative time", (WIDE.0, 200))
        .axes("relative time, s", "rank")
        .scaled(Scale::From(0.0))
        .lines(&[rank])
}

/// A singular value; values that count as zero are drawn at the axis.
fn singular_value(seen: &crate::plan::observability::Observability<INSTALLATION_STATES>, number: usize) -> f64 {
    const LEAST: f64 = 1e-6;
    if number < seen.rank { seen.singular_values[number].max(LEAST) } else { LEAST }
}

/// Normalized innovations of the last sweep, by segment and channel.
pub fn innovations(outcome: &Outcome) -> Drawn {
    let points = |channel: usize| {
        let of = outcome.innovations.iter().filter_map(move |innovations| {
            Some((f64::from(innovations.segment), f64::from(innovations.normalized[channel]?)))
        });
        Curve::new(CHANNEL_NAMES[channel], of)
    };
    let channels: Vec<_> = (0..CHANNEL_NAMES.len()).map(points).collect();
    Figure::new("normalized innovations by segment", WIDE).points(&channels, &[-3.0, 3.0])
}

/// Correlations of the estimated parameters.
pub fn correlation(outcome: &Outcome) -> Drawn {
    let names: Vec<_> = estimated(outcome).map(|index| PARAMETER_INFO[index].name).collect();
    let covariance = &outcome.covariance;
    let indices: Vec<_> = estimated(outcome).collect();
    let cell = |row: usize, column: usize| {
        let (row, column) = (indices[row], indices[column]);
        let product = covariance[(row, row)] * covariance[(column, column)];
        shade_signed(covariance[(row, column)] / product.sqrt())
    };
    figure((960, 960), |area| super::canvas::cells(area, &names, &names, cell))
}

/// Information of every segment about every parameter: the binary logarithm of sigma before over sigma after.
pub fn contributions(outcome: &Outcome) -> Drawn {
    let names: Vec<_> = estimated(outcome).map(|index| PARAMETER_INFO[index].name).collect();
    let indices: Vec<_> = estimated(outcome).collect();
    let segments: Vec<String> = outcome.live.iter().map(|progress| (progress.segments - 1).to_string()).collect();
    let segments: Vec<&str> = segments.iter().map(String::as_str).collect();
    let sigma = |segment: Option<usize>, index: usize| match segment {
        Some(segment) => outcome.live[segment].estimate.sigmas[index],
        None => outcome.prior_sigmas[index],
    };
    let cell = |row: usize, column: usize| {
        let index = indices[row];
        let bits = (sigma(column.checked_sub(1), index) / sigma(Some(column), index)).log2();
        shade(bits / DARKEST_BITS)
    };
    figure((960, 620), |area| super::canvas::cells(area, &names, &segments, cell))
}

/// Change of every parameter since an earlier calibration, in combined sigmas.
pub fn changes(names: &[&str], changes: &[f64], limit: f64) -> Drawn {
    Figure::new("change since the previous calibration, in combined sigmas", WIDE).bars(
        names,
        changes,
        &[-limit, limit],
    )
}

fn estimated(outcome: &Outcome) -> impl Iterator<Item = usize> + '_ {
    (0..PARAMETER_INFO.len()).filter(|index| outcome.is_estimated(*index))
}
