//! Golden bytes of everything that the link sends. A change of a row needs a new [`PROTOCOL_VERSION`], unless the row
//! belongs to a new variant at the end of its type: the other end refuses a variant that it does not know.
//!
//! The first three tables have a row for each payload. The other tables have rows for the types inside the payloads.
//! The values of the fields differ, so that the bytes show the order of the fields.

use super::corrected::CorrectedReport;
use super::frame::{Dropped, PROTOCOL_VERSION};
use super::protocol::{Answer, Command, Hello, Item, LinkCounts, Refusal, Setting, SettingName, Status};
use crate::base::angle::Angle;
use crate::base::golden::{check_bytes, table};
use crate::base::hardware::{HARDWARE, Hardware};
use crate::base::imu_identity::ImuIdentity;
use crate::base::loss::LossCounts;
use crate::base::method::Method;
use crate::base::restart::{FatalError, Registers, Restart, Task};
use crate::base::sample::SampleStatus;
use crate::base::site::Site;
use crate::estimator::constancy::SettingEvidence;
use crate::estimator::constancy::{Change, Suspicion};
use crate::estimator::{
    BaiTuning, EffectEstimates, Estimate, EstimatorConfig, Fit, HeadingSource, LargestInnovation, SegmentInnovations,
    Solution,
};
use crate::gimbal::axis::AxisLimits;
use crate::gimbal::servo::MotorAndLoad;
use crate::gimbal::travel::{LocateError, LocateRefusal};
use crate::gimbal::{BridgeFault, EncoderFault, Fault, FaultKind, Travel, TurnFault, TurnSource};
use crate::keep::black_box::{Entry, Event};
use crate::model::effects::{EFFECT_STATES, SiteSigmas};
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::run::abort::{Abort, AbortReason};
use crate::run::config::{BoundedNumber, CalibratorConfig, ConfigError};
use crate::run::policy::{Cause, Decision, MotionLock, PowerUpPolicy};
use crate::run::result::{StoredCalibration, StoredVerdict};
use crate::run::sequencer::Pace;
use crate::run::state::State;
use crate::run::telemetry::Message;
use crate::run::telemetry::Progress;
use crate::run::unit::UnitName;
use crate::scheme::{Leg, Scheme, SchemeError};
use crate::segment::intake::IntakeCounts;
use crate::segment::white_noise::Noise;
use crate::segment::{SegmentKind, Stillness};
use crate::verdict::{Reason, Verdict, VerdictLimits};

fn site() -> Site {
    Site { latitude_rad: 0.5, height_m: 20.0, measured_gravity_m_s2: Some(9.75) }
}

/// The numbers 1, 2, 3 and so on, each used once.
fn errors() -> InstrumentErrors<f64> {
    InstrumentErrors {
        gyro_non_orthogonality: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        accel_non_orthogonality: [7.0, 8.0, 9.0],
        mounting: [10.0, 11.0, 12.0],
        accel_bias_a: [13.0, 14.0, 15.0],
        accel_scale: [16.0, 17.0, 18.0],
        gyro_bias_g: [19.0, 20.0, 21.0],
        gyro_scale: [22.0, 23.0, 24.0],
        axis_non_perpendicularity: 25.0,
        base_roll: 26.0,
        base_pitch: 27.0,
        heading: 28.0,
    }
}

fn row() -> [f64; PARAMETERS] {
    core::array::from_fn(|index| 100.0 + index as f64)
}

fn estimate() -> Estimate {
    Estimate { errors: errors(), sigmas: row() }
}

fn solution() -> Solution {
    let largest = LargestInnovation { normalized: 3.5, segment: 300, channel: 5 };
    Solution {
        estimate: estimate(),
        fit: Fit { chi_square: 80.5, measurements: 168, gated: 1, refused: 2, largest },
        degrees_of_freedom: 140,
        sweeps: 3,
        converged: true,
        segments: 37,
        left_out: 4,
        duration_s: 292.5,
        temperature_c: 35.5,
        effects: EffectEstimates {
            values: core::array::from_fn(|index| 200.0 + index as f32),
            sigmas: [0.5; EFFECT_STATES],
        },
        suspicion: Suspicion { change: Change::Slip(1), segment: 9, size: 0.5, sigmas: 2.5, limit: 5.0 },
        settings: SettingEvidence {
            earth_rate_score: [1.5, 2.5],
            earth_rate_information: [3.5, 4.5, 5.5],
            heading_rad: 6.5,
            heading_sigmas: 7.5,
        },
    }
}

