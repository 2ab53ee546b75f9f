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
//! The encoder is followed by [`Tracker`]. After it was lost, the axis is controlled again from
//! the next command on. Braking begins at the current rate of the axis and uses the highest acceleration; its jerk is not
//! limited.

use crate::base::angle::{Angle, RAD_PER_TICK, rad_to_ticks, ticks_to_rad};
use crate::base::bounds::{ARCSECONDS, Bounded, DEGREES, DEGREES_PER_S, DEGREES_PER_S2, DEGREES_PER_S3, Unit};
use crate::base::linear::{Real, real};
use crate::base::profile::{MotionLimits, Point, Profile};
use crate::base::units::{ARCSEC, DEG};
use crate::gimbal::servo::{Drive, MotorAndLoad, PERIOD_S, Servo, Setpoint};
use crate::gimbal::tracker::{Tracked, Tracker};
use crate::gimbal::travel::{LocateRefusal, Travel, Turn, TurnState};
use crate::gimbal::{EncoderFault, FaultKind, TurnFault};
use core::f64::consts::PI;
use serde::{Deserialize, Serialize};

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
/// Permitted distance beyond the usable range of a moving axis, rad.
const BEYOND_RAD: f64 = 0.1 * DEG;
/// An axis runs away if its rate exceeds its rate limit by this fraction and one encoder step per control period,
/// whatever the configured runaway limit is.
const RUNAWAY_FRACTION: f64 = 0.2;
/// Rate at which somebody may turn an axis by hand while its encoder is lost, rad/s.
const BY_HAND_RAD_S: f64 = 60.0 * DEG;
/// Lowest rate, rad/s, and lowest acceleration, rad/s^2, of a move. They keep the duration of a move finite.
const LOWEST_RAD_S: f64 = 0.01 * DEG;
const LOWEST_RAD_S2: f64 = 0.01 * DEG;

/// Limits of rate, acceleration and travel of one axis. [`AXIS_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisLimits {
    /// Highest rate that may be commanded, rad/s.
    pub rate_rad_s: f64,
    /// Highest acceleration that may be commanded, rad/s^2. The axis also brakes with it after a fault.
    pub acceleration_rad_s2: f64,
    /// Highest jerk of a move, rad/s^3.
    pub jerk_rad_s3: f64,
    /// Travel of the axis, and how its turn is known after power-up.
    pub travel: Travel,
    /// The axis has arrived if its distance from the target is at most this, rad.
    pub arrived_rad: f64,
    /// Distance from the profile above which a following error is reported, rad.
    pub following_error_rad: f64,
    /// Rate in excess of the profile, or against it, above which a runaway is reported, rad/s. A rate that is clearly
    /// above `rate_rad_s` is reported in any case.
    pub runaway_rad_s: f64,
}

/// The permitted range of every number of [`AxisLimits`]. The highest rate is the range of the gyros of the IMU.
/// Following error and runaway limit end a motion that is out of control before the axis has gone far. A continuous
/// travel has no numbers and passes.
pub static AXIS_BOUNDS: [Bounded<AxisLimits>; 10] = [
    Bounded::new("highest rate", DEGREES_PER_S, [1.0, 125.0], |limits| limits.rate_rad_s),
    Bounded::new("highest acceleration", DEGREES_PER_S2, [0.1, 1e4], |limits| limits.acceleration_rad_s2),
    Bounded::new("jerk", DEGREES_PER_S3, [1.0, 1e6], |limits| limits.jerk_rad_s3),
    Bounded::new("tolerance of arrival", ARCSECONDS, [0.01, 3600.0], |limits| limits.arrived_rad),
    Bounded::new("following error", DEGREES, [0.1, 10.0], |limits| limits.following_error_rad),
    Bounded::new("runaway limit", DEGREES_PER_S, [1.0, 20.0], |limits| limits.runaway_rad_s),
    Bounded::new("lowest angle of travel", DEGREES, [-36_000.0, 36_000.0], |limits| limits.travel.ends_rad()[0]),
    Bounded::new("highest angle of travel", DEGREES, [-36_000.0, 36_000.0], |limits| limits.travel.ends_rad()[1]),
    Bounded::new("width of travel", DEGREES, [2.5, 72_000.0], |limits| limits.travel.width_rad().unwrap_or(PI)),
    Bounded::new("width of unique travel", DEGREES, [2.5, 358.0], |limits| {
        limits.travel.width_rad().filter(|_| limits.travel.is_unique()).unwrap_or(PI)
    }),
];

