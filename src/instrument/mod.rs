//! The instrument: the one main loop that firmware, virtual instrument and examples run.
//!
//! ```text
//! samples, time, received bytes                     motion commands, messages, bytes to send
//!            |                                                  ^
//!            v                                                  |
//!      Instrument::turn -> run -> verdict -> Archive, Events    |
//!            |              '-----------------------------------'
//!            '-> corrected samples -> CorrectedSink, and the serial line when asked for
//! ```
//! [`Instrument`] owns the run and the link. Everything around the instrument is behind small traits, [`Surroundings`]: the
//! board's clock and sample queue, the gimbal, the store, the black box, the serial line and whoever uses the corrected
//! samples. [`Instrument::power_up`] says what happens at power-up, [`Instrument::turn`] what happens from then on.

mod commands;
mod main_loop;
mod recording;
mod surroundings;

pub use main_loop::Instrument;
pub use recording::Recording;
pub use surroundings::{Archive, Axes, CorrectedSink, Events, FoundRecord, SerialLine, Surroundings, Telemetry};
