//! A simulated dual-axis rotational INS.
//!
//! ```text
//! presets    vec3 -> kinematics, encoder -> virtual_rins -> drive: open loop, along a scheme
//!                              motor -----------'-> driven: closed loop, through the windings
//! plant: the interface of both to other rooms
//! ```

pub mod drive;
pub mod driven;
pub mod encoder;
pub mod imperfections;
pub mod kinematics;
pub mod motor;
pub mod plant;
pub mod presets;
pub mod unit;
pub mod vec3;
pub mod virtual_rins;