fn verdict() -> Verdict {
    Verdict {
        reasons: [Reason::Refused(3), Reason::TooFewSegments(2)].into_iter().collect(),
        more: 1,
        changes: [Reason::Changed { parameter: 27, sigmas: 11.5 }].into_iter().collect(),
    }
}

fn stored() -> StoredCalibration {
    StoredCalibration {
        errors: errors(),
        sigmas: row(),
        method: Method::Bai,
        scheme: "bai".try_into().unwrap(),
        site: site(),
        utc_s: Some(1_790_000_000),
        temperature_c: 35.5,
        chi_square: 81.5,
        degrees_of_freedom: 84,
        software_version: "0.2.0".try_into().unwrap(),
        verdict: StoredVerdict::new(&verdict()),
        imu: Some(ImuIdentity { product: 16_495, serial: 300 }),
    }
}

fn calibrator() -> CalibratorConfig {
    CalibratorConfig {
        rate_hz: 200.0,
        stillness: Stillness { still_rad: 1e-4 },
        estimator: EstimatorConfig {
            method: Method::Joint,
            site: site(),
            noise: Noise { accel_psd_sqrt: 1.5, gyro_psd_sqrt: 2.5, encoder_sigma_rad: 3.5, margin: 4.5 },
            heading: HeadingSource::Configured { heading_rad: 1.0, sigma_rad: 0.25 },
            period_moves: Some(18),
            gate_sigma: Some(5.0),
            hardware: hardware(),
            site_sigmas: SiteSigmas { latitude_rad: 0.125, gravity_m_s2: 0.25 },
            tuning: BaiTuning::STATED,
        },
    }
}

fn hardware() -> Hardware {
    let mut hardware = Hardware::IDEAL;
    for (number, size) in (1_u8..).zip(&HARDWARE) {
        size.set(&mut hardware, number.into());
    }
    hardware
}

fn scheme() -> Scheme {
    Scheme {
        name: "mine".try_into().unwrap(),
        rate_rad_s: 0.25,
        acceleration_rad_s2: 0.5,
        first_stop_s: 10.0,
        legs: [Leg { outer_rad: -1.5, inner_rad: 1.25, stop_s: 8.0 }].into_iter().collect(),
        periods: 1,
    }
}

fn axis(first: f64) -> AxisLimits {
    AxisLimits {
        rate_rad_s: first,
        acceleration_rad_s2: first + 1.0,
        jerk_rad_s3: first + 2.0,
        travel: Travel::Limited { lowest_rad: first + 3.0, highest_rad: first + 4.0, turn: TurnSource::Stored },
        arrived_rad: first + 5.0,
        following_error_rad: first + 6.0,
        runaway_rad_s: first + 7.0,
    }
}

fn unit() -> UnitName {
    UnitName { name: "RINS 7".try_into().unwrap(), serial: "0007".try_into().unwrap() }
}

fn unlocated(refusal: LocateRefusal) -> Answer {
    Answer::Refused(Refusal::Locate(LocateError { axis: 1, refusal }))
}

fn motor(first: f64) -> MotorAndLoad {
    MotorAndLoad {
        inertia_kg_m2: first,
        coulomb_nm: first + 1.0,
        viscous_nm_s: first + 2.0,
        torque_constant_nm_a: first + 3.0,
        resistance_ohm: first + 4.0,
        inductance_h: first + 5.0,
        supply_v: first + 6.0,
        highest_current_a: first + 7.0,
        encoder_bits: 26,
    }
}

fn limits() -> VerdictLimits {
    VerdictLimits {
        installation_rad: 1.0,
        accel_bias_m_s2: 2.0,
        gyro_bias_rad_s: 3.0,
        scale: 4.0,
        non_perpendicularity_rad: 5.0,
        base_tilt_rad: 6.0,
        required_sigmas: Some(row()),
    }
}

fn pace() -> Pace {
    Pace { stop_repeats: 3, early_finish: true, longest_s: Some(60.0) }
}

