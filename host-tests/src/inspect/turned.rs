//! The scheme that the stops and moves of a log follow.
//!
//! Here a log is a list of stops. A stop has the angles of both axes, counted over whole turns, and a duration.

use rins_selfcal::base::angle::ticks_to_rad;
use rins_selfcal::base::units::DEG;
use rins_selfcal::scheme::library::LIBRARY;
use rins_selfcal::scheme::{Leg, MAX_LEGS, Scheme};
use rins_selfcal::segment::{GUARD_S, Segment, SegmentKind};
use serde::Serialize;

/// Largest difference between the angles of a log and of the scheme that it follows, rad.
const SAME_RAD: f64 = 0.5 * DEG;
/// Most periods with which a library scheme is compared.
const PERIODS: u8 = 4;
/// The duration of a stop is rounded to a tenth of a second.
const TENTHS: f64 = 10.0;

/// A scheme of the library, compared with the log's scheme.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Likeness {
    /// Name of the library scheme.
    pub name: &'static str,
    /// Number of periods.
    pub periods: u8,
    /// Largest difference of an angle at a stop, deg.
    pub apart_deg: f64,
    /// Mean duration of the stops after the first, of the log and of the library scheme, s.
    pub stops_s: [f64; 2],
}

/// A stop at these angles (outer, inner), with angles and duration rounded to the values that were probably commanded.
pub fn stop(angles_rad: [f64; 2], stop_s: f64) -> Leg {
    let [outer_rad, inner_rad] = angles_rad.map(rounded);
    Leg { outer_rad, inner_rad, stop_s: (stop_s * TENTHS).round() / TENTHS }
}

/// All stops of a log.
pub fn stops(segments: &[Segment<f64>]) -> Vec<Leg> {
    let mut at = [0.0; 2];
    let mut stops = Vec::new();
    for segment in segments {
        match segment.kind() {
            SegmentKind::Move => at = [at[0] + segment.turned.outer, at[1] + segment.turned.inner],
            SegmentKind::Stop => {
                if stops.is_empty() {
                    at = [segment.outer, segment.inner].map(|angle| ticks_to_rad(i64::from(angle.ticks() as i32)));
                }
                stops.push(stop(at, segment.duration_s() + GUARD_S));
            }
        }
    }
    stops
}

/// Rounds an angle to a whole degree if it is within 0.05 deg of it, else to a thousandth of a degree.
fn rounded(angle_rad: f64) -> f64 {
    let degrees = angle_rad / DEG;
    let near = if (degrees - degrees.round()).abs() < 0.05 { degrees.round() } else { (degrees * 1e3).round() / 1e3 };
    near * DEG
}

/// The scheme with these stops and with this rate, rad/s, and acceleration, rad/s^2, of its moves. `None` if the log
/// does not start at (0, 0), is too long for a scheme, or has no moves.
pub fn scheme(stops: &[Leg], pace: [f64; 2]) -> Option<Scheme> {
    let first = stops.first().filter(|first| (first.outer_rad, first.inner_rad) == (0.0, 0.0))?;
    if stops.len() > MAX_LEGS + 1 {
        return None;
    }
    let two_digits = |rate: f64| format!("{:.1e}", rate / DEG).parse().unwrap_or(rate / DEG) * DEG;
    let mut scheme = Scheme {
        name: "seen".try_into().ok()?,
        rate_rad_s: two_digits(pace[0]),
        acceleration_rad_s2: two_digits(pace[1]),
        first_stop_s: first.stop_s,
        legs: stops[1..].iter().copied().collect(),
        periods: 1,
    };
    if let Some(likeness) = nearest(stops).filter(|likeness| likeness.apart_deg * DEG < SAME_RAD) {
        scheme.name = likeness.name.try_into().ok()?;
    }
    scheme.check().is_ok().then_some(scheme)
}

/// The library scheme with the same number of moves whose angles differ least.
pub fn nearest(found: &[Leg]) -> Option<Likeness> {
    let first = *found.first()?;
    let likeness = |name: &'static str, periods: u8| {
        let scheme = Scheme { periods, ..Scheme::named(name)? };
        let legs: Vec<Leg> = (0..).map_while(|index| scheme.leg(index)).collect();
        if legs.len() + 1 != found.len() || scheme.check().is_err() {
            return None;
        }
        let apart = |(leg, stop): (&Leg, &Leg)| {
            let turns =
                [stop.outer_rad - first.outer_rad - leg.outer_rad, stop.inner_rad - first.inner_rad - leg.inner_rad];
            turns[0].abs().max(turns[1].abs())
        };
        let apart_rad = legs.iter().zip(&found[1..]).map(apart).fold(0.0, f64::max);
        let mean = |legs: &[Leg]| legs.iter().map(|leg| leg.stop_s).sum::<f64>() / legs.len() as f64;
        Some(Likeness { name, periods, apart_deg: apart_rad / DEG, stops_s: [mean(&found[1..]), mean(&legs)] })
    };
    let all = LIBRARY.iter().flat_map(|entry| (1..=PERIODS).filter_map(move |periods| likeness(entry.name, periods)));
    all.min_by(|a, b| a.apart_deg.total_cmp(&b.apart_deg))
}
