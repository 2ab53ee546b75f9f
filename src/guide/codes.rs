//! Every code that a message has has a page in the chapter `reasons`, and every page is of a code.

use crate::base::clock_check::ClockFault;
use crate::base::golden::{Row, table};
use crate::estimator::constancy::{Change, EarthRateAxis, Suspicion};
use crate::gimbal::{BridgeFault, EncoderFault, Fault, FaultKind, LocateError, LocateRefusal, TurnFault};
use crate::link::Refusal;
use crate::run::abort::AbortReason;
use crate::run::config::{BoundedNumber, ConfigError};
use crate::run::state::State;
use crate::scheme::SchemeError;
use crate::verdict::wiring::Wiring;
use crate::verdict::{Reason, Sensors, Unrest, WrongScale, WrongSetting};
use core::fmt::Display;
use std::collections::BTreeSet;
use std::format;
use std::string::ToString;
use std::vec::Vec;

const CHAPTER: &str = include_str!("reasons.md");

fn changing(change: Change) -> Reason {
    Reason::Changing(Suspicion { change, segment: 9, size: 0.5, sigmas: 6.0, limit: 5.0 })
}

fn of_reasons() -> Vec<Row<Reason>> {
    table! { Reason:
        Reason::Scale(_) => Reason::Scale(WrongScale::Speed(16.0)), "wrong-scale";
        Reason::Setting(WrongSetting::Latitude { .. }) =>
            Reason::Setting(WrongSetting::Latitude { felt_rad: 0.5, sigma_rad: 1e-4, configured_rad: 1.0 }),
            "wrong-latitude";
        Reason::Setting(WrongSetting::Heading { .. }) =>
            Reason::Setting(WrongSetting::Heading { off_rad: 0.5, sigmas: 6.0 }), "wrong-heading";
        Reason::Setting(WrongSetting::Gravity { .. }) =>
            Reason::Setting(WrongSetting::Gravity { of_configured: 1.5, configured_m_s2: 9.8 }), "wrong-gravity";
        Reason::NoiseLevel { .. } => Reason::NoiseLevel { sensors: Sensors::Gyros, ratio: 2.0 }, "noise-level";
        Reason::Cut { .. } => Reason::Cut { leg: 3, legs: 8 }, "cut-short";
        Reason::TooFewSegments(_) => Reason::TooFewSegments(2), "too-few-segments";
        Reason::NotConverged(_) => Reason::NotConverged(24), "not-converged";
        Reason::NotFinite { .. } => Reason::NotFinite { parameter: 0 }, "not-finite";
        Reason::Refused(_) => Reason::Refused(3), "refused-measurements";
        Reason::Unobserved { .. } => Reason::Unobserved { parameter: 0, of_prior: 0.5 }, "unobserved";
        Reason::Sigma { .. } => Reason::Sigma { parameter: 0, sigma: 0.5, required: 0.25 }, "sigma";
        Reason::Implausible { .. } => Reason::Implausible { parameter: 0, value: 0.5, limit: 0.25 }, "implausible";
        Reason::ChiSquare { .. } =>
            Reason::ChiSquare { chi_square: 220.0, degrees_of_freedom: 140, low: 71.5, high: 208.5 }, "chi-square";
        Reason::Innovation { .. } => Reason::Innovation { segment: 9, channel: 5, normalized: -7.5 }, "innovation";
        Reason::Unrest { unrest: Unrest::Variance(_) | Unrest::Trend(_), .. } =>
            Reason::Unrest { segment: 9, channel: 5, unrest: Unrest::Variance(2.0) }, "unrest";
        Reason::Unrest { unrest: Unrest::Stuck, .. } =>
            Reason::Unrest { segment: 9, channel: 5, unrest: Unrest::Stuck }, "stuck-channel";
        Reason::Noise { .. } => Reason::Noise { segment: 9, channel: 5, ratio: 2.0 }, "noise-rise";
        Reason::Trends { .. } => Reason::Trends { channel: 5, ratio: 2.0 }, "drift";
        Reason::Held { .. } => Reason::Held { segment: 9, channel: 5, samples: 64 }, "held-value";
        Reason::Stale { .. } => Reason::Stale { segment: 9, samples: 64 }, "stale-samples";
        Reason::Missing { .. } => Reason::Missing { missing: 300, of: 6000 }, "missing-samples";
        Reason::Changing(Suspicion { change: Change::Step(_), .. }) => changing(Change::Step(0)), "parameter-step";
        Reason::Changing(Suspicion { change: Change::Ramp(_), .. }) => changing(Change::Ramp(0)), "parameter-ramp";
        Reason::Changing(Suspicion { change: Change::Slip(_), .. }) => changing(Change::Slip(1)), "encoder-slip";
        Reason::Changing(Suspicion { change: Change::EncoderScale(_), .. }) => changing(Change::EncoderScale(1)),
            "encoder-scale";
        Reason::Changing(Suspicion { change: Change::Outlier(_), .. }) => changing(Change::Outlier(5)), "outlier";
        Reason::Changing(Suspicion { change: Change::EarthRate(_), .. }) =>
            changing(Change::EarthRate(EarthRateAxis::Up)), "earth-rate";
        Reason::Changing(Suspicion { change: Change::Heading, .. }) => changing(Change::Heading), "heading-error";
        Reason::Wiring(_) => Reason::Wiring(Wiring::EncodersSwapped), "wiring";
        Reason::Gap { .. } => Reason::Gap { segment: 9, longest_us: 250_000 }, "gap";
        Reason::LeftOut(_) => Reason::LeftOut(1), "left-out";
        Reason::Changed { .. } => Reason::Changed { parameter: 0, sigmas: 11.5 }, "changed";
        Reason::Hardware { .. } | Reason::Changing(Suspicion { change: Change::Effect(_) | Change::Kind(_), .. }) =>
            Reason::Hardware { effect: 0, size: 2e-4, sigma: 3e-5, configured: 6e-5 }, "hardware-effect";
        Reason::UnknownLatitude { .. } => Reason::UnknownLatitude { sigma_rad: 0.1 }, "unknown-latitude";
        Reason::Clock(ClockFault::Absent) => Reason::Clock(ClockFault::Absent), "no-clock";
        Reason::Clock(ClockFault::Off(_)) => Reason::Clock(ClockFault::Off(4000.0)), "clock-off";
        Reason::Clock(ClockFault::Unchecked) => Reason::Clock(ClockFault::Unchecked), "clock-not-checked";
    }
}

