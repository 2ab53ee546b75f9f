//! The watchdog. The waking interrupt feeds it after it has checked that every task still runs.
//!
//! A board may start the hardware first of all. Until the main loop runs, the waking interrupt feeds it for a limited time.
//!
//! A task that is overdue stops the program, as a fault does. If even the waking interrupt does not run, the watchdog
//! resets the processor.

use crate::board::{Board, ThisBoard};
use core::sync::atomic::{AtomicBool, Ordering};
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Task;
use rins_selfcal::keep::liveness::Liveness;

static LIVENESS: Liveness = Liveness::new(ThisBoard::DEADLINES_US);
/// Set by the first turn of the main loop. Power-up may take longer than a deadline.
static STARTED: AtomicBool = AtomicBool::new(false);

/// Notes that a task runs at this time, us. The main loop's first report starts the check.
pub fn report(task: Task, now_us: u64) {
    LIVENESS.report(task, now_us);
    if task == Task::Main && !STARTED.load(Ordering::Relaxed) {
        // The other tasks begin at about this time.
        Task::ALL.into_iter().for_each(|task| LIVENESS.report(task, now_us));
        ThisBoard::start_watchdog();
        STARTED.store(true, Ordering::Relaxed);
    }
}

/// Notes that the main loop still runs, during a long operation.
pub fn progress(now_us: u64) {
    LIVENESS.report(Task::Main, now_us);
}

/// The check of the waking interrupt, ten times a second.
pub fn check(now_us: u64) {
    let overdue = match (STARTED.load(Ordering::Relaxed), ThisBoard::POWER_UP_US) {
        (true, _) => LIVENESS.overdue(now_us),
        (false, Some(longest_us)) => (now_us > longest_us).then_some(Task::Main),
        (false, None) => return,
    };
    match overdue {
        None => ThisBoard::feed_watchdog(),
        Some(task) => ThisBoard::stop(&FatalError::Overdue(task)),
    }
}
