//! Good messages, commands and answers, from which damaged inputs are made.

use super::bytes_of;
use host_tests::bench::power_up::{Switched, in_process, shared};
use host_tests::virtual_unit::driven::DrivenRins;
use host_tests::virtual_unit::unit::VirtualUnit;
use rins_selfcal::base::method::Method;
use rins_selfcal::link::{
    Answer, Command, Hello, Item, LinkCounts, Payload, Refusal, Setting, SettingName, Status, UNLOCK_WORD,
};
use rins_selfcal::model::error_model::PARAMETERS;
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::CalibratorConfig;
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::result::{StoredCalibration, StoredVerdict};
use rins_selfcal::run::state::State;
use rins_selfcal::run::telemetry::Message;
use rins_selfcal::scheme::Scheme;
use std::sync::LazyLock;

/// Payloads by kind.
pub struct Samples {
    /// Kind and encoded payload of messages, commands and answers.
    pub all: Vec<(u8, Vec<u8>)>,
}

/// The messages of a short run, every command, and every answer. The run is made once.
pub fn all() -> &'static Samples {
    static SAMPLES: LazyLock<Samples> = LazyLock::new(Samples::new);
    &SAMPLES
}

impl Samples {
    fn new() -> Self {
        let commands = commands().into_iter().map(|command| kept(&command));
        let answers = answers().into_iter().map(|answer| kept(&answer));
        Self { all: messages().into_iter().chain(commands).chain(answers).collect() }
    }

    /// Payloads of one kind.
    pub fn of(&self, kind: u8) -> Vec<Vec<u8>> {
        self.all.iter().filter(|sample| sample.0 == kind).map(|sample| sample.1.clone()).collect()
    }
}

fn kept<P: Payload>(payload: &P) -> (u8, Vec<u8>) {
    (P::KIND, bytes_of(payload))
}

/// A configuration with a short scheme that waits for a command.
pub fn config() -> SelfCalibrationConfig {
    let unit = VirtualUnit::default();
    let calibrator = CalibratorConfig::new(Method::Joint, unit.site, unit.noise.psd(), unit.rate_hz);
    let config = SelfCalibrationConfig::new(calibrator, Scheme::bai(1.0, 1));
    SelfCalibrationConfig { policy: PowerUpPolicy::OnCommand, ..config }
}

/// A record as a run stores it.
pub fn record(number: u32) -> StoredCalibration {
    let scheme = config().scheme.name;
    StoredCalibration {
        errors: host_tests::virtual_unit::presets::real(u64::from(number)),
        sigmas: [1e-6; PARAMETERS],
        method: Method::Joint,
        scheme,
        site: config().calibrator.estimator.site,
        utc_s: Some(1_700_000_000 + u64::from(number)),
        temperature_c: 25.0,
        chi_square: 200.0,
        degrees_of_freedom: 190,
        software_version: Hello::new::<f64>().software,
        verdict: StoredVerdict::default(),
        imu: None,
    }
}

/// All messages that an instrument sends in a run.
fn messages() -> Vec<(u8, Vec<u8>)> {
    let config = SelfCalibrationConfig { policy: PowerUpPolicy::Always, ..config() };
    let (plant, off) = Switched::new(DrivenRins::new(&VirtualUnit::default(), 1));
    let bench = shared(plant);
    let mut messages = Vec::new();
    let note = |message: &Message| {
        messages.push(kept(message));
        off.set(matches!(message, Message::Corrected { .. }));
    };
    in_process::<f64, _>(&Assignment::SelfCalibrate(config), None, &bench, note).expect("a valid assignment");
    messages.push(kept(&Message::Refused(ConfigError::Travel { leg: 3, axis: 1 })));
    messages
}

fn commands() -> Vec<Command> {
    let config = config();
    let items = [Item::Calibration, Item::Estimate, Item::Covariance { row: 7 }];
    let names = SettingName::ALL;
    let plain = [Command::Hello, Command::Status, Command::Start, Command::Abort, Command::Erase];
    let unlocks = [Command::Unlock(UNLOCK_WORD), Command::Unlock(0)];
    let settings = names.map(|name| Command::Set(Setting::of(&config, name)));
    let reads = items.into_iter().chain(names.map(Item::Setting)).map(Command::Read);
    plain.into_iter().chain(unlocks).chain(settings).chain(reads).collect()
}

fn answers() -> Vec<Answer> {
    let config = config();
    let record = record(1);
    let status = Status {
        time_us: 12_345_678,
        state: State::Dwell(3),
        legs: 18,
        segments: 7,
        left_s: 60.0,
        angles_rad: [1.5, f32::NAN],
        correcting: false,
        unlocked: true,
        motion_lock: None,
        missing: 2,
        link: LinkCounts { overrun: 70_000, ..LinkCounts::default() },
    };
    let refusals = [Refusal::NotUnderstood, Refusal::NotNow(State::Parking), Refusal::Config(ConfigError::Limits)];
    let plain = [
        Answer::Done,
        Answer::Hello(Hello::new::<f64>()),
        Answer::Status(status),
        Answer::Estimate { segments: 7, estimate: record.estimate() },
        Answer::Calibration(record),
        Answer::Covariance { row: 3, values: [1e-12; PARAMETERS] },
    ];
    let settings = SettingName::ALL.map(|name| Answer::Setting(Setting::of(&config, name)));
    plain.into_iter().chain(refusals.map(Answer::Refused)).chain(settings).collect()
}
