//! Black box: the last events, in memory that keeps its content over a reset, and why the software has stopped.
//!
//! ```text
//! slot, little-endian   0-3      sequence number from 0; its remainder by the number of slots is the place of the slot
//!                       4..60    postcard of time, event and repeats, then zeros
//!                       60-63    CRC-32/ISO-HDLC of the format's number and all bytes before
//! ```
//! An event is one slot, so a reset during a write damages one event only. Any content of the memory at power-on is a
//! valid black box; most likely it is an empty black box. Starts that end in the same way, such as those of an
//! instrument with a broken IMU, are folded into one start with a count. So the events that led to the first of them
//! are kept.

use crate::base::restart::{FatalError, Restart};
use crate::gimbal::Fault;
use crate::run::abort::Abort;
use crate::run::config::ConfigError;
use crate::run::policy::Decision;
use crate::run::state::State;
use crate::run::telemetry::Message;
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::{Deserialize, Serialize};

/// Memory of one event, bytes.
pub const SLOT_BYTES: usize = 64;

const SEQUENCE_BYTES: usize = 4;
const CRC_BYTES: usize = 4;
/// Count it up when the encoding of an event changes.
const FORMAT: u8 = 2;
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

type Slot = [u8; SLOT_BYTES];

/// An event that is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The software has started, for this reason.
    Restarted(Restart),
    /// The software stops itself with the motors off. A reset follows.
    Stopped(FatalError),
    /// The run has entered a state.
    State(State),
    /// The decision at power-up or on command, and its cause.
    Decided(Decision),
    /// Both axes are stopped because of a fault of one axis.
    Fault(Fault),
    /// The run was given up.
    Aborted(Abort),
    /// A result was judged, with this number of doubts; 0 means accepted.
    Judged(u16),
    /// Storing has ended; `true` if it succeeded.
    Saved(bool),
    /// The configuration was refused.
    Refused(ConfigError),
    /// A slot of the calibration store is damaged.
    StoreDamaged,
    /// The memory of the calibration store does not work.
    StoreFault,
    /// The axes are brought to rest and then no longer controlled.
    Released,
}

impl Event {
    /// The event of a message, if the message is recorded. Only the first state of a leg is recorded, so that a whole
    /// run fits.
    pub fn of(message: &Message) -> Option<Self> {
        match message {
            Message::Restarted(restart) => Some(Self::Restarted(restart.clone())),
            Message::State { state: State::Settle(_) | State::Dwell(_) | State::Weigh(_), .. } => None,
            Message::State { state, .. } => Some(Self::State(*state)),
            Message::Decided(decision) => Some(Self::Decided(*decision)),
            Message::Fault(fault) => Some(Self::Fault(*fault)),
            Message::Aborted(abort) => Some(Self::Aborted(*abort)),
            Message::Judged(verdict) => Some(Self::Judged((verdict.reasons.len() as u16).saturating_add(verdict.more))),
            Message::Saved(saved) => Some(Self::Saved(*saved)),
            Message::Refused(error) => Some(Self::Refused(*error)),
            Message::Store { fault: true, .. } => Some(Self::StoreFault),
            Message::Store { damaged: true, .. } => Some(Self::StoreDamaged),
            Message::Released => Some(Self::Released),
            Message::Store { .. }
            | Message::Segment(_)
            | Message::Innovations(_)
            | Message::Solved { .. }
            | Message::Covariance { .. }
            | Message::Corrected { .. }
            | Message::Queue { .. } => None,
        }
    }
}

impl Restart {
    /// The reason of the start, from what the hardware knows and from the last event of the black box.
    pub fn after(hardware: Option<Self>, last: Option<Entry>) -> Self {
        match (hardware, last) {
            (Some(Self::PowerOn), _) | (None, None) => Self::PowerOn,
            (_, Some(Entry { event: Event::Stopped(stop), .. })) => Self::Stopped(stop),
            (Some(known), _) => known,
            (None, Some(_)) => Self::Unexplained,
        }
    }
}

/// A recorded event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Entry {
    /// Number of the event, counted from 0 over all starts.
    pub sequence: u32,
    /// Time since the last start, us.
    pub time_us: u64,
    /// The event.
    pub event: Event,
    /// For the event of a stop: the number of further starts that went the same way, event for event; 255 means 255 or
    /// more.
    pub repeats: u8,
}

impl Entry {
    fn is_stop(&self) -> bool {
        matches!(self.event, Event::Stopped(_))
    }
}