fn policy() -> PowerUpPolicy {
    PowerUpPolicy::WhenDue { age_s: Some(3600), temperature_k: Some(5.5) }
}

fn fault(kind: FaultKind) -> Fault {
    Fault { axis: 1, angle_rad: -0.5, kind }
}

fn abort(reason: AbortReason) -> Abort {
    Abort { reason, during: State::Turn(3) }
}

#[test]
fn the_bytes_of_every_message_are_these() {
    assert_eq!(PROTOCOL_VERSION, 7, "the rows of this file are of this version");
    let counts = IntakeCounts { admitted: 60_000, repeated: 1, out_of_order: 2, non_finite: 3, gaps: 4, missing: 5 };
    let losses = LossCounts { overrun: 1, bus: 2, crc: 3, status: 4, unread: 5, restarted: 6 };
    let innovations =
        SegmentInnovations { segment: 300, normalized: [Some(1.5), None, Some(2.5), None, Some(3.5), Some(4.5)] };
    let progress = Progress { segments: 7, kind: SegmentKind::Move, end_us: 5_000_000, estimate: estimate() };
    check_bytes(table! { Message:
        Message::Store { .. } =>
            Message::Store { found: true, damaged: false, fault: true, other_version: Some(b'3') }, "00 01 00 01 01 33";
        Message::Decided(_) => Message::Decided(Decision::UseStored(Cause::WithinLimits)), "01 01 03";
        Message::Released => Message::Released, "02";
        Message::Refused(_) => Message::Refused(ConfigError::Rate), "03 00";
        Message::State { .. } => Message::State { time_us: 5_000_000, state: State::Turn(3), legs: 18 },
            "04 c0 96 b1 02 02 03 12";
        Message::Segment(_) => Message::Segment(progress), "455 bytes, CRC 849c677b";
        Message::Innovations(_) => Message::Innovations(innovations),
            "06 ac 02 01 00 00 c0 3f 00 01 00 00 20 40 00 01 00 00 60 40 01 00 00 90 40";
        Message::Solved { .. } => Message::Solved { solution: solution(), counts }, "1117 bytes, CRC 53aad4c1";
        Message::Covariance { .. } => Message::Covariance { row: 27, values: row() }, "226 bytes, CRC 8e399ceb";
        Message::Judged(_) => Message::Judged(verdict()), "09 02 07 03 04 02 01 01 17 1b 00 00 00 00 00 00 27 40";
        Message::Aborted(_) => Message::Aborted(abort(AbortReason::SampleLoss)), "0a 04 02 03";
        Message::Saved(_) => Message::Saved(true), "0b 01";
        Message::Corrected { .. } =>
            Message::Corrected { time_us: 5_000_000, force_s: [1.5, 2.5, 3.5], omega_is_s: [4.5, 5.5, 6.5] },
            "53 bytes, CRC b787a5e6";
        Message::Queue { .. } => Message::Queue { samples: 60_000, losses }, "0d e0 d4 03 01 02 03 04 05 06";
        Message::Fault(_) => Message::Fault(fault(FaultKind::Travel { limit_rad: 0.25 })),
            "0e 01 00 00 00 bf 03 00 00 80 3e";
        Message::Restarted(_) => Message::Restarted(Restart::Watchdog), "0f 02";
    });
}

#[test]
fn the_bytes_of_a_corrected_sample_are_these() {
    let report = CorrectedReport {
        number: 300,
        time_us: 5_000_000,
        force_s: [1.5, 2.5, 3.5],
        omega_is_s: [4.5, 5.5, 6.5],
        angles: [Angle::from_ticks(1), Angle::from_ticks(2)],
        status: SampleStatus::CALIBRATED_NOW.with(SampleStatus::SAMPLES_MISSED, true),
    };
    check_bytes(table! { CorrectedReport: CorrectedReport { .. } => report, "57 bytes, CRC e33e1eb9"; });
}

