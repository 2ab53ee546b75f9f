//! Reaction of the instrument to failures: each failure at several phases of a run, in closed loop, in this process.

use crate::bench::line::{CommandLine, Commander};
use crate::bench::power_up::{Memory, Switched, in_process, self_calibrate, shared};
use crate::bench::{Chip, SharedBench, Trouble};
use crate::virtual_unit::drive::move_durations_s;
use crate::virtual_unit::driven::DrivenRins;
use crate::virtual_unit::plant::{Output, Plant, Tick};
use crate::virtual_unit::presets;
use crate::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::base::units::DEG;
use rins_selfcal::gimbal::servo::PERIOD_US;
use rins_selfcal::link::Command;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::result::StoredCalibration;
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// A failure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failing {
    /// Encoder or bridge of an axis.
    Chip(Trouble),
    /// The axis is blocked.
    Jammed,
    /// The axis is pushed with this torque for 0.1 s, N m.
    Pushed(f64),
    /// The motors' supply is lost.
    MotorSupply,
    /// The IMU does not answer.
    ImuSilent,
    /// The IMU reports a sensor as failed.
    ImuSensor,
    /// The data-ready line is broken.
    DataReady,
    /// The encoder does not answer for this time, us.
    EncoderAway(u64),
    /// The IMU restarts and samples at half its rate.
    ImuRestarted,
    /// No failure: a command stops all motion.
    StopCommand,
}

impl Failing {
    /// All faults, with their names.
    pub const ALL: [(Self, &'static str); 21] = [
        (Self::Chip(Trouble::EncoderSilent), "encoder silent"),
        (Self::Chip(Trouble::EncoderCrc(1)), "encoder frames damaged"),
        (Self::Chip(Trouble::EncoderAlarm), "encoder reports an error"),
        (Self::Chip(Trouble::EncoderFrozen), "encoder frozen"),
        (Self::Chip(Trouble::EncoderSlip(3.0)), "encoder slips by 3 deg"),
        (Self::Chip(Trouble::EncoderReversed), "encoder reversed"),
        (Self::Jammed, "axis jammed"),
        (Self::Pushed(-1.5), "axis pushed"),
        (Self::Chip(Trouble::Weak(0.1)), "motor weak"),
        (Self::Chip(Trouble::MotorReversed), "motor reversed"),
        (Self::Chip(Trouble::BridgeStuck), "bridge stuck"),
        (Self::Chip(Trouble::BridgeFull), "bridge full on"),
        (Self::Chip(Trouble::Overcurrent), "overcurrent"),
        (Self::Chip(Trouble::BridgeDead), "bridge dead"),
        (Self::MotorSupply, "motor supply lost"),
        (Self::ImuSilent, "IMU silent"),
        (Self::ImuSensor, "IMU sensor failed"),
        (Self::DataReady, "data-ready line broken"),
        (Self::EncoderAway(500_000), "encoder away for 0.5 s"),
        (Self::ImuRestarted, "IMU restarted"),
        (Self::StopCommand, "stop commanded"),
    ];
}

/// Phase of the run at which the failure occurs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "`name` says what each one is")]
pub enum Phase {
    FirstStop,
    RampUp,
    ConstantRate,
    RampDown,
    Settling,
    Stop,
    Solving,
    Parking,
}

impl Phase {
    /// All phases.
    pub const ALL: [Self; 8] = [
        Self::FirstStop,
        Self::RampUp,
        Self::ConstantRate,
        Self::RampDown,
        Self::Settling,
        Self::Stop,
        Self::Solving,
        Self::Parking,
    ];

    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::FirstStop => "first stop",
            Self::RampUp => "ramp up",
            Self::ConstantRate => "constant rate",
            Self::RampDown => "ramp down",
            Self::Settling => "settling",
            Self::Stop => "stop",
            Self::Solving => "solving",
            Self::Parking => "parking",
        }
    }

    /// Time of the failure: a state, and a time after the start of the state, us. The first move is a quarter turn at
    /// 20 deg/s with ramps of 1 s.
    fn moment(self) -> (State, u64) {
        match self {
            Self::FirstStop => (State::Dwell(0), 500_000),
            Self::RampUp => (State::Turn(1), 500_000),
            Self::ConstantRate => (State::Turn(1), 2_500_000),
            Self::RampDown => (State::Turn(1), 5_000_000),
            Self::Settling => (State::Settle(1), 100_000),
            Self::Stop => (State::Dwell(1), 500_000),
            Self::Solving => (State::Compute, 0),
            Self::Parking => (State::Parking, 2_500_000),
        }
    }
}

/// Outcome of a run.
#[derive(Clone, Debug)]
pub struct Fate {
    /// Time from the failure until both axes were at rest, ms; `None` if they did not come to rest.
    pub stopped_ms: Option<u64>,
    /// Whether both axes are at rest at the end.
    pub at_rest: bool,
    /// The farthest physical angles of the outer and the inner axis, counted over whole turns, from the lowest to the
    /// highest, rad.
    pub wound_rad: [[f64; 2]; 2],
    /// The last state.
    pub state: State,
    /// Whether the run ended, or waits for samples.
    pub ended: bool,
    /// Reports to the user.
    pub told: Vec<String>,
    /// Error of the worst parameter in sigmas, if the result was accepted.
    pub accepted: Option<f64>,
    /// Whether the store has a calibration: the earlier one or a newly accepted one.
    pub stored: bool,
}

