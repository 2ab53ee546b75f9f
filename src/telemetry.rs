//! Messages of the firmware to the host: postcard in COBS frames, each ended by a zero byte.

use crate::calibrator::Progress;
use crate::error_model::PARAMETERS;
use crate::estimator::{SegmentInnovations, Solution};
use crate::intake::IntakeCounts;
use crate::policy::Decision;
use crate::queue::Losses;
use crate::self_calibration::ConfigError;
use crate::sequencer::{AbortReason, State};
use crate::verdict::Verdict;
use serde::{Deserialize, Serialize};

/// Greatest length of a message, bytes.
pub const MAX_MESSAGE_BYTES: usize = 1000;
/// Greatest length of its frame, bytes: one more for every started 254, and the end.
pub const MAX_FRAME_BYTES: usize = MAX_MESSAGE_BYTES + MAX_MESSAGE_BYTES / 254 + 2;

/// What the instrument tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// What the calibration store held at power-up.
    Store {
        /// A good record was found.
        found: bool,
        /// A slot is damaged.
        damaged: bool,
        /// The memory does not answer, or is too small.
        fault: bool,
    },
    /// What is done at power-up or on command, and why.
    Decided(Decision),
    /// The axes did not follow where they should stand: their drives are told to rest, and the encoders not believed.
    Released,
    /// The configuration is refused.
    Refused(ConfigError),
    /// The run has entered a state.
    State {
        /// Time, us.
        time_us: u64,
        /// The state.
        state: State,
        /// Legs of the whole run.
        legs: u16,
    },
    /// A segment has ended.
    Segment(Progress),
    /// How far a segment is from what all others say.
    Innovations(SegmentInnovations),
    /// All segments are processed.
    Solved {
        /// The solution.
        solution: Solution,
        /// What became of the samples.
        counts: IntakeCounts,
    },
    /// One row of the covariance of the parameters, SI.
    Covariance {
        /// Parameter of the row.
        row: u8,
        /// The row.
        values: [f64; PARAMETERS],
    },
    /// The solution is judged.
    Judged(Verdict),
    /// The run was given up.
    Aborted(AbortReason),
    /// Storing has ended; whether it went well.
    Saved(bool),
    /// A corrected sample, once a second.
    Corrected {
        /// Time, us.
        time_us: u64,
        /// Specific force in the IMU frame, m/s^2.
        force_s: [f64; 3],
        /// Inertial angular rate of the IMU frame in the IMU frame, rad/s.
        omega_is_s: [f64; 3],
    },
    /// At the end: samples taken from the queue, and samples that never got there.
    Queue {
        /// Samples taken.
        samples: u64,
        /// Samples missing.
        losses: Losses,
    },
}

/// Frames a message; `None` if it is longer than [`MAX_MESSAGE_BYTES`].
pub fn encode<'a, M: Serialize>(message: &M, buffer: &'a mut [u8; MAX_FRAME_BYTES]) -> Option<&'a [u8]> {
    let mut scratch = [0; MAX_MESSAGE_BYTES];
    let payload = postcard::to_slice(message, &mut scratch).ok()?;
    let length = frame(payload, buffer)?;
    buffer.get(..length)
}

/// Consistent-overhead byte stuffing (Cheshire and Baker 1999) of `payload` and the zero byte after it. postcard's own
/// can panic.
fn frame(payload: &[u8], frame: &mut [u8]) -> Option<usize> {
    let mut length = 0;
    for run in payload.split(|byte| *byte == 0) {
        let mut blocks = run.chunks_exact(254);
        for block in &mut blocks {
            put(0xff, block, frame, &mut length)?;
        }
        let rest = blocks.remainder();
        put(u8::try_from(rest.len() + 1).ok()?, rest, frame, &mut length)?;
    }
    put(0, &[], frame, &mut length)?;
    Some(length)
}

fn put(code: u8, block: &[u8], frame: &mut [u8], length: &mut usize) -> Option<()> {
    let (first, rest) = frame.get_mut(*length..)?.split_first_mut()?;
    *first = code;
    rest.get_mut(..block.len())?.copy_from_slice(block);
    *length += 1 + block.len();
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn framed(payload: &[u8]) -> Vec<u8> {
        let mut buffer = [0xaa; MAX_FRAME_BYTES];
        let length = frame(payload, &mut buffer).unwrap();
        buffer[..length].to_vec()
    }

    #[test]
    fn examples_of_the_literature() {
        assert_eq!(framed(&[]), [1, 0]);
        assert_eq!(framed(&[0]), [1, 1, 0]);
        assert_eq!(framed(&[0x11, 0x22, 0, 0x33]), [3, 0x11, 0x22, 2, 0x33, 0]);
        assert_eq!(framed(&[0x11, 0, 0, 0]), [2, 0x11, 1, 1, 1, 0]);
    }

    #[test]
    fn a_frame_holds_its_message_and_one_zero() {
        for length in (0..=MAX_MESSAGE_BYTES).step_by(2) {
            for period in [1, 7, 254, 255, 2000] {
                let payload: Vec<u8> = (0..length)
                    .map(|index| if index % period == period - 1 { 0 } else { 1 + (index % 255) as u8 })
                    .collect();
                let mut frame = framed(&payload);
                assert_eq!(frame.pop(), Some(0));
                assert!(frame.iter().all(|byte| *byte != 0));
                assert_eq!(unstuffed(&frame), payload, "{length} bytes, a zero every {period}");
            }
        }
    }

    /// The definition, read backwards.
    fn unstuffed(mut frame: &[u8]) -> Vec<u8> {
        let mut payload = Vec::new();
        while let [code, rest @ ..] = frame {
            let (block, next) = rest.split_at(usize::from(*code) - 1);
            payload.extend_from_slice(block);
            if *code < 0xff && !next.is_empty() {
                payload.push(0);
            }
            frame = next;
        }
        payload
    }

    #[test]
    fn a_message_comes_back() {
        let losses = Losses { crc: 300, ..Losses::default() };
        let message = Message::Queue { samples: 200, losses };
        let mut buffer = [0; MAX_FRAME_BYTES];
        let frame = encode(&message, &mut buffer).unwrap();
        let payload = unstuffed(&frame[..frame.len() - 1]);
        assert_eq!(postcard::from_bytes(&payload), Ok(message));
    }
}