#[test]
fn the_bytes_of_every_command_are_these() {
    check_bytes(table! { Command:
        Command::Hello => Command::Hello, "00";
        Command::Status => Command::Status, "01";
        Command::Start => Command::Start, "02";
        Command::Abort => Command::Abort, "03";
        Command::Read(Item::Calibration) => Command::Read(Item::Calibration), "04 00";
        Command::Read(Item::Estimate) => Command::Read(Item::Estimate), "04 01";
        Command::Read(Item::Covariance { .. }) => Command::Read(Item::Covariance { row: 27 }), "04 02 1b";
        Command::Read(Item::Setting(SettingName::Calibrator)) => Command::Read(Item::Setting(SettingName::Calibrator)),
            "04 03 00";
        Command::Read(Item::Setting(SettingName::Scheme)) => Command::Read(Item::Setting(SettingName::Scheme)),
            "04 03 01";
        Command::Read(Item::Setting(SettingName::Axes)) => Command::Read(Item::Setting(SettingName::Axes)), "04 03 02";
        Command::Read(Item::Setting(SettingName::Limits)) => Command::Read(Item::Setting(SettingName::Limits)),
            "04 03 03";
        Command::Read(Item::Setting(SettingName::Pace)) => Command::Read(Item::Setting(SettingName::Pace)), "04 03 04";
        Command::Read(Item::Setting(SettingName::Policy)) => Command::Read(Item::Setting(SettingName::Policy)),
            "04 03 05";
        Command::Read(Item::Setting(SettingName::PowerUpUtc)) => Command::Read(Item::Setting(SettingName::PowerUpUtc)),
            "04 03 06";
        Command::Read(Item::Setting(SettingName::Motors)) => Command::Read(Item::Setting(SettingName::Motors)), "04 03 07";
        Command::Read(Item::History { .. }) => Command::Read(Item::History { back: 300 }), "04 04 ac 02";
        Command::Read(Item::Event { .. }) => Command::Read(Item::Event { back: 300 }), "04 05 ac 02";
        Command::Read(Item::Unit) => Command::Read(Item::Unit), "04 06";
        Command::Stream(_) => Command::Stream(true), "05 01";
        Command::Unlock(_) => Command::Unlock(300), "06 ac 02";
        Command::Set(Setting::Calibrator(_)) => Command::Set(Setting::Calibrator(calibrator())),
            "224 bytes, CRC 02102127";
        Command::Set(Setting::Scheme(_)) => Command::Set(Setting::Scheme(scheme())), "57 bytes, CRC 54b35564";
        Command::Set(Setting::Axes(_)) => Command::Set(Setting::Axes([axis(1.0), axis(11.0)])), "134 bytes, CRC dfdda196";
        Command::Set(Setting::Limits(_)) => Command::Set(Setting::Limits(limits())), "275 bytes, CRC c65dad80";
        Command::Set(Setting::Pace(_)) => Command::Set(Setting::Pace(pace())), "07 04 03 01 01 00 00 00 00 00 00 4e 40";
        Command::Set(Setting::Policy(_)) => Command::Set(Setting::Policy(policy())), "07 05 02 01 90 1c 01 00 00 b0 40";
        Command::Set(Setting::PowerUpUtc(_)) => Command::Set(Setting::PowerUpUtc(Some(1_790_000_000))),
            "07 06 01 80 f7 c4 d5 06";
        Command::Set(Setting::Motors(_)) => Command::Set(Setting::Motors([motor(1.0), motor(11.0)])), "132 bytes, CRC a937aa18";
        Command::Erase => Command::Erase, "08";
        Command::Stop => Command::Stop, "09";
        Command::Commission(_) => Command::Commission(unit()), "0a 06 52 49 4e 53 20 37 04 30 30 30 37";
        Command::Decommission => Command::Decommission, "0b";
        Command::ConfirmAngles(_) => Command::ConfirmAngles([Some(-1.5), None]), "0c 01 00 00 c0 bf 00";
    });
}