/// The memory of the black box. Any bytes are valid.
#[derive(Debug)]
#[repr(transparent)]
pub struct BlackBox<const N: usize> {
    slots: [Slot; N],
}

impl<const N: usize> BlackBox<N> {
    /// An empty black box.
    pub const fn new() -> Self {
        Self { slots: [[0; SLOT_BYTES]; N] }
    }

    /// Deletes all events.
    pub fn clear(&mut self) {
        *self = Self::new();
    }

    /// The newest event. Reads the whole memory, so use it at the start only.
    pub fn newest(&self) -> Option<Entry> {
        let sequences = (0..).zip(&self.slots).filter_map(|(place, slot)| {
            let sequence = sequence(slot)?;
            (sequence as usize % N == place).then_some(sequence)
        });
        self.entry(sequences.max()?)
    }

    /// The event with this number, if it is still in the memory.
    pub fn entry(&self, sequence: u32) -> Option<Entry> {
        let slot = self.slots.get((sequence as usize).checked_rem(N)?)?;
        decode(slot).filter(|entry| entry.sequence == sequence)
    }

    /// Deletes the events of the last start if the start before went the same way, and counts the start there. Called
    /// at the next start.
    pub fn fold(&mut self) {
        let Some(last) = self.newest().filter(Entry::is_stop) else { return };
        let back = |count: u32| last.sequence.checked_sub(count).and_then(|sequence| self.entry(sequence));
        let is_end = |count: &u32| back(*count).is_none_or(|entry| entry.is_stop());
        let Some(length) = (1..N as u32).find(is_end) else { return };
        let alike = (0..length).all(|count| {
            back(count).zip(back(length + count)).is_some_and(|(last, before)| last.event == before.event)
        });
        // The start before may have begun earlier and have more events.
        let alike = alike && back(2 * length).is_none_or(|entry| entry.is_stop());
        let Some(end) = back(length).filter(|_| alike) else { return };
        self.record(&Entry { repeats: end.repeats.saturating_add(1), ..end });
        (0..length).for_each(|count| self.forget(last.sequence.saturating_sub(count)));
    }

    fn forget(&mut self, sequence: u32) {
        if let Some(slot) = self.slot_mut(sequence) {
            *slot = [0; SLOT_BYTES];
        }
    }

    fn slot_mut(&mut self, sequence: u32) -> Option<&mut Slot> {
        self.slots.get_mut((sequence as usize).checked_rem(N)?)
    }

    /// Records an event with the number after that of the newest event.
    pub fn record(&mut self, entry: &Entry) {
        if let Some((place, slot)) = self.slot_mut(entry.sequence).zip(encode(entry)) {
            *place = slot;
        }
    }
}

impl<const N: usize> Default for BlackBox<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The CRC includes the format's number, because the memory may outlive the software: events of another format count as
/// damaged.
fn checksum(framed: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&[FORMAT]);
    digest.update(framed);
    digest.finalize()
}

/// Sequence number of an intact slot.
fn sequence(slot: &Slot) -> Option<u32> {
    let (framed, crc) = slot.split_last_chunk::<CRC_BYTES>()?;
    let whole = checksum(framed) == u32::from_le_bytes(*crc);
    framed.first_chunk().filter(|_| whole).map(|bytes| u32::from_le_bytes(*bytes))
}

fn decode(slot: &Slot) -> Option<Entry> {
    let sequence = sequence(slot)?;
    let (time_us, event, repeats) = postcard::take_from_bytes(slot.get(SEQUENCE_BYTES..)?).ok()?.0;
    Some(Entry { sequence, time_us, event, repeats })
}

fn encode(entry: &Entry) -> Option<Slot> {
    let mut slot = [0; SLOT_BYTES];
    let (framed, crc) = slot.split_last_chunk_mut::<CRC_BYTES>()?;
    *framed.first_chunk_mut()? = entry.sequence.to_le_bytes();
    postcard::to_slice(&(entry.time_us, &entry.event, entry.repeats), framed.get_mut(SEQUENCE_BYTES..)?).ok()?;
    *crc = checksum(framed).to_le_bytes();
    Some(slot)
}

