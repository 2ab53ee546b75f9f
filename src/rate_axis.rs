//! One gimbal axis on a drive that takes rates: a trapezoidal profile, and a loop that holds the encoder to it.
//!
//! ```text
//! rate command = profile rate at the end of the interval + gain * (profile angle - encoder angle)
//! ```
//! The profile's rate is fed forward, so the loop has only the drive's lag and the encoder's error to take out.

use crate::angle::{Angle, rad_to_ticks, ticks_to_rad};
use crate::axis::AxisLimits;
use crate::gimbal::{BridgeFault, Fault, FaultKind, GimbalStatus, MotionCommand};
use crate::linear::{ComplexField, Real, real};
use crate::profile::Profile;
use crate::sample::RawSample;

/// Gain of the position loop, 1/s: a time constant of 0.1 s, twenty sample intervals at 200 Hz.
const POSITION_GAIN: f64 = 10.0;
/// Sample intervals from a sample's time, the middle of its interval, to the end of the next interval, by when the drive
/// reaches the commanded rate.
const LEAD_INTERVALS: f64 = 1.5;
/// Commands in a row that a drive may fail to take.
const DRIVE_FAILURES: u8 = 10;
/// Time without samples after which the axes are brought to rest, us.
const LONGEST_SILENCE_US: u64 = 100_000;
/// Longest time between commands without samples, s: that between ticks of the main loop.
const LONGEST_COMMAND_INTERVAL_S: f64 = 0.1;

/// A move under way.
#[derive(Clone, Copy, Debug)]
struct Motion<T> {
    profile: Profile<T>,
    from_ticks: i64,
    start_us: u64,
    /// Nominal duration, us.
    duration_us: u64,
}

/// State of one axis.
#[derive(Clone, Debug)]
pub struct Axis<T: Real> {
    limits: AxisLimits,
    interval_s: T,
    /// Encoder angle counted over whole turns.
    angle_ticks: Option<i64>,
    target_ticks: i64,
    motion: Option<Motion<T>>,
    /// Coming to rest, wherever that will be.
    braking: bool,
    /// The encoder is not believed: the drive is brought to rest and left there until the next move.
    released: bool,
    commanded_rad_s: T,
    commanded_us: u64,
}

impl<T: Real> Axis<T> {
    /// An axis whose encoder has not been read yet, and whose drive gets a command every `interval_s`.
    pub fn new(limits: &AxisLimits, interval_s: T) -> Self {
        Self {
            limits: *limits,
            interval_s,
            angle_ticks: None,
            target_ticks: 0,
            motion: None,
            braking: false,
            released: false,
            commanded_rad_s: T::zero(),
            commanded_us: 0,
        }
    }

    /// Takes in an encoder reading; the first decides the turn: the one within the travel, of several the one nearest to
    /// zero.
    pub fn measure(&mut self, angle: Angle) {
        self.angle_ticks = Some(match self.angle_ticks {
            Some(before) => before + i64::from(angle.since(Angle::from_ticks(before as u32))),
            None => {
                // It stands there until it is told to move.
                self.target_ticks = self.within_travel(i64::from(angle.ticks() as i32));
                self.target_ticks
            }
        });
    }

    /// This angle on the turn that is within the travel; as it is where none is.
    fn within_travel(&self, ticks: i64) -> i64 {
        let travel = rad_to_ticks(self.limits.lowest_rad)..=rad_to_ticks(self.limits.highest_rad);
        let turns = [0, -1, 1, -2, 2].map(|turns: i64| ticks + (turns << 32));
        turns.into_iter().find(|turned| travel.contains(turned)).unwrap_or(ticks)
    }

    /// Starts a move to `target_rad`, counted over whole turns.
    pub fn move_to(&mut self, target_rad: f64, rate_rad_s: f64, acceleration_rad_s2: f64, now_us: u64) {
        let Some(from_ticks) = self.angle_ticks else { return };
        self.target_ticks = rad_to_ticks(target_rad);
        let distance = ticks_to_rad(self.target_ticks - from_ticks);
        let profile = Profile::<T>::trapezoid(distance, rate_rad_s, acceleration_rad_s2);
        let duration_us = (profile.duration_s().widened() * 1e6) as u64;
        self.motion = Some(Motion { profile, from_ticks, start_us: now_us, duration_us });
        (self.braking, self.released) = (false, false);
    }

    /// Comes to rest and stays there without a look at the encoder, until the next move.
    pub fn release(&mut self) {
        self.hold();
        self.released = true;
    }