#[test]
fn the_bytes_of_every_answer_are_these() {
    let software = "0.2.0".try_into().unwrap();
    let hello = Hello { protocol: 5, software, store_format: b'4', scalar_bits: 64, states: 32 };
    let dropped = Dropped { corrupt: 1, version: 2 };
    let status = Status {
        time_us: 5_000_000,
        state: State::Dwell(3),
        legs: 18,
        segments: 7,
        left_s: 60.5,
        angles_rad: [1.5, 2.5],
        correcting: true,
        unlocked: false,
        motion_lock: Some(MotionLock::AfterReset),
        missing: 300,
        link: LinkCounts { dropped, not_understood: 3, overrun: 4, unsent: 5 },
    };
    let event = Entry { sequence: 300, time_us: 5_000_000, event: Event::Judged(3), repeats: 2 };
    check_bytes(table! { Answer:
        Answer::Done => Answer::Done, "00";
        Answer::Refused(Refusal::NotUnderstood) => Answer::Refused(Refusal::NotUnderstood), "01 00";
        Answer::Refused(Refusal::NotNow(_)) => Answer::Refused(Refusal::NotNow(State::Turn(3))), "01 01 02 03";
        Answer::Refused(Refusal::Policy) => Answer::Refused(Refusal::Policy), "01 02";
        Answer::Refused(Refusal::Locked) => Answer::Refused(Refusal::Locked), "01 03";
        Answer::Refused(Refusal::WrongWord) => Answer::Refused(Refusal::WrongWord), "01 04";
        Answer::Refused(Refusal::Config(_)) => Answer::Refused(Refusal::Config(ConfigError::Unobserved(27))),
            "01 05 0f 1b";
        Answer::Refused(Refusal::Nothing) => Answer::Refused(Refusal::Nothing), "01 06";
        Answer::Refused(Refusal::Memory) => Answer::Refused(Refusal::Memory), "01 07";
        Answer::Refused(Refusal::NotCommissioned) => Answer::Refused(Refusal::NotCommissioned), "01 08";
        Answer::Refused(Refusal::Locate(LocateError { refusal: LocateRefusal::Searching, .. })) =>
            unlocated(LocateRefusal::Searching), "01 09 01 00";
        Answer::Refused(Refusal::Locate(LocateError { refusal: LocateRefusal::Moving, .. })) =>
            unlocated(LocateRefusal::Moving), "01 09 01 01";
        Answer::Refused(Refusal::Locate(LocateError { refusal: LocateRefusal::Disagrees(_), .. })) =>
            unlocated(LocateRefusal::Disagrees(0.5)), "01 09 01 02 00 00 00 3f";
        Answer::Refused(Refusal::Locate(LocateError { refusal: LocateRefusal::Outside, .. })) =>
            unlocated(LocateRefusal::Outside), "01 09 01 03";
        Answer::Hello(_) => Answer::Hello(hello), "02 05 05 30 2e 32 2e 30 34 40 20";
        Answer::Status(_) => Answer::Status(status),
            "03 c0 96 b1 02 04 03 12 07 00 00 72 42 00 00 c0 3f 00 00 20 40 01 00 01 01 ac 02 01 02 03 04 05";
        Answer::Calibration(_) => Answer::Calibration(stored()), "518 bytes, CRC 7cf28942";
        Answer::Estimate { .. } => Answer::Estimate { segments: 7, estimate: estimate() }, "450 bytes, CRC aabcb290";
        Answer::Covariance { .. } => Answer::Covariance { row: 27, values: row() }, "226 bytes, CRC f0950c12";
        Answer::Setting(Setting::Calibrator(_)) => Answer::Setting(Setting::Calibrator(calibrator())),
            "224 bytes, CRC 02102127";
        Answer::Setting(Setting::Scheme(_)) => Answer::Setting(Setting::Scheme(scheme())), "57 bytes, CRC 54b35564";
        Answer::Setting(Setting::Axes(_)) => Answer::Setting(Setting::Axes([axis(1.0), axis(11.0)])),
            "134 bytes, CRC dfdda196";
        Answer::Setting(Setting::Limits(_)) => Answer::Setting(Setting::Limits(limits())), "275 bytes, CRC c65dad80";
        Answer::Setting(Setting::Pace(_)) => Answer::Setting(Setting::Pace(pace())),
            "07 04 03 01 01 00 00 00 00 00 00 4e 40";
        Answer::Setting(Setting::Policy(_)) => Answer::Setting(Setting::Policy(policy())),
            "07 05 02 01 90 1c 01 00 00 b0 40";
        Answer::Setting(Setting::PowerUpUtc(_)) => Answer::Setting(Setting::PowerUpUtc(Some(1_790_000_000))),
            "07 06 01 80 f7 c4 d5 06";
        Answer::Setting(Setting::Motors(_)) => Answer::Setting(Setting::Motors([motor(1.0), motor(11.0)])), "132 bytes, CRC a937aa18";
        Answer::Unit(_) => Answer::Unit(unit()), "09 06 52 49 4e 53 20 37 04 30 30 30 37";
        Answer::Event(_) => Answer::Event(event), "08 ac 02 c0 96 b1 02 06 03 02";
    });
}