// --------------------------------------------------------------------------------------------------------------- texts

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Restarted(restart) => write!(f, "started: {restart}"),
            Self::Stopped(stop) => write!(f, "stopped: {stop}"),
            Self::State(state) => state.fmt(f),
            Self::Decided(decision) => decision.fmt(f),
            Self::Fault(fault) => fault.fmt(f),
            Self::Aborted(abort) => write!(f, "aborted: {abort}"),
            Self::Judged(0) => f.write_str("accepted"),
            Self::Judged(doubts) => write!(f, "rejected for {doubts} reasons"),
            Self::Saved(true) => f.write_str("stored"),
            Self::Saved(false) => f.write_str("not stored"),
            Self::Refused(error) => write!(f, "configuration refused: {error}"),
            Self::StoreDamaged => f.write_str("a stored calibration is damaged"),
            Self::StoreFault => f.write_str("the calibration memory does not work"),
            Self::Released => f.write_str("axes at rest and controlled no longer"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::restart::{Registers, Task};
    use crate::gimbal::FaultKind;
    use crate::run::abort::AbortReason;
    use heapless::String;

    fn entry(sequence: u32) -> Entry {
        Entry { sequence, time_us: 1000 * u64::from(sequence), event: Event::Judged(sequence as u16), repeats: 0 }
    }

    #[test]
    fn the_last_events_are_there_after_a_reset() {
        let mut black_box = BlackBox::<4>::new();
        assert_eq!(black_box.newest(), None);
        (0..6).for_each(|sequence| black_box.record(&entry(sequence)));
        let BlackBox { slots } = black_box;
        let found = BlackBox { slots };
        assert_eq!(found.newest(), Some(entry(5)));
        let there: Vec<_> = (0..7).filter_map(|sequence| found.entry(sequence)).collect();
        assert_eq!(there, [2, 3, 4, 5].map(entry));
    }

    #[test]
    fn a_slot_cut_or_changed_anywhere_costs_one_event() {
        let mut black_box = BlackBox::<4>::new();
        (0..4).for_each(|sequence| black_box.record(&entry(sequence)));
        let whole = black_box.slots;
        let mut next = BlackBox { slots: whole };
        next.record(&entry(4));
        for length in 1..SLOT_BYTES {
            let mut cut = BlackBox { slots: whole };
            cut.slots[0][..length].copy_from_slice(&next.slots[0][..length]);
            let newest = cut.newest().map(|entry| entry.sequence);
            assert_eq!(newest, Some(if cut.slots[0] == next.slots[0] { 4 } else { 3 }), "{length}");
            let mut changed = BlackBox { slots: whole };
            changed.slots[3][length] ^= 0x10;
            assert_eq!(changed.newest(), Some(entry(2)), "{length}");
        }
    }

    /// Records events after the newest event, at the times 1 ms, 2 ms, ...
    fn record(black_box: &mut BlackBox<16>, events: &[Event]) {
        let next = black_box.newest().map_or(0, |newest| newest.sequence + 1);
        for (sequence, event) in (next..).zip(events.iter().cloned()) {
            black_box.record(&Entry { sequence, time_us: 1000 * u64::from(sequence), event, repeats: 0 });
        }
    }

    fn events(black_box: &BlackBox<16>) -> Vec<(u8, Event)> {
        (0..64).filter_map(|sequence| black_box.entry(sequence)).map(|entry| (entry.repeats, entry.event)).collect()
    }

    #[test]
    fn starts_that_end_alike_are_one_with_a_count() {
        let stop = || Event::Stopped(FatalError::Overdue(Task::Sampling));
        let run = [Event::Restarted(Restart::PowerOn), Event::State(State::Turn(3)), stop()];
        let again = [Event::Restarted(Restart::Stopped(FatalError::Overdue(Task::Sampling))), stop()];
        let mut black_box = BlackBox::<16>::new();
        record(&mut black_box, &run);
        black_box.fold();
        for _ in 0..100 {
            record(&mut black_box, &again);
            black_box.fold();
        }
        let expected = run.iter().chain(&again).cloned().zip([0, 0, 0, 0, 99]).map(|(event, repeats)| (repeats, event));
        assert_eq!(events(&black_box), expected.collect::<Vec<_>>());
        // The software stops before it can record that it has started.
        let mut black_box = BlackBox::<16>::new();
        let stuck = Event::Stopped(FatalError::board("no IMU"));
        for _ in 0..100 {
            record(&mut black_box, core::slice::from_ref(&stuck));
            black_box.fold();
        }
        assert_eq!(events(&black_box), [(99, stuck)]);
    }

    #[test]
    fn starts_that_differ_are_kept() {
        let stops =
            [Task::Sampling, Task::Control, Task::Sampling].map(|task| Event::Stopped(FatalError::Overdue(task)));
        let mut black_box = BlackBox::<16>::new();
        for stop in &stops {
            record(&mut black_box, &[Event::Released, stop.clone()]);
            black_box.fold();
        }
        record(&mut black_box, &[Event::Saved(true), stops[2].clone()]);
        black_box.fold();
        assert_eq!(events(&black_box).len(), 8);
        // More events than the memory holds.
        let long: Vec<_> = (0..30).map(Event::Judged).chain([stops[0].clone()]).collect();
        record(&mut black_box, &long);
        let before = events(&black_box);
        black_box.fold();
        assert_eq!((events(&black_box), before.len()), (before, 16));
    }

    #[test]
    fn a_start_that_ends_alike_but_sooner_is_another_one() {
        let stop = Event::Stopped(FatalError::board("no IMU"));
        let mut black_box = BlackBox::<16>::new();
        record(&mut black_box, &[Event::Restarted(Restart::PowerOn), stop.clone()]);
        record(&mut black_box, core::slice::from_ref(&stop));
        black_box.fold();
        assert_eq!(events(&black_box).len(), 3);
    }

    #[test]
    fn what_another_format_has_left_is_no_event() {
        let mut black_box = BlackBox::<4>::new();
        black_box.record(&entry(1));
        assert_eq!(black_box.newest(), Some(entry(1)));
        let slot = &mut black_box.slots[1];
        // The CRC as it was before it included the format's number.
        let crc = CRC.checksum(&slot[..SLOT_BYTES - CRC_BYTES]);
        slot[SLOT_BYTES - CRC_BYTES..].copy_from_slice(&crc.to_le_bytes());
        assert_eq!(black_box.newest(), None);
    }

    #[test]
    fn an_event_in_a_place_of_another_is_none() {
        let mut black_box = BlackBox::<4>::new();
        black_box.record(&entry(1));
        black_box.slots[2] = black_box.slots[1];
        black_box.slots[1] = [0xa5; SLOT_BYTES];
        assert_eq!(black_box.newest(), None);
    }

    #[test]
    fn the_longest_events_fit() {
        let kind = FaultKind::Stall { rate_rad_s: 1.0, wanted_rad_s: 2.0 };
        let reason = AbortReason::Gimbal(Fault { axis: 1, angle_rad: 3.0, kind });
        let registers = Registers { pc: u32::MAX, lr: u32::MAX, status: u32::MAX, address: u32::MAX };
        let events = [
            Event::Stopped(FatalError::panic(&"x".repeat(100), u32::MAX)),
            Event::Restarted(Restart::Stopped(FatalError::Panic { file: String::try_from("y").unwrap(), line: 1 })),
            Event::Restarted(Restart::Stopped(FatalError::board(&"z".repeat(40)))),
            Event::Restarted(Restart::Stopped(FatalError::Fault(registers))),
            Event::Aborted(Abort { reason, during: State::Turn(u16::MAX) }),
        ];
        for event in events {
            let entry = Entry { sequence: u32::MAX - 7, time_us: u64::MAX, event, repeats: u8::MAX };
            let mut black_box = BlackBox::<8>::new();
            black_box.record(&entry);
            assert_eq!(black_box.newest(), Some(entry));
        }
    }

    #[test]
    fn the_reason_of_a_start_is_the_last_word_unless_the_power_was_off() {
        let stop = FatalError::Overdue(Task::Main);
        let said = |event: Event| Some(Entry { event, ..entry(1) });
        let stopped = || said(Event::Stopped(stop.clone()));
        let cases = [
            (None, None, Restart::PowerOn),
            (None, stopped(), Restart::Stopped(stop.clone())),
            (None, said(Event::Saved(true)), Restart::Unexplained),
            (Some(Restart::PowerOn), stopped(), Restart::PowerOn),
            (Some(Restart::Pin), stopped(), Restart::Stopped(stop.clone())),
            (Some(Restart::Watchdog), said(Event::Saved(true)), Restart::Watchdog),
            (Some(Restart::Pin), None, Restart::Pin),
        ];
        for (hardware, last, restart) in cases {
            assert_eq!(Restart::after(hardware, last), restart);
        }
    }

    #[test]
    fn a_fault_says_what_the_processor_met() {
        let fault = Registers { pc: 0x1234, lr: 0x99, status: 1 << 9 | 1 << 15, address: 0x0810_0020 };
        let text = "processor fault, data cannot be read or written, at address 0x08100020; pc 0x00001234, lr 0x00000099, \
                    status 0x00008200";
        assert_eq!(fault.to_string(), text);
        let path = "/long/way/to/the/sources/of/it/src/bin/firmware/main.rs";
        assert_eq!(FatalError::panic(path, 7).to_string(), "panic in s/of/it/src/bin/firmware/main.rs, line 7");
    }
}