    /// Comes to rest as fast as it may, and stays there.
    pub fn hold(&mut self) {
        self.motion = None;
        self.braking = true;
        self.target_ticks = self.angle_ticks.unwrap_or(0);
    }

    /// Rate that the drive shall reach by the end of the next interval, rad/s. Zero before the first reading.
    pub fn rate_command(&mut self, now_us: u64) -> T {
        self.rate_within(now_us, self.interval_s)
    }

    /// As [`Self::rate_command`], where commands come less often than samples should: the drive may have to change its
    /// rate by what the acceleration allows over the time since the last command, up to a tenth of a second.
    pub fn late_rate_command(&mut self, now_us: u64) -> T {
        self.rate_within(now_us, real(LONGEST_COMMAND_INTERVAL_S))
    }

    fn rate_within(&mut self, now_us: u64, longest_s: T) -> T {
        let Some(angle_ticks) = self.angle_ticks else { return T::zero() };
        if self.braking || self.released {
            self.target_ticks = angle_ticks;
            self.braking &= self.commanded_rad_s != T::zero();
        }
        let (wanted_ticks, _) = self.wanted(now_us, T::zero());
        let (_, rate) = self.wanted(now_us, self.interval_s * real(LEAD_INTERVALS));
        let error: T = ticks_to_rad(wanted_ticks - angle_ticks);
        let highest: T = real(self.limits.rate_rad_s);
        // However long ago the last command was, the drive takes this one up within an interval.
        let since_s: T = real(now_us.saturating_sub(self.commanded_us) as f64 * 1e-6);
        let step = since_s.min(longest_s) * real(self.limits.acceleration_rad_s2);
        self.commanded_us = now_us;
        let wanted = (rate + error * real(POSITION_GAIN)).max(-highest).min(highest);
        self.commanded_rad_s = wanted.max(self.commanded_rad_s - step).min(self.commanded_rad_s + step);
        self.commanded_rad_s
    }

    /// Angle counted over whole turns, rad; zero before the first reading.
    pub fn angle_rad(&self) -> f64 {
        ticks_to_rad(self.angle_ticks.unwrap_or(0))
    }

    /// Whether the drive has been told to stand.
    pub fn is_at_rest(&self) -> bool {
        self.commanded_rad_s == T::zero()
    }

    /// Whether the profile is over and the encoder within the tolerance of its end.
    pub fn has_arrived(&self, now_us: u64) -> bool {
        let over = self.motion.is_none_or(|motion| motion.elapsed_s(now_us) >= motion.profile.duration_s());
        over && self.distance_rad(self.target_ticks) <= self.limits.arrived_rad
    }

    /// Distance of the encoder from the profile, rad, if it is more than the axis is allowed to be behind.
    pub fn following_error_rad(&self, now_us: u64) -> Option<f64> {
        if self.released {
            return None;
        }
        let error = self.distance_rad(self.wanted(now_us, T::zero()).0);
        (error > self.limits.following_error_rad).then_some(error)
    }

    /// Nominal duration of the move under way, us.
    pub fn move_us(&self) -> u64 {
        self.motion.map_or(0, |motion| motion.duration_us)
    }

    fn distance_rad(&self, from_ticks: i64) -> f64 {
        self.angle_ticks.map_or(0.0, |angle| ComplexField::abs(ticks_to_rad::<f64>(angle - from_ticks)))
    }

    /// Angle (ticks) and rate (rad/s) that the profile wants `later_s` from now.
    fn wanted(&self, now_us: u64, later_s: T) -> (i64, T) {
        match self.motion {
            Some(motion) if motion.elapsed_s(now_us) < motion.profile.duration_s() => {
                let point = motion.profile.at(motion.elapsed_s(now_us) + later_s);
                (motion.from_ticks + rad_to_ticks(point.angle_rad.widened()), point.rate_rad_s)
            }
            _ => (self.target_ticks, T::zero()),
        }
    }
}

impl<T: Real> Motion<T> {
    fn elapsed_s(&self, now_us: u64) -> T {
        real(now_us.saturating_sub(self.start_us) as f64 * 1e-6)
    }
}

/// Both axes on drives that take rates: what [`crate::gimbal`] is to motors.
#[derive(Clone, Debug)]
pub struct RateGimbal<T: Real> {
    axes: [Axis<T>; 2],
    interval_us: u64,
    /// Time of the last sample, us.
    sample_us: Option<u64>,
    /// The same on a clock that does not go back, us.
    now_us: u64,
    /// When the board saw which time, us.
    heard: Option<(u64, u64)>,
    move_us: u64,
    failures: [u8; 2],
    released: bool,
    fault: Option<Fault>,
}

