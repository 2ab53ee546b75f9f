//! One gimbal axis with its servo: its mode, the check of its encoder readings, and its fault detection.
//!
//! ```text
//!            free(drive)                            winding shorted or open, no control
//!           ^      |
//!   release,|      | hold
//!    fault  |      v        at rest                  move_to                 end of profile
//!           +-- braking -----------------> holding -----------> moving ---------------------> holding
//!           |      ^                          |                    |
//!           |      +---------- hold ----------|--------------------+
//!           +---------------------------------+
//! ```
//! A reading is rejected if it is missing, or if it lies farther from the expected angle than the axis can have moved.
//! For up to two control periods the expected angle replaces a rejected reading; after that the encoder is faulty.
//! Braking begins at the current rate of the axis and uses the highest acceleration; its jerk is not limited.

use crate::base::angle::{Angle, rad_to_ticks, ticks_to_rad};
use crate::base::linear::{Real, real};
use crate::base::profile::{MotionLimits, Point, Profile};
use crate::base::units::{ARCSEC, DEG};
use crate::gimbal::servo::{Drive, MotorAndLoad, PERIOD_S, Servo, Setpoint};
use crate::gimbal::{EncoderFault, FaultKind};
use serde::{Deserialize, Serialize};

/// Tolerance for comparing angles of a scheme with limits of the travel, rad. It covers rounding only.
pub const ROUNDING_RAD: f64 = 1e-9;
/// Highest permitted rate limit of an axis, rad/s: the range of the gyros of the IMU.
const HIGHEST_RATE_RAD_S: f64 = 125.0 * DEG;
/// Control periods without a valid reading for which the expected angle is used.
const BRIDGED_PERIODS: u8 = 2;
/// An axis is assumed to move between two readings at no more than this multiple of its rate limit.
const PLAUSIBLE_RATE: f64 = 2.0;
/// An axis at or below this rate is at rest, rad/s.
const REST_RAD_S: f64 = 0.05 * DEG;
/// Time after which a shorted winding should have stopped the axis, us.
const SHORTED_US: u64 = 100_000;
/// Time after which an axis with a faulty encoder is assumed to be at rest, us.
const BLIND_REST_US: u64 = 2_000_000;
/// An axis is stalled if its commanded rate exceeds `STALL_RAD_S`, rad/s, and its own rate is below the fraction
/// `STALL_FRACTION` of it, for `STALL_PERIODS` control periods.
const STALL_RAD_S: f64 = 2.0 * DEG;
const STALL_FRACTION: f64 = 0.25;
const STALL_PERIODS: u8 = 5;
/// Permitted distance beyond the travel limits, rad.
const TRAVEL_MARGIN_RAD: f64 = 0.1 * DEG;

/// Limits of rate, acceleration and travel of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisLimits {
    /// Highest rate that may be commanded, rad/s.
    pub rate_rad_s: f64,
    /// Highest acceleration that may be commanded, rad/s^2. The axis also brakes with it after a fault.
    pub acceleration_rad_s2: f64,
    /// Highest jerk of a move, rad/s^3.
    pub jerk_rad_s3: f64,
    /// Lowest angle, counted over whole turns, rad.
    pub lowest_rad: f64,
    /// Highest angle, counted over whole turns, rad.
    pub highest_rad: f64,
    /// The axis has arrived if its distance from the target is at most this, rad.
    pub arrived_rad: f64,
    /// Distance from the profile above which a following error is reported, rad.
    pub following_error_rad: f64,
    /// Rate in excess of the profile, or against it, above which a runaway is reported, rad/s.
    pub runaway_rad_s: f64,
}

impl AxisLimits {
    /// Whether every number is finite, every limit positive, the rate limit within the range of the gyros, and the
    /// travel not empty.
    pub fn are_valid(&self) -> bool {
        let positive = [
            self.rate_rad_s,
            self.acceleration_rad_s2,
            self.jerk_rad_s3,
            self.arrived_rad,
            self.following_error_rad,
            self.runaway_rad_s,
        ];
        let travel_rad = self.highest_rad - self.lowest_rad;
        let all_positive = positive.iter().chain([&travel_rad]).all(|limit| limit.is_finite() && *limit > 0.0);
        all_positive && self.rate_rad_s <= HIGHEST_RATE_RAD_S
    }
}