/// Rate above which an axis turns, rad/s.
const TURNS_RAD_S: f64 = 0.01 * DEG;
/// Time without motion after which the axes count as at rest, us.
const STANDS_US: u64 = 200_000;
/// Longest time of a run, us.
const LIMIT_US: u64 = 200_000_000;
/// Time for which the simulation continues after the end of the run, us.
const AFTER_US: u64 = 1_500_000;
/// Time without samples after which an aborted run counts as waiting for samples, us.
const WAITS_US: u64 = 5_000_000;

/// The unit, and whether its axes turn.
struct Watched {
    rins: DrivenRins,
    now_us: u64,
    off: bool,
    no_edges: bool,
    failed_us: Option<u64>,
    turned_us: u64,
    stopped_us: Option<u64>,
    pushed_until_us: Option<(usize, u64)>,
    /// Whether every second sample is left out.
    halved: bool,
    samples: u64,
    wound_rad: [[f64; 2]; 2],
}

impl Watched {
    /// The tick as the IMU's interrupt sees it.
    fn sampled(&mut self, tick: Tick) -> Tick {
        self.samples += u64::from(tick.reading.is_some());
        let left_out = self.no_edges || self.halved && self.samples.is_multiple_of(2);
        if left_out { Tick { reading: None, ..tick } } else { tick }
    }

    fn note_winding(&mut self) {
        for ([lowest, highest], angle) in self.wound_rad.iter_mut().zip(self.rins.true_angles_rad()) {
            (*lowest, *highest) = (lowest.min(angle), highest.max(angle));
        }
    }

    fn turns(&self) -> bool {
        self.rins.true_rates_rad_s().iter().any(|rate| rate.abs() > TURNS_RAD_S)
    }
}

impl Plant for Watched {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        if self.off {
            return None;
        }
        if let Some((axis, _)) = self.pushed_until_us.take_if(|(_, until_us)| *until_us <= self.now_us) {
            self.rins.motor_mut(axis).mechanics.disturbance_nm = 0.0;
        }
        let tick = self.rins.advance(outputs)?;
        self.now_us += PERIOD_US;
        if self.turns() {
            self.turned_us = self.now_us;
        }
        if let Some(failed_us) = self.failed_us
            && self.now_us - self.turned_us.max(failed_us) >= STANDS_US
        {
            self.stopped_us.get_or_insert(self.turned_us.max(failed_us));
        }
        self.note_winding();
        Some(self.sampled(tick))
    }
}

/// Host's end of the serial line, which injects the failure.
struct Saboteur {
    bench: SharedBench<Rc<RefCell<Watched>>>,
    unit: Rc<RefCell<Watched>>,
    /// The state, and its start, us.
    state: Rc<Cell<(State, u64)>>,
    failing: Failing,
    phase: Phase,
    axis: usize,
    aborted: bool,
}

impl Commander for Saboteur {
    fn look(&mut self, send: &mut dyn FnMut(&Command)) {
        let (state, since_us) = self.state.get();
        let now_us = self.unit.borrow().now_us;
        let (when, after_us) = self.phase.moment();
        let failed_us = self.unit.borrow().failed_us;
        if failed_us.is_none() && state == when && now_us >= since_us + after_us {
            self.unit.borrow_mut().failed_us = Some(now_us);
            self.fail(now_us, send);
        }
        if let Failing::EncoderAway(away_us) = self.failing
            && failed_us.is_some_and(|failed_us| now_us >= failed_us + away_us)
        {
            self.bench.borrow_mut().set_trouble(self.axis, None);
        }
        if failed_us.is_some() && self.failing == Failing::ImuSensor {
            // The failure continues.
            self.fail(now_us, send);
        }
        // A command aborts the run, because the run would not park otherwise.
        if self.phase == Phase::Parking && state == State::Dwell(1) && !std::mem::replace(&mut self.aborted, true) {
            send(&Command::Abort);
        }
        let idle_us = if state == State::Stopping { WAITS_US } else { AFTER_US };
        let over = (state.is_idle() || state == State::Stopping) && now_us >= since_us + idle_us;
        let waits = failed_us.is_none_or(|failed_us| now_us < failed_us + WAITS_US);
        self.unit.borrow_mut().off = over && !waits || now_us >= LIMIT_US;
    }
}

