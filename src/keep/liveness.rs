//! Checks that every task still runs. The watchdog is fed only if every task runs.
//!
//! Each task reports with the time. The function that feeds the watchdog asks which task is overdue. A report is one
//! atomic word that only its task writes, so interrupts and the main loop need no lock.

use crate::base::restart::Task;
use core::sync::atomic::{AtomicU32, Ordering};

/// The last report of each task, and how old each report may become.
#[derive(Debug)]
pub struct Liveness {
    reported_us: [AtomicU32; 3],
    deadlines_us: [Option<u32>; 3],
}

impl Liveness {
    /// The longest deadline, us: half the range in which past and future times can be told apart.
    pub const LONGEST_US: u32 = i32::MAX as u32 / 2;

    /// Every task counts as having reported at time zero. Deadlines of (sampling, control, main loop), us, at most
    /// [`Self::LONGEST_US`]. A task without a deadline need not report.
    pub const fn new(deadlines_us: [Option<u32>; 3]) -> Self {
        Self { reported_us: [const { AtomicU32::new(0) }; 3], deadlines_us }
    }

    /// Notes that a task runs at this time.
    pub fn report(&self, task: Task, now_us: u64) {
        if let Some(reported) = self.reported_us.get(task as usize) {
            reported.store(now_us as u32, Ordering::Relaxed);
        }
    }

    /// The first task that has not reported in time; `None` if all have. Call it at least once in [`Self::LONGEST_US`].
    pub fn overdue(&self, now_us: u64) -> Option<Task> {
        let mut tasks = Task::ALL.into_iter().zip(self.reported_us.iter().zip(&self.deadlines_us));
        let late = |(_, (reported, deadline)): &(Task, (&AtomicU32, &Option<u32>))| {
            // An interrupt may have reported after `now_us` was read. The age is negative then.
            let age = (now_us as u32).wrapping_sub(reported.load(Ordering::Relaxed)).cast_signed();
            deadline.is_some_and(|deadline| age > deadline.min(Self::LONGEST_US).cast_signed())
        };
        tasks.find(late).map(|(task, _)| task)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEADLINES_US: [Option<u32>; 3] = [Some(20_000), Some(3_000), Some(1_000_000)];

    fn all_report(liveness: &Liveness, now_us: u64) {
        Task::ALL.into_iter().for_each(|task| liveness.report(task, now_us));
    }

    #[test]
    fn each_task_is_missed_after_its_own_deadline() {
        for (task, deadline_us) in Task::ALL.into_iter().zip([20_000, 3_000, 1_000_000]) {
            let liveness = Liveness::new(DEADLINES_US);
            all_report(&liveness, 1_000);
            let last_us = 1_000 + deadline_us;
            for now_us in [last_us, last_us + 1] {
                Task::ALL.into_iter().filter(|other| *other != task).for_each(|other| liveness.report(other, now_us));
                assert_eq!(liveness.overdue(now_us), (now_us > last_us).then_some(task));
            }
        }
    }

    #[test]
    fn who_never_reports_is_missed_and_who_reports_again_lives() {
        let liveness = Liveness::new(DEADLINES_US);
        assert_eq!(liveness.overdue(3_000), None);
        assert_eq!(liveness.overdue(3_001), Some(Task::Control));
        all_report(&liveness, 3_001);
        assert_eq!(liveness.overdue(3_001), None);
    }

    #[test]
    fn a_report_of_a_moment_later_and_a_clock_that_wraps_are_no_matter() {
        let liveness = Liveness::new(DEADLINES_US);
        let wrap_us = u64::from(u32::MAX);
        all_report(&liveness, wrap_us + 500);
        assert_eq!(liveness.overdue(wrap_us - 500), None);
        assert_eq!(liveness.overdue(wrap_us + 3_500), None);
        assert_eq!(liveness.overdue(wrap_us + 3_501), Some(Task::Control));
    }

    #[test]
    fn a_task_without_a_deadline_need_not_report() {
        let liveness = Liveness::new([Some(20_000), None, None]);
        liveness.report(Task::Sampling, 1_000_000);
        assert_eq!(liveness.overdue(1_020_000), None);
        assert_eq!(liveness.overdue(1_020_001), Some(Task::Sampling));
    }
}