impl Default for AxisLimits {
    /// 60 deg/s, 60 deg/s^2, 1000 deg/s^3, travel of two turns in either direction, 2 arcsec, 1 deg, 5 deg/s.
    fn default() -> Self {
        Self {
            rate_rad_s: 60.0 * DEG,
            acceleration_rad_s2: 60.0 * DEG,
            jerk_rad_s3: 1000.0 * DEG,
            lowest_rad: -720.0 * DEG,
            highest_rad: 720.0 * DEG,
            arrived_rad: 2.0 * ARCSEC,
            following_error_rad: DEG,
            runaway_rad_s: 5.0 * DEG,
        }
    }
}

/// Mode of an axis.
#[derive(Clone, Copy, Debug)]
enum Mode<T> {
    /// Not controlled since `since_us`; the bridge receives `drive`.
    Free { drive: Drive<T>, since_us: u64 },
    /// Following the profile of a move.
    Moving { profile: Profile<T>, from_ticks: i64, start_us: u64 },
    /// Braking to rest from the rate `rate_rad_s`.
    Braking { rate_rad_s: T, from_ticks: i64, start_us: u64 },
    /// At rest under control, at the angle `ticks`.
    Holding { ticks: i64 },
}

/// One axis and its state.
#[derive(Clone, Debug)]
pub struct Axis<T: Real> {
    limits: AxisLimits,
    /// Rate below which the axis is at rest, rad/s: not less than one encoder step per control period.
    rest_rad_s: f64,
    servo: Servo<T>,
    mode: Mode<T>,
    /// Angle counted over whole turns, ticks; `None` before the first reading.
    ticks: Option<i64>,
    /// Number of consecutive control periods without a valid reading.
    missing: u8,
    /// Reason of the last rejected reading.
    encoder_fault: EncoderFault,
    /// Number of consecutive control periods in which the axis was stalled.
    stalled: u8,
}

impl<T: Real> Axis<T> {
    /// An axis before the first reading of its encoder. Its winding is shorted.
    pub fn new(limits: &AxisLimits, data: &MotorAndLoad) -> Self {
        Self {
            limits: *limits,
            rest_rad_s: REST_RAD_S.max(data.encoder_step_rad() / PERIOD_S),
            servo: Servo::new(data),
            mode: Mode::Free { drive: Drive::Brake, since_us: 0 },
            ticks: None,
            missing: 0,
            encoder_fault: EncoderFault::Silent,
            stalled: 0,
        }
    }

    /// The same axis with other limits and another motor. The angle and its whole turns are kept; the axis is not
    /// controlled.
    pub fn reconfigured(&self, limits: &AxisLimits, data: &MotorAndLoad) -> Self {
        let fresh = Self::new(limits, data);
        let mode = if self.is_controlled() { fresh.mode } else { self.mode };
        Self { mode, ticks: self.ticks, missing: self.missing, encoder_fault: self.encoder_fault, ..fresh }
    }

    /// Takes an encoder reading, `periods` control periods after the reading before it. The first reading selects the
    /// whole turn: the turn within the travel limits; if several turns fit, the one nearest to zero.
    pub fn observe(&mut self, reading: Result<Angle, EncoderFault>, periods: u64) {
        let Some(before) = self.ticks else {
            self.ticks = reading.ok().map(|angle| self.within_travel(i64::from(angle.ticks() as i32)));
            self.missing = if self.ticks.is_some() { 0 } else { self.missing.saturating_add(1) };
            // The axis was commanded to hold before its first reading: hold it at this angle.
            if let Some(ticks) = self.ticks.filter(|_| self.is_controlled()) {
                self.mode = Mode::Holding { ticks };
            }
            return;
        };
        let periods = periods.clamp(1, 1000);
        let step = self.expected_step();
        // Expected angle after the control periods without a reading.
        let expected = before + step * periods as i64;
        let ticks = match self.check_reading(reading, expected, periods) {
            Ok(ticks) => {
                self.missing = 0;
                ticks
            }
            Err(fault) => {
                (self.missing, self.encoder_fault) = (self.missing.saturating_add(1), fault);
                expected
            }
        };
        self.servo.observe((ticks - before) / periods as i64);
        self.ticks = Some(ticks);
    }

