//! Many power-ups of units with cables: at random angles, with the power cut at random moments, in closed loop.
//! Whatever happens, an axis never leaves its physical travel, or the instrument refuses to move.

use crate::bench::line::{CommandLine, Commander};
use crate::bench::power_up::{Memory, Switched, share, start};
use crate::bench::{Bench, SharedBench};
use crate::virtual_unit::drive::move_durations_s;
use crate::virtual_unit::driven::DrivenRins;
use crate::virtual_unit::plant::{Output, Plant, Tick};
use crate::virtual_unit::unit::VirtualUnit;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rins_selfcal::base::method::Method;
use rins_selfcal::base::restart::Restart;
use rins_selfcal::base::units::DEG;
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::travel::{Travel, TurnSource};
use rins_selfcal::instrument::Startup;
use rins_selfcal::link::{Command, UNLOCK_WORD};
use rins_selfcal::run::config::{CalibratorConfig, SelfCalibrationConfig};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::{Leg, Scheme};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// Number of power-ups of one unit, with one memory.
const OF_ONE_UNIT: u32 = 10;
/// Longest time of a power-up, control periods of 1 ms.
const LONGEST: u64 = 60_000;
/// Time in which an axis without power comes to rest, control periods.
const COASTING: u32 = 5_000;

/// What became of a number of power-ups.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PowerUps {
    /// Number of power-ups.
    pub count: u32,
    /// Number of power-ups in which the power was cut before the run had ended.
    pub cut: u32,
    /// Number of power-ups in which the axes moved.
    pub moved: u32,
    /// Number of refusals to move because a turn was not known.
    pub refused: u32,
    /// Number of turns that the operator confirmed.
    pub confirmed: u32,
    /// Largest excess of a physical angle over its travel, deg; negative if all stayed inside.
    pub beyond_deg: f64,
    /// Every unit that left its travel, in words.
    pub breaches: Vec<String>,
}

/// Powers units up, `count` times in all.
///
/// # Panics
/// A configuration is refused.
pub fn power_ups(seed: u64, count: u32) -> PowerUps {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut all = PowerUps { beyond_deg: f64::NEG_INFINITY, ..PowerUps::default() };
    while all.count < count {
        let travels = [0, 1].map(|_| travel(&mut random));
        let mut memory = Memory::default();
        let mut standing_rad = travels.map(|travel| within(&travel, part(&mut random)));
        for _ in 0..OF_ONE_UNIT.min(count - all.count) {
            standing_rad = power_up(&mut random, travels, standing_rad, &mut memory, &mut all);
            turn_by_hand(&mut random, &travels, &mut standing_rad);
        }
    }
    all
}

/// From 0 to 1.
fn part(random: &mut Xoshiro256PlusPlus) -> f64 {
    (random.next_u64() >> 11) as f64 * 2.0_f64.powi(-53)
}

fn travel(random: &mut Xoshiro256PlusPlus) -> Travel {
    let around = |turn| Travel::around(-360.0 * DEG, 0.0, turn);
    match random.next_u64() % 5 {
        0 => Travel::Continuous,
        1 => Travel::around(-200.0 * DEG, 100.0 * DEG, TurnSource::Unique),
        2 => around(TurnSource::Stored),
        3 => Travel::around(-360.0 * DEG, 360.0 * DEG, TurnSource::Stored),
        _ => around(TurnSource::Confirm),
    }
}

/// An angle inside of a travel.
fn within(travel: &Travel, part: f64) -> f64 {
    match *travel {
        Travel::Continuous => (part - 0.5) * 720.0 * DEG,
        Travel::Limited { lowest_rad, highest_rad, .. } => lowest_rad + part * (highest_rad - lowest_rad),
    }
}

/// Sometimes somebody turns an axis while the power is off.
fn turn_by_hand(random: &mut Xoshiro256PlusPlus, travels: &[Travel; 2], standing_rad: &mut [f64; 2]) {
    for (travel, standing) in travels.iter().zip(standing_rad) {
        if part(random) < 0.1 {
            *standing = within(travel, part(random));
        }
    }
}

/// A scheme of three quarter turns within every travel.
fn scheme() -> Scheme {
    let leg = |outer: f64, inner: f64| Leg { outer_rad: outer * DEG, inner_rad: inner * DEG, stop_s: 0.5 };
    let legs = [leg(-90.0, 0.0), leg(-90.0, -90.0), leg(-180.0, -90.0)];
    Scheme {
        rate_rad_s: 50.0 * DEG,
        acceleration_rad_s2: 50.0 * DEG,
        first_stop_s: 0.6,
        legs: legs.into_iter().collect(),
        ..Scheme::bai(1.0, 1)
    }
}

