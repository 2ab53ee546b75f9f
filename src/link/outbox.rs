//! The frames that wait to be sent. Their memory is bounded, and nothing waits for room in it.
//!
//! Each lane has its own memory. Urgent frames are sent first, then answers, then live values. So commands, however many
//! arrive, never cost an urgent frame, and live values never delay a verdict. A frame that does not fit is left out as a
//! whole and counted.

use heapless::Deque;

/// The priority of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Lane {
    /// States, verdicts and faults.
    Urgent,
    /// Answers to commands.
    Answer,
    /// Live values. Newer values will follow.
    Routine,
}

/// Frames as bytes. A zero byte ends each frame.
#[derive(Debug)]
pub struct Outbox<const URGENT: usize, const ANSWER: usize, const ROUTINE: usize> {
    urgent: Deque<u8, URGENT>,
    answer: Deque<u8, ANSWER>,
    routine: Deque<u8, ROUTINE>,
    /// The lane of the frame that is partly sent, if there is a partly sent frame.
    sending: Option<Lane>,
    unsent: u32,
}

impl<const URGENT: usize, const ANSWER: usize, const ROUTINE: usize> Default for Outbox<URGENT, ANSWER, ROUTINE> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const URGENT: usize, const ANSWER: usize, const ROUTINE: usize> Outbox<URGENT, ANSWER, ROUTINE> {
    /// An empty outbox.
    pub const fn new() -> Self {
        Self { urgent: Deque::new(), answer: Deque::new(), routine: Deque::new(), sending: None, unsent: 0 }
    }

    /// Stores a whole frame, or counts it if it does not fit.
    pub fn put(&mut self, frame: &[u8], lane: Lane) {
        let taken = match lane {
            Lane::Urgent => put(&mut self.urgent, frame),
            Lane::Answer => put(&mut self.answer, frame),
            Lane::Routine => put(&mut self.routine, frame),
        };
        self.count(!taken);
    }

    /// Counts a frame that was not sent.
    pub fn count(&mut self, unsent: bool) {
        self.unsent = self.unsent.saturating_add(u32::from(unsent));
    }

    /// Number of frames that were not sent.
    pub fn unsent(&self) -> u32 {
        self.unsent
    }

    /// Whether all answers are sent.
    pub fn is_answered(&self) -> bool {
        self.answer.is_empty()
    }

    /// The lane of the next frame.
    fn next_lane(&self) -> Lane {
        if !self.urgent.is_empty() {
            Lane::Urgent
        } else if !self.answer.is_empty() {
            Lane::Answer
        } else {
            Lane::Routine
        }
    }

    /// The next byte for the wire. A frame is always completed before the next frame begins.
    pub fn pop(&mut self) -> Option<u8> {
        let lane = self.sending.unwrap_or_else(|| self.next_lane());
        let byte = match lane {
            Lane::Urgent => self.urgent.pop_front(),
            Lane::Answer => self.answer.pop_front(),
            Lane::Routine => self.routine.pop_front(),
        }?;
        self.sending = (byte != 0).then_some(lane);
        Some(byte)
    }
}

fn put<const N: usize>(queue: &mut Deque<u8, N>, frame: &[u8]) -> bool {
    N - queue.len() >= frame.len() && frame.iter().all(|byte| queue.push_back(*byte).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn all<const U: usize, const A: usize, const R: usize>(outbox: &mut Outbox<U, A, R>) -> Vec<u8> {
        core::iter::from_fn(|| outbox.pop()).collect()
    }

    #[test]
    fn urgent_frames_overtake_between_frames_only() {
        let mut outbox = Outbox::<8, 8, 8>::new();
        outbox.put(&[1, 2, 0], Lane::Routine);
        outbox.put(&[3, 0], Lane::Routine);
        assert_eq!(outbox.pop(), Some(1));
        outbox.put(&[5, 0], Lane::Answer);
        outbox.put(&[9, 0], Lane::Urgent);
        assert!(!outbox.is_answered());
        assert_eq!(all(&mut outbox), [2, 0, 9, 0, 5, 0, 3, 0]);
        assert_eq!((outbox.unsent(), outbox.is_answered()), (0, true));
    }

    #[test]
    fn a_full_lane_leaves_frames_out_whole_and_spares_the_other() {
        let mut outbox = Outbox::<4, 4, 4>::new();
        outbox.put(&[1, 2, 0], Lane::Routine);
        outbox.put(&[3, 0], Lane::Routine);
        outbox.put(&[4, 5, 6, 0], Lane::Urgent);
        outbox.put(&[7, 0], Lane::Urgent);
        outbox.put(&[8, 0], Lane::Answer);
        assert_eq!(outbox.unsent(), 2);
        assert_eq!(all(&mut outbox), [4, 5, 6, 0, 8, 0, 1, 2, 0]);
    }
}