impl<T: Real> RateGimbal<T> {
    /// Axes whose encoders have not been read yet, commanded `rate_hz` times a second.
    pub fn new(limits: &[AxisLimits; 2], rate_hz: f64) -> Self {
        Self {
            axes: limits.each_ref().map(|limits| Axis::new(limits, real(rate_hz.recip()))),
            interval_us: (1e6 / rate_hz) as u64,
            sample_us: None,
            now_us: 0,
            heard: None,
            move_us: 0,
            failures: [0; 2],
            released: false,
            fault: None,
        }
    }

    /// Takes in the angles of a sample.
    pub fn measure(&mut self, sample: &RawSample<T>) {
        let last_us = self.sample_us.replace(sample.time_us).unwrap_or(sample.time_us);
        self.now_us += sample.time_us.checked_sub(last_us).unwrap_or(self.interval_us);
        for (axis, angle) in self.axes.iter_mut().zip([sample.outer, sample.inner]) {
            axis.measure(angle);
        }
        self.watch();
    }

    fn watch(&mut self) {
        for (index, (axis, failures)) in (0_u8..).zip(self.axes.iter_mut().zip(self.failures)) {
            let following = axis.following_error_rad(self.now_us).map(|error_rad| FaultKind::Following { error_rad });
            let silent = failures >= DRIVE_FAILURES && !self.released;
            let kind = if silent { Some(FaultKind::Bridge(BridgeFault::Silent)) } else { following };
            if let (Some(kind), None) = (kind, self.fault) {
                self.fault = Some(Fault { axis: index, angle_rad: axis.angle_rad(), kind });
            }
        }
        if self.fault.is_some() {
            self.axes.iter_mut().for_each(Axis::release);
        }
    }

    /// Takes a command. It ends what was under way, and forgets the fault.
    pub fn command(&mut self, command: MotionCommand) {
        (self.fault, self.failures) = (None, [0; 2]);
        self.released = command == MotionCommand::Release;
        match command {
            MotionCommand::Hold => self.axes.iter_mut().for_each(Axis::hold),
            MotionCommand::Release => self.axes.iter_mut().for_each(Axis::release),
            MotionCommand::MoveTo { angles_rad, rate_rad_s, acceleration_rad_s2 } => {
                for (axis, target_rad) in self.axes.iter_mut().zip(angles_rad) {
                    axis.move_to(target_rad, rate_rad_s, acceleration_rad_s2, self.now_us);
                }
                self.move_us = self.axes.iter().map(Axis::move_us).max().unwrap_or(0);
            }
        }
    }

    /// Rates that the outer and the inner drive shall reach by the next sample, rad/s.
    pub fn rates_rad_s(&mut self) -> [T; 2] {
        let now_us = self.now_us;
        self.axes.each_mut().map(|axis| axis.rate_command(now_us))
    }

    /// Looks at the board's clock, us. Where samples fail to come, the axes are brought to rest by the rates returned.
    pub fn tick(&mut self, board_us: u64) -> Option<[T; 2]> {
        let (heard_us, now_us) = *self.heard.get_or_insert((board_us, self.now_us));
        if now_us != self.now_us {
            self.heard = Some((board_us, self.now_us));
            return None;
        }
        let silent_us = board_us.saturating_sub(heard_us);
        if silent_us <= LONGEST_SILENCE_US {
            return None;
        }
        self.axes.iter_mut().for_each(Axis::hold);
        Some(self.axes.each_mut().map(|axis| axis.late_rate_command(now_us.saturating_add(silent_us))))
    }

    /// Tells whether the outer and the inner drive took their last rates.
    pub fn drives_answered(&mut self, answered: [bool; 2]) {
        for (failures, answered) in self.failures.iter_mut().zip(answered) {
            *failures = if answered { 0 } else { failures.saturating_add(1) };
        }
    }

