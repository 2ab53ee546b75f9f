//! Limits of the axes.

use super::value::number_in;
use crate::plan::Travel;
use clap::Args;
use rins_selfcal::base::bounds::first_outside;
use rins_selfcal::base::units::DEG;
use rins_selfcal::gimbal;
use rins_selfcal::gimbal::TurnSource;
use rins_selfcal::gimbal::axis::{AXIS_BOUNDS, AxisLimits};

/// Limits of the axes.
#[derive(Debug, Args)]
pub struct AxisArguments {
    /// Usable range of the outer and the inner axis, deg; none is for axes with slip rings [default: none]
    #[arg(long, value_name = "LOW..HIGH,LOW..HIGH", value_parser = travel, allow_hyphen_values = true)]
    limits: Option<TravelArgument>,
    /// Highest rate of the axes, deg/s [default: 60]
    #[arg(long, value_name = "DEG_S", value_parser = pace, allow_negative_numbers = true)]
    axis_rate: Option<f64>,
    /// Highest acceleration of the axes, deg/s^2 [default: 60]
    #[arg(long, value_name = "DEG_S2", value_parser = pace, allow_negative_numbers = true)]
    acceleration: Option<f64>,
}

impl AxisArguments {
    pub fn axes(&self) -> [AxisLimits; 2] {
        let travel = self.limits.and_then(|limits| limits.0).map(|both| both.map(around));
        travel.unwrap_or_default().map(|travel| self.with_travel(travel))
    }

    fn with_travel(&self, travel: gimbal::Travel) -> AxisLimits {
        let usual = AxisLimits::default();
        AxisLimits {
            rate_rad_s: self.axis_rate.map_or(usual.rate_rad_s, |rate| rate * DEG),
            acceleration_rad_s2: self.acceleration.map_or(usual.acceleration_rad_s2, |limit| limit * DEG),
            travel,
            ..usual
        }
    }
}

/// The travel with this usable range. One turn of each angle is within it if it is narrow enough for that.
fn around(Travel { lowest_rad, highest_rad }: Travel) -> gimbal::Travel {
    let with = |turn| gimbal::Travel::around(lowest_rad, highest_rad, turn);
    let unique = AxisLimits { travel: with(TurnSource::Unique), ..AxisLimits::default() };
    with(if first_outside(&AXIS_BOUNDS, &unique).is_none() { TurnSource::Unique } else { TurnSource::Stored })
}

/// Travel of both axes, or no limits.
#[derive(Clone, Copy, Debug)]
pub struct TravelArgument(pub Option<[Travel; 2]>);

pub fn travel(text: &str) -> Result<TravelArgument, String> {
    if text == "none" {
        return Ok(TravelArgument(None));
    }
    let axis = |text: &str| {
        let (low, high) = text.split_once("..")?;
        let (low, high) = (low.trim().parse::<f64>().ok()?, high.trim().parse::<f64>().ok()?);
        let inside = (-36_000.0..=0.0).contains(&low) && (0.0..=36_000.0).contains(&high);
        inside.then_some(Travel { lowest_rad: low * DEG, highest_rad: high * DEG })
    };
    let both = text.split_once(',').and_then(|(outer, inner)| Some([axis(outer)?, axis(inner)?]));
    both.map(|both| TravelArgument(Some(both)))
        .ok_or_else(|| "not LOW..HIGH,LOW..HIGH in deg with 0 inside both ranges".into())
}

pub fn pace(text: &str) -> Result<f64, String> {
    number_in(text, 0.1, 1e4)
}