/// An axis and its motor.
pub type AxisAndMotor = (AxisLimits, MotorAndLoad);

/// The permitted range of the numbers that follow from an axis and its motor together. The response time is that of the
/// rate loop: the inverse of [`MotorAndLoad::bandwidth_rad_s`].
///
/// - The motor has acceleration in reserve at the highest rate, against friction and its own voltage. Otherwise the axis
///   could not brake before the end of its travel.
/// - The ramp to the highest rate is long enough for the servo to follow it without overshoot.
/// - The axis moves by several encoder steps in a control period. Otherwise the servo does not see the rate.
/// - Dry friction takes little of the rate in a control period. The servo needs a few control periods to notice that
///   a friction at rest has broken away.
/// - Following error and runaway limit exceed what the rounding of the encoder and the response time of the servo cause
///   in normal operation.
pub static AXIS_AND_MOTOR_BOUNDS: [Bounded<AxisAndMotor>; 8] = [
    at_least(
        "acceleration of the motor at the highest rate",
        1.5,
        "times the highest acceleration",
        |(limits, motor)| motor.acceleration_at_rad_s2(limits.rate_rad_s) / limits.acceleration_rad_s2,
    ),
    at_least("time to the highest rate", 4.0, "response times", |(limits, motor)| {
        limits.rate_rad_s / limits.acceleration_rad_s2 * motor.bandwidth_rad_s()
    }),
    at_least("movement in a control period at the highest rate", 4.0, "encoder steps", |(limits, motor)| {
        limits.rate_rad_s * PERIOD_S / motor.encoder_step_rad()
    }),
    Bounded::new(DRY_FRICTION, Unit::si("times the highest rate"), [0.0, 0.5], |(limits, motor)| {
        motor.coulomb_nm / motor.inertia_kg_m2 / motor.bandwidth_rad_s() / limits.rate_rad_s
    }),
    at_least("following error", 20.0, "encoder steps", |(limits, motor)| {
        limits.following_error_rad / motor.encoder_step_rad()
    }),
    at_least(
        "following error",
        4.0,
        "times the highest acceleration times the response time squared",
        |(limits, motor)| {
            limits.following_error_rad / limits.acceleration_rad_s2 * motor.bandwidth_rad_s() * motor.bandwidth_rad_s()
        },
    ),
    at_least("runaway limit", 1.0, "encoder step per control period", |(limits, motor)| {
        limits.runaway_rad_s * PERIOD_S / motor.encoder_step_rad()
    }),
    at_least("runaway limit", 1.0, "times the highest acceleration times the response time", |(limits, motor)| {
        limits.runaway_rad_s / limits.acceleration_rad_s2 * motor.bandwidth_rad_s()
    }),
];

const DRY_FRICTION: &str = "rate that dry friction takes in a response time";

const fn at_least(
    name: &'static str,
    lowest: f64,
    unit: &'static str,
    value: fn(&AxisAndMotor) -> f64,
) -> Bounded<AxisAndMotor> {
    Bounded::new(name, Unit::si(unit), [lowest, f64::INFINITY], value)
}

