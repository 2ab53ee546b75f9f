//! Marks of motion: whether the gimbal may have turned since its angles were last known, and else where it rests. A mark
//! outlives a loss of power. An encoder knows an angle within a turn; the mark tells the turn.
//!
//! [`Mark::Moving`] is written before the first move of a run, and [`Mark::AtRest`] when the gimbal has come to rest. The
//! letters of the record are `"RSM"`, and a slot has 64 bytes. A sector of 128 KiB holds 2048 marks, so 10 000 runs of
//! two marks each need ten erases: five of each of two sectors, which are good for 10 000. In an EEPROM of 2 KiB the same
//! runs write each slot 625 times; it is good for a million.

use super::journal::{Journal, Latest};
use super::medium::Medium;
use super::slots::Kind;
use serde::{Deserialize, Serialize};

/// Version of the format that is read and written. Count it up whenever the bytes of a [`Mark`] change.
pub const MARK_VERSION: u8 = b'1';
/// Memory of one mark, bytes.
pub const MARK_BYTES: usize = 64;
/// Number of marks that can be written between two power-ups without an erase: a hundred runs.
pub const MARKS_AHEAD: usize = 200;

/// What is known of the gimbal's motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mark {
    /// The gimbal may have turned by any angle.
    Moving,
    /// The gimbal is at rest.
    AtRest {
        /// Angles of the outer and the inner axis, counted over whole turns, rad.
        angles_rad: [f64; 2],
    },
}

/// Marks of motion.
#[derive(Debug)]
pub enum Marks {}

impl Kind for Marks {
    const MAGIC: [u8; 3] = *b"RSM";
    const VERSION: u8 = MARK_VERSION;
    type Slot = [u8; MARK_BYTES];
    const BLANK: [u8; MARK_BYTES] = [0xff; MARK_BYTES];
    type Record = Mark;
}

impl<M: Medium> Journal<M, Marks> {
    /// The last mark; `None` if nothing was ever marked. If a newer mark may be lost, because the write of a mark was cut
    /// or because the memory does not work, the answer is [`Mark::Moving`]: an older [`Mark::AtRest`] is not given.
    pub fn last_mark(&mut self) -> Option<Mark> {
        match self.load() {
            Ok(Latest { record, damage: None }) => record,
            Ok(Latest { damage: Some(_), .. }) | Err(_) => Some(Mark::Moving),
        }
    }
}
