//! Studies of many runs: statistics, disturbances, failures, and the paper's own results.

pub mod chaos;
pub mod closed_loop;
pub mod effects_table;
pub mod fault_campaign;
pub mod fault_table;
pub mod faults;
pub mod hostile_line;
pub mod methods_table;
pub mod monte_carlo;
pub mod power_ups;
pub mod promises;
pub mod replication;
pub mod separating;
pub mod statistics;