/// One power-up. Returns where the axes come to rest without power.
fn power_up(
    random: &mut Xoshiro256PlusPlus,
    travels: [Travel; 2],
    standing_rad: [f64; 2],
    memory: &mut Memory,
    all: &mut PowerUps,
) -> [f64; 2] {
    all.count += 1;
    let unit = VirtualUnit::default();
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let axes = travels.map(|travel| AxisLimits { travel, ..AxisLimits::default() });
    let usual = SelfCalibrationConfig::new(calibrator, scheme());
    let config = SelfCalibrationConfig { axes, refuse_unobserved: false, ..usual };
    let mut rins = DrivenRins::new(&unit, random.next_u64()).standing_at(standing_rad);
    rins.expect_moves(&move_durations_s(&config.scheme, unit.rate_hz));
    let cut_after = (part(random) * 40_000.0) as u64;
    let wound =
        Rc::new(RefCell::new(Wound { rins, range_rad: standing_rad.map(|angle| [angle; 2]), periods: 0, cut_after }));
    let (plant, off) = Switched::new(Rc::clone(&wound));
    let bench: SharedBench<_> = share(Bench::new(plant));
    let state = Rc::new(Cell::new(State::PowerUp));
    let mut operator = CommandLine::new(Operator {
        wound: Rc::clone(&wound),
        state: Rc::clone(&state),
        off,
        helps: part(random) < 0.5,
        asked: false,
        refused: false,
    });
    let mut on_message = |message: &Message| {
        if let Message::State { state: entered, .. } = message {
            state.set(*entered);
        }
    };
    start::<f64, _>(&mut Startup::assigned(config, Restart::PowerOn), memory, &bench, &mut operator, &mut on_message)
        .expect("a valid configuration");
    all.cut += u32::from(!state.get().is_idle());
    all.refused += u32::from(operator.commander.refused);
    all.confirmed += u32::from(operator.commander.asked);
    drop((operator, bench));
    let mut wound = Rc::into_inner(wound).expect("the run is over").into_inner();
    for _ in 0..COASTING {
        wound.advance([Output::Open; 2]);
    }
    all.note(&travels, &wound);
    wound.rins.true_angles_rad()
}

impl PowerUps {
    fn note(&mut self, travels: &[Travel; 2], wound: &Wound) {
        self.moved += u32::from(wound.range_rad.iter().any(|[low, high]| high - low > 0.1 * DEG));
        for ((travel, [low, high]), axis) in travels.iter().zip(wound.range_rad).zip(["outer", "inner"]) {
            let (lowest, highest) = travel.physical_rad().into_inner();
            let beyond_deg = (lowest - low).max(high - highest) / DEG;
            self.beyond_deg = self.beyond_deg.max(beyond_deg);
            if beyond_deg > 1e-6 {
                let (low, high) = (low / DEG, high / DEG);
                self.breaches
                    .push(format!("power-up {}: {axis} axis from {low:.2} to {high:.2} deg, {travel:?}", self.count));
            }
        }
    }
}

/// A unit whose physical angles are noted, and whose power is cut after some control periods.
struct Wound {
    rins: DrivenRins,
    range_rad: [[f64; 2]; 2],
    periods: u64,
    cut_after: u64,
}

impl Plant for Wound {
    fn advance(&mut self, outputs: [Output; 2]) -> Option<Tick> {
        self.periods += 1;
        let tick = self.rins.advance(outputs);
        for ([low, high], angle) in self.range_rad.iter_mut().zip(self.rins.true_angles_rad()) {
            (*low, *high) = (low.min(angle), high.max(angle));
        }
        tick
    }
}

/// The operator at the other end of the line: says where the axes stand if a run is refused, and starts it again.
struct Operator {
    wound: Rc<RefCell<Wound>>,
    state: Rc<Cell<State>>,
    off: Rc<Cell<bool>>,
    helps: bool,
    asked: bool,
    refused: bool,
}

impl Commander for Operator {
    fn look(&mut self, send: &mut dyn FnMut(&Command)) {
        let Wound { periods, cut_after, .. } = *self.wound.borrow();
        let state = self.state.get();
        let refused = matches!(state, State::Stopped | State::Stranded);
        self.refused |= refused;
        if refused && self.helps && !self.asked {
            self.asked = true;
            let angles = self.wound.borrow().rins.true_angles_rad().map(|angle| Some(angle as f32));
            [Command::Unlock(UNLOCK_WORD), Command::ConfirmAngles(angles), Command::Start].iter().for_each(send);
        }
        self.off.set(periods >= cut_after.min(LONGEST));
    }
}
