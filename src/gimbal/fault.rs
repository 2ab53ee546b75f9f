//! Faults of a gimbal axis and their messages.

use crate::base::units::{ARCSEC, DEG};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Names of the axes.
pub const AXIS_NAMES: [&str; 2] = ["outer", "inner"];

/// Why an encoder gives no valid reading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EncoderFault {
    /// The encoder does not answer, or its bus fails.
    Silent,
    /// The frames of the encoder are damaged.
    Crc,
    /// The encoder reports an error of its own.
    Alarm,
    /// The reading is farther from the expected angle than the axis can have moved; the difference, rad.
    Jump(f32),
}

/// Fault of the bridge of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BridgeFault {
    /// The bridge reports a fault: overcurrent, over-temperature or undervoltage.
    Overcurrent,
    /// The bridge does not accept commands.
    Silent,
}

/// Why an axis of limited travel must not move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TurnFault {
    /// The turn on which the axis stands is not known.
    Unknown,
    /// The axis stands outside of its travel.
    Outside,
}

/// Kind of a fault. The numbers are for messages only, so they are `f32`: every sample carries a copy of the fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(missing_docs, reason = "the documentation of a variant explains its fields")]
pub enum FaultKind {
    /// The axis is this far from its profile.
    Following { error_rad: f32 },
    /// The axis turns at less than a quarter of its commanded rate.
    Stall { rate_rad_s: f32, wanted_rad_s: f32 },
    /// The axis turns faster than commanded, or in the opposite direction.
    Runaway { rate_rad_s: f32, wanted_rad_s: f32 },
    /// The axis moves, or was commanded to move, beyond this travel limit.
    Travel { limit_rad: f32 },
    /// The encoder of the axis has given no valid reading for several control periods.
    Encoder(EncoderFault),
    /// The bridge of the motor failed.
    Bridge(BridgeFault),
    /// The axis was commanded to move, but it is not known in which direction its cables permit that.
    Turn(TurnFault),
    /// The servo has computed a duty that is not finite. The bridge does not get such a duty.
    NotFinite,
}

/// A fault of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// Axis: 0 is the outer axis, 1 the inner axis.
    pub axis: u8,
    /// Angle of the axis at the fault, counted over whole turns, rad.
    pub angle_rad: f32,
    /// Kind of the fault.
    pub kind: FaultKind,
}

impl FaultKind {
    /// Whether encoder and motor of the axis can still be trusted, so that the axis can brake under control.
    pub fn is_controllable(self) -> bool {
        matches!(self, Self::Following { .. } | Self::Travel { .. } | Self::Turn(_))
    }
}

impl Fault {
    /// Whether the axes may move to their parking angles without an inspection by a person.
    pub fn allows_parking(&self) -> bool {
        matches!(self.kind, FaultKind::Following { .. } | FaultKind::Travel { .. })
    }
}

impl FaultKind {
    /// Short name of the fault. It is printed with the text, and `rins explain` shows its page of the guide.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Following { .. } => "following",
            Self::Stall { .. } => "stall",
            Self::Runaway { .. } => "runaway",
            Self::Travel { .. } => "travel",
            Self::Encoder(EncoderFault::Silent) => "encoder-silent",
            Self::Encoder(EncoderFault::Crc) => "encoder-frames",
            Self::Encoder(EncoderFault::Alarm) => "encoder-alarm",
            Self::Encoder(EncoderFault::Jump(_)) => "encoder-jump",
            Self::Bridge(BridgeFault::Overcurrent) => "bridge-fault",
            Self::Bridge(BridgeFault::Silent) => "bridge-silent",
            Self::Turn(TurnFault::Unknown) => "turn-unknown",
            Self::Turn(TurnFault::Outside) => "turn-outside",
            Self::NotFinite => "duty-not-finite",
        }
    }
}

fn degrees(angle_rad: f32) -> f64 {
    f64::from(angle_rad) / DEG
}