impl Default for AxisLimits {
    /// 60 deg/s, 60 deg/s^2, 1000 deg/s^3, continuous travel, 2 arcsec, 1 deg, 5 deg/s.
    fn default() -> Self {
        Self {
            rate_rad_s: 60.0 * DEG,
            acceleration_rad_s2: 60.0 * DEG,
            jerk_rad_s3: 1000.0 * DEG,
            travel: Travel::Continuous,
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
    /// Rate above which an axis runs away unless it brakes, rad/s.
    runaway_rad_s: f64,
    servo: Servo<T>,
    mode: Mode<T>,
    tracker: Tracker,
    turn: Turn,
    /// Number of consecutive control periods in which the axis was stalled.
    stalled: u8,
}

impl<T: Real> Axis<T> {
    /// An axis before the first reading of its encoder. Its winding is shorted.
    pub fn new(limits: &AxisLimits, data: &MotorAndLoad) -> Self {
        let step_rad = data.encoder_step_rad();
        Self {
            limits: *limits,
            rest_rad_s: REST_RAD_S.max(step_rad / PERIOD_S),
            runaway_rad_s: limits.rate_rad_s * (1.0 + RUNAWAY_FRACTION) + step_rad / PERIOD_S,
            servo: Servo::new(data),
            mode: Mode::Free { drive: Drive::Brake, since_us: 0 },
            tracker: Tracker::new(limits.rate_rad_s, step_rad),
            turn: Turn::new(limits.travel),
            stalled: 0,
        }
    }

    /// The same axis with other limits and another motor. The count of the encoder is kept, and its turn if
    /// [`Turn::with_travel`] permits it; the axis is not controlled.
    pub fn reconfigured(&self, limits: &AxisLimits, data: &MotorAndLoad) -> Self {
        let fresh = Self::new(limits, data);
        let mode = if self.is_controlled() { fresh.mode } else { self.mode };
        let tracker = self.tracker.reconfigured(limits.rate_rad_s, data.encoder_step_rad());
        let turn = self.turn.with_travel(limits.travel, tracker.ticks());
        Self { mode, tracker, turn, ..fresh }
    }

    /// Takes an encoder reading, `periods` control periods after the reading before it.
    pub fn observe(&mut self, reading: Result<Angle, EncoderFault>, periods: u64, now_us: u64) {
        match self.tracker.observe(reading, periods, self.expected_step()) {
            Tracked::Moved(step) => self.servo.observe(step),
            Tracked::Lost => self.servo.reset(T::zero()),
            Tracked::Searching => {}
            Tracked::Found { step, unseen_s } => self.found(step, unseen_s, now_us),
        }
        if let Some(ticks) = self.tracker.ticks() {
            self.turn.search(ticks);
        }
    }

    /// The encoder was found after `unseen_s` without it. A command to hold that was given meanwhile is carried out from
    /// here on.
    fn found(&mut self, step: f64, unseen_s: f64, now_us: u64) {
        self.servo.reset(real(step * (RAD_PER_TICK / PERIOD_S)));
        if unseen_s * BY_HAND_RAD_S.max(self.limits.rate_rad_s) > PI {
            self.turn.forget();
        }
        if self.is_controlled() {
            self.brake(now_us);
        }
    }

    /// Expected movement in one control period at the current rate, ticks.
    fn expected_step(&self) -> i64 {
        rad_to_ticks((self.servo.rate_rad_s() * real(PERIOD_S)).widened())
    }

    /// Angle counted over whole turns, rad; within one turn if the turn is not known. Zero before the first reading.
    pub fn angle_rad(&self) -> f64 {
        ticks_to_rad(self.tracker.last_ticks() + self.turn.offset_ticks())
    }

    /// Angle counted over whole turns, rad; `None` unless the encoder works and the turn is known.
    pub fn known_angle_rad(&self) -> Option<f64> {
        (self.turn_state() == TurnState::Known).then(|| self.angle_rad())
    }

    /// What is known of the turn on which the axis stands.
    pub fn turn_state(&self) -> TurnState {
        self.turn.state(self.tracker.ticks())
    }

    /// Takes the turn that is nearest to `angle_rad`: see [`Turn::locate`].
    ///
    /// # Errors
    /// The axis is moving under control, its encoder does not work, or [`Turn::locate`] refuses the angle.
    pub fn locate(&mut self, angle_rad: f64, tolerance_rad: f64) -> Result<(), LocateRefusal> {
        let ticks = self.tracker.ticks().ok_or(LocateRefusal::Searching)?;
        if matches!(self.mode, Mode::Moving { .. } | Mode::Braking { .. }) {
            return Err(LocateRefusal::Moving);
        }
        self.turn.locate(ticks, angle_rad, tolerance_rad)
    }

    /// Whether the encoder has given a valid reading within the last control periods.
    pub fn has_valid_encoder(&self) -> bool {
        self.tracker.ticks().is_some()
    }

    /// Brakes with the highest acceleration and then holds the axis at rest.
    pub fn hold(&mut self, now_us: u64) {
        if matches!(self.mode, Mode::Holding { .. } | Mode::Braking { .. }) {
            return;
        }
        self.brake(now_us);
    }

    fn brake(&mut self, now_us: u64) {
        let (rate_rad_s, from_ticks) = (self.braking_rate_rad_s(), self.tracker.last_ticks());
        self.servo.restart(rate_rad_s);
        self.stalled = 0;
        self.mode = Mode::Braking { rate_rad_s, from_ticks, start_us: now_us };
    }

    /// Rate at which braking begins: that of the axis. In a move it is not above that of the profile, so that rounding by
    /// a coarse encoder does not make the way longer than the way that the move has left.
    fn braking_rate_rad_s(&self) -> T {
        let (rate, profile) = (self.servo.rate_rad_s(), self.servo.setpoint_rate_rad_s());
        let is_above = rate * profile > T::zero() && rate.abs() > profile.abs();
        if is_above && matches!(self.mode, Mode::Moving { .. }) { profile } else { rate }
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
        let target_ticks = rad_to_ticks(target_rad) - self.turn.offset_ticks();
        let distance = ticks_to_rad(target_ticks - from_ticks);
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

    /// Command to the bridge for the control period that begins. The winding is shorted until the encoder is found.
    ///
    /// # Errors
    /// [`FaultKind::NotFinite`]: the servo has no finite duty. The axis is then no longer controlled, and its winding is
    /// shorted.
    pub fn drive(&mut self, now_us: u64) -> Result<Drive<T>, FaultKind> {
        if let Mode::Free { drive, .. } = self.mode {
            return Ok(drive);
        }
        let Some(ticks) = self.tracker.ticks() else { return Ok(Drive::Brake) };
        self.finish_motion(now_us);
        let Some(duty) = self.servo.duty(&self.setpoint(now_us), ticks) else {
            self.servo.reset(T::zero());
            self.free(Drive::Brake, now_us);
            return Err(FaultKind::NotFinite);
        };
        Ok(Drive::Duty(duty))
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
            Mode::Free { .. } => Setpoint::rest(self.tracker.last_ticks()),
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
            return self.tracker.fault().map(FaultKind::Encoder);
        }
        let (rate, commanded) = (self.servo.rate_rad_s().widened(), self.servo.setpoint_rate_rad_s().widened());
        let deviation_rad = self.deviation_rad(now_us);
        self.count_stall(rate, commanded);
        let beyond = self.beyond_travel_rad(rate);
        let too_fast = !matches!(self.mode, Mode::Braking { .. }) && absolute(rate) > self.runaway_rad_s;
        if too_fast || excess_rate(rate, commanded) > self.limits.runaway_rad_s {
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
        let ticks = self.setpoint(now_us).ticks - self.tracker.last_ticks();
        ticks_to_rad(ticks.saturating_abs())
    }

    fn count_stall(&mut self, rate: f64, commanded: f64) {
        let (rate, commanded) = (absolute(rate), absolute(commanded));
        let stalled = commanded > STALL_RAD_S && rate < STALL_FRACTION * commanded;
        self.stalled = if stalled { self.stalled.saturating_add(1) } else { 0 };
    }

    /// The end of the usable range that the axis has passed and is moving away from, rad.
    fn beyond_travel_rad(&self, rate_rad_s: f64) -> Option<f64> {
        let (lowest_rad, highest_rad) = self.turn.known_usable_rad().into_inner();
        let angle_rad = self.angle_rad();
        if angle_rad > highest_rad + BEYOND_RAD && rate_rad_s > self.rest_rad_s {
            Some(highest_rad)
        } else if angle_rad < lowest_rad - BEYOND_RAD && rate_rad_s < -self.rest_rad_s {
            Some(lowest_rad)
        } else {
            None
        }
    }

    /// Why the axis does not move to `target_rad`, if it does not. An axis whose encoder has not been found is not
    /// refused: the move waits for it.
    pub fn refusal(&self, target_rad: f64) -> Option<FaultKind> {
        let travel = self.turn.travel();
        match self.turn_state() {
            TurnState::Unknown => Some(FaultKind::Turn(TurnFault::Unknown)),
            TurnState::Outside => Some(FaultKind::Turn(TurnFault::Outside)),
            TurnState::Searching | TurnState::Known if travel.permits(target_rad) => None,
            TurnState::Searching | TurnState::Known => {
                Some(FaultKind::Travel { limit_rad: travel.nearest_rad(target_rad) as f32 })
            }
        }
    }

    /// Limits of a move with this rate and with ramps of this mean acceleration, both lowered to the limits of the axis.
    /// If the axis' limits of jerk or acceleration are too low for such ramps, `acceleration_rad_s2` becomes the highest
    /// acceleration of the ramps.
    pub fn motion_limits(&self, rate_rad_s: f64, acceleration_rad_s2: f64) -> MotionLimits {
        let jerk_rad_s3 = self.limits.jerk_rad_s3;
        let rate_rad_s = rate_rad_s.max(LOWEST_RAD_S).min(self.limits.rate_rad_s);
        let acceleration_rad_s2 = acceleration_rad_s2.max(LOWEST_RAD_S2).min(self.limits.acceleration_rad_s2);
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
