//! The program `rins`: it reads arguments and writes text and files. The other rooms do the work.

mod apply;
mod arguments;
mod calibrate;
mod command_line;
mod compare;
mod ending;
mod explain;
mod files;
mod guide;
mod history;
mod inspect;
mod interrupt;
mod manual;
mod monitor;
mod monte_carlo;
mod observability;
mod output;
mod plan;
mod program;
mod progress;
mod prose;
mod replay;
mod replicate;
mod separating;
mod simulate;

pub use program::main;