fn of_aborts() -> Vec<Row<AbortReason>> {
    let gimbal = |kind| AbortReason::Gimbal(Fault { axis: 0, angle_rad: 0.5, kind });
    table! { AbortReason:
        AbortReason::Commanded => AbortReason::Commanded, "commanded";
        AbortReason::Stopped => AbortReason::Stopped, "stopped";
        AbortReason::NotStill => AbortReason::NotStill, "not-still";
        AbortReason::TurnTimeout => AbortReason::TurnTimeout, "turn-timeout";
        AbortReason::SampleLoss => AbortReason::SampleLoss, "sample-loss";
        AbortReason::SampleRate => AbortReason::SampleRate, "sample-rate";
        AbortReason::NotMarked => AbortReason::NotMarked, "not-marked";
        AbortReason::ImuRestarted => AbortReason::ImuRestarted, "imu-restarted";
        AbortReason::Gimbal(Fault { kind: FaultKind::Following { .. }, .. }) =>
            gimbal(FaultKind::Following { error_rad: 0.5 }), "following";
        AbortReason::Gimbal(Fault { kind: FaultKind::Stall { .. }, .. }) =>
            gimbal(FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: 0.5 }), "stall";
        AbortReason::Gimbal(Fault { kind: FaultKind::Runaway { .. }, .. }) =>
            gimbal(FaultKind::Runaway { rate_rad_s: 1.0, wanted_rad_s: 0.5 }), "runaway";
        AbortReason::Gimbal(Fault { kind: FaultKind::Travel { .. }, .. }) =>
            gimbal(FaultKind::Travel { limit_rad: 0.5 }), "travel";
        AbortReason::Gimbal(Fault { kind: FaultKind::Encoder(EncoderFault::Silent), .. }) =>
            gimbal(FaultKind::Encoder(EncoderFault::Silent)), "encoder-silent";
        AbortReason::Gimbal(Fault { kind: FaultKind::Encoder(EncoderFault::Crc), .. }) =>
            gimbal(FaultKind::Encoder(EncoderFault::Crc)), "encoder-frames";
        AbortReason::Gimbal(Fault { kind: FaultKind::Encoder(EncoderFault::Alarm), .. }) =>
            gimbal(FaultKind::Encoder(EncoderFault::Alarm)), "encoder-alarm";
        AbortReason::Gimbal(Fault { kind: FaultKind::Encoder(EncoderFault::Jump(_)), .. }) =>
            gimbal(FaultKind::Encoder(EncoderFault::Jump(0.5))), "encoder-jump";
        AbortReason::Gimbal(Fault { kind: FaultKind::Bridge(BridgeFault::Overcurrent), .. }) =>
            gimbal(FaultKind::Bridge(BridgeFault::Overcurrent)), "bridge-fault";
        AbortReason::Gimbal(Fault { kind: FaultKind::Bridge(BridgeFault::Silent), .. }) =>
            gimbal(FaultKind::Bridge(BridgeFault::Silent)), "bridge-silent";
        AbortReason::Gimbal(Fault { kind: FaultKind::Turn(TurnFault::Unknown), .. }) =>
            gimbal(FaultKind::Turn(TurnFault::Unknown)), "turn-unknown";
        AbortReason::Gimbal(Fault { kind: FaultKind::Turn(TurnFault::Outside), .. }) =>
            gimbal(FaultKind::Turn(TurnFault::Outside)), "turn-outside";
        AbortReason::Gimbal(Fault { kind: FaultKind::NotFinite, .. }) => gimbal(FaultKind::NotFinite),
            "duty-not-finite";
    }
}