impl fmt::Display for EncoderFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => f.write_str("does not answer"),
            Self::Crc => f.write_str("sends damaged frames"),
            Self::Alarm => f.write_str("reports an error"),
            Self::Jump(off_rad) => write!(f, "jumped by {:.1} arcsec", f64::from(*off_rad) / ARCSEC),
        }
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Following { error_rad } => write!(f, "following error of {:.2} deg", degrees(*error_rad)),
            Self::Stall { rate_rad_s, wanted_rad_s } => {
                write!(f, "stalled at {:.1} deg/s, commanded {:.1} deg/s", degrees(*rate_rad_s), degrees(*wanted_rad_s))
            }
            Self::Runaway { rate_rad_s, wanted_rad_s } => {
                write!(f, "runaway at {:.1} deg/s, commanded {:.1} deg/s", degrees(*rate_rad_s), degrees(*wanted_rad_s))
            }
            Self::Travel { limit_rad } => write!(f, "motion beyond the travel limit of {:.1} deg", degrees(*limit_rad)),
            Self::Encoder(fault) => write!(f, "encoder {fault}"),
            Self::Bridge(BridgeFault::Overcurrent) => {
                f.write_str("motor bridge fault (overcurrent, over-temperature or undervoltage)")
            }
            Self::Bridge(BridgeFault::Silent) => f.write_str("motor bridge does not accept commands"),
            Self::Turn(TurnFault::Unknown) => f.write_str(
                "the turn on which the axis stands is not known, so it does not move: look at its cables, and enter its \
                 angle counted over whole turns",
            ),
            Self::Turn(TurnFault::Outside) => {
                f.write_str("the axis stands outside of its travel, so it does not move: turn it back by hand")
            }
            Self::NotFinite => f.write_str("the control loop computed no finite duty, and the winding was shorted"),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = AXIS_NAMES.get(usize::from(self.axis)).copied().unwrap_or("?");
        write!(f, "[{}] ", self.kind.code())?;
        write!(f, "{name} axis at {:.2} deg: {}", degrees(self.angle_rad), self.kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_faults_that_leave_encoder_motor_and_turn_known_allow_parking() {
        let allows = |kind| Fault { axis: 0, angle_rad: 0.0, kind }.allows_parking();
        assert!(allows(FaultKind::Following { error_rad: 1.0 }) && allows(FaultKind::Travel { limit_rad: 1.0 }));
        let turns = [TurnFault::Unknown, TurnFault::Outside].map(FaultKind::Turn);
        assert!(!turns.into_iter().any(allows) && turns.into_iter().all(FaultKind::is_controllable));
        assert!(!allows(FaultKind::NotFinite) && !FaultKind::NotFinite.is_controllable());
    }

    #[test]
    fn a_message_contains_axis_angle_and_number() {
        let fault = |axis, kind| Fault { axis, angle_rad: (-90.5 * DEG) as f32, kind }.to_string();
        let cases = [
            (
                fault(0, FaultKind::Following { error_rad: (1.004 * DEG) as f32 }),
                "outer axis at -90.50 deg: following error of 1.00 deg",
            ),
            (
                fault(1, FaultKind::Runaway { rate_rad_s: (-6.0 * DEG) as f32, wanted_rad_s: (2.0 * DEG) as f32 }),
                "inner axis at -90.50 deg: runaway at -6.0 deg/s, commanded 2.0 deg/s",
            ),
            (
                fault(1, FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: (20.0 * DEG) as f32 }),
                "inner axis at -90.50 deg: stalled at 0.0 deg/s, commanded 20.0 deg/s",
            ),
            (
                fault(0, FaultKind::Travel { limit_rad: (-360.0 * DEG) as f32 }),
                "outer axis at -90.50 deg: motion beyond the travel limit of -360.0 deg",
            ),
            (
                fault(0, FaultKind::Encoder(EncoderFault::Jump((30.0 * ARCSEC) as f32))),
                "outer axis at -90.50 deg: encoder jumped by 30.0 arcsec",
            ),
            (fault(1, FaultKind::Encoder(EncoderFault::Crc)), "inner axis at -90.50 deg: encoder sends damaged frames"),
            (
                fault(0, FaultKind::Bridge(BridgeFault::Overcurrent)),
                "outer axis at -90.50 deg: motor bridge fault (overcurrent, over-temperature or undervoltage)",
            ),
            (
                fault(1, FaultKind::Turn(TurnFault::Outside)),
                "inner axis at -90.50 deg: the axis stands outside of its travel, so it does not move: turn it back by hand",
            ),
        ];
        for (text, expected) in cases {
            let (code, text) = text.split_once(' ').unwrap();
            assert!(code.starts_with('[') && code.ends_with(']'), "{code}");
            assert_eq!(text, expected);
        }
    }
}
