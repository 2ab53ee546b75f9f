//! What can go wrong with a gimbal axis, and its text.

use crate::base::units::{ARCSEC, DEG};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Names of the axes.
pub const AXIS_NAMES: [&str; 2] = ["outer", "inner"];

/// Why there is no reading of an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum EncoderFault {
    /// It does not answer, or the bus fails.
    Silent,
    /// Its frames are damaged.
    Crc,
    /// It reports an error of its own.
    Alarm,
    /// It reads this far from where the axis can be, rad.
    Jump(f32),
}

/// What a motor's bridge has against it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum BridgeFault {
    /// It reports too much current.
    Overcurrent,
    /// It does not take commands.
    Silent,
}

/// What is wrong. Numbers are for people, so `f32`: a fault goes with every sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the text of a variant says what its fields are")]
pub enum FaultKind {
    /// It is this far from its profile.
    Following { error_rad: f32 },
    /// It hardly turns where it should.
    Stall { rate_rad_s: f32, wanted_rad_s: f32 },
    /// It turns faster than it should, or the other way.
    Runaway { rate_rad_s: f32, wanted_rad_s: f32 },
    /// It turns out of its travel, or is told to.
    Travel { limit_rad: f32 },
    /// Its encoder is not believed.
    Encoder(EncoderFault),
    /// The bridge of its motor cannot be used.
    Bridge(BridgeFault),
}

/// A fault of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Axis: 0 outer, 1 inner.
    pub axis: u8,
    /// Where it was, counted over whole turns, rad.
    pub angle_rad: f32,
    /// What is wrong with it.
    pub kind: FaultKind,
}

impl FaultKind {
    /// Whether the encoder of the axis can be believed in spite of it, so that the axis is brought to rest under control.
    pub fn is_controllable(self) -> bool {
        matches!(self, Self::Following { .. } | Self::Travel { .. })
    }
}

impl Fault {
    /// Whether the axes may be turned again without anyone having looked at them.
    pub fn lets_park(&self) -> bool {
        self.kind.is_controllable()
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
            Self::Following { error_rad } => write!(f, "{:.2} deg from its profile", degrees(*error_rad)),
            Self::Stall { rate_rad_s, wanted_rad_s } => {
                write!(f, "stalled, {:.1} deg/s where {:.1} are wanted", degrees(*rate_rad_s), degrees(*wanted_rad_s))
            }
            Self::Runaway { rate_rad_s, wanted_rad_s } => {
                write!(f, "runs away, {:.1} deg/s where {:.1} are wanted", degrees(*rate_rad_s), degrees(*wanted_rad_s))
            }
            Self::Travel { limit_rad } => write!(f, "leaves its travel, which ends at {:.1} deg", degrees(*limit_rad)),
            Self::Encoder(fault) => write!(f, "its encoder {fault}"),
            Self::Bridge(BridgeFault::Overcurrent) => f.write_str("too much current in its motor"),
            Self::Bridge(BridgeFault::Silent) => f.write_str("its drive does not take commands"),
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
    fn a_text_names_axis_angle_and_number() {
        let fault = |axis, kind| Fault { axis, angle_rad: (-90.5 * DEG) as f32, kind }.to_string();
        let cases = [
            (
                fault(0, FaultKind::Following { error_rad: (1.004 * DEG) as f32 }),
                "outer axis at -90.50 deg: 1.00 deg from its profile",
            ),
            (
                fault(1, FaultKind::Runaway { rate_rad_s: (-6.0 * DEG) as f32, wanted_rad_s: (2.0 * DEG) as f32 }),
                "inner axis at -90.50 deg: runs away, -6.0 deg/s where 2.0 are wanted",
            ),
            (
                fault(1, FaultKind::Stall { rate_rad_s: 0.0, wanted_rad_s: (20.0 * DEG) as f32 }),
                "inner axis at -90.50 deg: stalled, 0.0 deg/s where 20.0 are wanted",
            ),
            (
                fault(0, FaultKind::Travel { limit_rad: (-360.0 * DEG) as f32 }),
                "outer axis at -90.50 deg: leaves its travel, which ends at -360.0 deg",
            ),
            (
                fault(0, FaultKind::Encoder(EncoderFault::Jump((30.0 * ARCSEC) as f32))),
                "outer axis at -90.50 deg: its encoder jumped by 30.0 arcsec",
            ),
            (
                fault(1, FaultKind::Encoder(EncoderFault::Crc)),
                "inner axis at -90.50 deg: its encoder sends damaged frames",
            ),
            (
                fault(0, FaultKind::Bridge(BridgeFault::Overcurrent)),
                "outer axis at -90.50 deg: too much current in its motor",
            ),
        ];
        for (text, expected) in cases {
            let (code, text) = text.split_once(' ').unwrap();
            assert!(code.starts_with('[') && code.ends_with(']'), "{code}");
            assert_eq!(text, expected);
        }
    }
}