/// Those of a configuration are among them.
fn of_refusals() -> Vec<Row<Refusal>> {
    let config = Refusal::Config;
    let scheme = |error| Refusal::Config(ConfigError::Scheme(error));
    let unlocated = |refusal| Refusal::Locate(LocateError { axis: 0, refusal });
    table! { Refusal:
        Refusal::NotUnderstood => Refusal::NotUnderstood, "not-understood";
        Refusal::NotNow(_) => Refusal::NotNow(State::Compute), "not-now";
        Refusal::Policy => Refusal::Policy, "policy-never";
        Refusal::NotCommissioned => Refusal::NotCommissioned, "not-commissioned";
        Refusal::Locked => Refusal::Locked, "locked";
        Refusal::WrongWord => Refusal::WrongWord, "wrong-word";
        Refusal::Nothing => Refusal::Nothing, "nothing-there";
        Refusal::Locate(LocateError { refusal: LocateRefusal::Searching, .. }) => unlocated(LocateRefusal::Searching),
            "locate-searching";
        Refusal::Locate(LocateError { refusal: LocateRefusal::Moving, .. }) => unlocated(LocateRefusal::Moving),
            "locate-moving";
        Refusal::Locate(LocateError { refusal: LocateRefusal::Disagrees(_), .. }) =>
            unlocated(LocateRefusal::Disagrees(0.5)), "locate-disagrees";
        Refusal::Locate(LocateError { refusal: LocateRefusal::Outside, .. }) => unlocated(LocateRefusal::Outside),
            "locate-outside";
        Refusal::Memory => Refusal::Memory, "memory";
        Refusal::Config(ConfigError::Rate) => config(ConfigError::Rate), "config-rate";
        Refusal::Config(ConfigError::Noise) => config(ConfigError::Noise), "config-noise";
        Refusal::Config(ConfigError::Heading) => config(ConfigError::Heading), "config-heading";
        Refusal::Config(ConfigError::Stillness) => config(ConfigError::Stillness), "config-stillness";
        Refusal::Config(ConfigError::OutOfBounds { .. }) =>
            config(ConfigError::OutOfBounds { number: BoundedNumber::Axis(2), axis: Some(1) }), "config-bounds";
        Refusal::Config(ConfigError::Pace) => config(ConfigError::Pace), "config-pace";
        Refusal::Config(ConfigError::Policy) => config(ConfigError::Policy), "config-policy";
        Refusal::Config(ConfigError::Limits) => config(ConfigError::Limits), "config-limits";
        Refusal::Config(ConfigError::Hardware(_)) => config(ConfigError::Hardware(3)), "config-hardware";
        Refusal::Config(ConfigError::Site) => config(ConfigError::Site), "config-site";
        Refusal::Config(ConfigError::Segments) => config(ConfigError::Segments), "scheme-segments";
        Refusal::Config(ConfigError::TooFast(_)) => config(ConfigError::TooFast(1)), "scheme-fast";
        Refusal::Config(ConfigError::Travel { .. }) => config(ConfigError::Travel { leg: 3, axis: 1 }), "scheme-travel";
        Refusal::Config(ConfigError::ShortStop(_)) => config(ConfigError::ShortStop(3)), "scheme-short-stop";
        Refusal::Config(ConfigError::Unobserved(_)) => config(ConfigError::Unobserved(0)), "scheme-unobserved";
        Refusal::Config(ConfigError::Scheme(SchemeError::Motion)) => scheme(SchemeError::Motion), "scheme-motion";
        Refusal::Config(ConfigError::Scheme(SchemeError::Stop(_))) => scheme(SchemeError::Stop(3)), "scheme-stop";
        Refusal::Config(ConfigError::Scheme(SchemeError::Leg(_))) => scheme(SchemeError::Leg(3)), "scheme-leg";
        Refusal::Config(ConfigError::Scheme(SchemeError::Legs)) => scheme(SchemeError::Legs), "scheme-legs";
        Refusal::Config(ConfigError::Scheme(SchemeError::OpenPeriod)) => scheme(SchemeError::OpenPeriod),
            "scheme-open-period";
        Refusal::Config(ConfigError::Scheme(SchemeError::Long)) => scheme(SchemeError::Long), "scheme-long";
    }
}

