//! A dual-axis rotational INS that exists in numbers only.
//!
//! ```text
//! presets    vec3 -> kinematics, encoder -> virtual_rins -> drive: open loop, along a scheme
//!                              motor -----------'-> driven: its windings driven
//! plant: what both are to others
//! ```

pub mod drive;
pub mod driven;
pub mod encoder;
pub mod kinematics;
pub mod motor;
pub mod plant;
pub mod presets;
pub mod unit;
pub mod vec3;
pub mod virtual_rins;