#[test]
fn the_bytes_of_every_state_and_decision_are_these() {
    check_bytes(table! { State:
        State::PowerUp => State::PowerUp, "00";
        State::AwaitStill => State::AwaitStill, "01";
        State::Turn(_) => State::Turn(300), "02 ac 02";
        State::Settle(_) => State::Settle(300), "03 ac 02";
        State::Dwell(_) => State::Dwell(300), "04 ac 02";
        State::Weigh(_) => State::Weigh(300), "05 ac 02";
        State::Compute => State::Compute, "06";
        State::Verdict => State::Verdict, "07";
        State::Store => State::Store, "08";
        State::Correcting => State::Correcting, "09";
        State::StandBy => State::StandBy, "0a";
        State::Stopping => State::Stopping, "0b";
        State::Parking => State::Parking, "0c";
        State::Parked => State::Parked, "0d";
        State::Stranded => State::Stranded, "0e";
        State::Stopped => State::Stopped, "0f";
    });
    check_bytes(table! { Decision:
        Decision::Calibrate(Cause::Policy) => Decision::Calibrate(Cause::Policy), "00 00";
        Decision::Calibrate(Cause::Commanded) => Decision::Calibrate(Cause::Commanded), "00 01";
        Decision::Calibrate(Cause::NothingStored) => Decision::Calibrate(Cause::NothingStored), "00 02";
        Decision::Calibrate(Cause::WithinLimits) => Decision::Calibrate(Cause::WithinLimits), "00 03";
        Decision::Calibrate(Cause::Age { .. }) => Decision::Calibrate(Cause::Age { age_s: 300, limit_s: 200 }),
            "00 04 ac 02 c8 01";
        Decision::Calibrate(Cause::AgeUnknown) => Decision::Calibrate(Cause::AgeUnknown), "00 05";
        Decision::Calibrate(Cause::Temperature { .. }) =>
            Decision::Calibrate(Cause::Temperature { difference_k: 6.5, limit_k: 5.5 }), "00 06 00 00 d0 40 00 00 b0 40";
        Decision::Calibrate(Cause::TemperatureUnknown) => Decision::Calibrate(Cause::TemperatureUnknown), "00 07";
        Decision::Calibrate(Cause::ImuExchanged) => Decision::Calibrate(Cause::ImuExchanged), "00 08";
        Decision::Calibrate(Cause::NotCommissioned) => Decision::Calibrate(Cause::NotCommissioned), "00 09";
        Decision::Calibrate(Cause::AfterReset) => Decision::Calibrate(Cause::AfterReset), "00 0a";
        Decision::UseStored(_) => Decision::UseStored(Cause::Policy), "01 00";
        Decision::StandBy(_) => Decision::StandBy(Cause::Policy), "02 00";
    });
    check_bytes(table! { PowerUpPolicy:
        PowerUpPolicy::Always => PowerUpPolicy::Always, "00";
        PowerUpPolicy::OnCommand => PowerUpPolicy::OnCommand, "01";
        PowerUpPolicy::WhenDue { .. } => policy(), "02 01 90 1c 01 00 00 b0 40";
        PowerUpPolicy::Never => PowerUpPolicy::Never, "03";
    });
}