/// The codes, each of which must be as pinned and be printed once, in front of its text.
fn checked<T: Display>(rows: Vec<Row<T>>, code: impl Fn(&T) -> &'static str) -> impl Iterator<Item = &'static str> {
    rows.into_iter().map(move |(matches, value, pinned)| {
        let (text, prefix) = (value.to_string(), format!("[{pinned}] "));
        assert!(matches && code(&value) == pinned, "{text}");
        let said = text.strip_prefix(&prefix).unwrap_or_else(|| panic!("{text}"));
        assert!(!said.contains(['[', '\n']) && said.len() > 12, "{text}");
        let is_kebab =
            pinned.split('-').all(|word| word.len() > 1 && word.bytes().all(|byte| byte.is_ascii_lowercase()));
        assert!(is_kebab, "{pinned}");
        pinned
    })
}

#[test]
fn every_code_is_unique_and_has_a_page_and_every_page_is_of_a_code() {
    let reasons = checked(of_reasons(), Reason::code);
    let others = checked(of_aborts(), AbortReason::code).chain(checked(of_refusals(), Refusal::code));
    let codes: Vec<_> = reasons.chain(others).collect();
    let unique: BTreeSet<_> = codes.iter().copied().collect();
    assert_eq!(unique.len(), codes.len(), "{codes:?}");
    let pages: Vec<_> = CHAPTER.lines().filter_map(|line| line.strip_prefix("### ")).collect();
    assert_eq!(pages.iter().copied().collect::<BTreeSet<_>>(), unique);
    assert_eq!(pages.len(), unique.len(), "a page is there twice");
}

#[test]
fn every_page_says_what_was_seen_what_it_means_why_and_what_to_do() {
    for page in CHAPTER.split("\n### ").skip(1) {
        let page = page.split("\n## ").next().unwrap_or_default();
        let lines: Vec<_> = page.lines().filter(|line| !line.is_empty()).collect();
        let begins = |line: usize, with: &str| lines.get(line).is_some_and(|text| text.starts_with(with));
        assert!(lines.get(1).is_some_and(|summary| summary.ends_with('.') && summary.len() < 120), "{page}");
        assert!(begins(2, "- Seen: ") && begins(3, "- Means: "), "{page}");
        assert!(begins(4, "- Likely causes: ") && begins(5, "- What to do: "), "{page}");
    }
}
