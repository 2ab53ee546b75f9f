//! Checks the wiring: finds swapped or reversed gyros, accelerometers and encoders, and names them.
//!
//! Every single mistake is tried: if the mistake is undone, the sums of stops and moves must agree with the gimbal
//! angles as those of a perfect instrument do, to within installation errors and base tilt. The gyros show which axis
//! turns, so a reversed encoder is not taken for a reversed accelerometer.

use crate::base::angle::{Angle, ticks_to_rad};
use crate::base::linear::{ComplexField, Real, Vector3};
use crate::model::error_model::{frame_rotation_x, frame_rotation_z};
use crate::segment::Segment;
use serde::{Deserialize, Serialize};

/// Squared misfit, as part of the squared measurements, that errors of 10 deg in installation and in base tilt cause: 2
/// (1 - cos 10 deg) for each of the two. It applies to the gyros and to the accelerometers.
const PLAUSIBLE_MISFIT: f64 = 0.06;
/// A mistake is reported if undoing it leaves at most this part of the misfit.
const EXPLAINED: f64 = 0.25;

/// One wiring mistake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Wiring {
    /// The sign of a channel is wrong. Channels: 0 to 2 are accelerometers x y z, 3 to 5 gyros x y z.
    Reversed(u8),
    /// Two channels of a triad are swapped: this channel and the next one, cyclically.
    Swapped(u8),
    /// The sign of an encoder is wrong: 0 for the outer encoder, 1 for the inner one.
    EncoderReversed(u8),
    /// The encoders are swapped.
    EncodersSwapped,
}

impl Wiring {
    fn all() -> impl Iterator<Item = Self> {
        let channels = (0..6).flat_map(|channel| [Self::Reversed(channel), Self::Swapped(channel)]);
        channels.chain((0..2).map(Self::EncoderReversed)).chain([Self::EncodersSwapped])
    }

    /// Undoes the mistake in the triad whose first channel is `first`.
    fn undone(self, first: u8, v: &Vector3<f64>) -> Vector3<f64> {
        let mut v = *v;
        let within = |channel: u8| channel.checked_sub(first).filter(|axis| *axis < 3).map(usize::from);
        match self {
            Self::Reversed(channel) => {
                if let Some(value) = within(channel).and_then(|axis| v.get_mut(axis)) {
                    *value = -*value;
                }
            }
            Self::Swapped(channel) => {
                if let Some(axis) = within(channel) {
                    v.swap_rows(axis, (axis + 1) % 3);
                }
            }
            Self::EncoderReversed(_) | Self::EncodersSwapped => {}
        }
        v
    }

    /// Undoes the mistake in the angles (outer, inner).
    fn undone_angles(self, [outer, inner]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::EncoderReversed(0) => [-outer, inner],
            Self::EncoderReversed(_) => [outer, -inner],
            Self::EncodersSwapped => [inner, outer],
            Self::Reversed(_) | Self::Swapped(_) => [outer, inner],
        }
    }
}

/// The mistake that explains the misfit of the segments, if there is one.
pub fn mistake<T: Real>(segments: &[Segment<T>]) -> Option<Wiring> {
    let as_it_is = misfit(segments, None);
    if as_it_is <= PLAUSIBLE_MISFIT {
        return None;
    }
    let mut best = (EXPLAINED * as_it_is, None);
    for wiring in Wiring::all() {
        let left = misfit(segments, Some(wiring));
        if left < best.0 {
            best = (left, Some(wiring));
        }
    }
    best.1
}

/// Squared misfit of the rotations of all moves and of the forces of all stops, each as part of the measurements.
fn misfit<T: Real>(segments: &[Segment<T>], wiring: Option<Wiring>) -> f64 {
    let mut sums = [(0.0, f64::MIN_POSITIVE); 2];
    let [turns, forces] = &mut sums;
    let mut stop = [0.0; 2];
    let undone = |first, v: &Vector3<T>| {
        let v = v.map(Real::widened);
        wiring.map_or(v, |wiring| wiring.undone(first, &v))
    };
    let undone_angles = |angles| wiring.map_or(angles, |wiring: Wiring| wiring.undone_angles(angles));
    for segment in segments {
        if let Some(standing) = segment.standing() {
            stop = undone_angles([radians(segment.outer), radians(segment.inner)]);
            add(forces, &undone(0, &standing.force_a), &up_r(stop));
        } else {
            let turned = undone_angles([segment.turned.outer.widened(), segment.turned.inner.widened()]);
            add(turns, &undone(3, &segment.rotation_g), &turn_r(stop, turned));
        }
    }
    sums.iter().map(|(misfit, measured)| misfit / measured).sum()
}