    /// Expected movement in one control period at the current rate, ticks.
    fn expected_step(&self) -> i64 {
        rad_to_ticks((self.servo.rate_rad_s() * real(PERIOD_S)).widened())
    }

    fn check_reading(
        &self,
        reading: Result<Angle, EncoderFault>,
        expected: i64,
        periods: u64,
    ) -> Result<i64, EncoderFault> {
        let off = reading?.since(Angle::from_ticks(expected as u32));
        let unseen_s = (u64::from(self.missing) + periods) as f64 * PERIOD_S;
        let possible = rad_to_ticks(PLAUSIBLE_RATE * self.limits.rate_rad_s * unseen_s);
        if i64::from(off).abs() <= possible {
            Ok(expected + i64::from(off))
        } else {
            Err(EncoderFault::Jump(ticks_to_rad::<f64>(off.into()) as f32))
        }
    }

    /// This angle on a turn within the travel limits. If no turn fits, the angle is returned unchanged.
    fn within_travel(&self, ticks: i64) -> i64 {
        let travel = rad_to_ticks(self.limits.lowest_rad)..=rad_to_ticks(self.limits.highest_rad);
        let turns = [0, -1, 1, -2, 2].map(|turns: i64| ticks + (turns << 32));
        turns.into_iter().find(|turned| travel.contains(turned)).unwrap_or(ticks)
    }

    /// Angle counted over whole turns, rad; zero before the first reading.
    pub fn angle_rad(&self) -> f64 {
        ticks_to_rad(self.ticks.unwrap_or(0))
    }

    /// Whether the encoder has given a valid reading within the last control periods.
    pub fn has_valid_encoder(&self) -> bool {
        self.ticks.is_some() && self.missing <= BRIDGED_PERIODS
    }

    /// Brakes with the highest acceleration and then holds the axis at rest.
    pub fn hold(&mut self, now_us: u64) {
        if matches!(self.mode, Mode::Holding { .. } | Mode::Braking { .. }) {
            return;
        }
        let (rate_rad_s, from_ticks) = (self.servo.rate_rad_s(), self.ticks.unwrap_or(0));
        self.servo.restart(rate_rad_s);
        self.stalled = 0;
        self.mode = Mode::Braking { rate_rad_s, from_ticks, start_us: now_us };
    }

    /// Brakes under control if the axis is controlled and its encoder is valid; otherwise shorts its winding.
    pub fn bring_to_rest(&mut self, now_us: u64) {
        if self.is_controlled() && self.has_valid_encoder() {
            self.hold(now_us);
        } else if self.is_controlled() {
            self.free(Drive::Brake, now_us);
        }
    }

    /// Starts a move from rest to `target_rad`, counted over whole turns.
    pub fn move_to(&mut self, target_rad: f64, limits: &MotionLimits, now_us: u64) {
        let Mode::Holding { ticks: from_ticks } = self.mode else { return };
        let distance = ticks_to_rad(rad_to_ticks(target_rad) - from_ticks);
        self.mode = Mode::Moving { profile: Profile::new(distance, limits), from_ticks, start_us: now_us };
    }

    /// Stops the control. The bridge receives `drive` from now on.
    pub fn free(&mut self, drive: Drive<T>, now_us: u64) {
        if !matches!(self.mode, Mode::Free { drive: before, .. } if before == drive) {
            self.mode = Mode::Free { drive, since_us: now_us };
        }
    }

    /// Opens the winding if the axis still turns 0.1 s after its winding was shorted. In this case the bridge ignores
    /// its commands. If the bridge does work, friction stops the axis nearly as well.
    pub fn open_if_turning(&mut self, now_us: u64) {
        if let Mode::Free { drive: Drive::Brake, since_us } = self.mode
            && self.has_valid_encoder()
            && now_us.saturating_sub(since_us) >= SHORTED_US
            && self.servo.rate_rad_s().abs() > real(self.rest_rad_s)
        {
            self.free(Drive::Off, now_us);
        }
    }

