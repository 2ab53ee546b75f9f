//! What outlasts a power-off or a reset: stored calibrations, the configuration of the unit, marks of motion, and the
//! black box. Also the liveness check of the watchdog.
//!
//! ```text
//! CalibrationStore    Journal<Configurations>    Journal<Marks>       what is kept, in memories or partitions of their own
//!        '------------------ slots --------------------'              the log, its search, its erase
//!                            frame                                    letters, version, sequence number, CRC
//!                            medium, partition                        EEPROM or NOR flash
//! ```

pub mod black_box;
pub mod configuration;
pub mod frame;
pub mod journal;
pub mod liveness;
pub mod mark;
pub mod medium;
pub mod partition;
pub mod record;
pub mod slots;
pub mod store;