/// Adds the squared misfit of a direction. The prediction is scaled to the measured length, so only its direction
/// counts.
fn add(sums: &mut (f64, f64), measured: &Vector3<f64>, predicted: &Vector3<f64>) {
    let length = if predicted.norm() > 0.0 { measured.norm() / predicted.norm() } else { 0.0 };
    sums.0 += (measured - predicted * length).norm_squared();
    sums.1 += measured.norm_squared();
}

fn radians(angle: Angle) -> f64 {
    ticks_to_rad(i64::from(angle.ticks()))
}

/// The up direction in the rotation frame of a level base. (M3)
fn up_r([outer, inner]: [f64; 2]) -> Vector3<f64> {
    frame_rotation_z::<f64>(Angle::from_rad(inner)) * frame_rotation_x(Angle::from_rad(outer)) * Vector3::z()
}

/// Rotation of a move in the rotation frame, with the outer axis in its direction at the middle of the move. (M7)
fn turn_r([_, inner]: [f64; 2], [outer_turn, inner_turn]: [f64; 2]) -> Vector3<f64> {
    let (sin, cos) = ComplexField::sin_cos(inner + 0.5 * inner_turn);
    Vector3::new(cos * outer_turn, -sin * outer_turn, inner_turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::{AngleIntegrals, Course, Turned};
    use std::vec::Vec;

    const QUARTER: f64 = core::f64::consts::FRAC_PI_2;

    /// Outer and inner turns, in quarter turns, that affect every channel.
    const TURNS: [[f64; 2]; 6] = [[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]];

    /// A perfect instrument with one mistake, on a base tilted by a few degrees. Undoing the mistake once more makes
    /// it.
    fn segments(wiring: Option<Wiring>) -> Vec<Segment<f64>> {
        let made = |first, v: Vector3<f64>| wiring.map_or(v, |wiring| wiring.undone(first, &v));
        let made_angles = |angles| wiring.map_or(angles, |wiring: Wiring| wiring.undone_angles(angles));
        let up_b = Vector3::new(0.08, -0.05, 1.0).normalize() * 9.8;
        let stop = |at: [f64; 2]| {
            let rot = frame_rotation_z::<f64>(Angle::from_rad(at[1])) * frame_rotation_x(Angle::from_rad(at[0]));
            let [outer, inner] = made_angles(at).map(Angle::from_rad);
            let mut stop = Segment { outer, inner, ..Segment::quiet_stop(10_000_000) };
            stop.standing_mut().force_a = made(0, rot * up_b);
            stop
        };
        let mut at = [0.0; 2];
        let mut segments = std::vec![stop(at)];
        for turn in TURNS.map(|turn| turn.map(|quarters| quarters * QUARTER)) {
            let [outer, inner] = made_angles(turn);
            segments.push(Segment {
                rotation_g: made(3, turn_r(at, turn)),
                turned: Turned { outer, inner, ..Turned::default() },
                course: Course::Move(AngleIntegrals::default()),
                ..Segment::quiet_stop(10_000_000)
            });
            at = [at[0] + turn[0], at[1] + turn[1]];
            segments.push(stop(at));
        }
        segments
    }

    #[test]
    fn correct_wiring_gives_no_doubt() {
        assert_eq!(mistake(&segments(None)), None);
        assert_eq!(mistake::<f64>(&[]), None);
    }

    #[test]
    fn every_mistake_is_named() {
        for wiring in Wiring::all() {
            assert_eq!(mistake(&segments(Some(wiring))), Some(wiring));
        }
    }
}
