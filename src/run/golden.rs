//! Golden bytes of the reasons, which are stored with a calibration. A change of a row needs a new [`REASONS_SCHEMA`],
//! unless the row belongs to a new variant at the end of its type.

use super::result::REASONS_SCHEMA;
use crate::base::clock_check::ClockFault;
use crate::base::golden::{check_bytes, table};
use crate::estimator::constancy::{Change, EarthRateAxis, Suspicion};
use crate::verdict::wiring::Wiring;
use crate::verdict::{Reason, Sensors, Unrest, WrongScale, WrongSetting};

fn changing(change: Change) -> Reason {
    Reason::Changing(Suspicion { change, segment: 300, size: 0.5, sigmas: 6.0, limit: 5.0 })
}

#[test]
fn the_bytes_of_every_reason_are_these() {
    assert_eq!(REASONS_SCHEMA, 1, "the rows below are of this version");
    check_bytes(table! { Reason:
        Reason::Scale(WrongScale::Force { .. }) => Reason::Scale(WrongScale::Force { of_gravity: 0.5, interval_s: 2.0 }),
            "00 00 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 00 40";
        Reason::Scale(WrongScale::Turn { .. }) => Reason::Scale(WrongScale::Turn { of_encoders: 0.5, interval_s: 2.0 }),
            "00 01 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 00 40";
        Reason::Scale(WrongScale::Speed(_)) => Reason::Scale(WrongScale::Speed(0.5)), "00 02 00 00 00 00 00 00 e0 3f";
        Reason::Setting(WrongSetting::Latitude { .. }) =>
            Reason::Setting(WrongSetting::Latitude { felt_rad: 0.5, sigma_rad: 0.25, configured_rad: 1.0 }),
            "01 00 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 d0 3f 00 00 00 00 00 00 f0 3f";
        Reason::Setting(WrongSetting::Heading { .. }) =>
            Reason::Setting(WrongSetting::Heading { off_rad: 0.5, sigmas: 6.0 }),
            "01 01 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40";
        Reason::Setting(WrongSetting::Gravity { .. }) =>
            Reason::Setting(WrongSetting::Gravity { of_configured: 1.5, configured_m_s2: 9.75 }),
            "01 02 00 00 00 00 00 00 f8 3f 00 00 00 00 00 80 23 40";
        Reason::NoiseLevel { sensors: Sensors::Channel(_), .. } =>
            Reason::NoiseLevel { sensors: Sensors::Channel(5), ratio: 2.0 }, "02 00 05 00 00 00 00 00 00 00 40";
        Reason::NoiseLevel { sensors: Sensors::Accelerometers, .. } =>
            Reason::NoiseLevel { sensors: Sensors::Accelerometers, ratio: 2.0 }, "02 01 00 00 00 00 00 00 00 40";
        Reason::NoiseLevel { sensors: Sensors::Gyros, .. } =>
            Reason::NoiseLevel { sensors: Sensors::Gyros, ratio: 2.0 }, "02 02 00 00 00 00 00 00 00 40";
        Reason::Cut { .. } => Reason::Cut { leg: 3, legs: 300 }, "03 03 ac 02";
        Reason::TooFewSegments(_) => Reason::TooFewSegments(2), "04 02";
        Reason::NotConverged(_) => Reason::NotConverged(24), "05 18";
        Reason::NotFinite { .. } => Reason::NotFinite { parameter: 27 }, "06 1b";
        Reason::Refused(_) => Reason::Refused(300), "07 ac 02";
        Reason::Unobserved { .. } => Reason::Unobserved { parameter: 27, of_prior: 0.5 }, "08 1b 00 00 00 00 00 00 e0 3f";
        Reason::Sigma { .. } => Reason::Sigma { parameter: 27, sigma: 0.5, required: 0.25 },
            "09 1b 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 d0 3f";
        Reason::Implausible { .. } => Reason::Implausible { parameter: 27, value: 0.5, limit: 0.25 },
            "0a 1b 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 d0 3f";
        Reason::ChiSquare { .. } =>
            Reason::ChiSquare { chi_square: 220.0, degrees_of_freedom: 140, low: 71.5, high: 208.5 },
            "0b 00 00 00 00 00 80 6b 40 8c 01 00 00 00 00 00 e0 51 40 00 00 00 00 00 10 6a 40";
        Reason::Innovation { .. } => Reason::Innovation { segment: 300, channel: 5, normalized: -7.5 },
            "0c ac 02 05 00 00 00 00 00 00 1e c0";
        Reason::Unrest { unrest: Unrest::Variance(_), .. } =>
            Reason::Unrest { segment: 300, channel: 5, unrest: Unrest::Variance(2.0) }, "0d ac 02 05 00 00 00 00 40";
        Reason::Unrest { unrest: Unrest::Trend(_), .. } =>
            Reason::Unrest { segment: 300, channel: 5, unrest: Unrest::Trend(6.0) }, "0d ac 02 05 01 00 00 c0 40";
        Reason::Unrest { unrest: Unrest::Stuck, .. } =>
            Reason::Unrest { segment: 300, channel: 5, unrest: Unrest::Stuck }, "0d ac 02 05 02";
        Reason::Noise { .. } => Reason::Noise { segment: 300, channel: 5, ratio: 2.0 },
            "0e ac 02 05 00 00 00 00 00 00 00 40";
        Reason::Trends { .. } => Reason::Trends { channel: 5, ratio: 2.0 }, "0f 05 00 00 00 00 00 00 00 40";
        Reason::Held { .. } => Reason::Held { segment: 300, channel: 5, samples: 64 }, "10 ac 02 05 40";
        Reason::Stale { .. } => Reason::Stale { segment: 300, samples: 64 }, "11 ac 02 40";
        Reason::Missing { .. } => Reason::Missing { missing: 300, of: 60_000 }, "12 ac 02 e0 d4 03";
        Reason::Changing(Suspicion { change: Change::Step(_), .. }) => changing(Change::Step(27)),
            "13 00 1b ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::Ramp(_), .. }) => changing(Change::Ramp(27)),
            "13 01 1b ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::Slip(_), .. }) => changing(Change::Slip(1)),
            "13 02 01 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::EncoderScale(_), .. }) => changing(Change::EncoderScale(1)),
            "13 03 01 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::Outlier(_), .. }) => changing(Change::Outlier(5)),
            "13 04 05 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::EarthRate(EarthRateAxis::North), .. }) =>
            changing(Change::EarthRate(EarthRateAxis::North)),
            "13 05 00 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::EarthRate(EarthRateAxis::Up), .. }) =>
            changing(Change::EarthRate(EarthRateAxis::Up)),
            "13 05 01 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::EarthRate(EarthRateAxis::Both), .. }) =>
            changing(Change::EarthRate(EarthRateAxis::Both)),
            "13 05 02 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::Heading, .. }) => changing(Change::Heading),
            "13 06 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Wiring(Wiring::Reversed(_)) => Reason::Wiring(Wiring::Reversed(5)), "14 00 05";
        Reason::Wiring(Wiring::Swapped(_)) => Reason::Wiring(Wiring::Swapped(5)), "14 01 05";
        Reason::Wiring(Wiring::EncoderReversed(_)) => Reason::Wiring(Wiring::EncoderReversed(1)), "14 02 01";
        Reason::Wiring(Wiring::EncodersSwapped) => Reason::Wiring(Wiring::EncodersSwapped), "14 03";
        Reason::Gap { .. } => Reason::Gap { segment: 300, longest_us: 250_000 }, "15 ac 02 90 a1 0f";
        Reason::LeftOut(_) => Reason::LeftOut(300), "16 ac 02";
        Reason::Changed { .. } => Reason::Changed { parameter: 27, sigmas: 11.5 }, "17 1b 00 00 00 00 00 00 27 40";
        Reason::Changing(Suspicion { change: Change::Effect(_), .. }) => changing(Change::Effect(58)),
            "13 07 3a ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Changing(Suspicion { change: Change::Kind(_), .. }) => changing(Change::Kind(16)),
            "13 08 10 ac 02 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 18 40 00 00 00 00 00 00 14 40";
        Reason::Hardware { .. } => Reason::Hardware { effect: 58, size: 0.5, sigma: 0.25, configured: 2.0 },
            "18 3a 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 d0 3f 00 00 00 00 00 00 00 40";
        Reason::UnknownLatitude { .. } => Reason::UnknownLatitude { sigma_rad: 0.5 }, "19 00 00 00 00 00 00 e0 3f";
        Reason::Clock(ClockFault::Absent) => Reason::Clock(ClockFault::Absent), "1a 00";
        Reason::Clock(ClockFault::Off(_)) => Reason::Clock(ClockFault::Off(-2.0)), "1a 01 00 00 00 c0";
        Reason::Clock(ClockFault::Unchecked) => Reason::Clock(ClockFault::Unchecked), "1a 02";
    });
}
