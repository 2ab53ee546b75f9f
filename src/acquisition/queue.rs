//! Queue of raw samples from the data-ready interrupt to the main loop.
//!
//! Its two ends are types of their own: one producer, one consumer. Every sample that does not get through is counted by
//! its reason; the producer counts, the consumer reads.

use crate::base::linear::Real;
use crate::base::loss::{Loss, Losses};
use crate::base::sample::RawSample;
use crate::gimbal::GimbalStatus;
use core::sync::atomic::{AtomicU32, Ordering};
use heapless::spsc;

/// A sample, and how the gimbal was when it came.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observed<T: Real> {
    /// The sample.
    pub sample: RawSample<T>,
    /// The gimbal.
    pub gimbal: GimbalStatus,
}

/// Written by the producer only, read by both.
struct Counters {
    overrun: AtomicU32,
    bus: AtomicU32,
    crc: AtomicU32,
    status: AtomicU32,
    unread: AtomicU32,
    deepest: AtomicU32,
}

/// Memory of the queue; holds `N - 1` samples.
pub struct SampleQueue<T: Real, const N: usize> {
    samples: spsc::Queue<Observed<T>, N>,
    counters: Counters,
}

impl<T: Real, const N: usize> SampleQueue<T, N> {
    /// An empty queue.
    pub const fn new() -> Self {
        let counters = Counters {
            overrun: AtomicU32::new(0),
            bus: AtomicU32::new(0),
            crc: AtomicU32::new(0),
            status: AtomicU32::new(0),
            unread: AtomicU32::new(0),
            deepest: AtomicU32::new(0),
        };
        Self { samples: spsc::Queue::new(), counters }
    }

    /// The two ends.
    pub fn split(&mut self) -> (SampleProducer<'_, T>, SampleConsumer<'_, T>) {
        let (producer, consumer) = self.samples.split();
        let counters = &self.counters;
        (SampleProducer { samples: producer, counters }, SampleConsumer { samples: consumer, counters })
    }
}

impl<T: Real, const N: usize> Default for SampleQueue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Always so: the queue does not compile for `N` < 2. Its ends have forgotten `N`, and index by a remainder; asking makes
/// sure that the division cannot panic.
fn has_memory(capacity: usize) -> bool {
    capacity != usize::MAX
}

/// The interrupt's end.
pub struct SampleProducer<'q, T: Real> {
    samples: spsc::Producer<'q, Observed<T>>,
    counters: &'q Counters,
}

impl<T: Real> SampleProducer<'_, T> {
    /// Adds a sample; a full queue keeps what it has and counts an overrun.
    ///
    /// # Errors
    /// [`Loss::Overrun`], already counted.
    pub fn push(&mut self, sample: Observed<T>) -> Result<(), Loss> {
        if has_memory(self.samples.capacity()) && self.samples.enqueue(sample).is_ok() {
            let deepest = &self.counters.deepest;
            deepest.store(deepest.load(Ordering::Relaxed).max(self.samples.len() as u32), Ordering::Relaxed);
            return Ok(());
        }
        self.count(Loss::Overrun, 1);
        Err(Loss::Overrun)
    }

    /// Counts samples that never became one.
    pub fn count(&mut self, loss: Loss, samples: u32) {
        let counter = match loss {
            Loss::Overrun => &self.counters.overrun,
            Loss::Bus => &self.counters.bus,
            Loss::Crc => &self.counters.crc,
            Loss::Status => &self.counters.status,
            Loss::Unread => &self.counters.unread,
        };
        // The only writer: load and store need not be one step.
        counter.store(counter.load(Ordering::Relaxed).saturating_add(samples), Ordering::Relaxed);
    }
}

/// The main loop's end.
pub struct SampleConsumer<'q, T: Real> {
    samples: spsc::Consumer<'q, Observed<T>>,
    counters: &'q Counters,
}

impl<T: Real> SampleConsumer<'_, T> {
    /// The oldest sample.
    pub fn pop(&mut self) -> Option<Observed<T>> {
        if has_memory(self.samples.capacity()) { self.samples.dequeue() } else { None }
    }

    /// Whether there is nothing to pop.
    pub fn is_empty(&self) -> bool {
        !self.samples.ready()
    }

    /// The most samples that have waited at once.
    pub fn deepest(&self) -> u32 {
        self.counters.deepest.load(Ordering::Relaxed)
    }

    /// The samples missing so far.
    pub fn losses(&self) -> Losses {
        let load = |counter: &AtomicU32| counter.load(Ordering::Relaxed);
        Losses {
            overrun: load(&self.counters.overrun),
            bus: load(&self.counters.bus),
            crc: load(&self.counters.crc),
            status: load(&self.counters.status),
            unread: load(&self.counters.unread),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(time_us: u64) -> Observed<f32> {
        Observed { sample: RawSample { time_us, ..RawSample::default() }, ..Observed::default() }
    }

    #[test]
    fn samples_come_out_in_order_across_threads() {
        let mut queue = SampleQueue::<f32, 8>::new();
        let (mut producer, mut consumer) = queue.split();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for time_us in 0..10_000 {
                    while producer.push(sample(time_us)).is_err() {
                        std::thread::yield_now();
                    }
                }
            });
            let popped = core::iter::from_fn(|| {
                loop {
                    match consumer.pop() {
                        Some(observed) => return Some(observed.sample.time_us),
                        None => std::thread::yield_now(),
                    }
                }
            });
            assert!(popped.take(10_000).eq(0..10_000));
        });
    }

    #[test]
    fn an_overrun_keeps_the_old_samples_and_is_counted() {
        let mut queue = SampleQueue::<f32, 4>::new();
        let (mut producer, mut consumer) = queue.split();
        let pushed: Vec<_> = (0..5).map(|time_us| producer.push(sample(time_us)).is_ok()).collect();
        assert_eq!(pushed, [true, true, true, false, false]);
        assert_eq!(consumer.losses(), Losses { overrun: 2, ..Losses::default() });
        assert_eq!(consumer.deepest(), 3);
        assert!((0..3).all(|time_us| consumer.pop().map(|observed| observed.sample.time_us) == Some(time_us)));
        assert!(consumer.is_empty());
    }

    #[test]
    fn counters_saturate() {
        let mut queue = SampleQueue::<f32, 4>::new();
        let (mut producer, consumer) = queue.split();
        producer.count(Loss::Unread, u32::MAX);
        producer.count(Loss::Unread, 5);
        producer.count(Loss::Bus, 1);
        assert_eq!(consumer.losses().unread, u32::MAX);
        assert_eq!(consumer.losses().total(), u32::MAX);
    }
}