    /// Command to the bridge for the control period that begins.
    pub fn drive(&mut self, now_us: u64) -> Drive<T> {
        self.finish_motion(now_us);
        match (self.mode, self.ticks) {
            (Mode::Free { drive, .. }, _) => drive,
            (_, None) => Drive::Brake,
            (_, Some(ticks)) => Drive::Duty(self.servo.duty(&self.setpoint(now_us), ticks)),
        }
    }

    /// Changes to holding when a move or braking has ended.
    fn finish_motion(&mut self, now_us: u64) {
        let over = match self.mode {
            Mode::Moving { profile, start_us, .. } => since_s::<T>(start_us, now_us) >= profile.duration_s(),
            Mode::Braking { rate_rad_s, start_us, .. } => since_s::<T>(start_us, now_us) >= self.braking_s(rate_rad_s),
            Mode::Free { .. } | Mode::Holding { .. } => false,
        };
        if over {
            self.mode = Mode::Holding { ticks: self.setpoint(now_us).ticks };
        }
    }

    fn braking_s(&self, rate_rad_s: T) -> T {
        rate_rad_s.abs() / real(self.limits.acceleration_rad_s2)
    }

    /// Setpoint at this time.
    fn setpoint(&self, now_us: u64) -> Setpoint<T> {
        match self.mode {
            Mode::Free { .. } => Setpoint::rest(self.ticks.unwrap_or(0)),
            Mode::Holding { ticks } => Setpoint::rest(ticks),
            Mode::Moving { profile, from_ticks, start_us } => {
                setpoint_from(from_ticks, profile.at(since_s(start_us, now_us)))
            }
            Mode::Braking { rate_rad_s, from_ticks, start_us } => {
                let duration_s = self.braking_s(rate_rad_s);
                let left_s = (duration_s - since_s::<T>(start_us, now_us)).max(T::zero());
                let slowing = real::<T>(self.limits.acceleration_rad_s2).copysign(-rate_rad_s);
                let half: T = real(0.5);
                let angle_rad = half * (rate_rad_s * duration_s + slowing * left_s * left_s);
                let acceleration_rad_s2 = if left_s > T::zero() { slowing } else { T::zero() };
                setpoint_from(from_ticks, Point { angle_rad, rate_rad_s: -slowing * left_s, acceleration_rad_s2 })
            }
        }
    }

    /// Fault of the axis, if it is controlled.
    pub fn fault(&mut self, now_us: u64) -> Option<FaultKind> {
        if !self.is_controlled() {
            return None;
        }
        if !self.has_valid_encoder() {
            return Some(FaultKind::Encoder(self.encoder_fault));
        }
        let (rate, commanded) = (self.servo.rate_rad_s().widened(), self.servo.setpoint_rate_rad_s().widened());
        let deviation_rad = self.deviation_rad(now_us);
        self.count_stall(rate, commanded);
        let beyond = self.beyond_travel_rad(rate);
        if excess_rate(rate, commanded) > self.limits.runaway_rad_s {
            Some(FaultKind::Runaway { rate_rad_s: rate as f32, wanted_rad_s: commanded as f32 })
        } else if self.stalled >= STALL_PERIODS {
            Some(FaultKind::Stall { rate_rad_s: rate as f32, wanted_rad_s: commanded as f32 })
        } else if deviation_rad > self.limits.following_error_rad {
            Some(FaultKind::Following { error_rad: deviation_rad as f32 })
        } else {
            beyond.map(|limit_rad| FaultKind::Travel { limit_rad: limit_rad as f32 })
        }
    }

    /// Distance of the axis from its setpoint, rad.
    pub fn deviation_rad(&self, now_us: u64) -> f64 {
        let ticks = self.setpoint(now_us).ticks - self.ticks.unwrap_or(0);
        ticks_to_rad(ticks.saturating_abs())
    }

    fn count_stall(&mut self, rate: f64, commanded: f64) {
        let (rate, commanded) = (absolute(rate), absolute(commanded));
        let stalled = commanded > STALL_RAD_S && rate < STALL_FRACTION * commanded;
        self.stalled = if stalled { self.stalled.saturating_add(1) } else { 0 };
    }