#[test]
fn the_bytes_of_every_error_of_a_configuration_are_these() {
    check_bytes(table! { ConfigError:
        ConfigError::Rate => ConfigError::Rate, "00";
        ConfigError::Noise => ConfigError::Noise, "01";
        ConfigError::Heading => ConfigError::Heading, "02";
        ConfigError::Stillness => ConfigError::Stillness, "03";
        ConfigError::OutOfBounds { number: BoundedNumber::Axis(_), .. } =>
            ConfigError::OutOfBounds { number: BoundedNumber::Axis(2), axis: Some(1) }, "04 00 02 01 01";
        ConfigError::OutOfBounds { number: BoundedNumber::Motor(_), .. } =>
            ConfigError::OutOfBounds { number: BoundedNumber::Motor(3), axis: None }, "04 01 03 00";
        ConfigError::OutOfBounds { number: BoundedNumber::AxisAndMotor(_), .. } =>
            ConfigError::OutOfBounds { number: BoundedNumber::AxisAndMotor(3), axis: Some(0) }, "04 02 03 01 00";
        ConfigError::Pace => ConfigError::Pace, "05";
        ConfigError::Policy => ConfigError::Policy, "06";
        ConfigError::Limits => ConfigError::Limits, "07";
        ConfigError::Hardware(_) => ConfigError::Hardware(3), "08 03";
        ConfigError::Segments => ConfigError::Segments, "09";
        ConfigError::Site => ConfigError::Site, "0a";
        ConfigError::Scheme(SchemeError::Motion) => ConfigError::Scheme(SchemeError::Motion), "0b 00";
        ConfigError::Scheme(SchemeError::Stop(_)) => ConfigError::Scheme(SchemeError::Stop(3)), "0b 01 03";
        ConfigError::Scheme(SchemeError::Leg(_)) => ConfigError::Scheme(SchemeError::Leg(3)), "0b 02 03";
        ConfigError::Scheme(SchemeError::Legs) => ConfigError::Scheme(SchemeError::Legs), "0b 03";
        ConfigError::Scheme(SchemeError::OpenPeriod) => ConfigError::Scheme(SchemeError::OpenPeriod), "0b 04";
        ConfigError::Scheme(SchemeError::Long) => ConfigError::Scheme(SchemeError::Long), "0b 05";
        ConfigError::TooFast(_) => ConfigError::TooFast(1), "0c 01";
        ConfigError::Travel { .. } => ConfigError::Travel { leg: 3, axis: 1 }, "0d 03 01";
        ConfigError::ShortStop(_) => ConfigError::ShortStop(3), "0e 03";
        ConfigError::Unobserved(_) => ConfigError::Unobserved(27), "0f 1b";
    });
}

#[test]
fn the_bytes_of_every_travel_are_these() {
    let limited = |turn| Travel::Limited { lowest_rad: -1.0, highest_rad: 0.5, turn };
    check_bytes(table! { Travel:
        Travel::Continuous => Travel::Continuous, "00";
        Travel::Limited { turn: TurnSource::Unique, .. } => limited(TurnSource::Unique),
            "01 00 00 00 00 00 00 f0 bf 00 00 00 00 00 00 e0 3f 00";
        Travel::Limited { turn: TurnSource::Stored, .. } => limited(TurnSource::Stored),
            "01 00 00 00 00 00 00 f0 bf 00 00 00 00 00 00 e0 3f 01";
        Travel::Limited { turn: TurnSource::Confirm, .. } => limited(TurnSource::Confirm),
            "01 00 00 00 00 00 00 f0 bf 00 00 00 00 00 00 e0 3f 02";
    });
}

#[test]
fn the_bytes_of_every_abort_and_fault_are_these() {
    check_bytes(table! { AbortReason:
        AbortReason::Commanded => AbortReason::Commanded, "00";
        AbortReason::NotStill => AbortReason::NotStill, "01";
        AbortReason::TurnTimeout => AbortReason::TurnTimeout, "02";
        AbortReason::Gimbal(_) => AbortReason::Gimbal(fault(FaultKind::Following { error_rad: 0.5 })),
            "03 01 00 00 00 bf 00 00 00 00 3f";
        AbortReason::SampleLoss => AbortReason::SampleLoss, "04";
        AbortReason::Stopped => AbortReason::Stopped, "05";
        AbortReason::SampleRate => AbortReason::SampleRate, "06";
        AbortReason::NotMarked => AbortReason::NotMarked, "07";
        AbortReason::ImuRestarted => AbortReason::ImuRestarted, "08";
    });
    check_bytes(table! { FaultKind:
        FaultKind::Following { .. } => FaultKind::Following { error_rad: 0.5 }, "00 00 00 00 3f";
        FaultKind::Stall { .. } => FaultKind::Stall { rate_rad_s: 0.5, wanted_rad_s: 0.25 }, "01 00 00 00 3f 00 00 80 3e";
        FaultKind::Runaway { .. } => FaultKind::Runaway { rate_rad_s: 0.5, wanted_rad_s: 0.25 },
            "02 00 00 00 3f 00 00 80 3e";
        FaultKind::Travel { .. } => FaultKind::Travel { limit_rad: 0.5 }, "03 00 00 00 3f";
        FaultKind::Encoder(EncoderFault::Silent) => FaultKind::Encoder(EncoderFault::Silent), "04 00";
        FaultKind::Encoder(EncoderFault::Crc) => FaultKind::Encoder(EncoderFault::Crc), "04 01";
        FaultKind::Encoder(EncoderFault::Alarm) => FaultKind::Encoder(EncoderFault::Alarm), "04 02";
        FaultKind::Encoder(EncoderFault::Jump(_)) => FaultKind::Encoder(EncoderFault::Jump(0.5)), "04 03 00 00 00 3f";
        FaultKind::Bridge(BridgeFault::Overcurrent) => FaultKind::Bridge(BridgeFault::Overcurrent), "05 00";
        FaultKind::Bridge(BridgeFault::Silent) => FaultKind::Bridge(BridgeFault::Silent), "05 01";
        FaultKind::Turn(TurnFault::Unknown) => FaultKind::Turn(TurnFault::Unknown), "06 00";
        FaultKind::Turn(TurnFault::Outside) => FaultKind::Turn(TurnFault::Outside), "06 01";
        FaultKind::NotFinite => FaultKind::NotFinite, "07";
    });
}

