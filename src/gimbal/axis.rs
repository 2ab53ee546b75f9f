//! One gimbal axis under its servo: what it shall do, whether its encoder is believed, and whether it does it.
//!
//! ```text
//!            free(winding)                          the winding shorted or open; nothing is controlled
//!           ^      |
//!   release,|      | hold
//!    fault  |      v        at rest                  move_to                 profile over
//!           +-- braking -----------------> holding -----------> moving ---------------------> holding
//!           |      ^                          |                    |
//!           |      +---------- hold ----------|--------------------+
//!           +---------------------------------+
//! ```
//! A reading that is missing, or farther from where the axis should be than it can have gone, is replaced by where it
//! should be, for two periods; then the encoder is not believed. A stop begins at the axis' own rate and goes with the
//! highest acceleration; its jerk is not limited.

use crate::base::angle::{Angle, rad_to_ticks, ticks_to_rad};
use crate::base::linear::{Real, real};
use crate::base::profile::{MotionLimits, Point, Profile};
use crate::base::units::{ARCSEC, DEG};
use crate::gimbal::servo::{Drive, MotorAndLoad, PERIOD_S, Servo, Setpoint};
use crate::gimbal::{EncoderFault, FaultKind};
use serde::{Deserialize, Serialize};

/// What angles of a scheme and limits of the travel may differ by where they are meant to be the same, rad.
pub const ROUNDING_RAD: f64 = 1e-9;
/// Highest rate that an axis may have, rad/s: the range of the IMU's gyros.
const HIGHEST_RATE_RAD_S: f64 = 125.0 * DEG;
/// Periods without a believable reading that are bridged.
const BRIDGED_PERIODS: u8 = 2;
/// Rate, of the highest, at which an axis is taken to go at most between two readings.
const PLAUSIBLE_RATE: f64 = 2.0;
/// Rate below which an axis is at rest, rad/s.
const REST_RAD_S: f64 = 0.05 * DEG;
/// Time after which a shorted winding should have shown its effect, us.
const SHORTED_US: u64 = 100_000;
/// Time after which an axis whose encoder is not believed is taken to be at rest, us.
const BLIND_REST_US: u64 = 2_000_000;
/// An axis stalls if it should go at this rate, rad/s, and goes at less than a quarter of it, for so many periods.
const STALL_RAD_S: f64 = 2.0 * DEG;
const STALL_PART: f64 = 0.25;
const STALL_PERIODS: u8 = 5;
/// How far beyond its travel an axis may be, rad.
const TRAVEL_MARGIN_RAD: f64 = 0.1 * DEG;

/// Rate, acceleration and travel of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisLimits {
    /// Highest rate that may be commanded, rad/s.
    pub rate_rad_s: f64,
    /// Highest acceleration that may be commanded, rad/s^2; with it the axis is brought to rest when something fails.
    pub acceleration_rad_s2: f64,
    /// Highest jerk of a move, rad/s^3.
    pub jerk_rad_s3: f64,
    /// Lowest angle, counted over whole turns, rad.
    pub lowest_rad: f64,
    /// Highest angle, counted over whole turns, rad.
    pub highest_rad: f64,
    /// Distance from the target within which the axis has arrived, rad.
    pub arrived_rad: f64,
    /// Distance from the profile beyond which the axis does not follow, rad.
    pub following_error_rad: f64,
    /// Rate beyond the profile's, or against it, at which the axis runs away, rad/s.
    pub runaway_rad_s: f64,
}

impl AxisLimits {
    /// Whether every number is finite, every limit positive, the rate within the gyros' range, and the travel not empty.
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
    /// 60 deg/s, 60 deg/s^2, 1000 deg/s^3, two turns either way, 2 arcsec, 1 deg, 5 deg/s.
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

/// What an axis is doing.
#[derive(Clone, Copy, Debug)]
enum Mode<T> {
    /// Not controlled since this time, us: its bridge is told this.
    Free { drive: Drive<T>, since_us: u64 },
    /// On its way.
    Moving { profile: Profile<T>, from_ticks: i64, start_us: u64 },
    /// Coming to rest from this rate, rad/s.
    Braking { rate_rad_s: T, from_ticks: i64, start_us: u64 },
    /// Standing.
    Holding { ticks: i64 },
}

/// State of one axis.
#[derive(Clone, Debug)]
pub struct Axis<T: Real> {
    limits: AxisLimits,
    /// Rate below which it is at rest: no less than what the encoder can tell from rest.
    rest_rad_s: f64,
    servo: Servo<T>,
    mode: Mode<T>,
    /// Counted over whole turns; `None` before the first reading.
    ticks: Option<i64>,
    /// Periods without a believable reading, and why.
    missing: u8,
    encoder_fault: EncoderFault,
    /// Periods in which it stood where it should have turned.
    stalled: u8,
}

impl<T: Real> Axis<T> {
    /// An axis whose encoder has not been read yet; its winding is shorted.
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

