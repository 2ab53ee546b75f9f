//! One message to all its receivers.

use super::surroundings::Surroundings;
use crate::base::linear::Real;
use crate::keep::black_box::Event;
use crate::link::{Link, MAX_FRAME_BYTES};
use crate::run::telemetry::Message;

/// Passes a message to all its receivers: the black box, the serial line, and the channels of the board. Not inlined,
/// because the frame needs the stack.
#[inline(never)]
pub(super) fn tell<T: Real>(link: &mut Link, outside: &mut impl Surroundings<T>, message: &Message) {
    if let Some(event) = Event::of(message) {
        outside.record(event);
    }
    let mut buffer = [0; MAX_FRAME_BYTES];
    let frame = link.tell(message, &mut buffer);
    outside.tell(message, frame);
    outside.transmit(link);
}
