//! The main loop for a recording. The samples come from a log, not from an IMU. There is no motion and no store.

use super::surroundings::{Done, Surroundings};
use super::tell::tell;
use crate::base::linear::Real;
use crate::estimator::MAX_SEGMENTS;
use crate::link::{Hello, Link};
use crate::run::calibrator::Calibrator;
use crate::run::config::CalibratorConfig;
use crate::run::state::State;
use crate::run::telemetry::Message;
use crate::verdict::VerdictLimits;

/// Takes the samples of a recording, and computes the solution when they end.
#[derive(Debug)]
pub struct Recording<'m, T: Real> {
    calibrator: &'m mut Calibrator<T, MAX_SEGMENTS>,
    link: &'m mut Link,
    samples: u64,
}

impl<'m, T: Real> Recording<'m, T> {
    /// The instrument before the first sample.
    #[inline(never)]
    pub fn new(config: &CalibratorConfig, link: &'m mut Link, calibrator: &'m mut Calibrator<T, MAX_SEGMENTS>) -> Self {
        link.greet(Hello::new::<T>());
        calibrator.restart(config);
        Self { calibrator, link, samples: 0 }
    }

    /// One turn of the main loop: processes all waiting samples.
    pub fn turn(&mut self, outside: &mut impl Surroundings<T>) {
        while let Some(observed) = outside.next_sample() {
            self.samples += 1;
            let progress = self.calibrator.step(&observed.sample);
            if let Some(progress) = progress {
                tell(self.link, outside, &Message::Segment(progress));
            }
            outside.done(Done::Sample { during: State::PowerUp, ends_segment: progress.is_some() });
        }
    }

    /// The end of the recording: computes the solution, judges it, and reports the result.
    #[inline(never)]
    pub fn conclude(&mut self, outside: &mut impl Surroundings<T>) {
        let solution = self.calibrator.conclude(&mut |message| tell(self.link, outside, message));
        let verdict = self.calibrator.judge(&solution, None, &VerdictLimits::default());
        tell(self.link, outside, &Message::Judged(verdict));
        let losses = outside.losses();
        tell(self.link, outside, &Message::Queue { samples: self.samples, losses });
    }
}