    /// The same axis, with other limits and another motor; it is where it was, on the same turn, and not controlled.
    pub fn reconfigured(&self, limits: &AxisLimits, data: &MotorAndLoad) -> Self {
        let fresh = Self::new(limits, data);
        let mode = if self.is_controlled() { fresh.mode } else { self.mode };
        Self { mode, ticks: self.ticks, missing: self.missing, encoder_fault: self.encoder_fault, ..fresh }
    }

    /// Takes in an encoder reading, `periods` after the one before. The first decides the turn: the one within the travel,
    /// of several the one nearest to zero.
    pub fn observe(&mut self, reading: Result<Angle, EncoderFault>, periods: u64) {
        let Some(before) = self.ticks else {
            self.ticks = reading.ok().map(|angle| self.within_travel(i64::from(angle.ticks() as i32)));
            self.missing = if self.ticks.is_some() { 0 } else { self.missing.saturating_add(1) };
            // Told to stand before anybody knew where: there.
            if let Some(ticks) = self.ticks.filter(|_| self.is_controlled()) {
                self.mode = Mode::Holding { ticks };
            }
            return;
        };
        let periods = periods.clamp(1, 1000);
        let step = self.expected_step();
        // Periods in which nobody looked.
        let expected = before + step * periods as i64;
        let ticks = match self.believed(reading, expected, periods) {
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

    /// How far it goes in a period at its rate, ticks.
    fn expected_step(&self) -> i64 {
        rad_to_ticks((self.servo.rate_rad_s() * real(PERIOD_S)).widened())
    }

    fn believed(&self, reading: Result<Angle, EncoderFault>, expected: i64, periods: u64) -> Result<i64, EncoderFault> {
        let off = reading?.since(Angle::from_ticks(expected as u32));
        let unseen_s = (u64::from(self.missing) + periods) as f64 * PERIOD_S;
        let possible = rad_to_ticks(PLAUSIBLE_RATE * self.limits.rate_rad_s * unseen_s);
        if i64::from(off).abs() <= possible {
            Ok(expected + i64::from(off))
        } else {
            Err(EncoderFault::Jump(ticks_to_rad::<f64>(off.into()) as f32))
        }
    }

    /// This angle on the turn that is within the travel; as it is where none is.
    fn within_travel(&self, ticks: i64) -> i64 {
        let travel = rad_to_ticks(self.limits.lowest_rad)..=rad_to_ticks(self.limits.highest_rad);
        let turns = [0, -1, 1, -2, 2].map(|turns: i64| ticks + (turns << 32));
        turns.into_iter().find(|turned| travel.contains(turned)).unwrap_or(ticks)
    }

    /// Angle counted over whole turns, rad; zero before the first reading.
    pub fn angle_rad(&self) -> f64 {
        ticks_to_rad(self.ticks.unwrap_or(0))
    }

    /// Whether the encoder is believed.
    pub fn is_seen(&self) -> bool {
        self.ticks.is_some() && self.missing <= BRIDGED_PERIODS
    }

    /// Comes to rest as fast as it may, and stays there.
    pub fn hold(&mut self, now_us: u64) {
        if matches!(self.mode, Mode::Holding { .. } | Mode::Braking { .. }) {
            return;
        }
        let (rate_rad_s, from_ticks) = (self.servo.rate_rad_s(), self.ticks.unwrap_or(0));
        self.servo.restart(rate_rad_s);
        self.stalled = 0;
        self.mode = Mode::Braking { rate_rad_s, from_ticks, start_us: now_us };
    }

    /// Comes to rest under control, if it is controlled and its encoder is believed; else its winding is shorted.
    pub fn stop(&mut self, now_us: u64) {
        if self.is_controlled() && self.is_seen() {
            self.hold(now_us);
        } else if self.is_controlled() {
            self.free(Drive::Brake, now_us);
        }
    }

    /// Starts a move from where it stands to `target_rad`, counted over whole turns.
    pub fn move_to(&mut self, target_rad: f64, limits: &MotionLimits, now_us: u64) {
        let Mode::Holding { ticks: from_ticks } = self.mode else { return };
        let distance = ticks_to_rad(rad_to_ticks(target_rad) - from_ticks);
        self.mode = Mode::Moving { profile: Profile::new(distance, limits), from_ticks, start_us: now_us };
    }

    /// Gives up control: the bridge is told this from here on.
    pub fn free(&mut self, drive: Drive<T>, now_us: u64) {
        if !matches!(self.mode, Mode::Free { drive: before, .. } if before == drive) {
            self.mode = Mode::Free { drive, since_us: now_us };
        }
    }

    /// Opens the winding if the axis still turns a while after it was shorted: its bridge does not obey, and if it does,
    /// friction stops the axis nearly as well.
    pub fn open_if_it_turns(&mut self, now_us: u64) {
        if let Mode::Free { drive: Drive::Brake, since_us } = self.mode
            && self.is_seen()
            && now_us.saturating_sub(since_us) >= SHORTED_US
            && self.servo.rate_rad_s().abs() > real(self.rest_rad_s)
        {
            self.free(Drive::Off, now_us);
        }
    }

    /// What the bridge is told for the period that begins.
    pub fn drive(&mut self, now_us: u64) -> Drive<T> {
        self.come_to_rest(now_us);
        match (self.mode, self.ticks) {
            (Mode::Free { drive, .. }, _) => drive,
            (_, None) => Drive::Brake,
            (_, Some(ticks)) => Drive::Duty(self.servo.duty(&self.wanted(now_us), ticks)),
        }
    }

    /// A motion that is over is rest.
    fn come_to_rest(&mut self, now_us: u64) {
        let over = match self.mode {
            Mode::Moving { profile, start_us, .. } => since_s::<T>(start_us, now_us) >= profile.duration_s(),
            Mode::Braking { rate_rad_s, start_us, .. } => since_s::<T>(start_us, now_us) >= self.braking_s(rate_rad_s),
            Mode::Free { .. } | Mode::Holding { .. } => false,
        };
        if over {
            self.mode = Mode::Holding { ticks: self.wanted(now_us).ticks };
        }
    }

    fn braking_s(&self, rate_rad_s: T) -> T {
        rate_rad_s.abs() / real(self.limits.acceleration_rad_s2)
    }

    /// Where it should be now.
    fn wanted(&self, now_us: u64) -> Setpoint<T> {
        match self.mode {
            Mode::Free { .. } => Setpoint::rest(self.ticks.unwrap_or(0)),
            Mode::Holding { ticks } => Setpoint::rest(ticks),
            Mode::Moving { profile, from_ticks, start_us } => {
                wanted_from(from_ticks, profile.at(since_s(start_us, now_us)))
            }
            Mode::Braking { rate_rad_s, from_ticks, start_us } => {
                let duration_s = self.braking_s(rate_rad_s);
                let left_s = (duration_s - since_s::<T>(start_us, now_us)).max(T::zero());
                let slowing = real::<T>(self.limits.acceleration_rad_s2).copysign(-rate_rad_s);
                let half: T = real(0.5);
                let angle_rad = half * (rate_rad_s * duration_s + slowing * left_s * left_s);
                let acceleration_rad_s2 = if left_s > T::zero() { slowing } else { T::zero() };
                wanted_from(from_ticks, Point { angle_rad, rate_rad_s: -slowing * left_s, acceleration_rad_s2 })
            }
        }
    }

    /// What is wrong with the axis, if it is controlled.
    pub fn fault(&mut self, now_us: u64) -> Option<FaultKind> {
        if !self.is_controlled() {
            return None;
        }
        if !self.is_seen() {
            return Some(FaultKind::Encoder(self.encoder_fault));
        }
        let (rate, wanted) = (self.servo.rate_rad_s().widened(), self.servo.wanted_rate_rad_s().widened());
        let off_rad = self.off_rad(now_us);
        self.note_stall(rate, wanted);
        let beyond = self.beyond_travel_rad(rate);
        if too_fast(rate, wanted) > self.limits.runaway_rad_s {
            Some(FaultKind::Runaway { rate_rad_s: rate as f32, wanted_rad_s: wanted as f32 })
        } else if self.stalled >= STALL_PERIODS {
            Some(FaultKind::Stall { rate_rad_s: rate as f32, wanted_rad_s: wanted as f32 })
        } else if off_rad > self.limits.following_error_rad {
            Some(FaultKind::Following { error_rad: off_rad as f32 })
        } else {
            beyond.map(|limit_rad| FaultKind::Travel { limit_rad: limit_rad as f32 })
        }
    }

    /// Distance from where it should be, rad.
    pub fn off_rad(&self, now_us: u64) -> f64 {
        let ticks = self.wanted(now_us).ticks - self.ticks.unwrap_or(0);
        ticks_to_rad(ticks.saturating_abs())
    }

    fn note_stall(&mut self, rate: f64, wanted: f64) {
        let (rate, wanted) = (absolute(rate), absolute(wanted));
        let stands = wanted > STALL_RAD_S && rate < STALL_PART * wanted;
        self.stalled = if stands { self.stalled.saturating_add(1) } else { 0 };
    }

    /// The end of the travel that it is beyond, and leaving behind, rad.
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

    /// Whether an angle, rad, is within the travel.
    pub fn reaches(&self, angle_rad: f64) -> bool {
        (self.limits.lowest_rad - ROUNDING_RAD..=self.limits.highest_rad + ROUNDING_RAD).contains(&angle_rad)
    }

    /// The angle within the travel that is nearest to this one, rad.
    pub fn nearest_within(&self, angle_rad: f64) -> f64 {
        angle_rad.max(self.limits.lowest_rad).min(self.limits.highest_rad)
    }

    /// Limits of a move at this rate and with ramps of this mean acceleration; where jerk or acceleration of the axis are
    /// too low for such ramps, the highest acceleration is that.
    pub fn motion_limits(&self, rate_rad_s: f64, acceleration_rad_s2: f64) -> MotionLimits {
        let jerk_rad_s3 = self.limits.jerk_rad_s3;
        MotionLimits::with_mean_acceleration(rate_rad_s, acceleration_rad_s2, jerk_rad_s3)
            .filter(|ramps| ramps.acceleration_rad_s2 <= self.limits.acceleration_rad_s2)
            .unwrap_or(MotionLimits { rate_rad_s, acceleration_rad_s2, jerk_rad_s3 })
    }

    /// Nominal duration of the move under way, us.
    pub fn move_us(&self) -> u64 {
        match self.mode {
            Mode::Moving { profile, .. } => (profile.duration_s().widened() * 1e6) as u64,
            _ => 0,
        }
    }

    /// Whether its motor is driven.
    pub fn is_controlled(&self) -> bool {
        !matches!(self.mode, Mode::Free { .. })
    }

    /// Whether it is controlled and should stand.
    pub fn is_holding(&self) -> bool {
        matches!(self.mode, Mode::Holding { .. })
    }

    /// Whether it stands within the tolerance of where it shall.
    pub fn has_arrived(&self, now_us: u64) -> bool {
        self.is_holding() && self.off_rad(now_us) <= self.limits.arrived_rad
    }

    /// Whether it has come to rest, as far as can be known.
    pub fn is_at_rest(&self, now_us: u64) -> bool {
        match self.mode {
            Mode::Free { since_us, .. } if !self.is_seen() => now_us.saturating_sub(since_us) >= BLIND_REST_US,
            Mode::Free { .. } | Mode::Holding { .. } => self.servo.rate_rad_s().abs() <= real(self.rest_rad_s),
            Mode::Moving { .. } | Mode::Braking { .. } => false,
        }
    }
}

fn wanted_from<T: Real>(from_ticks: i64, point: Point<T>) -> Setpoint<T> {
    Setpoint { ticks: from_ticks + rad_to_ticks(point.angle_rad.widened()), point }
}

fn since_s<T: Real>(start_us: u64, now_us: u64) -> T {
    real(now_us.saturating_sub(start_us) as f64 * 1e-6)
}

/// How much faster than wanted it goes, or how fast the other way, rad/s.
fn too_fast(rate: f64, wanted: f64) -> f64 {
    if rate * wanted >= 0.0 { absolute(rate) - absolute(wanted) } else { absolute(rate) }
}

fn absolute(x: f64) -> f64 {
    crate::base::linear::ComplexField::abs(x)
}