    /// How the axes are.
    pub fn status(&self) -> GimbalStatus {
        GimbalStatus {
            time_us: self.now_us,
            arrived: self.axes.iter().all(|axis| axis.has_arrived(self.now_us)),
            at_rest: self.axes.iter().all(Axis::is_at_rest),
            move_us: self.move_us,
            following_rad: self.axes.each_ref().map(|axis| axis.following_error_rad(self.now_us).unwrap_or(0.0)),
            fault: self.fault,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::DEG;

    const INTERVAL_S: f64 = 0.005;

    fn axis() -> Axis<f64> {
        Axis::new(&AxisLimits::default(), INTERVAL_S)
    }

    /// A drive that reaches the commanded rate at the end of each interval, with a gain error, and an encoder.
    #[test]
    fn loop_follows_and_arrives_in_spite_of_a_drive_error() {
        let mut axis = axis();
        let (mut angle, mut rate, mut now_us) = (0.1_f64, 0.0, 0);
        axis.measure(Angle::from_rad(angle));
        axis.move_to(-4.0, 0.35, 0.35, now_us);
        let mut arrived_us = None;
        for _ in 0..4000 {
            let next = axis.rate_command(now_us) * 1.001;
            angle += 0.5 * (rate + next) * INTERVAL_S;
            rate = next;
            now_us += 5000;
            axis.measure(Angle::from_rad(angle));
            assert_eq!(axis.following_error_rad(now_us), None);
            if axis.has_arrived(now_us) {
                arrived_us.get_or_insert(now_us);
            }
        }
        assert!((angle + 4.0).abs() < 1e-8, "{angle}");
        let late_s = arrived_us.expect("arrives") as f64 * 1e-6 - (4.1 / 0.35 + 1.0);
        assert!(late_s < 1.0, "{late_s}");
    }

    #[test]
    fn an_axis_stands_where_it_is_found() {
        let mut axis = axis();
        axis.measure(Angle::from_rad(1.5));
        assert_eq!(axis.following_error_rad(0), None);
        assert_eq!(axis.rate_command(0), 0.0);
    }

    #[test]
    fn the_drive_is_never_asked_for_more_than_the_limits() {
        let limits = AxisLimits::default();
        let mut axis = axis();
        let (mut angle, mut rate) = (-3.0, 0.0);
        axis.measure(Angle::from_rad(angle));
        for edge in 0..6000_u64 {
            let now_us = edge * 5000;
            match edge {
                // Faster than the axis, and a new target, and a stop, each while it turns.
                100 => axis.move_to(4.0, 2.0, 5.0, now_us),
                500 => axis.move_to(-1.0, 0.35, 0.35, now_us),
                900 => axis.hold(),
                1200 => axis.move_to(0.5, 0.35, 0.35, now_us),
                _ => {}
            }
            let next = axis.rate_command(now_us);
            assert!(next.abs() <= limits.rate_rad_s * (1.0 + 1e-12));
            assert!((next - rate).abs() <= limits.acceleration_rad_s2 * INTERVAL_S * (1.0 + 1e-9), "{edge}");
            angle += 0.5 * (rate + next) * INTERVAL_S;
            rate = next;
            axis.measure(Angle::from_rad(angle));
        }
        assert!((angle - 0.5).abs() < 1e-8, "{angle}");
    }

    #[test]
    fn the_turn_is_the_one_within_the_travel() {
        let degrees = |lowest: f64, highest: f64, read: f64| {
            let limits = AxisLimits { lowest_rad: lowest * DEG, highest_rad: highest * DEG, ..AxisLimits::default() };
            let mut axis = Axis::<f64>::new(&limits, INTERVAL_S);
            axis.measure(Angle::from_rad(read * DEG));
            (ticks_to_rad::<f64>(axis.target_ticks) / DEG).round()
        };
        assert_eq!(degrees(-361.0, 1.0, 68.0), -292.0);
        assert_eq!(degrees(-361.0, 1.0, 0.0), 0.0);
        assert_eq!(degrees(-720.0, 720.0, 200.0), -160.0);
        assert_eq!(degrees(400.0, 800.0, 100.0), 460.0);
        assert_eq!(degrees(-10.0, 10.0, 100.0), 100.0, "none is");
    }

    #[test]
    fn a_released_axis_does_not_look_at_its_encoder() {
        let mut axis = axis();
        axis.measure(Angle::from_rad(0.0));
        axis.move_to(1.0, 0.35, 0.35, 0);
        let mut rate = 0.0;
        for edge in 1..400_u64 {
            if edge == 100 {
                axis.release();
            }
            // An encoder of reversed sign.
            axis.measure(Angle::from_rad(-1e-3 * edge as f64));
            rate = axis.rate_command(edge * 5000);
        }
        assert_eq!((rate, axis.following_error_rad(2_000_000)), (0.0, None));
    }

    #[test]
    fn an_axis_that_does_not_turn_is_noticed() {
        let mut axis = axis();
        axis.measure(Angle::from_rad(0.0));
        axis.move_to(1.0, 0.35, 0.35, 0);
        axis.measure(Angle::from_rad(0.0));
        assert!(axis.following_error_rad(1_000_000).is_some_and(|error| error > 0.17));
        axis.hold();
        assert_eq!(axis.following_error_rad(1_000_000), None);
        assert_eq!(axis.rate_command(1_000_000), 0.0);
    }
}