impl Saboteur {
    fn fail(&mut self, now_us: u64, send: &mut dyn FnMut(&Command)) {
        let axis = self.axis;
        match self.failing {
            Failing::Chip(trouble) => self.bench.borrow_mut().set_trouble(axis, Some(trouble)),
            Failing::Jammed => self.unit.borrow_mut().rins.motor_mut(axis).jammed = true,
            Failing::Pushed(torque_nm) => {
                let mut unit = self.unit.borrow_mut();
                unit.rins.motor_mut(axis).mechanics.disturbance_nm = torque_nm;
                unit.pushed_until_us = Some((axis, now_us + 100_000));
            }
            Failing::MotorSupply => {
                (0..2).for_each(|axis| self.bench.borrow_mut().set_trouble(axis, Some(Trouble::BridgeDead)));
            }
            Failing::ImuSilent => {
                let silent = |chip, frame: &mut [u8]| {
                    if chip == Chip::Imu {
                        frame.fill(0xff);
                    }
                };
                self.bench.borrow_mut().damage(silent);
            }
            Failing::ImuSensor => self.bench.borrow_mut().fail_gyro(),
            Failing::DataReady => self.unit.borrow_mut().no_edges = true,
            Failing::EncoderAway(_) => self.bench.borrow_mut().set_trouble(axis, Some(Trouble::EncoderSilent)),
            Failing::ImuRestarted => self.unit.borrow_mut().halved = true,
            Failing::StopCommand => send(&Command::Stop),
        }
    }
}

/// Runs the instrument with a failure of the outer (0) or inner (1) axis at a phase. The store has a calibration at
/// power-up.
///
/// # Panics
/// The configuration is refused.
pub fn fate(failing: Failing, phase: Phase, axis: usize, before: &StoredCalibration) -> Fate {
    let unit = VirtualUnit { errors: presets::real(1), ..VirtualUnit::default() };
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let usual = SelfCalibrationConfig::new(calibrator, Scheme::bai(1.0, 1));
    let config = SelfCalibrationConfig { policy: PowerUpPolicy::Always, ..usual };
    let mut rins = DrivenRins::new(&unit, 1);
    rins.expect_moves(&move_durations_s(&config.scheme, unit.rate_hz));
    let watched = Rc::new(RefCell::new(Watched {
        rins,
        now_us: 0,
        off: false,
        no_edges: false,
        failed_us: None,
        turned_us: 0,
        stopped_us: None,
        pushed_until_us: None,
        halved: false,
        samples: 0,
        wound_rad: [[0.0; 2]; 2],
    }));
    let state = Rc::new(Cell::new((State::PowerUp, 0)));
    let bench = shared(Rc::clone(&watched));
    let mut line = CommandLine::new(Saboteur {
        bench: Rc::clone(&bench),
        unit: Rc::clone(&watched),
        state: Rc::clone(&state),
        failing,
        phase,
        axis,
        aborted: false,
    });
    let (mut told, mut accepted) = (Vec::new(), false);
    let mut on_message = |message: &Message| match message {
        Message::State { state: entered, .. } => state.set((*entered, watched.borrow().now_us)),
        Message::Fault(fault) => told.push(fault.to_string()),
        Message::Aborted(abort) => told.push(format!("aborted: {abort}")),
        Message::Judged(verdict) if verdict.accepted() => accepted = true,
        Message::Judged(verdict) => {
            told.push(format!("rejected: {}", verdict.reasons.first().map_or(String::new(), ToString::to_string)));
        }
        Message::Released => told.push("the axes are no longer controlled".into()),
        _ => {}
    };
    let mut memory = Memory { stored: Some(before.clone()), ..Memory::default() };
    let ran = self_calibrate::<f64, _>(&config, &mut memory, &bench, &mut line, &mut on_message);
    ran.expect("a good configuration");
    let unit_after = watched.borrow();
    let off = |stored: &StoredCalibration| {
        let difference = stored.errors.to_vector() - unit.errors.to_vector();
        let worst = difference.iter().zip(&stored.sigmas).take(27).map(|(off, sigma)| (off / sigma).abs());
        worst.fold(0.0, f64::max)
    };
    Fate {
        stopped_ms: unit_after.stopped_us.zip(unit_after.failed_us).map(|(stopped, failed)| (stopped - failed) / 1000),
        at_rest: !unit_after.turns(),
        wound_rad: unit_after.wound_rad,
        state: state.get().0,
        ended: unit_after.now_us < LIMIT_US,
        told,
        accepted: memory.stored.as_ref().filter(|_| accepted).map(off),
        stored: memory.stored.as_ref().is_some_and(|stored| memory.saved || stored == before),
    }
}

/// A calibration of the unit, as an earlier run stored it.
///
/// # Panics
/// The run is not accepted.
pub fn good_calibration() -> StoredCalibration {
    let unit = VirtualUnit { errors: presets::real(1), ..VirtualUnit::default() };
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let config = SelfCalibrationConfig::new(calibrator, Scheme::bai(1.0, 1));
    let mut rins = DrivenRins::new(&unit, 2);
    rins.expect_moves(&move_durations_s(&config.scheme, unit.rate_hz));
    let (plant, off) = Switched::new(rins);
    let saved = |message: &Message| off.set(off.get() || matches!(message, Message::Saved(_)));
    let assignment = Assignment::SelfCalibrate(config);
    let stored = in_process::<f64, _>(&assignment, None, &shared(plant), saved);
    stored.expect("a good configuration").expect("an accepted run")
}
