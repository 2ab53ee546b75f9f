//! The instrument: the main loop that firmware, virtual instrument and examples share.
//!
//! ```text
//! samples, time, received bytes                     motion commands, messages, bytes to send
//!            |                                                  ^
//!            v                                                  |
//!      Instrument::turn -> run -> verdict -> Archive, Events    |
//!            |              '-----------------------------------'
//!            '-> corrected samples -> CorrectedSink, and the serial line on request
//! ```
//! [`Instrument`] owns the run and the link. The traits of [`Surroundings`] stand for everything around the instrument:
//! the board's clock and sample queue, the gimbal, the store, the black box, the serial line, and the user of the
//! corrected samples. [`Instrument::power_up`] is the sequence at power-up, and [`Instrument::turn`] is one turn of the
//! main loop.

mod commands;
#[cfg(feature = "defmt")]
mod logged;
mod main_loop;
mod motion_log;
mod recording;
mod startup;
mod surroundings;
mod tell;
mod unit_memory;

pub use main_loop::Instrument;
pub use recording::Recording;
pub use startup::Startup;
pub use surroundings::{
    Archive, Axes, CorrectedSink, Done, Events, FoundConfiguration, FoundRecord, SerialLine, Surroundings, Telemetry,
};
pub use unit_memory::UnitMemory;