#[test]
fn the_bytes_of_every_event_and_restart_are_these() {
    check_bytes(table! { Event:
        Event::Restarted(_) => Event::Restarted(Restart::Pin), "00 03";
        Event::Stopped(_) => Event::Stopped(FatalError::Unfed), "01 01";
        Event::State(_) => Event::State(State::Turn(3)), "02 02 03";
        Event::Decided(_) => Event::Decided(Decision::StandBy(Cause::Policy)), "03 02 00";
        Event::Fault(_) => Event::Fault(fault(FaultKind::Travel { limit_rad: 0.25 })), "04 01 00 00 00 bf 03 00 00 80 3e";
        Event::Aborted(_) => Event::Aborted(abort(AbortReason::SampleLoss)), "05 04 02 03";
        Event::Judged(_) => Event::Judged(300), "06 ac 02";
        Event::Saved(_) => Event::Saved(true), "07 01";
        Event::Refused(_) => Event::Refused(ConfigError::Rate), "08 00";
        Event::StoreDamaged => Event::StoreDamaged, "09";
        Event::StoreFault => Event::StoreFault, "0a";
        Event::Released => Event::Released, "0b";
    });
    let registers = Registers { pc: 1, lr: 2, status: 3, address: 4 };
    check_bytes(table! { Restart:
        Restart::PowerOn => Restart::PowerOn, "00";
        Restart::Stopped(FatalError::Overdue(Task::Sampling)) => Restart::Stopped(FatalError::Overdue(Task::Sampling)), "01 00 00";
        Restart::Stopped(FatalError::Overdue(Task::Control)) => Restart::Stopped(FatalError::Overdue(Task::Control)), "01 00 01";
        Restart::Stopped(FatalError::Overdue(Task::Main)) => Restart::Stopped(FatalError::Overdue(Task::Main)), "01 00 02";
        Restart::Stopped(FatalError::Unfed) => Restart::Stopped(FatalError::Unfed), "01 01";
        Restart::Stopped(FatalError::Panic { .. }) => Restart::Stopped(FatalError::panic("main.rs", 300)),
            "01 02 07 6d 61 69 6e 2e 72 73 ac 02";
        Restart::Stopped(FatalError::Fault(_)) => Restart::Stopped(FatalError::Fault(registers)), "01 03 01 02 03 04";
        Restart::Stopped(FatalError::StackOverflow { .. }) => Restart::Stopped(FatalError::StackOverflow { pc: 300 }), "01 04 ac 02";
        Restart::Stopped(FatalError::Interrupt(_)) => Restart::Stopped(FatalError::Interrupt(300)), "01 05 ac 02";
        Restart::Stopped(FatalError::Board(_)) => Restart::Stopped(FatalError::board("encoder")), "01 06 07 65 6e 63 6f 64 65 72";
        Restart::Watchdog => Restart::Watchdog, "02";
        Restart::Pin => Restart::Pin, "03";
        Restart::Unexplained => Restart::Unexplained, "04";
        Restart::BrownOut => Restart::BrownOut, "05";
    });
}
