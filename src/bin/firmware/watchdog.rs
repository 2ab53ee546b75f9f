//! The watchdog: fed by the waking interrupt, which makes sure first that everything else goes on.
//!
//! A task that is overdue ends the program, as any fault does. Where not even the waking interrupt gets through, the
//! watchdog itself bites.

use crate::board::{Board, ThisBoard};
use core::sync::atomic::{AtomicBool, Ordering};
use rins_selfcal::base::restart::FatalError;
use rins_selfcal::base::restart::Task;
use rins_selfcal::keep::liveness::Liveness;

static LIVENESS: Liveness = Liveness::new(ThisBoard::DEADLINES_US);
/// Set by the main loop's first turn: what comes before may take its time.
static STARTED: AtomicBool = AtomicBool::new(false);

/// A task lives at this time, us. The main loop's first report starts the watch.
pub fn report(task: Task, now_us: u64) {
    LIVENESS.report(task, now_us);
    if task == Task::Main && !STARTED.load(Ordering::Relaxed) {
        // The others begin about now.
        Task::ALL.into_iter().for_each(|task| LIVENESS.report(task, now_us));
        ThisBoard::start_watchdog();
        STARTED.store(true, Ordering::Relaxed);
    }
}

/// The main loop lives, in the middle of something long.
pub fn progress(now_us: u64) {
    LIVENESS.report(Task::Main, now_us);
}

/// What the waking interrupt does: ten times a second.
pub fn check(now_us: u64) {
    if !STARTED.load(Ordering::Relaxed) {
        return;
    }
    match LIVENESS.overdue(now_us) {
        None => ThisBoard::feed_watchdog(),
        Some(task) => ThisBoard::stop(&FatalError::Overdue(task)),
    }
}