    /// The travel limit that the axis has passed and is moving away from, rad.
    fn beyond_travel_rad(&self, rate_rad_s: f64) -> Option<f64> {
        let (angle_rad, AxisLimits { lowest_rad, highest_rad, .. }) = (self.angle_rad(), self.limits);
        if angle_rad > highest_rad + TRAVEL_MARGIN_RAD && rate_rad_s > self.rest_rad_s {
            Some(highest_rad)
        } else if angle_rad < lowest_rad - TRAVEL_MARGIN_RAD && rate_rad_s < -self.rest_rad_s {
            Some(lowest_rad)
        } else {
            None
        }
    }

    /// Whether `angle_rad` is within the travel limits.
    pub fn reaches(&self, angle_rad: f64) -> bool {
        (self.limits.lowest_rad - ROUNDING_RAD..=self.limits.highest_rad + ROUNDING_RAD).contains(&angle_rad)
    }

    /// The angle within the travel limits that is nearest to `angle_rad`, rad.
    pub fn nearest_within(&self, angle_rad: f64) -> f64 {
        angle_rad.max(self.limits.lowest_rad).min(self.limits.highest_rad)
    }

    /// Limits of a move with this rate and with ramps of this mean acceleration. If the axis' limits of jerk or
    /// acceleration are too low for such ramps, `acceleration_rad_s2` becomes the highest acceleration of the ramps.
    pub fn motion_limits(&self, rate_rad_s: f64, acceleration_rad_s2: f64) -> MotionLimits {
        let jerk_rad_s3 = self.limits.jerk_rad_s3;
        MotionLimits::with_mean_acceleration(rate_rad_s, acceleration_rad_s2, jerk_rad_s3)
            .filter(|ramps| ramps.acceleration_rad_s2 <= self.limits.acceleration_rad_s2)
            .unwrap_or(MotionLimits { rate_rad_s, acceleration_rad_s2, jerk_rad_s3 })
    }

    /// Nominal duration of the current move, us; 0 if the axis is not moving.
    pub fn move_us(&self) -> u64 {
        match self.mode {
            Mode::Moving { profile, .. } => (profile.duration_s().widened() * 1e6) as u64,
            _ => 0,
        }
    }

    /// Whether the axis is controlled.
    pub fn is_controlled(&self) -> bool {
        !matches!(self.mode, Mode::Free { .. })
    }

    /// Whether the axis holds an angle at rest under control.
    pub fn is_holding(&self) -> bool {
        matches!(self.mode, Mode::Holding { .. })
    }

    /// Whether the axis holds its target within the tolerance `arrived_rad`.
    pub fn has_arrived(&self, now_us: u64) -> bool {
        self.is_holding() && self.deviation_rad(now_us) <= self.limits.arrived_rad
    }

    /// Whether the axis is at rest. With a faulty encoder this is assumed after a fixed time.
    pub fn is_at_rest(&self, now_us: u64) -> bool {
        match self.mode {
            Mode::Free { since_us, .. } if !self.has_valid_encoder() => {
                now_us.saturating_sub(since_us) >= BLIND_REST_US
            }
            Mode::Free { .. } | Mode::Holding { .. } => self.servo.rate_rad_s().abs() <= real(self.rest_rad_s),
            Mode::Moving { .. } | Mode::Braking { .. } => false,
        }
    }
}

fn setpoint_from<T: Real>(from_ticks: i64, point: Point<T>) -> Setpoint<T> {
    Setpoint { ticks: from_ticks + rad_to_ticks(point.angle_rad.widened()), point }
}

fn since_s<T: Real>(start_us: u64, now_us: u64) -> T {
    real(now_us.saturating_sub(start_us) as f64 * 1e-6)
}

/// Excess of the rate over the commanded rate, rad/s; against the commanded direction, the whole rate.
fn excess_rate(rate: f64, commanded: f64) -> f64 {
    if rate * commanded >= 0.0 { absolute(rate) - absolute(commanded) } else { absolute(rate) }
}

fn absolute(x: f64) -> f64 {
    crate::base::linear::ComplexField::abs(x)
}
